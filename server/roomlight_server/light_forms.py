"""Light as a client wants it: a `PointLight` and a `LightForm` into media type, numbers or bytes, and an ETag.

The forms themselves are `roomlight.light`; this is their only user here.
"""

from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np

from roomlight.conventions import NO_FRAME
from roomlight.light.cube import DEFAULT_SIZE
from roomlight.light.light import Light
from roomlight.light.prior import prior_panorama
from roomlight.light.spherical_harmonics import Layout, Phase
from roomlight.wire.messages import (
    CUBE_FORMATS,
    EncodedLight,
    HarmonicsBasis,
    LightForm,
    LightFormat,
    ProbeLight,
    SessionRequest,
)
from roomlight_server.live_session import PointLight

MEDIA_TYPES: Final[dict[str, str]] = {
    "exr": "image/x-exr",
    "hdr": "image/vnd.radiance",
    "png": "image/png",
    "npy": "application/x-npy",
    "cube": "application/octet-stream",
    "ktx2": "image/ktx2",
    "specular": "image/ktx2",
    "sh": "application/json",
    "main_light": "application/json",
    "confidence": "image/png",
}
_USUAL: Final = (16, 32, 64)
"""Widths of a face that are asked for: ARCore's, the default, and what a reflection wants."""
_BASES: Final[dict[HarmonicsBasis, tuple[Layout, Phase]]] = {
    "arcore": ("interleaved", "condon-shortley"),
    "arkit": ("planar", "condon-shortley"),
    "threejs": ("interleaved", "positive"),
}


@dataclass(frozen=True)
class Encoded:
    """One form: numbers, or bytes."""

    form: LightForm
    values: dict[str, Any] | None = None
    data: bytes | None = None

    def described(self) -> EncodedLight:
        """As a response lists it; `bytes` is the length of its data."""
        size = None if self.data is None else len(self.data)
        kind = self.form.format
        return EncodedLight(format=kind, media_type=MEDIA_TYPES[kind], values=self.values, bytes=size)


def etag(point: PointLight, form: LightForm) -> str:
    """The same as long as the light at the point, and what is asked of it, is the same."""
    size = "" if form.size is None else f"-{form.size}"
    extra = {"sh": f"-{form.kind}-{form.basis}", "png": f"-{form.exposure_ev:g}"}.get(form.format, "")
    return f'"{point.digest}-{form.format}{size}{extra}"'


def most_bytes(form: LightForm) -> int:
    """The most bytes that the form can take; a panorama of unstated size counts as 1 MB."""
    if form.format in ("sh", "main_light"):
        return 1024
    if form.format in CUBE_FORMATS:
        side = form.size or DEFAULT_SIZE
        return 6 * side * side * 8 * (2 if form.format == "specular" else 1) + 1024
    return (2 * form.size**2 * 12 if form.size else 2**20) + 1024


def encode(point: PointLight, form: LightForm) -> Encoded:
    """The light in this form; 1 to 30 ms, specular mips of 256 pixels up to a second."""
    light = point.light
    if form.format == "sh":
        layout, phase = _BASES[form.basis]
        harmonics = light.harmonics if form.kind == "total" else light.ambient
        return Encoded(form, values=harmonics.with_phase(phase).to_json(layout))
    if form.format == "main_light":
        return Encoded(form, values=light.main_light.to_json())
    return Encoded(form, data=light.file(form.format, size=form.size, exposure_ev=form.exposure_ev))


def warm_up() -> None:
    """Every form once, of panoramas of the default height, and of cubes every width in `_USUAL`.

    Without it the first cube map of a width takes 0.25 s longer, of 128 pixels 1 s, of 256 nearly 3 (two busy cores),
    and on a machine where no kernel was ever compiled some seconds more.
    """
    height = SessionRequest().height
    panorama = prior_panorama(height)
    light = Light((0.0, 0.0, 0.0), panorama, np.zeros(panorama.shape[:2], np.float32), 0.0)
    point = PointLight(light, "", NO_FRAME)
    for kind in get_args(LightFormat):
        for size in _USUAL if kind in CUBE_FORMATS else (None,):
            encode(point, LightForm(format=kind, size=size))


def encode_all(point: PointLight, forms: list[LightForm]) -> tuple[ProbeLight, list[bytes]]:
    """One probe's entry in a response, and the data of its binary forms in order."""
    encoded = [encode(point, form) for form in forms]
    described = ProbeLight(
        position=list(point.light.position),
        name=point.name,
        coverage=point.light.coverage,
        etag=point.digest,
        forms=[one.described() for one in encoded],
    )
    return described, [one.data for one in encoded if one.data is not None]
