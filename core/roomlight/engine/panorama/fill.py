"""Push-pull: fill the unknown pixels of a panorama from the known ones, smoothly and in one pass.

Images are [row, column, channel] with columns that wrap around (equirectangular) and rows that end at the
poles. The pyramid of Gortler et al. ("The Lumigraph", 1996, section 3.3.2): push known colour to coarser
levels with the tent filter (1 3 3 1) / 8, then pull it back into the pixels whose weight leaves room.
"""

import numpy as np
from jaxtyping import Float, Float32

from roomlight.engine.kernels.fill import halve, premultiply, pull, put_before


def push_pull(image: Float[np.ndarray, "h w c"], weight: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w c"]:
    """Return `image` where `weight` is 1, colour spread from known pixels where it is 0, a blend between (float32).

    Weights are confidences: values outside [0, 1] are clipped, and the colour of a pixel without weight is
    never read (it may be NaN). Every filled value is a convex combination of known ones, so no value leaves
    their range and a constant stays that constant. Where nothing is known at all the result is zero
    everywhere: the caller chooses a prior. 1 ms for 120 x 240 x 3.
    """
    rows, columns, colours = image.shape
    finest = np.empty((rows, columns, colours + 1), np.float32)
    if premultiply(*_plain(image, weight), finest):
        return np.ascontiguousarray(finest[..., :-1])
    levels = [finest]
    while rows > 1 or columns > 1:
        buffer = np.empty((columns, colours + 1), np.float32)
        rows, columns = (rows + 1) // 2, (columns + 1) // 2
        levels.append(np.empty((rows, columns, colours + 1), np.float32))
        halve(levels[-2], buffer, levels[-1])
    filled = levels[-1][..., :-1] / np.maximum(levels[-1][..., -1:], np.finfo(np.float32).tiny)
    for level in reversed(levels[:-1]):
        coarse, filled = filled, np.empty_like(level[..., :-1])
        pull(coarse, level, np.empty_like(coarse[0]), filled)
    return filled


def fill_unknown(image: Float[np.ndarray, "h w c"], weight: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w c"]:
    """Return `image` where `weight` is 1, and where it is 0 a push-pull fill from pixels of at most white
    (`at_most_white`).
    """
    filled = push_pull(at_most_white(image), weight)
    put_before(*_plain(image, weight), filled)
    return filled


def _plain(
    image: Float[np.ndarray, "h w c"], weight: Float[np.ndarray, "h w"]
) -> tuple[Float32[np.ndarray, "h w c"], Float32[np.ndarray, "h w"]]:
    return np.ascontiguousarray(image, np.float32), np.ascontiguousarray(weight, np.float32)


def at_most_white(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Scale pixels brighter than white down to white, each in its own colour, as the source of a fill.

    Windows and lamps end at their frames while walls go on. Clipped channel by channel, warm light would fade to white.
    """
    red, green, blue = np.moveaxis(image, -1, 0)
    return image / np.maximum(np.maximum(np.maximum(red, green), blue), 1)[..., None]
