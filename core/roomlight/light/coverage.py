"""How much of the light was observed, and how much is inferred.

`observed` [H, 2H] is the accumulated blending weight (`PanoramaState.seen`): 1 where frames showed a direction, 0 where
the model inferred it, and values between.
"""

import numpy as np
from jaxtyping import Float

from roomlight.conventions import LUMINANCE, panorama_solid_angles
from roomlight.images import encode_png
from roomlight.light.checks import check_observed, check_panorama


def coverage(observed: Float[np.ndarray, "h w"]) -> float:
    """Return the share of the sphere that was observed, by solid angle, in [0, 1]."""
    observed = check_observed(observed)
    share = (observed * panorama_solid_angles(len(observed))).sum(dtype=np.float64) / (4 * np.pi)
    return min(1.0, float(share))


def light_coverage(panorama: Float[np.ndarray, "h w 3"], observed: Float[np.ndarray, "h2 w2"]) -> float:
    """Return the share of the light (luminance x solid angle) from observed directions; 1 if there is no light.

    Half a room with its lamp may hold nine tenths of the light.

    Raises:
        ValueError: the sizes differ.
    """
    observed, panorama = check_observed(observed), check_panorama(panorama)
    if panorama.shape[:2] != observed.shape:
        raise ValueError(
            f"panorama and observed are of one size, got {panorama.shape[1]} x {panorama.shape[0]} "
            f"and {observed.shape[1]} x {observed.shape[0]}"
        )
    power = np.maximum(panorama @ LUMINANCE, 0) * panorama_solid_angles(len(observed))
    total = power.sum(dtype=np.float64)
    return min(1.0, float((power * observed).sum(dtype=np.float64) / total)) if total > 0 else 1.0


def confidence_png(observed: Float[np.ndarray, "h w"]) -> bytes:
    """Encode `observed` as an 8-bit grey PNG: 255 = observed, 0 = inferred."""
    return encode_png(np.rint(check_observed(observed) * 255).astype(np.uint8))


def confidence_bytes(observed: Float[np.ndarray, "h w"]) -> bytes:
    """Encode `observed` as float32, little endian, row after row."""
    return check_observed(observed).astype("<f4").tobytes()
