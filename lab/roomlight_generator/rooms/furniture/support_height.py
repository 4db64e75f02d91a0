"""Height of a model's supporting surface, measured by rays from above: few library catalogues give it."""

from typing import Final

import numpy as np

from roomlight.rays import RayTree
from roomlight_generator.rooms.scene import Mesh

_GRID: Final = 11
_LEVEL_M: Final = 0.012
"""Heights that differ by less than twice this value are one surface."""

_FLAT: Final = 0.6
_LISTED_FLAT: Final = 0.45
"""Minimum share of the footprint that lies at one height, if measured and if listed in the catalogue file."""

_ABOVE: Final = 0.1
"""Maximum share of the footprint that may rise above that height: objects are placed anywhere and must not intersect a
mirror."""

_LOW_M: Final = 0.15


def measure_top_m(mesh: Mesh, *, listed_m: float | None) -> float | None:
    """Return the height of the flat surface that takes up most of the model seen from above, or None.

    The height listed in the catalogue file is preferred to the most frequent height.
    """
    low, high = mesh.bounds()
    along = (np.arange(_GRID) + 0.5) / _GRID * 0.94 + 0.03
    x, z = np.meshgrid(low[0] + along * (high[0] - low[0]), low[2] + along * (high[2] - low[2]))
    origins = np.stack([x.ravel(), np.full(x.size, high[1] + 0.1), z.ravel()], 1).astype(np.float32)
    down = np.broadcast_to(np.array([0, -1, 0], np.float32), origins.shape).copy()
    hits = RayTree(mesh.vertices, mesh.faces).trace(origins, down)
    heights = np.where(hits.face >= 0, high[1] + 0.1 - hits.distance_m, -1.0)
    common = max(heights, key=lambda height: float((abs(heights - height) < _LEVEL_M).mean()))
    for level, least in ((listed_m, _LISTED_FLAT), (float(common), _FLAT)):
        if level is None or level < _LOW_M:
            continue
        flat = float((abs(heights - level) < 2 * _LEVEL_M).mean())
        if flat >= least and float((heights > level + 2 * _LEVEL_M).mean()) <= _ABOVE:
            return float(np.clip(level, 0, high[1]))
    return None
