"""Denoising of rendered objects by Intel Open Image Denoise, where its wheel is installed (`roomlight[denoise]`)."""

from importlib import import_module
from importlib.util import find_spec
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import Float32

_LOCK = Lock()


def denoiser_name() -> str:
    """Return "oidn" if Open Image Denoise is installed, otherwise "none": radiance then stays as it was sampled."""
    return "oidn" if find_spec("pyoidn") is not None else "none"


def denoise(
    radiance: Float32[np.ndarray, "h w 3"],
    alpha: Float32[np.ndarray, "h w"],
    albedo: Float32[np.ndarray, "h w 3"],
    normal: Float32[np.ndarray, "h w 3"],
) -> Float32[np.ndarray, "h w 3"]:
    """Denoise premultiplied radiance; pixels that no object covers stay 0.

    Without the wheel the radiance is returned as it is: 256 paths a pixel leave little noise, and a bilateral filter
    would blur reflections and textures.
    """
    if denoiser_name() == "none":
        return radiance
    oidn: Any = import_module("pyoidn")
    rows, columns = (np.flatnonzero(alpha.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return radiance
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    with _LOCK:
        clean = oidn.denoise(
            np.ascontiguousarray(radiance[box]),
            albedo=np.ascontiguousarray(albedo[box]),
            normal=np.ascontiguousarray(normal[box]),
            hdr=True,
        )
    out = radiance.copy()
    out[box] = np.where(alpha[box][..., None] > 0, np.maximum(clean, 0), 0)
    return out
