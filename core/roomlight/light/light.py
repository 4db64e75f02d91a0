"""The light at one point, in every form that renderers use.

    light = session.light_at((0.2, -0.1, -1.5))   # from the engine, or from a server through `roomlight_client`
    light.panorama, light.observed, light.coverage
    light.main_light, light.lights, light.harmonics, light.ambient
    light.cube(size=64), light.specular(size=64)
    light.save("light.exr")                       # or .hdr, .png, .ktx2, .json

The engine gives a panorama, and the other forms are computed from it on first use. A server sends the forms that were
requested; what it did not send is computed from the panorama if that was sent. Conventions: `roomlight.conventions`.
"""

import io
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32

from roomlight.conventions import NO_FRAME, Position
from roomlight.errors import OptionError, RoomLightError
from roomlight.files import write_atomic, write_json
from roomlight.light.checks import MAX_ROWS, MIN_ROWS
from roomlight.light.coverage import confidence_png
from roomlight.light.coverage import coverage as coverage_of
from roomlight.light.cube import DEFAULT_SIZE, CubeMap, observed_cube
from roomlight.light.encode import to_exr, to_hdr, to_png
from roomlight.light.main_light import MainLight, TrackedLights, find_lights, no_light
from roomlight.light.prefilter import SpecularMips, prefilter
from roomlight.light.spherical_harmonics import HarmonicsKind, SphericalHarmonics, project
from roomlight.spheres import resize_panorama

FileFormat = Literal["exr", "hdr", "png", "npy", "confidence", "cube", "ktx2", "specular"]
"""Encodings that are bytes: the panorama as exr, hdr, png or npy; `observed` as a grey PNG (confidence); a cube map as
raw half floats (cube) or KTX2; specular mips as KTX2."""

SAVED_AS: Final[dict[str, FileFormat | Literal["json"]]] = {
    ".exr": "exr",
    ".hdr": "hdr",
    ".png": "png",
    ".ktx2": "ktx2",
    ".json": "json",
}
"""What `Light.save` writes, by suffix."""

_CONVENTIONS: Final = {
    "position": "world metres, right-handed, y up",
    "coverage": "share of the sphere of directions that was observed, by solid angle, 0 to 1",
    "radiance": "linear RGB (Rec. 709 primaries), relative: 1.0 is white at the session's reference exposure",
    "main_light.direction": "unit vector in the world, from the position toward the light",
    "main_light.intensity": "RGB irradiance on a surface that faces the light, in radiance x steradian",
    "main_light.radius_deg": "angular radius of a round light of the same spread, in degrees",
    "main_light.shadow_strength": "share of the irradiance on a surface that faces the light, 0 to 1",
    "main_light.emitted": "1: brighter than any surface that the room's light explains; toward 0: a bright surface",
    "lights": "up to three lights with the values of main_light, the strongest first",
    "harmonics.coefficients": "27 numbers: r, g, b of C00, C1-1, C10, C11, C2-2, C2-1, C20, C21, C22, world axes",
    "ambient": "harmonics minus those of the main light: ambient and main light together shade as harmonics does",
}


@runtime_checkable  # the test run checks annotations with isinstance
class FormReader(Protocol):
    """Reader of the forms that a server sent; each method returns None for a form that is not there."""

    def panorama(self) -> Float32[np.ndarray, "h w 3"] | None:
        """Return linear RGB [H, 2H, 3]."""
        ...

    def observed(self) -> Float32[np.ndarray, "h w"] | None:
        """Return how far each direction was observed, 0 to 1, [H, 2H]."""
        ...

    def main_light(self) -> MainLight | None:
        """Return the main directional light."""
        ...

    def lights(self) -> tuple[MainLight, ...] | None:
        """Return the lights, the strongest first."""
        ...

    def harmonics(self, kind: HarmonicsKind) -> SphericalHarmonics | None:
        """Return the L2 harmonics of this kind."""
        ...

    def cube(self, size: int | None) -> CubeMap | None:
        """Return the cube map, if its faces have this size (None: any)."""
        ...

    def file(self, file_format: FileFormat) -> bytes | None:
        """Return the bytes of a form."""
        ...

    def missing(self, form: str, request: str) -> RoomLightError:
        """Return the error for a form that is not there; `request` is how to ask for it."""
        ...


