"""Numba kernels over triangles; their annotations are not checked at run time, since numba compiles their source."""
