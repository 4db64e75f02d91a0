"""When one observation of a surface gives way to another.

An observation is the radiance of a surface, the share of it that was clipped, and a lower bound of its luminance: the
image as measured, 1 / exposure where it was clipped.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.engine.kernels.blend import HIGHER, NOISE

CLOSER_M: Final = 0.25
"""A newly observed surface replaces an earlier one only if it is this much closer (the paper's value); two observations
within it show the same surface."""


def better_share(
    clipped: Float[np.ndarray, "*n"],
    bound: Float[np.ndarray, "*n"],
    new_clipped: Float[np.ndarray, "*n"],
    new_bound: Float[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """Return how much of a clipped observation a new one of the same surface replaces, 0 to 1.

    The new one replaces all if it shows a higher white: its bound exceeds bound / clipped, which is at least the white
    of the old exposure. Otherwise it replaces as much as is less clipped in it, unless it is darker than the old bound:
    then it shows another surface (a pose is off by a pixel), or a reflection that is gone.

    `clipped` is the share that was clipped, `bound` a lower bound of the luminance: itself where the share is 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        less = np.where(new_bound >= bound * (1 - NOISE * clipped), (clipped - new_clipped) / clipped, 0)
    share = np.where(new_bound * clipped > HIGHER * bound, 1, np.maximum(less, 0))
    return np.where(clipped > 0, share, 0).astype(np.float32)
