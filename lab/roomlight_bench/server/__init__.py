"""Benchmarks of the server: load, and a neighbour beside attacks."""
