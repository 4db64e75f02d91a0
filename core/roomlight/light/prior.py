"""Default light returned before the first frame: grey, brighter from above, zero coverage.

Servers return it, because a request may arrive before the first frame. The engine itself raises an error instead.

Linear RGB, 1.0 = what the reference exposure shows as white; panoramas are world-aligned, +Y in the top row.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_directions

LEVEL: Final = 0.3
"""Radiance from the horizon. At the exposure of the first frame the geometric mean over the sphere is 0.3 to 0.35 in
generated rooms (141 probes in 47 rooms by day and night), and 0.3 at nine probes in three other rooms."""
UPWARD: Final = 0.2
"""More from straight above, less from below: those rooms have 0.3 to 0.6 in the upper half, 0.12 to 0.16 from the
floor. No tint: lamps are warmer than white, daylight is cooler."""


@lru_cache(maxsize=4)
def prior_panorama(height: int) -> Float[np.ndarray, "{height} 2*{height} 3"]:
    """Return `LEVEL` + `UPWARD` y for the direction (x, y, z), in all channels; float32, read-only.

    Its main light comes softly from above, and its harmonics are of the first two bands alone: an object lit by it fits
    into the room, with hardly a shadow.
    """
    upward = panorama_directions(height)[..., 1:2]
    radiance = np.repeat(np.float32(LEVEL) + np.float32(UPWARD) * upward, 3, axis=-1).astype(np.float32)
    radiance.setflags(write=False)
    return radiance
