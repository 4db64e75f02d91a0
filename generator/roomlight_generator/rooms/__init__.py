"""Procedural furnished and lit rooms: shells, textures, furniture, placement and lights. Does not import PyTorch.

Start at `build.build_room`.
"""
