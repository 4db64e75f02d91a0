"""Small HDR panoramas for tests."""

import numpy as np

from roomlight.conventions import panorama_directions
from roomlight.images import write_exr

NAMES = ("attic_01", "attic_02", "barn", "shed", "den_2k", "den_05", "loft")


def panorama(seed=0, height=64):
    """A smooth room: a bright window, a lamp of one degree overhead, a floor darker than the ceiling."""
    direction = panorama_directions(height)
    x, y, z = np.moveaxis(direction, -1, 0)
    tint = 1 + 0.3 * np.sin(3 * direction + seed)
    image = (0.4 + 0.2 * y)[..., None] * tint
    image[(x > 0.9) & (np.abs(y) < 0.25)] = (20.0, 22.0, 25.0)
    image[(y > 0.93) & (np.abs(z) < 0.1)] = (60.0, 50.0, 40.0)
    return image.astype(np.float32)


def folder_of(path, names=NAMES, height=64):
    """Write a folder of panoramas."""
    path.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        write_exr(path / f"{name}.exr", panorama(number, height))
    return path
