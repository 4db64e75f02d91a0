"""What every form of light asks of a panorama, checked in one place."""

import numpy as np
from jaxtyping import Float, Shaped

FEWEST_ROWS = 4
"""Below this a panorama cannot tell the nine harmonics apart."""
MOST_ROWS = 4096


def check_panorama(panorama: Shaped[np.ndarray, "*shape"]) -> Float[np.ndarray, "h w 3"]:
    """The panorama as contiguous float32; ValueError if it is not H x 2H x 3, 4 to 4096 rows, of finite numbers."""
    if panorama.ndim != 3 or panorama.shape[2] != 3:
        raise ValueError(f"a panorama has shape (H, 2H, 3), got {panorama.shape}")
    return _check_map(panorama, "a panorama")


def check_observed(observed: Shaped[np.ndarray, "*shape"]) -> Float[np.ndarray, "h w"]:
    """How far each direction was observed, as contiguous float32.

    ValueError if it is not H x 2H of numbers in [0, 1].
    """
    if observed.ndim != 2:
        raise ValueError(f"what was observed has shape (H, 2H), got {observed.shape}")
    checked = _check_map(observed, "what was observed")
    if checked.min() < 0 or checked.max() > 1:
        raise ValueError(f"what was observed lies in [0, 1], got {checked.min()} to {checked.max()}")
    return checked


def _check_map(values: Shaped[np.ndarray, "h w *c"], name: str) -> Float[np.ndarray, "h w *c"]:
    height, width = values.shape[:2]
    if width != 2 * height:
        raise ValueError(f"{name} is twice as wide as high, this is {width} x {height}")
    if not FEWEST_ROWS <= height <= MOST_ROWS:
        raise ValueError(f"{name} has {FEWEST_ROWS} to {MOST_ROWS} rows, this has {height}")
    with np.errstate(over="ignore"):
        checked = np.ascontiguousarray(values, np.float32)
    if not np.isfinite(checked).all():
        row, column = np.argwhere(~np.isfinite(checked))[0, :2]
        raise ValueError(f"{name} holds finite numbers only, got {values[row, column]} in row {row}, column {column}")
    return checked
