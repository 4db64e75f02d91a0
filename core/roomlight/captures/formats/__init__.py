"""Readers of capture formats: one module a format."""
