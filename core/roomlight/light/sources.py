"""Where a light comes from, and what it is used for: panoramas of the engine, or the forms that a server sent."""

import hashlib
from dataclasses import dataclass
from typing import Final, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32

from roomlight.errors import RoomLightError
from roomlight.light.cube import CubeMap
from roomlight.light.main_light import MainLight, TrackedLights
from roomlight.light.spherical_harmonics import HarmonicsKind, SphericalHarmonics

FileFormat = Literal[
    "exr", "hdr", "png", "npy", "confidence", "cube", "ktx2", "specular", "equirect", "usdz", "glb"
]  # fmt: skip
"""Encodings that are bytes: the panorama as exr, hdr, png, npy or KTX2 (equirect); `observed` as a grey PNG
(confidence); a cube map as raw half floats (cube) or KTX2; specular mips as KTX2; scenes with lights (usdz, glb)."""
SavedFormat = Literal[FileFormat, "json"]
"""Files that a light is saved as: an encoding, or its numbers as JSON."""

LightUse = Literal["lighting", "reflection"]
"""What light is for: it lights a thing, or it is seen in a mirror and behind things."""
DEFAULT_USES: Final[dict[str, LightUse]] = {"png": "reflection"}
"""Uses of formats that are not of lighting unless another use is asked for: a PNG is looked at."""


def use_of(light_format: str, use: LightUse | None = None) -> LightUse:
    """Return the use of a form: the one that is asked for, or the format's own."""
    return use or DEFAULT_USES.get(light_format, "lighting")


@runtime_checkable  # the test run checks annotations with isinstance
class FormReader(Protocol):
    """Reader of the forms that a server sent; each method returns None for a form that is not there."""

    def panorama(self, use: LightUse) -> Float32[np.ndarray, "h w 3"] | None:
        """Return linear RGB [H, 2H, 3]."""
        ...

    def observed(self) -> Float32[np.ndarray, "h w"] | None:
        """Return how far each direction was observed, 0 to 1, [H, 2H]."""
        ...

    def main_light(self, use: LightUse) -> MainLight | None:
        """Return the main directional light."""
        ...

    def lights(self, use: LightUse) -> tuple[MainLight, ...] | None:
        """Return the lights, the strongest first."""
        ...

    def harmonics(self, kind: HarmonicsKind, use: LightUse) -> SphericalHarmonics | None:
        """Return the L2 harmonics of this kind."""
        ...

    def cube(self, size: int | None, use: LightUse) -> CubeMap | None:
        """Return the cube map, if its faces have this size (None: any)."""
        ...

    def file(self, file_format: FileFormat, use: LightUse) -> bytes | None:
        """Return the bytes of a form."""
        ...

    def missing(self, form: str, request: str) -> RoomLightError:
        """Return the error for a form that is not there; `request` is how to ask for it."""
        ...


@dataclass(frozen=True, eq=False)
class LightPanorama:
    """The panorama of one light for a use, and its main lights where a session followed them.

    Attributes:
        radiance: float32 linear RGB [H, 2H, 3].
        tracked: the main lights that a session has seen, as strong as in `radiance`; None: to be found in it.
    """

    radiance: Float[np.ndarray, "h w 3"]
    tracked: TrackedLights | None = None


@runtime_checkable
class LightSource(Protocol):
    """What a light is computed from when it is asked for."""

    def panorama(self, use: LightUse) -> LightPanorama:
        """Compute the panorama of a use."""
        ...

    def digest(self) -> str:
        """Return an identity, without computing the panoramas: equal sources give equal light."""
        ...


@dataclass(frozen=True, eq=False)
class GivenPanorama:
    """A panorama that is used for everything."""

    radiance: Float[np.ndarray, "h w 3"]

    def panorama(self, use: LightUse) -> LightPanorama:  # noqa: ARG002 - the same for both uses
        """Return it for both uses."""
        return LightPanorama(self.radiance)

    def digest(self) -> str:
        """Hash its values."""
        return hashlib.sha256(np.ascontiguousarray(self.radiance).tobytes()).hexdigest()[:24]
