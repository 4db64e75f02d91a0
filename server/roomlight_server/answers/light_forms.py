"""Encoding of a `Light` in the requested `LightForm`s: media types, numbers or bytes, and ETags."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, get_args

import numpy as np
from jaxtyping import Float

from roomlight.light.cube import DEFAULT_SIZE
from roomlight.light.light import Light
from roomlight.light.prior import prior_panorama
from roomlight.light.sources import LightUse, use_of
from roomlight.light.spherical_harmonics import CoefficientOrder, Phase
from roomlight.wire.messages import (
    CUBE_FORMATS,
    EncodedLight,
    HarmonicsBasis,
    LightForm,
    LightFormat,
    ProbeLight,
    SessionRequest,
)

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
    "equirect": "image/ktx2",
    "usdz": "model/vnd.usdz+zip",
    "glb": "model/gltf-binary",
}
_WARM_FACE_SIZES: Final = (16, 32, 64)
"""Face widths that are prepared at the start: ARCore's, the default, and a usual one for reflections."""
_SMALL_FACE: Final = 64
_PIXEL_BYTES: Final = {"exr": 6, "hdr": 4, "png": 3, "npy": 12, "confidence": 1, "equirect": 8, "usdz": 12}
_BASES: Final[dict[HarmonicsBasis, tuple[CoefficientOrder, Phase]]] = {
    "arcore": ("interleaved", "condon-shortley"),
    "arkit": ("planar", "condon-shortley"),
    "threejs": ("interleaved", "positive"),
}


@dataclass(frozen=True)
class LightPayload:
    """Light in one form: numbers (`values`) or bytes (`data`)."""

    form: LightForm
    values: dict[str, Any] | None = None
    data: bytes | None = None

    def entry(self) -> EncodedLight:
        """Return the entry of a response, with the number of bytes instead of the data."""
        size = None if self.data is None else len(self.data)
        name = self.form.format
        return EncodedLight(
            format=name, media_type=MEDIA_TYPES[name], use=use_of_form(self.form), values=self.values, bytes=size
        )


def use_of_form(form: LightForm) -> LightUse:
    """Return the use of a form: the requested one, or the format's own."""
    return use_of(form.format, form.use)


def http_etag(light: Light, form: LightForm) -> str:
    """Return the ETag of a light in a form: equal light in the same form has the same ETag."""
    size = "" if form.size is None else f"-{form.size}"
    extra = {"sh": f"-{form.kind}-{form.basis}", "png": f"-{form.exposure_ev:g}"}.get(form.format, "")
    return f'"{light.etag}-{form.format}-{use_of_form(form)}{size}{extra}"'


def max_bytes(form: LightForm, height: int) -> int:
    """Return an upper bound of the form's size in bytes, for a session whose panoramas have this height in pixels."""
    if form.format in ("sh", "main_light"):
        return 2048
    if form.format in CUBE_FORMATS:
        face_size = form.size or DEFAULT_SIZE
        return 6 * face_size**2 * 8 * (2 if form.format == "specular" else 1) + 1024
    rows = form.size or height
    pixels = 2 * rows**2 * _PIXEL_BYTES[form.format]
    return pixels + pixels // 32 + 16 * rows + 4096  # incompressible data grows a little; headers and line offsets


def encode(light: Light, form: LightForm) -> LightPayload:
    """Encode a light in a form. Takes 1 to 30 ms, for specular mips of 256 pixels up to a second."""
    light = light.used_for(use_of_form(form))
    if form.format == "sh":
        layout, phase = _BASES[form.basis]
        harmonics = light.harmonics if form.kind == "total" else light.ambient
        return LightPayload(form, values=harmonics.with_phase(phase).to_json(layout))
    if form.format == "main_light":
        lights = [source.to_json() for source in light.lights]
        return LightPayload(form, values={**light.main_light.to_json(), "lights": lights})
    return LightPayload(form, data=light.file(form.format, size=form.size, exposure_ev=form.exposure_ev, use=light.use))


def encode_all(light: Light, forms: Sequence[LightForm]) -> list[LightPayload]:
    """Encode a light in several forms."""
    return [encode(light, form) for form in forms]


def grouped_forms(forms: Sequence[LightForm]) -> list[list[LightForm]]:
    """Return the forms in order, in groups that take up to 0.1 s together."""
    groups: list[list[LightForm]] = []
    for form in forms:
        if not groups or _is_large(form) or _is_large(groups[-1][-1]):
            groups.append([form])
        else:
            groups[-1].append(form)
    return groups


def _is_large(form: LightForm) -> bool:
    return form.format in CUBE_FORMATS and (form.size or DEFAULT_SIZE) > _SMALL_FACE


def entry_of(light: Light, payloads: Sequence[LightPayload]) -> ProbeLight:
    """Return the entry of a light in a response."""
    return ProbeLight(
        position=list(light.position),
        name=light.name,
        coverage=light.coverage,
        etag=light.etag or "",
        forms=[payload.entry() for payload in payloads],
    )


def warm_up() -> None:
    """Encode a light of the default height in every format, cube maps in every size of `_WARM_FACE_SIZES`.

    Otherwise the first cube map of a size takes 0.25 s longer, of 128 pixels 1 s, of 256 nearly 3 s (two busy cores),
    and several seconds more on a machine where no kernel has been compiled yet.
    """
    panorama = prior_panorama(SessionRequest().height)
    light = Light((0.0, 0.0, 0.0), panorama, np.zeros(panorama.shape[:2], np.float32), 0.0)
    for name in get_args(LightFormat):
        for size in _WARM_FACE_SIZES if name in CUBE_FORMATS else (None,):
            encode(light, LightForm(format=name, size=size))


@lru_cache(maxsize=4)
def default_panorama(height: int) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"], str]:
    """Return panorama, `observed` (all zero) and digest of the default light, which is used before the first frame."""
    panorama = prior_panorama(height)
    observed = np.zeros(panorama.shape[:2], np.float32)
    return panorama, observed, Light((0.0, 0.0, 0.0), panorama, observed).digest()
