"""Benchmark of the engine's stages beside references, plain PyTorch and the roofline."""
