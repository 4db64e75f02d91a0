"""Sequences of path-traced rooms: camera motion, exposure, shards, loading. Needs no PyTorch."""
