"""Furnished and lit rooms: shells, finishes, furniture, placement and lights. Does not import PyTorch.

Start at `build.build_room`.
"""
