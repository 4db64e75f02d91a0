"""Compiled kernels that several packages share: sampling, GGX reflection, sRGB encoding."""
