"""Panels of a probe's panorama: the input of a network that changes its light (`engine.lighting`).
`resized` resamples panoramas for all networks.

A network sees the panorama that the frames of the stream make together, never its own results, so that nothing that it
inferred can grow by being looked at. Its output is the change of log(1 + L), per channel, at the panels' size. Three
runs take 3.4 ms where the SGLV's networks take 9.7 (OpenVINO in bf16 on two cores, least of 20).
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32

HEIGHT: Final = 60
"""Rows of the panels; they have twice as many columns."""
PANELS: Final = 9
"""Observed radiance (3), share observed, share of it clipped, distance in metres, radiance with the fill (3)."""
FARTHEST_M: Final = 50.0
BRIGHTEST: Final = 60_000.0
"""Limits of the input: distance, and radiance in units of white."""


def changed_light(
    light: Float[np.ndarray, "h w 3"], change: Float32[np.ndarray, "3 ph pw"], share: Float[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w 3"]:
    """Return light whose log(1 + L) has changed by a network's output, by as much of it as `share` says.

    Where the share is 0 the light keeps its bits.
    """
    height, change = len(light), np.ascontiguousarray(np.moveaxis(change, 0, -1))
    fine = resized(change, height, cv2.INTER_LINEAR)
    edge = -(-height // len(change))  # columns beside the seam; half a turn on, it lies inside
    turned = np.roll(resized(np.roll(change, len(change), axis=1), height, cv2.INTER_LINEAR), height, axis=1)
    fine[:, :edge], fine[:, -edge:] = turned[:, :edge], turned[:, -edge:]
    log = np.log1p(np.maximum(light, 0)) + fine * share[..., None]
    return np.where(share[..., None] > 0, np.expm1(np.clip(log, 0, np.float32(np.log1p(BRIGHTEST)))), light)


def panorama_panels(
    *,
    detail: Float[np.ndarray, "h w 3"],
    known: Float[np.ndarray, "h w"],
    clipped: Float[np.ndarray, "h w"],
    depth_m: Float[np.ndarray, "h w"],
    fill: Float[np.ndarray, "h w 3"],
) -> Float32[np.ndarray, "9 ph pw"]:
    """Compute the panels: means over their pixels, those of observed values weighted by the share observed."""
    share = resized(known, HEIGHT)

    def mean(plane: Float[np.ndarray, "h w *c"]) -> Float32[np.ndarray, "ph pw *c"]:
        weighted = known.reshape(known.shape + (1,) * (plane.ndim - 2)) * plane
        return resized(weighted, HEIGHT) / np.maximum(share, 1e-3).reshape(share.shape + (1,) * (plane.ndim - 2))

    panels = np.empty((PANELS, HEIGHT, 2 * HEIGHT), np.float32)
    panels[0:3] = np.moveaxis(mean(np.minimum(detail, BRIGHTEST)), -1, 0)
    panels[3], panels[4] = share, mean(clipped)
    panels[5] = mean(np.minimum(depth_m, FARTHEST_M))
    panels[6:9] = np.moveaxis(resized(np.minimum(fill, BRIGHTEST), HEIGHT), -1, 0)
    return panels


def resized(
    image: Float[np.ndarray, "h w *c"], height: int, interpolation: int | None = None
) -> Float32[np.ndarray, "{height} 2*{height} *c"]:
    """Return an image as a panorama of `height` rows: area means where it gets smaller, else bilinear."""
    if image.shape[0] == height:
        return np.asarray(image, np.float32)
    smaller = image.shape[0] > height
    chosen = interpolation if interpolation is not None else cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return cv2.resize(np.asarray(image, np.float32), (2 * height, height), interpolation=chosen)
