"""Lights of a server's response: `roomlight.light.light.Light`, whose forms are read from the bytes when needed."""

import base64
import binascii
import io
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from roomlight.conventions import Position
from roomlight.errors import ImageError, RoomLightError, WireError
from roomlight.images import decode_colour, decode_grey8
from roomlight.light.cube import CubeMap
from roomlight.light.light import Light
from roomlight.light.main_light import MainLight
from roomlight.light.sources import FileFormat, use_of
from roomlight.light.spherical_harmonics import HarmonicsKind, SphericalHarmonics
from roomlight.wire.light_message import MEDIA_TYPE, parse_light
from roomlight.wire.messages import EncodedLight, LightFormat, LightResponse, LightUse
from roomlight_client.errors import BadReplyError


@dataclass(frozen=True)
class LightFile:
    """One form as a file: bytes, their media type, and the light's etag (equal as long as the light is the same)."""

    data: bytes
    media_type: str
    etag: str


@dataclass(frozen=True)
class ReceivedForms:
    """The forms of one light in a response, in its order; implements `roomlight.light.sources.FormReader`.

    Every method returns None for a form that was not sent, and raises BadReplyError for one that cannot be read.
    """

    forms: tuple[tuple[EncodedLight, bytes], ...]

    def panorama(self, use: LightUse) -> Float32[np.ndarray, "h w 3"] | None:
        """Read `npy` (exact), else `exr` (half floats): linear RGB [H, 2H, 3]."""
        for form, data in self._of("npy", use):
            with _reading(form):
                panorama = np.load(io.BytesIO(data), allow_pickle=False)
                if panorama.dtype != np.float32 or panorama.ndim != 3 or panorama.shape[2] != 3:
                    raise ValueError(f"an array of {panorama.dtype} {panorama.shape}")
                return panorama
        for form, data in self._of("exr", use):
            with _reading(form):
                return decode_colour(data, "the panorama")[0]
        return None

    def observed(self) -> Float32[np.ndarray, "h w"] | None:
        """Read `confidence`: how far each direction was observed, 0 to 1 in steps of 1/255."""
        for form, data in self._of("confidence"):
            with _reading(form):
                return decode_grey8(data, "the confidence panorama") / np.float32(255)
        return None

    def main_light(self, use: LightUse) -> MainLight | None:
        """Read `main_light`."""
        for form, _ in self._of("main_light", use):
            with _reading(form):
                return _main_light(form.values or {})
        return None

    def lights(self, use: LightUse) -> tuple[MainLight, ...] | None:
        """Read the lights beside the main light in `main_light`."""
        for form, _ in self._of("main_light", use):
            with _reading(form):
                return tuple(_main_light(light) for light in (form.values or {})["lights"])
        return None

    def harmonics(self, kind: HarmonicsKind, use: LightUse) -> SphericalHarmonics | None:
        """Read `sh` of this kind."""
        for form, _ in self._of("sh", use):
            values = form.values or {}
            if values.get("kind", "total") != kind:
                continue
            with _reading(form):
                flat = _numbers(values["coefficients"], 27)
                return SphericalHarmonics.from_flat(
                    flat, layout=values["layout"], phase=values["phase"], quantity=values["quantity"], kind=kind
                )
        return None

    def cube(self, size: int | None, use: LightUse) -> CubeMap | None:
        """Read the first `cube` whose faces are `size` pixels wide (None: any); `observed` in its alpha is left out."""
        for form, data in self._of("cube", use):
            with _reading(form):
                texels = np.frombuffer(data, "<f2")
                side = round((len(texels) / 24) ** 0.5)
                if size in (None, side):
                    return CubeMap(texels.reshape(6, side, side, 4)[..., :3].astype(np.float32))
        return None

    def file(self, file_format: FileFormat, use: LightUse) -> bytes | None:
        """Return the bytes of the first form of this format."""
        return next((data for _, data in self._of(file_format, use)), None)

    def missing(self, form: str, request: str) -> RoomLightError:
        """Return the error for a form that can neither be read nor computed, with what to request."""
        sent = ", ".join(form.format for form, _ in self.forms) or "nothing"
        return RoomLightError(f"this light has no {form}: requested was {sent}; request it with forms=({request}, ...)")

    def _of(self, light_format: LightFormat, use: LightUse | None = None) -> list[tuple[EncodedLight, bytes]]:
        """Return the forms of a format and a use; None: of any."""
        of_format = [(form, data) for form, data in self.forms if form.format == light_format]
        return [(form, data) for form, data in of_format if use in (None, use_of(form.format, form.use))]


def parse_lights(body: bytes, media_type: str) -> list[Light]:
    """Parse the lights of a response, binary or JSON. Raises BadReplyError if the response is malformed."""
    try:
        if media_type.partition(";")[0].strip() == MEDIA_TYPE:
            response, parts = parse_light(body, LightResponse)
        else:
            response = LightResponse.model_validate_json(body)
            parts = None
    except (ValueError, WireError) as error:
        raise BadReplyError(f"the light cannot be read: {str(error)[:300]}") from error
    return lights_of(response, parts)


def lights_of(response: LightResponse, parts: list[list[bytes | None]] | None) -> list[Light]:
    """Return the lights of a parsed response.

    Args:
        response: The response.
        parts: The data of each form of each result in a binary message; None for plain JSON, which holds it as base64.

    Raises:
        BadReplyError: the base64 is malformed.
    """
    if parts is None:
        parts = [[_base64(form) for form in result.forms] for result in response.results]
    return [
        Light(
            _position(result.position),
            coverage=result.coverage,
            frame=response.frame,
            name=result.name,
            etag=result.etag,
            forms=ReceivedForms(tuple((form, data or b"") for form, data in zip(result.forms, datas, strict=True))),
        )
        for result, datas in zip(response.results, parts, strict=True)
    ]


@contextmanager
def _reading(form: EncodedLight) -> Generator[None]:
    """Turn errors of reading a form's bytes or values into a BadReplyError that names the form."""
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
        raise ValueError(f"expected {count} finite numbers, got {str(values)[:80]}")
    return numbers


def _main_light(values: dict[str, Any]) -> MainLight:
    radius_deg, shadow_strength, emitted, number = _numbers(
        [values[name] for name in ("radius_deg", "shadow_strength", "emitted", "number")], 4
    ).tolist()
    direction, intensity = _numbers(values["direction"], 3), _numbers(values["intensity"], 3)
    return MainLight(direction, intensity, radius_deg, shadow_strength, emitted, int(number))


def _position(values: Sequence[float]) -> Position:
    x, y, z = values
    return x, y, z
