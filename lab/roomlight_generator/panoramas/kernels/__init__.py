"""Numba kernels of the rooms lit by panoramas."""
