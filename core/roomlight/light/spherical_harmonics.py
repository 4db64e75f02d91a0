"""Light as nine spherical harmonics a channel (L2), in the signs and orders that AR platforms expect.

Order: C00, C1-1, C10, C11, C2-2, C2-1, C20, C21, C22, over the world axes (m = -1, 0, 1 of band 1 belong to y, z, x).
Each basis function has unit norm over the sphere.

| phase            | basis                                                | who uses it                             |
|------------------|------------------------------------------------------|-----------------------------------------|
| condon-shortley  | functions of odd m are negative: -y, z, -x, xy, -yz, | ARCore (its sample shader multiplies by |
|                  | 3z2-1, -xz, x2-y2                                    | -0.325735 for C1-1), Filament           |
| positive         | all of them positive: y, z, x, xy, yz, 3z2-1, xz, .. | three.js, ARCore's SDK for Unity        |

| quantity    | evaluating it gives                                                                              |
|-------------|--------------------------------------------------------------------------------------------------|
| radiance    | the light from a direction, un-convolved (ARCore)                                                |
| irradiance  | the light on a surface facing a direction, pi in constant radiance 1 (three.js `LightProbe` does |
|             | this itself by `shGetIrradianceAt`, so give it radiance)                                         |

| kind     | content                                                                                             |
|----------|-----------------------------------------------------------------------------------------------------|
| total    | all of the panorama                                                                                 |
| ambient  | all but the main light: exactly total - intensity x basis(direction), so that ambient harmonics and |
|          | a directional light together shade as total does (OpenXR's two kinds)                               |
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_solid_angles, uv_to_direction
from roomlight.light.checks import check_panorama
from roomlight.light.main_light import MainLight, main_light

Phase = Literal["condon-shortley", "positive"]
Quantity = Literal["radiance", "irradiance"]
HarmonicsKind = Literal["total", "ambient"]
CoefficientOrder = Literal["interleaved", "planar"]
"""Order of 27 numbers: interleaved r0 g0 b0 r1 g1 b1 .. (ARCore, WebXR), planar r0 .. r8 g0 .. g8 b0 .. b8 (ARKit)."""

_PHASE: Final = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1], np.float64)  # (-1)^m
_COSINE_LOBE: Final = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4], [1, 3, 5])
"""Factors of a clamped cosine for each band (Ramamoorthi and Hanrahan 2001)."""
_AZIMUTHS: Final = 8  # enough to separate 1, cos, sin, cos 2, sin 2 of the azimuth


@dataclass(frozen=True, eq=False)
class SphericalHarmonics:
    """Coefficients [9, 3] (RGB), with their phase, quantity and kind.

    Raises:
        ValueError: a coefficient is not finite.

    Examples:
        >>> import numpy as np, roomlight as rl
        >>> light = rl.Light((0.0, 0.0, 0.0), np.ones((16, 32, 3), np.float32))
        >>> light.harmonics.coefficients.shape
        (9, 3)
    """

    coefficients: Float[np.ndarray, "9 3"]
    phase: Phase = "condon-shortley"
    quantity: Quantity = "radiance"
    kind: HarmonicsKind = "total"

    def __post_init__(self) -> None:
        if not np.isfinite(self.coefficients).all():
            raise ValueError(f"harmonics must be finite numbers, got {self.coefficients.tolist()}")

    @classmethod
    def from_flat(
        cls,
        values: Float[np.ndarray, " n"],
        *,
        layout: CoefficientOrder,
        phase: Phase,
        quantity: Quantity = "radiance",
        kind: HarmonicsKind = "total",
    ) -> "SphericalHarmonics":
        """Make harmonics from their 27 numbers; inverse of `flat`.

        Raises:
            ValueError: they are not 27 finite numbers.
        """
        if values.shape != (27,):
            raise ValueError(f"L2 harmonics in RGB are 27 numbers, got {values.size}")
        coefficients = values.reshape(9, 3) if layout == "interleaved" else values.reshape(3, 9).T
        return cls(coefficients.astype(np.float64), phase, quantity, kind)

    def flat(self, layout: CoefficientOrder) -> Float[np.ndarray, "27"]:
        """Return the 27 numbers, float32."""
        ordered = self.coefficients if layout == "interleaved" else self.coefficients.T
        return np.ascontiguousarray(ordered, np.float32).reshape(27)

    def to_json(self, layout: CoefficientOrder = "interleaved") -> dict[str, Any]:
        """Return plain JSON values: the 27 coefficients, their layout, phase, quantity and kind."""
        return {
            "coefficients": self.flat(layout).tolist(),
            "layout": layout,
            "phase": self.phase,
            "quantity": self.quantity,
            "kind": self.kind,
        }

    def with_phase(self, phase: Phase) -> "SphericalHarmonics":
        """Return the same light with the signs of `phase`."""
        if phase == self.phase:
            return self
        return replace(self, coefficients=self.coefficients * _PHASE[:, None], phase=phase)

    def irradiance(self) -> "SphericalHarmonics":
        """Convolve with a clamped cosine: evaluated at a normal, the result is the irradiance of a surface."""
        if self.quantity == "irradiance":
            return self
        return replace(self, coefficients=self.coefficients * _COSINE_LOBE[:, None], quantity="irradiance")

    def without(self, light: MainLight) -> "SphericalHarmonics":
        """Subtract a directional light from these harmonics (total radiance): the ambient remainder.

        Raises:
            ValueError: these are not harmonics of total radiance.
        """
        if self.kind != "total" or self.quantity != "radiance":
            raise ValueError(f"a light is subtracted from total radiance, not from {self.kind} {self.quantity}")
        delta = basis(light.direction[None], phase=self.phase)[0][:, None] * light.intensity
        return replace(self, coefficients=self.coefficients - delta, kind="ambient")

    def evaluate(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Evaluate along unit world directions; nine harmonics ring, so values beside a lamp may be below 0."""
        return basis(directions, phase=self.phase) @ self.coefficients


