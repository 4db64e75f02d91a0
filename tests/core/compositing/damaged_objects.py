"""Damage to the files of objects, for the tests of the loader and of the server."""

import numpy as np


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip, overwrite, cut or repeat bytes."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(0, len(out)))
        kind = rng.integers(0, 5)
        if kind == 0:
            out[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            out[at : at + 4] = rng.bytes(4)
        elif kind == 2:
            out[at : at + 4] = b"\xff\xff\xff\x7f"
        elif kind == 3:
            del out[at : at + int(rng.integers(1, 40))]
        else:
            out[at:at] = out[at : at + int(rng.integers(1, 40))]
    return bytes(out)
