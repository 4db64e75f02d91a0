"""Where an object changes a picture: the object, its shadow and the rest; and the truth without the renders' noise.

The truth is rendered with and without the object, each with path noise of its own. Their ratio outside of the object is
smoothed. The shadow region is where it differs from 1 by more than `CHANGED` and by more than the noise does far from
the object, in one piece with the object's outline: light that it takes and light that it reflects. Outside of the
object the truth is the frame times this ratio in the shadow region, and the frame itself elsewhere, so that noise
is no method's error.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.conventions import LUMINANCE

OBJECT: Final = "object"
SHADOW: Final = "shadow"
ELSEWHERE: Final = "elsewhere"
REGIONS: Final = (OBJECT, SHADOW, ELSEWHERE)

CHANGED: Final = 0.05
"""Least change of luminance in the shadow region, in logarithms."""
SHADOW_RADII: Final = 6.0
"""The shadow region ends at this distance from the object's centre, in radii of its bounding sphere."""
RIM_PX: Final = 2
"""Pixels on both sides of the object's outline that belong to no region."""
_DEVIATIONS: Final = 2.5
_SMOOTH_PX: Final = 1.5

Mask = Bool[np.ndarray, "h w"]


def regions(
    with_object: Float[np.ndarray, "h w 3"],
    without: Float[np.ndarray, "h w 3"],
    covered: Bool[np.ndarray, "h w"],
    distance_m: Float[np.ndarray, "h w"],
    *,
    radius_m: float,
) -> dict[str, Mask]:
    """Return a mask of each of `REGIONS`.

    Args:
        with_object, without: Undeveloped radiance in units of white.
        covered: Pixels that show the object.
        distance_m: Of each pixel's surface to the object's centre; radius_m is its bounding sphere's.
    """
    mask = covered.astype(np.uint8)
    inside = cv2.erode(mask, _box(RIM_PX)).astype(bool)
    outside = ~cv2.dilate(mask, _box(RIM_PX)).astype(bool)
    change = np.abs(luminance_change(with_object, without, ~covered))
    near = distance_m < SHADOW_RADII * radius_m
    far = change[outside & ~near]
    noise = 1.5 * float(np.median(far)) if far.size else 0.0  # the deviation, by the median of absolute values
    changed = (outside & near & (change > max(CHANGED, _DEVIATIONS * noise))).astype(np.uint8)
    changed = cv2.morphologyEx(changed, cv2.MORPH_OPEN, _box(1))
    joined = np.maximum(changed, cv2.dilate(mask, _box(RIM_PX + 1)))  # the outline joins the pieces that touch it
    _, labels = cv2.connectedComponents(joined, connectivity=8)
    own = np.unique(labels[covered])
    shadow = changed.astype(bool) & np.isin(labels, own[own > 0])
    return {OBJECT: inside, SHADOW: shadow, ELSEWHERE: outside & ~shadow}


def smoothed_truth(
    frame: Float[np.ndarray, "h w 3"],
    developed: Float[np.ndarray, "h w 3"],
    clean: tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 3"]],
    covered: Bool[np.ndarray, "h w"],
    shadow: Bool[np.ndarray, "h w"],
) -> Float32[np.ndarray, "h w 3"]:
    """Return the picture with the object, without the noise of the renders outside of it; linear light.

    Args:
        frame: Without the object, as the session got it.
        developed: With the object, by the same sensor: used in the object and on its rim.
        clean: Undeveloped radiance with the object and without, in units of white.
    """
    with_object, without = clean
    rim = cv2.dilate(covered.astype(np.uint8), _box(RIM_PX)).astype(bool)
    base = np.where(frame >= 1, np.maximum(without, 1), frame)  # a clipped pixel may stay clipped in a shadow
    ratio = np.exp(log_change(with_object, without, ~covered))
    out = np.where(shadow[..., None], base * ratio, frame)
    return np.where(rim[..., None], developed, out).astype(np.float32)


def darker_part(
    with_object: Float[np.ndarray, "h w 3"], without: Float[np.ndarray, "h w 3"], covered: Mask, shadow: Mask
) -> Mask:
    """Return the pixels of the shadow region that the object darkens."""
    return shadow & (luminance_change(with_object, without, ~covered) < 0)


def luminance_change(
    with_object: Float[np.ndarray, "h w 3"], without: Float[np.ndarray, "h w 3"], counted: Mask
) -> Float32[np.ndarray, "h w"]:
    """Return `log_change` of luminance."""
    return log_change((with_object @ LUMINANCE)[..., None], (without @ LUMINANCE)[..., None], counted)[..., 0]


def log_change(
    with_object: Float[np.ndarray, "h w c"], without: Float[np.ndarray, "h w c"], counted: Mask
) -> Float32[np.ndarray, "h w c"]:
    """Return the log of the ratio of smoothed radiance, channel by channel, of the pixels that count alone.

    Radiance is cut at four times white, so that single bright paths do not spread.
    """
    weight = counted.astype(np.float32)[..., None]

    def smooth(image: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "h w c"]:
        cut = np.clip(image, 1e-6, 4).astype(np.float32) * weight
        return cv2.GaussianBlur(cut, (0, 0), _SMOOTH_PX).reshape(image.shape)

    total = np.maximum(cv2.GaussianBlur(weight, (0, 0), _SMOOTH_PX).reshape(*weight.shape[:2], 1), 1e-6)
    return np.log(np.maximum(smooth(with_object) / total, 1e-6) / np.maximum(smooth(without) / total, 1e-6)).astype(
        np.float32
    )


def _box(radius: int) -> np.ndarray:
    return np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
