"""The camera's noise and blur, estimated from a frame and given to virtual objects.

Noise is measured in sRGB-encoded values, where viewers see it, as a function of brightness: the mean absolute
high-pass (Immerkaer 1996) of flat pixels, without the largest tenth. Cameras that demosaic and compress make noise that
is correlated between pixels and channels: the same measure at half the resolution and of differences of channels tells
how far: drawn with independent channels it would be a coarse pattern of colours. Blur is the width of strong edges, by
the ratio of their gradients before and after a known blur (Zhuo and Sim 2011). Nothing is added to a picture without
noise.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.kernels.encode import add_pattern
from roomlight.threads import parallel_for

LEVELS: Final = 8
"""Bins of brightness that noise is measured in, evenly from 0 to 1."""
FLAT_PERCENT: Final = 15
"""Noise is measured in this part of the picture, the flattest: in the flatter half, wood grain counted twice as much
as the camera's noise, and pictures rendered without noise had some."""
MAX_BLUR_PX: Final = 2.5
MEASURED: Final = (288, 384)
"""Most rows and columns that are measured."""
RENDERED_BLUR_PX: Final = 0.35
"""Blur of a rendered object's edges: a box filter of one pixel has a standard deviation of 0.29."""
_HIGH_PASS: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
_FEWEST: Final = 150
_GRAINS: Final = (0.0, 0.4, 0.55, 0.7, 0.9, 1.2)
_TILE: Final = 256
_REBLUR_PX: Final = 1.0
_STRONG: Final = 0.05
_WIDE_PX: Final = 3.0
_STEP: Final = (0.5, 1.6)
_DARKEST, _BRIGHTEST = 0.02, 0.97
"""Clipped pixels have lost their noise: they say nothing."""
_MOST_OF_ALL: Final = 1.5
"""Noise at a brightness is at most this much of that of all flat pixels: a few carpets and wood grain are no noise."""
_OF_NORMAL: Final = 0.657
"""Mean absolute value of normal numbers of deviation 1 without the largest tenth."""
_QUANTISED: Final = 0.4 / 255
"""Noise below this is the rounding to 8 bits."""


@dataclass(frozen=True)
class CameraModel:
    """A frame's noise and blur.

    Attributes:
        noise: [LEVELS, 3] standard deviation of the encoded value at each brightness, for red, green, blue.
        grain_px: blur of the noise itself; 0 is white.
        blur_px: standard deviation of the point spread, in pixels.
        shared: part of the noise's variance that the channels have in common.
        known: whether enough pixels were neither black nor white to measure noise at.
    """

    noise: Float32[np.ndarray, "levels 3"]
    grain_px: float
    blur_px: float
    shared: float = 0.0
    known: bool = True

    @classmethod
    def perfect(cls) -> "CameraModel":
        """Return a camera without noise and blur."""
        return cls(np.zeros((LEVELS, 3), np.float32), 0.0, 0.0)

    def eased(self, newer: "CameraModel", share: float) -> "CameraModel":
        """Return the model moved toward a newer one, by a share of 0 to 1."""
        noise = (1 - share) * self.noise + share * newer.noise
        shapes = ((model.grain_px, model.blur_px, model.shared) for model in (self, newer))
        return CameraModel(
            noise.astype(np.float32), *((1 - share) * a + share * b for a, b in zip(*shapes, strict=True))
        )


def measure_camera(encoded: Float[np.ndarray, "h w 3"]) -> CameraModel:
    """Estimate noise and blur of an image, sRGB-encoded in [0, 1], from its middle; 20 ms on one core."""
    if min(encoded.shape[:2]) < 16:
        return CameraModel.perfect()
    height, width = encoded.shape[:2]
    top, left = max(0, height - MEASURED[0]) // 2, max(0, width - MEASURED[1]) // 2
    image = np.ascontiguousarray(encoded[top : top + MEASURED[0], left : left + MEASURED[1]], np.float32)
    smooth, flat = _flat(image)
    high = cv2.filter2D(image, -1, _HIGH_PASS, borderType=cv2.BORDER_REFLECT)
    noise = _by_brightness(high, smooth, flat)
    grain = _grain_of(image, high, flat) if noise.any() else 0.0
    usable = flat[..., None] & (smooth > _DARKEST) & (smooth < _BRIGHTEST)
    known = bool(usable.sum(axis=(0, 1)).max() >= _FEWEST)
    return CameraModel(noise, grain, measure_blur(image), _shared(high[usable.all(axis=-1)]), known)


