"""What a panorama does to an object: pictures of three spheres, the shadow of a sphere on the surface below it, and how
brightly a level surface is lit.

The spheres are those of `roomlight.spheres`, clamped to white as a camera clamps them; the diffuse one has an albedo of
`DIFFUSE_ALBEDO`. The shadow is that of `roomlight_evaluation.objects.sphere_shadow`.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles
from roomlight.spheres import DIFFUSE_ALBEDO, Material, SphereRenderer
from roomlight_evaluation.objects.sphere_shadow import SHADED, shadow_of_sphere

SPHERES: Final[tuple[Material, ...]] = ("diffuse", "glossy", "mirror")
SHADOW: Final = "shadow"
BRIGHTNESS: Final = "brightness"
LOOKS: Final = (*SPHERES, SHADOW, BRIGHTNESS)
"""The errors of `LitObjects`."""


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