def basis(directions: Float[np.ndarray, "n 3"], *, phase: Phase) -> Float[np.ndarray, "n 9"]:
    """Evaluate the nine basis functions at unit directions, float64."""
    x, y, z = directions.astype(np.float64).T
    values = [
        np.full_like(x, np.sqrt(1 / (4 * np.pi))),
        np.sqrt(3 / (4 * np.pi)) * y,
        np.sqrt(3 / (4 * np.pi)) * z,
        np.sqrt(3 / (4 * np.pi)) * x,
        np.sqrt(15 / (4 * np.pi)) * x * y,
        np.sqrt(15 / (4 * np.pi)) * y * z,
        np.sqrt(5 / (16 * np.pi)) * (3 * z * z - 1),
        np.sqrt(15 / (4 * np.pi)) * x * z,
        np.sqrt(15 / (16 * np.pi)) * (x * x - y * y),
    ]
    positive = np.stack(values, axis=-1)
    return positive * _PHASE if phase == "condon-shortley" else positive


def project(
    panorama: Float[np.ndarray, "h w 3"],
    *,
    kind: HarmonicsKind = "total",
    phase: Phase = "condon-shortley",
    light: MainLight | None = None,
) -> SphericalHarmonics:
    """Project a panorama onto L2 radiance harmonics, by least squares under exact solid angles.

    Light that is band-limited to L2 is recovered exactly at any height; summing basis x solid angle over pixel centres
    is off by 1e-4 at 120 rows. `light`: the main light that kind `ambient` leaves out; computed unless given. 0.2 ms
    for 120 x 240 on one core.

    Raises:
        ValueError: the panorama is not [H, 2H, 3] with 4 to 4096 rows of finite floats.
    """
    panorama = check_panorama(panorama)
    azimuths, rows, inverse_gram = _factors(panorama.shape[0])
    per_row = azimuths @ panorama  # [h 5 3]: five trigonometric moments a row
    sums = rows @ per_row.reshape(-1, 3).astype(np.float64)
    total = SphericalHarmonics(inverse_gram @ sums, "positive").with_phase(phase)
    if kind == "total":
        return total
    return total.without(light or main_light(panorama))


@lru_cache(maxsize=8)
def _factors(height: int) -> tuple[Float[np.ndarray, "5 w"], Float[np.ndarray, "9 h5"], Float[np.ndarray, "9 9"]]:
    """Return basis x solid angle of pixels as azimuths [5, 2h] and rows [9, h * 5], and the inverse Gram matrix."""
    few = (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    polar = (np.arange(height) + 0.5) / height
    u, v = np.meshgrid(few, polar)
    values = basis(uv_to_direction(np.stack([u, v], axis=-1).reshape(-1, 2)), phase="positive")
    moments = _trigonometric((few - 0.5) * 2 * np.pi)
    moments /= (moments**2).sum(axis=1, keepdims=True)
    per_row = np.einsum("jik,mi->kjm", values.reshape(height, _AZIMUTHS, 9), moments)  # [9 h 5]
    solid_angle = panorama_solid_angles(height).astype(np.float64)
    longitudes = (np.arange(2 * height) + 0.5) / (2 * height)
    azimuths = _trigonometric((longitudes - 0.5) * 2 * np.pi)
    weighted = per_row * solid_angle
    gram = np.einsum("ajm,bjn,mn->ab", weighted, per_row, azimuths @ azimuths.T)
    return azimuths.astype(np.float32), weighted.reshape(9, -1), np.linalg.inv(gram)


def _trigonometric(azimuth: Float[np.ndarray, " n"]) -> Float[np.ndarray, "5 n"]:
    constant = np.ones_like(azimuth)
    return np.stack([constant, np.cos(azimuth), np.sin(azimuth), np.cos(2 * azimuth), np.sin(2 * azimuth)])
