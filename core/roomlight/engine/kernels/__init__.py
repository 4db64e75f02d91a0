"""Compiled kernels. Each stands beside a readable twin elsewhere in the package, and a test holds the two
together."""
