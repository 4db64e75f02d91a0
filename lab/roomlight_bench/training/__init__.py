"""Benchmarks of training: a step by its parts, and the rendering layer's sampling."""
