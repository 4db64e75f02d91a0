"""Compiled kernels of the light transport."""
