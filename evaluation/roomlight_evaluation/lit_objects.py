"""What a panorama does to an object: the pictures of three spheres, and the shadow of a sphere on the surface below it.

The spheres are those of `roomlight.spheres`, clamped to white as a camera clamps them; the diffuse one has an albedo of
`DIFFUSE_ALBEDO`. The shadow is the irradiance on a horizontal surface with a sphere on it, relative to that
without, luminance, for light from far away and without what the sphere reflects (Debevec 1998, differential rendering).
"""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles
from roomlight.spheres import Material, SphereRenderer, resize_panorama

SPHERES: Final[tuple[Material, ...]] = ("diffuse", "glossy", "mirror")
SHADOW: Final = "shadow"
LOOKS: Final = (*SPHERES, SHADOW)
"""The errors of `LitObjects`."""
DIFFUSE_ALBEDO: Final = 0.5
SHADED: Final = 0.05
"""The shadow counts where the true light makes it at least this deep, in logarithms."""
_REACH: Final = 4.0
"""Of the shadow, in radii of the sphere."""
_STEP: Final = 0.4
_ROWS: Final = 40
"""Of the panorama that casts the shadow: 4.5 degrees a row."""


class LitObjects:
    """Objects under the true light of one place, with which those under estimated light are compared."""

    def __init__(self, truth: Float[np.ndarray, "h w 3"], view: tuple[float, float, float]) -> None:
        """`truth`: the panorama in units of white; `view`: the world direction in which a camera sees the spheres."""
        self._renderer = SphereRenderer(view, size=32)
        self._truth = {name: self._pixels(truth, name) for name in SPHERES}
        self._shadow = shadow_of_sphere(truth)
        self._shaded: Bool[np.ndarray, " n"] = self._shadow < np.exp(-SHADED)

    def errors(self, panorama: Float[np.ndarray, "h w 3"]) -> dict[str, float]:
        """Return the root of the mean squared error of each of `LOOKS`; NaN for a shadow that there is not."""
        found = {name: _rmse(self._pixels(panorama, name), self._truth[name]) for name in SPHERES}
        shaded = self._shaded
        lost = _rmse(shadow_of_sphere(panorama)[shaded], self._shadow[shaded]) if shaded.any() else float("nan")
        return {**found, SHADOW: lost}

    def _pixels(self, panorama: Float[np.ndarray, "h w 3"], name: Material) -> Float[np.ndarray, "n 3"]:
        albedo = DIFFUSE_ALBEDO if name == "diffuse" else 1.0
        return np.clip(albedo * self._renderer.pixels(panorama, name), 0, 1)


def shadow_of_sphere(panorama: Float[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " n"]:
    """Return the irradiance with a sphere / without it at points around the sphere's foot; 1 in the dark."""
    cosine, blocked = _shadow_tables()
    light = resize_panorama(panorama, _ROWS).reshape(-1, 3)[: len(cosine)] @ LUMINANCE * cosine
    total = light.sum()
    return (1 - blocked @ light / total if total > 0 else np.ones(len(blocked))).astype(np.float32)


@lru_cache(maxsize=1)
def _shadow_tables() -> tuple[Float32[np.ndarray, " d"], Float32[np.ndarray, "n d"]]:
    """Return each direction's cosine times its solid angle, above the horizon, and whether a unit sphere hides it."""
    directions = panorama_directions(_ROWS).reshape(-1, 3)[: _ROWS // 2 * 2 * _ROWS].astype(np.float32)
    solid_angle = np.broadcast_to(panorama_solid_angles(_ROWS), (_ROWS, 2 * _ROWS)).reshape(-1)[: len(directions)]
    ticks = np.arange(-_REACH, _REACH + _STEP / 2, _STEP)
    x, z = (axis.reshape(-1) for axis in np.meshgrid(ticks, ticks))
    outside = (np.hypot(x, z) < _REACH) & (np.hypot(x, z) > _STEP)
    toward = np.stack([-x, np.ones_like(x), -z], axis=-1)[outside].astype(np.float32)
    along = toward @ directions.T
    hidden = (along > 0) & ((toward**2).sum(axis=1)[:, None] - along**2 < 1)
    return (directions[:, 1] * solid_angle).astype(np.float32), hidden.astype(np.float32)


def _rmse(found: Float[np.ndarray, "..."], wanted: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.mean((found - wanted) ** 2, dtype=np.float64)))
