"""Compiled kernels of the light forms; each has a readable reference in the tests."""
