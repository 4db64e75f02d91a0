"""How much of the light was observed, and how much is inferred.

`observed` [H, 2H] is the accumulated blending weight (`PanoramaState.observed`): 1 where frames showed a direction, 0
where the model inferred it, and values between.
"""

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_solid_angles
from roomlight.images import encode_png
from roomlight.light.checks import check_observed


def coverage(observed: Float[np.ndarray, "h w"]) -> float:
    """Return the share of the sphere that was observed, by solid angle, in [0, 1]."""
    observed = check_observed(observed)
    share = (observed * panorama_solid_angles(len(observed))).sum(dtype=np.float64) / (4 * np.pi)
    return min(1.0, float(share))


def confidence_png(observed: Float[np.ndarray, "h w"]) -> bytes:
    """Encode `observed` as an 8-bit grey PNG: 255 = observed, 0 = inferred."""
    return encode_png(np.rint(check_observed(observed) * 255).astype(np.uint8))
