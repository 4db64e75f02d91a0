"""How much of the light was observed, and how much is inferred.

`observed` [H, 2H] comes from blending (`PanoramaState.seen`): 1 where frames showed a direction, 0 where the model
filled it in, in between where a blending weight stood.
"""

import numpy as np
from jaxtyping import Float

from roomlight.conventions import LUMINANCE, panorama_solid_angles
from roomlight.images import encode_png
from roomlight.light.checks import check_observed, check_panorama


def coverage(observed: Float[np.ndarray, "h w"]) -> float:
    """Share of the sphere that was observed, by solid angle, in [0, 1]."""
    observed = check_observed(observed)
    share = (observed * panorama_solid_angles(len(observed))).sum(dtype=np.float64) / (4 * np.pi)
    return min(1.0, float(share))


def light_coverage(panorama: Float[np.ndarray, "h w 3"], observed: Float[np.ndarray, "h2 w2"]) -> float:
    """Share of the light (luminance x solid angle) that comes from observed directions; 1 if there is no light.

    A room half seen, its lamp included, may have nine tenths of its light measured.
    """
    observed, panorama = check_observed(observed), check_panorama(panorama)
    if panorama.shape[:2] != observed.shape:
        raise ValueError(
            f"panorama and observed are of one size, got {panorama.shape[1]} x {panorama.shape[0]} "
            f"and {observed.shape[1]} x {observed.shape[0]}"
        )
    power = np.maximum(panorama @ LUMINANCE, 0) * panorama_solid_angles(len(observed))
    everything = power.sum(dtype=np.float64)
    return min(1.0, float((power * observed).sum(dtype=np.float64) / everything)) if everything > 0 else 1.0


def confidence_png(observed: Float[np.ndarray, "h w"]) -> bytes:
    """The confidence panorama as an 8-bit grey PNG: 255 = observed, 0 = inferred."""
    return encode_png(np.rint(check_observed(observed) * 255).astype(np.uint8))


def confidence_bytes(observed: Float[np.ndarray, "h w"]) -> bytes:
    """The confidence panorama as float32, little endian, row after row."""
    return check_observed(observed).astype("<f4").tobytes()
