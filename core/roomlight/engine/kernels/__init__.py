"""Compiled kernels. `reference` has a readable twin of each, and tests compare them."""
