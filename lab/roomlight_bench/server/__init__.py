"""Benchmarks of the server: load, attacks, kills, replicas, capacity."""
