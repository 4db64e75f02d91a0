"""Benchmarks of virtual objects in frames."""
