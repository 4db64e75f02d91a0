"""The light at one point, in every form that renderers use.

    light = session.light_at((0.2, -0.1, -1.5))   # from the engine, or from a server through `roomlight_client`
    light.panorama, light.observed, light.coverage
    light.main_light, light.lights, light.harmonics, light.ambient
    light.cube(size=64), light.specular(size=64)
    light.save("light.exr")                       # or .hdr, .png, .ktx2, .usdz, .glb, .json
    light.reflection                              # the panorama that a mirror shows

A light has two uses (`LightUse`). `lighting` is what lights a thing: sums over many directions, such as what a matte
surface receives, are as right as they can be. `reflection` is what is seen in a mirror or behind things: each single
direction is the best guess. Where frames measured a direction the two are equal. Forms are of lighting, but for
pictures to look at (`DEFAULT_USES`); `Light.used_for` gives all forms of the other use.

The engine gives panoramas, and the other forms are computed from them on first use. A server sends the forms that were
requested; what it did not send is computed from the panorama if that was sent. Conventions: `roomlight.conventions`.
"""

import hashlib
import io
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from jaxtyping import Float

from roomlight.conventions import NO_FRAME, Position
from roomlight.errors import OptionError, RoomLightError
from roomlight.files import write_atomic, write_json
from roomlight.light.checks import MAX_ROWS, MIN_ROWS, check_observed, check_panorama
from roomlight.light.coverage import confidence_png
from roomlight.light.coverage import coverage as coverage_of
from roomlight.light.cube import DEFAULT_SIZE, CubeMap, observed_cube
from roomlight.light.encode import to_exr, to_hdr, to_png
from roomlight.light.glb import to_glb
from roomlight.light.ktx2 import panorama_ktx2
from roomlight.light.main_light import MainLight, TrackedLights, find_lights, no_light
from roomlight.light.prefilter import SpecularMips, prefilter
from roomlight.light.sources import (
    FileFormat,
    FormReader,
    GivenPanorama,
    LightPanorama,
    LightSource,
    LightUse,
    SavedFormat,
    use_of,
)
from roomlight.light.spherical_harmonics import HarmonicsKind, SphericalHarmonics, project
from roomlight.light.usd import to_usdz
from roomlight.spheres import resize_panorama

SAVED_AS: Final[dict[str, SavedFormat]] = {
    ".exr": "exr",
    ".hdr": "hdr",
    ".confidence.png": "confidence",
    ".png": "png",
    ".npy": "npy",
    ".cube": "cube",
    ".equirect.ktx2": "equirect",
    ".specular.ktx2": "specular",
    ".ktx2": "ktx2",
    ".usdz": "usdz",
    ".glb": "glb",
    ".json": "json",
}
"""What `Light.save` writes, by the end of the name; the first that fits."""
ENDINGS: Final = {form: end for end, form in SAVED_AS.items()}
"""Ends of names by what is written."""

