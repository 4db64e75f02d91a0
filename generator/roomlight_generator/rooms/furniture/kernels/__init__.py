"""Numba loops over triangles; their annotations are not checked, for numba compiles them from their source."""
