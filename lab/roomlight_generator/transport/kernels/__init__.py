"""Compiled kernels of the light transport; `structs` lists their arguments with shapes."""
