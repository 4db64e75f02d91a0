"""Benchmark of training: a step by its parts."""
