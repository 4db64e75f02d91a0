"""Compiled kernels of the compositor."""