class Light:
    """The light at one point. Forms are computed on first use and kept, except cube maps and files.

    position:  world metres, y up.
    coverage:  share of the sphere of directions that was observed, by solid angle, 0 to 1.
    frame:     index of the last frame that contributed; -1 (`NO_FRAME`) if none did.
    name:      of a tracked probe, else None.
    etag:      a server's identity of this light: equal as long as the light is the same. None from the engine.
    """

    def __init__(
        self,
        position: Position,
        panorama: Float[np.ndarray, "h w 3"] | None = None,
        observed: Float[np.ndarray, "h w"] | None = None,
        coverage: float | None = None,
        *,
        frame: int = NO_FRAME,
        name: str | None = None,
        etag: str | None = None,
        forms: FormReader | None = None,
    ) -> None:
        """Make a light from a panorama [H, 2H, 3], or from `forms` that a server sent.

        observed:  1 = observed, 0 = inferred, [H, 2H]; everything, unless given with the panorama.
        coverage:  computed from `observed` unless given.

        Raises:
            ValueError: neither `panorama` nor `forms` is given.
        """
        if panorama is None and forms is None:
            raise ValueError("a light is made from a panorama or from forms; got neither")
        if panorama is not None and observed is None:
            observed = np.ones(panorama.shape[:2], np.float32)
        if coverage is None:
            coverage = 0.0 if observed is None else coverage_of(observed)
        self.position: Final = position
        self.coverage: Final = coverage
        self.frame: Final = frame
        self.name: Final = name
        self.etag: Final = etag
        self._forms = forms
        self._panorama = panorama
        self._observed = observed
        self._tracked: TrackedLights | None = None

    def with_lights(self, tracked: TrackedLights) -> "Light":
        """Return this light with the main light and lights that a session followed from frame to frame."""
        result = copy(self)
        for name in ("main_light", "lights", "ambient"):  # computed from the panorama before
            result.__dict__.pop(name, None)
        result._tracked = tracked
        return result

    @property
    def tracked_lights(self) -> TrackedLights | None:
        """What `with_lights` set; None for a point that is not tracked."""
        return self._tracked

    @property
    def is_prior(self) -> bool:
        """Whether no frame contributed yet: the grey default light of `roomlight.light.prior`, coverage 0."""
        return self.frame == NO_FRAME

    @property
    def panorama(self) -> Float[np.ndarray, "h w 3"]:
        """Equirectangular radiance [H, 2H, 3], float32 linear RGB, world-aligned.

        Raises:
            RoomLightError: it was not requested from the server.
        """
        panorama = self._find_panorama()
        if panorama is None:
            raise self._missing("npy", "'npy'")
        return panorama

    @property
    def observed(self) -> Float[np.ndarray, "h w"]:
        """How far each direction was observed, equirectangular [H, 2H]: 1 = observed, 0 = inferred.

        From a server in steps of 1/255.

        Raises:
            RoomLightError: it was not requested from the server.
        """
        observed = self._find_observed()
        if observed is None:
            raise self._missing("confidence", "'confidence'")
        return observed

    @cached_property
    def main_light(self) -> MainLight:
        """The main directional light: what casts the shadows.

        At a tracked probe it turns by at most 10 degrees a frame (`roomlight.engine.panorama.light_tracking`);
        elsewhere it is found in this panorama alone.

        Raises:
            RoomLightError: neither it nor the panorama was requested from the server.
        """
        received = None if self._forms is None else self._forms.main_light()
        if received is not None:
            return received
        if self._tracked is not None:
            return self._tracked.main
        self._panorama_for("main_light", "'main_light'")
        return self.lights[0] if self.lights else no_light()

    @cached_property
    def lights(self) -> tuple[MainLight, ...]:
        """Up to three lights, the strongest first: lamps and windows, with size, colour and shadow strength.

        At a tracked probe a light keeps its `number` from frame to frame. None where the light comes evenly from
        everywhere.

        Raises:
            RoomLightError: neither the main light nor the panorama was requested from the server.
        """
        received = None if self._forms is None else self._forms.lights()
        if received is not None:
            return received
        if self._tracked is not None:
            return self._tracked.sources
        return find_lights(self._panorama_for("lights", "'main_light'"))

    @cached_property
    def harmonics(self) -> SphericalHarmonics:
        """L2 spherical harmonics of all light (kind total).

        Raises:
            RoomLightError: neither them nor the panorama was requested from the server.
        """
        return self._harmonics("total")

    @cached_property
    def ambient(self) -> SphericalHarmonics:
        """L2 spherical harmonics of all light but the main light (kind ambient).

        Raises:
            RoomLightError: neither them nor the panorama was requested from the server.
        """
        return self._harmonics("ambient")

    def cube(self, *, size: int | None = None) -> CubeMap:
        """Return a cube map with faces of `size` pixels: 16, 32 (default), 64, 128 or 256; 0.5 to 8 ms.

        A cube map that a server sent is returned if its size fits.

        Raises:
            OptionError: no cube map of this size is made.
            RoomLightError: neither it nor the panorama was requested from the server.
        """
        received = None if self._forms is None else self._forms.cube(size)
        if received is not None:
            return received
        size = DEFAULT_SIZE if size is None else size
        return CubeMap.from_panorama(self._panorama_for("cube", f"LightForm(format='cube', size={size})"), size=size)

    def specular(self, *, size: int | None = None) -> SpecularMips:
        """Return the cube map prefiltered for rough surfaces, a level per roughness; 10 ms at size 32, 1 s at 256.

        Raises:
            OptionError: no cube map of this size is made.
            RoomLightError: neither the cube map nor the panorama was requested from the server.
        """
        return prefilter(self.cube(size=size))

    def file(self, file_format: FileFormat, *, size: int | None = None, exposure_ev: float = 0.0) -> bytes:
        """Encode the light as the bytes of a file.

        size:         rows of the panorama for exr, hdr, png, npy and confidence (default: as computed); pixels of a
                      face for cube, ktx2 and specular (default 32).
        exposure_ev:  for png: radiance 2^-exposure_ev is white.

        Without these two options, a form that a server sent is returned as it came. The alpha channel of cube and ktx2
        is `observed`, and 1 if the light came without it.

        Raises:
            OptionError: no such format, size or exposure.
            RoomLightError: neither this form nor the panorama was requested from the server.
        """
        if file_format not in get_args(FileFormat):
            raise OptionError(f"file format must be {', '.join(get_args(FileFormat))}; got {file_format!r}")
        if self._forms is not None and size is None and exposure_ev == 0:
            received = self._forms.file(file_format)
            if received is not None:
                return received
        if file_format == "specular":
            return self.specular(size=size).to_ktx2()
        if file_format in ("cube", "ktx2"):
            cube = self.cube(size=size)
            observed = self._find_observed()
            alpha = None if observed is None else observed_cube(observed, size=cube.size)
            return cube.to_bytes(alpha) if file_format == "cube" else cube.to_ktx2(alpha)
        if size is not None and not MIN_ROWS <= size <= MAX_ROWS:
            raise OptionError(f"size of a panorama must be {MIN_ROWS} to {MAX_ROWS} rows, got {size}")
        if file_format == "confidence":
            observed = np.repeat(self.observed[..., None], 3, axis=-1)
            observed = resize_panorama(observed, len(observed) if size is None else size)[..., 0]
            return confidence_png(np.clip(observed, 0, 1))
        panorama = self._panorama_for(file_format, f"'{file_format}'")
        panorama = resize_panorama(panorama, len(panorama) if size is None else size)
        if file_format == "exr":
            return to_exr(panorama, metadata={"roomlight:coverage": f"{self.coverage:.4f}"})
        if file_format == "hdr":
            return to_hdr(panorama)
        if file_format == "png":
            return to_png(panorama, exposure_ev=exposure_ev)
        stream = io.BytesIO()
        np.save(stream, np.ascontiguousarray(panorama, np.float32))
        return stream.getvalue()

    def to_json(self) -> dict[str, Any]:
        """Return position, coverage, main light and harmonics as plain JSON values, with their conventions."""
        return {
            "position": list(self.position),
            "frame": self.frame,
            "name": self.name,
            "coverage": self.coverage,
            "main_light": self.main_light.to_json(),
            "lights": [light.to_json() for light in self.lights],
            "harmonics": self.harmonics.to_json(),
            "ambient": self.ambient.to_json(),
            "conventions": _CONVENTIONS,
        }

    def save(self, path: str | Path) -> None:
        """Write the light to a file; its suffix says how. The file appears complete or not at all.

        .exr, .hdr:  the panorama for renderers: half floats, or Radiance RGBE.
        .png:        the panorama to look at: 8-bit sRGB, 1.0 is white.
        .ktx2:       a cube map of half floats with faces of 32 pixels.
        .json:       `to_json`.

        Raises:
            OptionError: the suffix is none of these.
            OutputError: the file cannot be written.
            RoomLightError: neither this form nor the panorama was requested from the server.
        """
        path = Path(path)
        file_format = SAVED_AS.get(path.suffix.lower())
        if file_format is None:
            raise OptionError(f"{path}: light is saved as {', '.join(SAVED_AS)}; got the suffix {path.suffix!r}")
        if file_format == "json":
            write_json(path, self.to_json())
        else:
            write_atomic(path, self.file(file_format))

    def __repr__(self) -> str:
        x, y, z = self.position
        name = "" if self.name is None else f", name={self.name!r}"
        at = f"({x:g}, {y:g}, {z:g})"
        return f"Light(position={at}, frame={self.frame}, coverage={self.coverage:.3f}{name})"

    def _repr_png_(self) -> bytes | None:
        """Return the tone-mapped panorama for a notebook; None where there is no panorama to show."""
        panorama = self._find_panorama()
        return None if panorama is None else to_png(panorama)

    def _find_panorama(self) -> Float[np.ndarray, "h w 3"] | None:
        if self._panorama is None and self._forms is not None:
            self._panorama = self._forms.panorama()
        return self._panorama

    def _find_observed(self) -> Float[np.ndarray, "h w"] | None:
        if self._observed is None and self._forms is not None:
            self._observed = self._forms.observed()
        return self._observed

    def _harmonics(self, kind: HarmonicsKind) -> SphericalHarmonics:
        received = None if self._forms is None else self._forms.harmonics(kind)
        if received is not None:
            return received
        panorama = self._panorama_for(f"sh of kind {kind}", f"LightForm(format='sh', kind='{kind}')")
        return project(panorama, kind=kind, light=self.main_light if kind == "ambient" else None)

    def _panorama_for(self, form: str, request: str) -> Float[np.ndarray, "h w 3"]:
        panorama = self._find_panorama()
        if panorama is None:
            raise self._missing(form, request)
        return panorama

    def _missing(self, form: str, request: str) -> RoomLightError:
        assert self._forms is not None, "a light without forms has a panorama and what was observed of it"
        return self._forms.missing(form, request)
