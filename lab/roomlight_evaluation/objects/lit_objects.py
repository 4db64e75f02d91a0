"""What a panorama does to an object: pictures of three spheres, the shadow of a sphere on the surface below it, how
brightly a level surface is lit, and what inferred directions look like in a mirror.

The spheres are those of `roomlight.spheres`, clamped to white as a camera clamps them; the diffuse one has an albedo of
`DIFFUSE_ALBEDO`. The shadow is that of a sphere that rests on a horizontal surface, under light from far away: the
irradiance with the sphere relative to that without, by luminance, without what the sphere reflects (Debevec 1998,
differential rendering), at points around the sphere's foot.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles
from roomlight.spheres import DIFFUSE_ALBEDO, Material, SphereRenderer, resize_panorama

SPHERES: Final[tuple[Material, ...]] = ("diffuse", "glossy", "mirror")
SHADOW: Final = "shadow"
BRIGHTNESS: Final = "brightness"
LOOKS: Final = (*SPHERES, SHADOW, BRIGHTNESS)
"""The errors of `LitObjects`."""
MEASURES: Final = ("saturation", "gradient energy")
"""Mean of (max - min) / max over the channels; mean squared difference of neighbours in log(1 + luminance), x 10,000.
Both of light that white cuts, as a picture shows it."""
ROWS: Final = 40
"""Of the panorama that casts the shadow: 4.5 degrees a row."""
SHADED: Final = 0.05
"""The shadow counts where the true light makes it at least this deep, in logarithms."""
_REACH: Final = 4.0
"""Of the shadow, in radii of the sphere."""
_STEP: Final = 0.4


class LitObjects:
    """Objects under the true light of one place, with which those under estimated light are compared."""

    def __init__(self, truth: Float[np.ndarray, "h w 3"], view: tuple[float, float, float]) -> None:
        """`truth`: the panorama in units of white; `view`: the world direction in which a camera sees the spheres."""
        self._renderer = SphereRenderer(view, size=32)
        self._truth = {name: self._pixels(truth, name) for name in SPHERES}
        self._shadow = shadow_of_sphere(truth)
        self._from_above = _from_above(truth)
        self._shaded: Bool[np.ndarray, " n"] = self._shadow < np.exp(-SHADED)

    def errors(self, panorama: Float[np.ndarray, "h w 3"]) -> dict[str, float]:
        """Return the root of the mean squared error of each of `LOOKS`; NaN for a shadow that there is not.

        That of the brightness is the absolute logarithm of the ratio of irradiances from above.
        """
        rmse = {name: _rmse(self._pixels(panorama, name), self._truth[name]) for name in SPHERES}
        shaded = self._shaded
        lost = _rmse(shadow_of_sphere(panorama)[shaded], self._shadow[shaded]) if shaded.any() else float("nan")
        return {**rmse, SHADOW: lost, BRIGHTNESS: abs(np.log(_from_above(panorama) / self._from_above))}

    def _pixels(self, panorama: Float[np.ndarray, "h w 3"], name: Material) -> Float[np.ndarray, "n 3"]:
        albedo = DIFFUSE_ALBEDO if name == "diffuse" else 1.0
        return np.clip(albedo * self._renderer.pixels(panorama, name), 0, 1)


def _rmse(values: Float[np.ndarray, "..."], wanted: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.mean((values - wanted) ** 2, dtype=np.float64)))


def _from_above(panorama: Float[np.ndarray, "h w 3"]) -> float:
    """Return the luminance of the irradiance on a level surface; at least a thousandth of white's."""
    cosine = np.maximum(panorama_directions(len(panorama))[..., 1], 0) * panorama_solid_angles(len(panorama))
    return max(float(np.sum((panorama @ LUMINANCE) * cosine, dtype=np.float64)), 1e-3)


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


def unseen_look(panorama: Float[np.ndarray, "h w 3"], observed: Float[np.ndarray, "h w"]) -> dict[str, float]:
    """Return each of `MEASURES` over the directions that were not observed; NaN if there are none.

    Smears of half-seen furniture and tiles show as too much of both; a grey fog as too little.
    """
    weights = np.where(observed < 0.5, panorama_solid_angles(len(panorama)), 0)
    shown = np.clip(panorama, 0, 1)
    brightest, darkest = shown.max(axis=-1), shown.min(axis=-1)
    log = np.log1p(shown @ LUMINANCE)
    across, down = np.roll(log, -1, axis=1) - log, np.diff(log, axis=0)
    both = weights[:-1] * (weights[1:] > 0) * (np.roll(weights, -1, axis=1)[:-1] > 0)
    saturation = (brightest - darkest) / np.maximum(brightest, 0.02)
    return {
        MEASURES[0]: _mean(saturation, weights),
        MEASURES[1]: 1e4 * _mean(across[:-1] ** 2 + down**2, both),
    }


def _mean(values: Float[np.ndarray, "h w"], weights: Float[np.ndarray, "h w"]) -> float:
    total = float(weights.sum())
    return float((values * weights).sum()) / total if total > 0 else float("nan")