_CONVENTIONS: Final = {
    "position": "world metres, right-handed, y up",
    "use": "what the forms are for: lighting lights a thing, reflection is what a mirror shows",
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


class Light:
    """The light at one point. Forms are computed on first use and kept, except cube maps and files.

    Attributes:
        position: World metres, y up.
        coverage: Share of the sphere of directions that was observed, by solid angle, 0 to 1.
        frame: Index of the last frame that contributed; -1 (`NO_FRAME`) if none did.
        name: Name of a tracked probe, else None.
        etag: A server's identity of this light: equal as long as the light is the same. None from the engine.

    Examples:
        >>> import numpy as np, roomlight as rl
        >>> light = rl.Light((0.0, 0.0, 0.0), np.ones((16, 32, 3), np.float32))
        >>> light.cube(size=16).faces.shape
        (6, 16, 16, 3)
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
        source: LightSource | None = None,
    ) -> None:
        """Make a light from a panorama [H, 2H, 3] of both uses, from `forms` that a server sent, or from a `source`.

        Args:
            panorama: linear RGB for both uses.
            observed: 1 = observed, 0 = inferred, [H, 2H]; everything, unless given with the panorama.
            coverage: computed from `observed` unless given.
            source: computes the panorama of each use once, when it is needed.

        Raises:
            ValueError: none of `panorama`, `forms` and `source` is given, the panorama is not [H, 2H, 3] of finite
                floats, or `observed` is not of its size.
        """
        if panorama is None and forms is None and source is None:
            raise ValueError("a light is made from a panorama, from forms or from a source; got none of them")
        if panorama is not None:  # copies: the caller may write into its arrays again
            panorama = check_panorama(panorama.copy())
            observed = np.ones(panorama.shape[:2], np.float32) if observed is None else check_observed(observed.copy())
            if observed.shape != panorama.shape[:2]:
                raise ValueError(f"observed {observed.shape} and the panorama {panorama.shape} have one (H, 2H)")
        if coverage is None:
            coverage = 0.0 if observed is None else coverage_of(observed)
        x, y, z = (float(value) for value in position)  # JSON has no numbers of NumPy
        self.position: Final = (x, y, z)
        self.coverage: Final = coverage
        self.frame, self.name, self.etag = frame, name, etag
        self.use: LightUse = "lighting"
        self._forms = forms
        self._source = source if panorama is None else GivenPanorama(panorama)
        self._computed: dict[LightUse, LightPanorama] = {}  # copies of the light share what was computed and received
        self._received: dict[LightUse, Float[np.ndarray, "h w 3"]] = {}
        self._observed = observed

    def used_for(self, use: LightUse) -> "Light":
        """Return this light with all forms of a use: `lighting`, or `reflection` for what is seen in a mirror.

            light.used_for("reflection").cube(size=128)  # a cube map for sharp reflections

        Raises:
            OptionError: there is no such use.
        """
        if use not in get_args(LightUse):
            raise OptionError(f"use must be one of {', '.join(get_args(LightUse))}; got {use!r}")
        if use == self.use:
            return self
        result = copy(self)
        for name in ("main_light", "lights", "harmonics", "ambient"):  # computed for the other use
            result.__dict__.pop(name, None)
        result.use = use
        return result

    def labelled(self, *, frame: int, name: str | None, etag: str | None) -> "Light":
        """Return this light with another frame index, name and ETag, as a server answers it."""
        result = copy(self)
        result.frame, result.name, result.etag = frame, name, etag
        return result

    def digest(self) -> str:
        """Return an identity of this light, without computing it: equal light has the same.

        Light of one digest is equal to the bit where `ROOMLIGHT_THREADS` is: networks round by the number of threads.

        Raises:
            ValueError: the light came from a server; its `etag` is its identity.
        """
        if self._source is None:
            raise ValueError("a light from a server has its etag for an identity, and no digest")
        observed = b"" if self._observed is None else np.ascontiguousarray(self._observed).tobytes()
        return hashlib.sha256(self._source.digest().encode() + observed).hexdigest()[:24]

    def _compute(self) -> LightPanorama | None:
        """Return the panorama of this use, which the source computes once; None without a source."""
        if self._source is not None and self.use not in self._computed:
            self._computed[self.use] = self._source.panorama(self.use)
        return self._computed.get(self.use)

    @property
    def _tracked(self) -> TrackedLights | None:
        computed = self._compute()
        return None if computed is None else computed.tracked

    @property
    def is_prior(self) -> bool:
        """Whether no frame contributed yet: the grey default light of `roomlight.light.prior`, coverage 0."""
        return self.frame == NO_FRAME

    @property
    def panorama(self) -> Float[np.ndarray, "h w 3"]:
        """Equirectangular radiance [H, 2H, 3], float32 linear RGB, world-aligned: what lights a thing (`use`).

        Raises:
            RoomLightError: it was not requested from the server.
        """
        return self._panorama_for("npy")

    @property
    def reflection(self) -> Float[np.ndarray, "h w 3"]:
        """The radiance that is seen from here, in a mirror or behind things: the best estimate of each direction.

        Cheaper than `panorama`, and too dark as a sum: lamps are clipped or never seen.

        Raises:
            RoomLightError: it was not requested from the server.
        """
        return self.used_for("reflection")._panorama_for("npy")

    @property
    def observed(self) -> Float[np.ndarray, "h w"]:
        """How far each direction was observed, equirectangular [H, 2H]: 1 = observed, 0 = inferred.

        From a server in steps of 1/255.

        Raises:
            RoomLightError: it was not requested from the server.
        """
        observed = self._find_observed()
        if observed is None:
            raise self._missing("confidence", self._request("confidence"))
        return observed

    @cached_property
    def main_light(self) -> MainLight:
        """The main directional light: what casts the shadows.

        At a tracked probe it turns by at most 10 degrees a frame (`roomlight.engine.panorama.light_tracking`);
        elsewhere it is found in this panorama, at a session's points where it most likely is
        (`roomlight.engine.panorama.likely_light`).

        Raises:
            RoomLightError: neither it nor the panorama was requested from the server.
        """
        received = None if self._forms is None else self._forms.main_light(self.use)
        if received is not None:
            return received
        if self._tracked is not None:
            return self._tracked.main
        self._panorama_for("main_light")
        return self.lights[0] if self.lights else no_light()

    @cached_property
    def lights(self) -> tuple[MainLight, ...]:
        """Up to three lights, the strongest first: lamps and windows, with size, colour and shadow strength.

        At a tracked probe a light keeps its `number` from frame to frame. None where the light comes evenly from
        everywhere.

        Raises:
            RoomLightError: neither the main light nor the panorama was requested from the server.
        """
        received = None if self._forms is None else self._forms.lights(self.use)
        if received is not None:
            return received
        if self._tracked is not None:
            return self._tracked.sources
        return find_lights(self._panorama_for("main_light", "lights"))

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
        received = None if self._forms is None else self._forms.cube(size, self.use)
        if received is not None:
            return received
        size = DEFAULT_SIZE if size is None else size
        return CubeMap.from_panorama(self._panorama_for("cube", size=size), size=size)

    def specular(self, *, size: int | None = None) -> SpecularMips:
        """Return the cube map prefiltered for rough surfaces, a level per roughness; 10 ms at size 32, 1 s at 256.

        Raises:
            OptionError: no cube map of this size is made.
            RoomLightError: neither the cube map nor the panorama was requested from the server.
        """
        return prefilter(self.cube(size=size))

    def file(
        self,
        file_format: FileFormat,
        *,
        size: int | None = None,
        exposure_ev: float = 0.0,
        use: LightUse | None = None,
    ) -> bytes:
        """Encode the light as the bytes of a file.

        Args:
            file_format: see `FileFormat`.
            size: rows of the panorama for exr, hdr, png, npy, equirect, usdz and confidence (default: as computed);
                pixels of a face for cube, ktx2, specular and glb (default 32).
            exposure_ev: for png: radiance 2^-exposure_ev is white.
            use: lighting or reflection; default: this light's own (lighting), and reflection for png.

        Without size and exposure, a form that a server sent is returned as it came. The alpha channel of cube and ktx2
        is `observed`, and 1 if the light came without it.

        Raises:
            OptionError: no such format, size, exposure or use.
            RoomLightError: neither this form nor the panorama was requested from the server.
        """
        if file_format not in get_args(FileFormat):
            raise OptionError(f"file format must be {', '.join(get_args(FileFormat))}; got {file_format!r}")
        wanted = use or (use_of(file_format) if self.use == "lighting" else self.use)
        return self.used_for(wanted)._file(file_format, size, exposure_ev)

    def _file(self, file_format: FileFormat, size: int | None, exposure_ev: float) -> bytes:
        if self._forms is not None and size is None and exposure_ev == 0:
            received = self._forms.file(file_format, self.use)
            if received is not None:
                return received
        if file_format == "specular":
            return self.specular(size=size).to_ktx2()
        if file_format in ("cube", "ktx2"):
            cube = self.cube(size=size)
            observed = self._find_observed()
            alpha = None if observed is None else observed_cube(observed, size=cube.size)
            return cube.to_bytes(alpha) if file_format == "cube" else cube.to_ktx2(alpha)
        if file_format == "glb":
            return to_glb(self._panorama_for("glb"), self.lights, size=size)
        if size is not None and not MIN_ROWS <= size <= MAX_ROWS:
            raise OptionError(f"size of a panorama must be {MIN_ROWS} to {MAX_ROWS} rows, got {size}")
        if file_format == "confidence":
            observed = np.repeat(self.observed[..., None], 3, axis=-1)
            observed = resize_panorama(observed, len(observed) if size is None else size)[..., 0]
            return confidence_png(np.clip(observed, 0, 1))
        panorama = self._panorama_for(file_format)
        panorama = resize_panorama(panorama, len(panorama) if size is None else size)
        metadata = {"roomlight:coverage": f"{self.coverage:.4f}", "roomlight:use": self.use}
        if file_format == "exr":
            return to_exr(panorama, metadata=metadata)
        if file_format == "usdz":
            return to_usdz(self.position, panorama, self.lights, metadata=metadata)
        if file_format == "equirect":
            return panorama_ktx2(panorama)
        if file_format == "hdr":
            return to_hdr(panorama)
        if file_format == "png":
            return to_png(panorama, exposure_ev=exposure_ev)
        stream = io.BytesIO()
        np.save(stream, np.ascontiguousarray(panorama, np.float32))
        return stream.getvalue()

    def to_json(self) -> dict[str, Any]:
        """Return position, use, coverage, main light and harmonics as plain JSON values, with their conventions."""
        return {
            "position": list(self.position),
            "use": self.use,
            "frame": self.frame,
            "name": self.name,
            "coverage": self.coverage,
            "main_light": self.main_light.to_json(),
            "lights": [light.to_json() for light in self.lights],
            "harmonics": self.harmonics.to_json(),
            "ambient": self.ambient.to_json(),
            "conventions": _CONVENTIONS,
        }

    def save(self, path: str | Path, *, use: LightUse | None = None) -> None:
        """Write the light to a file; the end of its name says how. The file appears complete or not at all.

        .exr, .hdr:  the panorama for renderers, as a dome light: half floats, or Radiance RGBE.
        .png:        the panorama that is seen, to look at: 8-bit sRGB, 1.0 is white.
        .ktx2:       a cube map of half floats with faces of 32 pixels; .equirect.ktx2: the panorama, for three.js.
        .usdz:       a dome light, and lamps and windows as distant lights (`roomlight.light.usd`).
        .glb:        an image-based light and directional lights (`roomlight.light.glb`).
        .npy, .cube, .confidence.png, .specular.ktx2: as `file` has them.
        .json:       `to_json`.

        Args:
            path: of the file; missing folders are made.
            use: lighting or reflection instead of the suffix's own.

        Raises:
            OptionError: the suffix or the use is none of these.
            OutputError: the file cannot be written.
            RoomLightError: neither this form nor the panorama was requested from the server.
        """
        path = Path(path)
        end = next((end for end in SAVED_AS if path.name[1:].lower().endswith(end)), None)
        if end is None:
            raise OptionError(f"{path}: light is saved as {', '.join(SAVED_AS)}; got the suffix {path.suffix!r}")
        file_format = SAVED_AS[end]
        if file_format == "json":
            write_json(path, (self if use is None else self.used_for(use)).to_json())
        else:
            write_atomic(path, self.file(file_format, use=use))

    def __repr__(self) -> str:
        x, y, z = self.position
        name = "" if self.name is None else f", name={self.name!r}"
        at = f"({x:g}, {y:g}, {z:g})"
        return f"Light(position={at}, frame={self.frame}, coverage={self.coverage:.3f}{name})"

    def _repr_png_(self) -> bytes | None:
        """Return the tone-mapped panorama for a notebook; None where there is no panorama to show."""
        panorama = self.used_for("reflection")._find_panorama()
        return None if panorama is None else to_png(panorama)

    def _find_panorama(self) -> Float[np.ndarray, "h w 3"] | None:
        computed = self._compute()
        if computed is not None:
            return computed.radiance
        if self.use not in self._received and self._forms is not None:
            received = self._forms.panorama(self.use)
            if received is not None:
                self._received[self.use] = received
        return self._received.get(self.use)

    def _find_observed(self) -> Float[np.ndarray, "h w"] | None:
        if self._observed is None and self._forms is not None:
            self._observed = self._forms.observed()
        return self._observed

    def _harmonics(self, kind: HarmonicsKind) -> SphericalHarmonics:
        received = None if self._forms is None else self._forms.harmonics(kind, self.use)
        if received is not None:
            return received
        panorama = self._panorama_for("sh", f"sh of kind {kind}", kind=kind)
        return project(panorama, kind=kind, light=self.main_light if kind == "ambient" else None)

    def _panorama_for(self, form: str, label: str | None = None, **options: object) -> Float[np.ndarray, "h w 3"]:
        """Return the panorama, or raise the error that names the form (`label`) and says how to request it."""
        panorama = self._find_panorama()
        if panorama is None:
            raise self._missing(label or form, self._request(form, **options))
        return panorama

    def _request(self, form: str, **options: object) -> str:
        options |= {} if use_of(form) == self.use else {"use": self.use}
        named = "".join(f", {name}={value!r}" for name, value in options.items())
        return f"LightForm(format={form!r}{named})" if named else repr(form)

    def _missing(self, form: str, request: str) -> RoomLightError:
        assert self._forms is not None, "a light without forms has a panorama and what was observed of it"
        return self._forms.missing(form, request)
