"""Compiled kernels of the forms of light; each has a readable reference in the tests."""
