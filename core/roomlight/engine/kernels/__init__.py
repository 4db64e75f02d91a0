"""Compiled kernels. Each has a readable reference in NumPy elsewhere in the package, and a test that compares them."""
