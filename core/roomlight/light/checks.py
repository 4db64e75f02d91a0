"""Checks of panoramas that all forms of light share."""

import numpy as np
from jaxtyping import Float, Shaped

MIN_ROWS = 4
"""With fewer rows the nine harmonics cannot be fitted."""
MAX_ROWS = 4096


def check_panorama(panorama: Shaped[np.ndarray, "*shape"]) -> Float[np.ndarray, "h w 3"]:
    """Return the panorama as contiguous float32.

    Raises:
        ValueError: it is not [H, 2H, 3] with 4 to 4096 rows of finite floats.
    """
    if panorama.ndim != 3 or panorama.shape[2] != 3:
        raise ValueError(f"a panorama has shape (H, 2H, 3), got {panorama.shape}")
    if panorama.dtype.kind != "f":
        raise ValueError(
            f"a panorama is linear float RGB, got {panorama.dtype}; "
            "roomlight.conventions.srgb8_to_linear decodes 8-bit sRGB"
        )
    return _check_map(panorama, "a panorama")


def check_observed(observed: Shaped[np.ndarray, "*shape"]) -> Float[np.ndarray, "h w"]:
    """Return the observed shares as contiguous float32.

    Raises:
        ValueError: they are not [H, 2H] with 4 to 4096 rows of numbers in [0, 1].
    """
    if observed.ndim != 2:
        raise ValueError(f"observed has shape (H, 2H), got {observed.shape}")
    checked = _check_map(observed, "observed")
    if checked.min() < 0 or checked.max() > 1:
        raise ValueError(f"observed lies in [0, 1], got {checked.min()} to {checked.max()}")
    return checked


def _check_map(values: Shaped[np.ndarray, "h w *c"], name: str) -> Float[np.ndarray, "h w *c"]:
    height, width = values.shape[:2]
    if width != 2 * height:
        raise ValueError(f"{name} is twice as wide as high, this is {width} x {height}")
    if not MIN_ROWS <= height <= MAX_ROWS:
        raise ValueError(f"{name} has {MIN_ROWS} to {MAX_ROWS} rows, this has {height}")
    with np.errstate(over="ignore"):
        checked = np.ascontiguousarray(values, np.float32)
    if not np.isfinite(checked).all():
        row, column = np.argwhere(~np.isfinite(checked))[0, :2]
        raise ValueError(f"{name} holds finite numbers only, got {values[row, column]} in row {row}, column {column}")
    return checked
