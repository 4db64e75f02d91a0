"""Light as it comes back: typed views of the forms that were asked for."""

import base64
import binascii
import io
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Float16, Float32

from roomlight.conventions import Position
from roomlight.errors import ImageError, RoomLightError, WireError
from roomlight.images import decode_colour, decode_grey8
from roomlight.light.main_light import MainLight
from roomlight.light.spherical_harmonics import Kind, SphericalHarmonics
from roomlight.wire.light_message import MEDIA_TYPE, parse_light
from roomlight.wire.messages import NO_FRAME, EncodedLight, LightFormat, LightResponse
from roomlight_client.errors import BadReplyError


@dataclass(frozen=True)
class LightFile:
    """One form as a file: its bytes, what they are, and the light's identity (the same as long as the light is)."""

    data: bytes
    media_type: str
    etag: str


@dataclass(frozen=True)
class Light:
    """The light at one point, in the forms that were asked for; asking for another is a RoomLightError that says so.

    position:   world metres.
    frame:      index of the last frame that is in it; -1: none is (`is_prior`).
    coverage:   share of the sphere that was observed, 0 to 1, by solid angle.
    etag:       the same as long as the light at this point is.
    name:       of a tracked probe.
    """

    position: Position
    frame: int
    coverage: float
    etag: str
    name: str | None = None
    _forms: tuple[tuple[EncodedLight, bytes], ...] = field(default=(), repr=False)

    @property
    def is_prior(self) -> bool:
        """Whether no frame is in it yet: grey light, brighter from above, that fits most rooms and shows none."""
        return self.frame == NO_FRAME

    @property
    def panorama(self) -> Float32[np.ndarray, "h w 3"]:
        """Equirectangular linear RGB [H, 2H, 3] (form `npy`, exact; else `exr`, half floats)."""
        form = self._find("npy", "exr")
        with _reading(form):
            if form.format == "exr":
                return decode_colour(self.file("exr"), "the panorama")[0]
            panorama = np.load(io.BytesIO(self.file("npy")), allow_pickle=False)
            if panorama.dtype != np.float32 or panorama.ndim != 3 or panorama.shape[2] != 3:
                raise ValueError(f"an array of {panorama.dtype} {panorama.shape}")
            return panorama

    @property
    def observed(self) -> Float32[np.ndarray, "h w"]:
        """How far each direction was observed, 0 to 1 in steps of 1/255, equirectangular (form `confidence`)."""
        with _reading(self._find("confidence")):
            return decode_grey8(self.file("confidence"), "the confidence panorama") / np.float32(255)

    @property
    def harmonics(self) -> SphericalHarmonics:
        """L2 harmonics of all light (form `sh`)."""
        return self._harmonics("total")

    @property
    def ambient(self) -> SphericalHarmonics:
        """L2 harmonics of what the main light leaves (form `sh` of kind `ambient`)."""
        return self._harmonics("ambient")

    @property
    def main_light(self) -> MainLight:
        """Direction toward the main light and its RGB intensity (form `main_light`)."""
        form = self._find("main_light")
        with _reading(form):
            values = form.values or {}
            direction, intensity = _numbers(values["direction"], 3), _numbers(values["intensity"], 3)
            return MainLight(direction, intensity)

    @property
    def cube(self) -> Float16[np.ndarray, "6 n n 4"]:
        """Faces +X -X +Y -Y +Z -Z in GL orientation, linear RGB and how far it was observed (form `cube`)."""
        with _reading(self._find("cube")):
            texels = np.frombuffer(self.file("cube"), "<f2")
            side = round((len(texels) / 24) ** 0.5)
            return texels.reshape(6, side, side, 4).astype(np.float16)

    def file(self, form: LightFormat) -> bytes:
        """A form's bytes as a file has them: exr, hdr, png, npy, ktx2, specular, confidence, cube."""
        found = self._find(form)
        return next(data for candidate, data in self._forms if candidate is found)

    def _harmonics(self, kind: Kind) -> SphericalHarmonics:
        for form, _ in self._forms:
            values = form.values or {}
            if form.format != "sh" or values.get("kind", "total") != kind:
                continue
            with _reading(form):
                flat = _numbers(values["coefficients"], 27)
                return SphericalHarmonics.from_flat(
                    flat, layout=values["layout"], phase=values["phase"], quantity=values["quantity"], kind=kind
                )
        raise self._not_asked(f"sh of kind {kind}", f"LightForm(format='sh', kind='{kind}')")

    def _find(self, *formats: LightFormat) -> EncodedLight:
        for wanted in formats:
            for form, _ in self._forms:
                if form.format == wanted:
                    return form
        raise self._not_asked(formats[0], f"'{formats[0]}'")

    def _not_asked(self, what: str, form: str) -> RoomLightError:
        held = ", ".join(form.format for form, _ in self._forms) or "nothing"
        return RoomLightError(f"this light has no {what}: it was asked for {held}; ask with forms=({form}, ..)")


def parse_lights(body: bytes, media_type: str) -> list[Light]:
    """The lights of an answer, binary or JSON. Raises BadReplyError."""
    try:
        if media_type.partition(";")[0].strip() == MEDIA_TYPE:
            response, parts = parse_light(body, LightResponse)
        else:
            response = LightResponse.model_validate_json(body)
            parts = [[_base64(form) for form in result.forms] for result in response.results]
    except (ValueError, WireError) as error:
        raise BadReplyError(f"the light cannot be read: {str(error)[:300]}") from error
    return [
        Light(
            position=_position(result.position),
            frame=response.frame,
            coverage=result.coverage,
            etag=result.etag,
            name=result.name,
            _forms=tuple((form, data or b"") for form, data in zip(result.forms, datas, strict=True)),
        )
        for result, datas in zip(response.results, parts, strict=True)
    ]


@contextmanager
def _reading(form: EncodedLight) -> Generator[None]:
    """What a form's bytes or values raise while they are read becomes a BadReplyError that names the form."""
    try:
        yield
    except (ValueError, KeyError, TypeError, ImageError, EOFError, OSError) as error:
        raise BadReplyError(f"the form {form.format} cannot be read: {error}") from error


def _base64(form: EncodedLight) -> bytes | None:
    try:
        return None if form.data is None else base64.b64decode(form.data, validate=True)
    except binascii.Error as error:
        raise BadReplyError(f"the form {form.format} is not base64: {error}") from error


def _numbers(values: Any, count: int) -> Float[np.ndarray, " n"]:
    numbers = np.array(values, np.float64)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ValueError(f"{count} finite numbers, got {str(values)[:80]}")
    return numbers


def _position(values: Sequence[float]) -> Position:
    x, y, z = values
    return x, y, z