def _flat(encoded: Float[np.ndarray, "h w 3"]) -> tuple[Float32[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Return the smoothed image, and its flattest pixels."""
    smooth = cv2.GaussianBlur(encoded, (0, 0), 1.5)
    grey = smooth.mean(axis=-1)
    slope = np.abs(cv2.Sobel(grey, cv2.CV_32F, 1, 0)) + np.abs(cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    return smooth, slope <= np.percentile(slope, FLAT_PERCENT)


def _by_brightness(
    high: Float[np.ndarray, "h w 3"], smooth: Float[np.ndarray, "h w 3"], flat: Bool[np.ndarray, "h w"]
) -> Float32[np.ndarray, "levels 3"]:
    """Return the standard deviation of the noise by brightness and channel; levels without pixels take their
    neighbours'."""
    result = np.zeros((LEVELS, 3), np.float32)
    for channel in range(3):
        values, at = high[..., channel][flat], smooth[..., channel][flat]
        usable = (at > _DARKEST) & (at < _BRIGHTEST)
        values, level = values[usable], (at[usable] * LEVELS).astype(np.int64)
        if len(values) < _FEWEST:
            continue
        most = _MOST_OF_ALL * _deviation(values)
        parts = [(number, values[level == number]) for number in range(LEVELS)]
        known = [(number, min(_deviation(part), most)) for number, part in parts if len(part) >= _FEWEST]
        numbers, sigmas = zip(*(known or [(0, most / _MOST_OF_ALL)]), strict=True)
        result[:, channel] = np.interp(np.arange(LEVELS), numbers, sigmas)
    result[result.mean(axis=1) < _QUANTISED] = 0
    return result


def _grain_of(
    image: Float[np.ndarray, "h w 3"], high: Float[np.ndarray, "h w 3"], flat: Bool[np.ndarray, "h w"]
) -> float:
    """Return the blur of the noise, by the noise of the flat pixels and that of the same at half the resolution."""
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    all_flat = cv2.resize(flat.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) > 0.99
    if all_flat.sum() < _FEWEST:
        return 0.0
    coarse = cv2.filter2D(half, -1, _HIGH_PASS, borderType=cv2.BORDER_REFLECT)[all_flat]
    ratio = _deviation(coarse.reshape(-1)) / max(_deviation(high[flat].reshape(-1)), 1e-9)
    return float(np.interp(ratio, _grain_ratios(), _GRAINS))


def _shared(high: Float[np.ndarray, "n 3"]) -> float:
    """Return the mean correlation of two channels' high-pass, by the deviations of both and of their difference."""
    if len(high) < _FEWEST:
        return 0.0
    red, green, blue = high.T
    correlations = [
        (of_a**2 + of_b**2 - _deviation(a - b) ** 2) / max(2 * of_a * of_b, 1e-12)
        for a, b in ((red, green), (green, blue), (blue, red))
        for of_a, of_b in [(_deviation(a), _deviation(b))]
    ]
    return float(np.clip(np.mean(correlations), 0, 1))


def _deviation(values: Float[np.ndarray, " n"]) -> float:
    """Return the standard deviation of noise by its mean absolute value without the largest tenth.

    The median of 8-bit values would be a multiple of a quarter of a level, which is as much as many cameras have.
    """
    sizes = np.abs(values)
    kept = np.partition(sizes, int(0.9 * len(sizes)))[: int(0.9 * len(sizes))]
    return float(kept.mean()) / _OF_NORMAL


def measure_blur(encoded: Float[np.ndarray, "h w 3"]) -> float:
    """Return the standard deviation, in pixels, of strong steps of brightness, in the median; 0 without steps."""
    grey = encoded.mean(axis=-1, dtype=np.float32)
    soft = cv2.GaussianBlur(grey, (0, 0), 0.5)  # so that noise makes no edges
    blurred = cv2.GaussianBlur(soft, (0, 0), _REBLUR_PX)

    def gradient(image: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        return cv2.magnitude(cv2.Sobel(image, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(image, cv2.CV_32F, 0, 1) / 8)

    sharp = gradient(soft)
    ridge = (sharp > _STRONG) & (sharp >= cv2.dilate(sharp, np.ones((3, 3), np.uint8)) - 1e-9)
    ratio = np.maximum(sharp[ridge] / np.maximum(gradient(blurred)[ridge], 1e-6), 1.001)
    # R = sqrt((s^2 + b^2) / s^2) with s the edge's width after the first blur and the pixel's own derivative
    width = _REBLUR_PX / np.sqrt(ratio**2 - 1)
    # lines and corners lose more than steps do: the step's height must be the same at a larger scale
    wide = gradient(cv2.GaussianBlur(soft, (0, 0), _WIDE_PX))[ridge]
    kept = wide * np.sqrt(_WIDE_PX**2 + width**2) / (sharp[ridge] * width)
    steps = (kept > _STEP[0]) & (kept < _STEP[1])
    if steps.sum() < 40:
        return 0.0
    typical = float(np.median(width[steps]))
    return float(np.clip(np.sqrt(max(typical**2 - 0.5**2 - 0.6**2, 0.0)), 0.0, MAX_BLUR_PX))


def blur_layer(layer: Float[np.ndarray, "h w c"], blur_px: float) -> Float32[np.ndarray, "h w c"]:
    """Blur a rendered, premultiplied layer to the camera's sharpness."""
    more = np.sqrt(max(blur_px**2 - RENDERED_BLUR_PX**2, 0.0))
    if more < 0.15:
        return layer.astype(np.float32)
    return cv2.GaussianBlur(layer.astype(np.float32), (0, 0), more, borderType=cv2.BORDER_REPLICATE)


def add_noise(
    encoded: Float[np.ndarray, "h w 3"],
    alpha: Float[np.ndarray, "h w"],
    camera: CameraModel,
    *,
    frame_index: int,
    at: tuple[int, int] = (0, 0),
) -> Float32[np.ndarray, "h w 3"]:
    """Add the camera's noise to the part `alpha` of an encoded image; the pattern is fixed by the frame's index.

    Args:
        at: row and column of the image's corner in the frame, so that a crop has the pattern of the whole.
    """
    if not camera.noise.any():
        return encoded.astype(np.float32)
    shift = np.random.default_rng([frame_index & 0xFFFFFFFF, 5]).integers(0, _TILE, 2)
    corner = (at[0] + int(shift[0])) % _TILE, (at[1] + int(shift[1])) % _TILE
    out = np.ascontiguousarray(encoded, np.float32).copy()
    grain_px = min(_GRAINS, key=lambda grain: abs(grain - camera.grain_px))
    pattern = _pattern(grain_px, round(camera.shared, 1))
    sigma = camera.noise.astype(np.float32)
    arguments = (out, np.ascontiguousarray(alpha, np.float32), sigma, pattern, corner)
    parallel_for(lambda start, stop: add_pattern(*arguments, start, stop), len(out))
    return out


@lru_cache(maxsize=8)
def _pattern(grain_px: float, shared: float = 0.0) -> Float32[np.ndarray, "n n 3"]:
    """Return periodic noise whose high-pass measure is 1, of which the channels share a part of the variance."""
    own, common = (np.random.default_rng(seed).standard_normal((_TILE, _TILE, 3)) for seed in (11, 12))
    white = (np.sqrt(1 - shared) * own + np.sqrt(shared) * common[..., :1]).astype(np.float32)
    if grain_px > 0:
        wide = np.pad(white, ((8, 8), (8, 8), (0, 0)), mode="wrap")
        white = cv2.GaussianBlur(wide, (0, 0), grain_px)[8:-8, 8:-8]
    pattern = white / _spread(white)
    pattern.setflags(write=False)
    return pattern


def _spread(noise: Float[np.ndarray, "h w 3"]) -> float:
    return _deviation(cv2.filter2D(noise, -1, _HIGH_PASS).reshape(-1))


@lru_cache(maxsize=1)
def _grain_ratios() -> tuple[float, ...]:
    """Return the measure at half the resolution over that at the full one, for each grain."""
    halves = (cv2.resize(_pattern(grain), (_TILE // 2, _TILE // 2), interpolation=cv2.INTER_AREA) for grain in _GRAINS)
    return tuple(_spread(half) for half in halves)
