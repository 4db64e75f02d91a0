"""Furnished, lit rooms from a seed: shells, textures, furniture, placement and lights. Needs no PyTorch."""
