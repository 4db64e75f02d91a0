"""Sequences of path-traced rooms on disk: reading them for training, writing them from the generator. Needs no PyTorch.

Start at `loader.Dataset`, which reads any sequence by number. `recording` is one sequence in memory, `sequence_files`
its files, `shards` and `folder` the tar files and their manifest, `verify` their checksums; `arkit_depth` degrades
exact depth to a phone's.
"""
