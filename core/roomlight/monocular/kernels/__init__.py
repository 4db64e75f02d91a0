"""Compiled kernels of estimated depth. `reference` has a readable twin of each, and tests compare them."""
