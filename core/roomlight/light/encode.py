"""Encoding of panoramas as image files: EXR and Radiance HDR for renderers, PNG to look at."""

import math
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.conventions import linear_to_srgb8
from roomlight.errors import OptionError, OutputError
from roomlight.images import encode_exr, encode_png
from roomlight.light.checks import check_panorama

MAX_EXPOSURE_EV: Final = 16.0


def to_exr(panorama: Float[np.ndarray, "h w 3"], *, metadata: dict[str, str] | None = None) -> bytes:
    """Encode as half floats, ZIP-compressed: relative error 2^-11, up to 65504; the bytes that `write_exr` writes."""
    return encode_exr(check_panorama(panorama), metadata=metadata)


def to_hdr(panorama: Float[np.ndarray, "h w 3"]) -> bytes:
    """Encode as run-length encoded Radiance RGBE; errors up to 1.5/256 of the brightest channel, negative becomes 0."""
    panorama = np.maximum(check_panorama(panorama), 0)
    brightest = panorama.max(axis=-1, keepdims=True)
    # The encoder truncates mantissas, which darkens a picture by 0.3 % of its brightest channel: half a step rounds.
    step = np.ldexp(np.float32(1), np.frexp(brightest)[1] - 8)
    rounded = np.where(brightest > 1e-30, np.minimum(panorama, np.float32(1e38)) + step / 2, 0)
    ok, data = cv2.imencode(".hdr", np.ascontiguousarray(rounded[..., ::-1], np.float32))
    if not ok:
        raise OutputError(f"HDR encoding of {panorama.shape} failed")
    return data.tobytes()


def to_png(panorama: Float[np.ndarray, "h w 3"], *, exposure_ev: float = 0.0) -> bytes:
    """Encode as 8-bit sRGB: radiance 2^-exposure_ev and above is white; -16 to 16 EV.

    Raises:
        OptionError: `exposure_ev` is out of range.
    """
    if not math.isfinite(exposure_ev) or abs(exposure_ev) > MAX_EXPOSURE_EV:
        raise OptionError(f"exposure_ev must be {-MAX_EXPOSURE_EV:g} to {MAX_EXPOSURE_EV:g} EV, got {exposure_ev}")
    white = np.float32(2.0**-exposure_ev)
    return encode_png(linear_to_srgb8(np.minimum(check_panorama(panorama), white) / white))
