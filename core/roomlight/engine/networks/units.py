"""The unit of colour in which networks see a frame: the geometric mean of what its initial volume shows.

The recurrent networks keep the first frame's unit. Readable twin:
`roomlight_model.volume_networks.mean_colour`.
"""

import math
from typing import Final

import numpy as np
from jaxtyping import Float

DARKEST: Final = 0.02
"""Added to observed colours before their logarithm: an 8-bit image does not resolve less."""
GREY: Final = 0.3
"""The unit where hardly anything was seen; networks see a frame's mean colour as this."""


def mean_colour(volume: Float[np.ndarray, "5 z y x"]) -> Float[np.ndarray, "3"]:
    """Return the geometric mean colour of an initial volume's surfaces, at most white; grey if there are hardly any."""
    opacity = volume[3]
    seen = opacity > 0
    alpha = opacity[seen]
    colour = np.clip(volume[:3, seen] / np.maximum(alpha, np.float32(1e-3)), 0, 1)
    logs = (alpha * np.log(colour + np.float32(DARKEST))).sum(axis=1, dtype=np.float64)
    return np.exp((logs + math.log(GREY)) / (alpha.sum(dtype=np.float64) + 1)).astype(np.float32)
