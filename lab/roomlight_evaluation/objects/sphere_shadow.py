"""The shadow of a sphere that rests on a horizontal surface, under light from far away.

It is the irradiance with the sphere relative to that without, by luminance, without what the sphere reflects (Debevec
1998, differential rendering), at points around the sphere's foot.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles
from roomlight.spheres import resize_panorama

ROWS: Final = 40
"""Of the panorama that casts the shadow: 4.5 degrees a row."""
SHADED: Final = 0.05
"""The shadow counts where the true light makes it at least this deep, in logarithms."""
_REACH: Final = 4.0
"""Of the shadow, in radii of the sphere."""
_STEP: Final = 0.4


def shadow_of_sphere(panorama: Float[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " n"]:
    """Return the irradiance with a sphere / without it at points around the sphere's foot; 1 in the dark."""
    cosine, blocked = shadow_tables()
    light = resize_panorama(panorama, ROWS).reshape(-1, 3)[: len(cosine)] @ LUMINANCE * cosine
    total = light.sum()
    return (1 - blocked @ light / total if total > 0 else np.ones(len(blocked))).astype(np.float32)


@lru_cache(maxsize=1)
def shadow_tables() -> tuple[Float32[np.ndarray, " d"], Float32[np.ndarray, "n d"]]:
    """Return for the directions above the horizon, in the order of a panorama of `ROWS` rows: cosine times solid angle,
    and by point whether a unit sphere hides the direction.
    """
    directions = panorama_directions(ROWS).reshape(-1, 3)[: ROWS // 2 * 2 * ROWS].astype(np.float32)
    solid_angle = np.broadcast_to(panorama_solid_angles(ROWS), (ROWS, 2 * ROWS)).reshape(-1)[: len(directions)]
    ticks = np.arange(-_REACH, _REACH + _STEP / 2, _STEP)
    x, z = (axis.reshape(-1) for axis in np.meshgrid(ticks, ticks))
    outside = (np.hypot(x, z) < _REACH) & (np.hypot(x, z) > _STEP)
    toward = np.stack([-x, np.ones_like(x), -z], axis=-1)[outside].astype(np.float32)
    along = toward @ directions.T
    hidden = (along > 0) & ((toward**2).sum(axis=1)[:, None] - along**2 < 1)
    return (directions[:, 1] * solid_angle).astype(np.float32), hidden.astype(np.float32)
