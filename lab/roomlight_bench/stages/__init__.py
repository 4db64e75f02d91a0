"""Benchmark of the engine's stages beside references and plain PyTorch."""
