"""The light that is taken for granted before any frame: grey, brighter from above, seen by nobody.

What a server answers with: there a question may well overtake the first frame. A program that holds the engine itself
knows which came first, and gets an error.

Linear RGB, 1.0 = what the reference exposure shows as white; panoramas are world-aligned, +Y in the top row.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_directions

LEVEL: Final = 0.3
"""Radiance from the horizon. Rooms at their first frame's exposure shed 0.3 to 0.35 in the geometric mean over the
sphere (141 probes in 47 generated rooms by day and night), and nine probes in three other rooms 0.3."""
UPWARD: Final = 0.2
"""More from straight above, less from below: those rooms shed 0.3 to 0.6 from the upper half, 0.12 to 0.16 from the
floor. No tint: lamps' and daylight's pull either way."""


@lru_cache(maxsize=4)
def prior_panorama(height: int) -> Float[np.ndarray, "{height} 2*{height} 3"]:
    """`LEVEL` + `UPWARD` y for the direction (x, y, z), in all channels; float32, read-only.

    Its main light comes softly from above, and its harmonics are of the first band alone: what is lit by it looks
    placed, and no shadow of it is more than a hint.
    """
    upward = panorama_directions(height)[..., 1:2]
    radiance = np.repeat(np.float32(LEVEL) + np.float32(UPWARD) * upward, 3, axis=-1).astype(np.float32)
    radiance.setflags(write=False)
    return radiance
