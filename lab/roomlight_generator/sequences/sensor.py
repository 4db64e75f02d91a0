"""A phone's camera: turns radiance into an 8-bit picture by lens, noise, clipping and sRGB.

The response is sRGB's, because every client linearises by it; in some sequences (`Sensor.response`) it deviates a
little, as phones' do.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float16, UInt8

from roomlight.conventions import linear_to_srgb, linear_to_srgb8
from roomlight.dataset.sequence_files import HALF_MAX
from roomlight.frame import CLIPPED_SRGB8

BASE_MULTIPLIER: Final = 4.2
"""Multiplier per kcd/m2 up to which a phone needs no gain: f/1.8, 1/30 s and ISO 32 clip at 237 cd/m2.

Above, gain is multiplier / BASE_MULTIPLIER, and the noise of the light itself shows.
"""
OWN_RESPONSE_SHARE: Final = 0.3
"""Share of sequences whose tone curve is not exactly sRGB's."""

_FULL_WELL: Final = 150_000.0
"""Electrons at white, without gain, behind one pixel of a 320 x 240 picture.

An assumption: 160 sensor pixels of 6,000 electrons fall on it, of which a sixth counts, because video reads fewer of
them and its denoising leaves coarse grain.
"""
_READ_NOISE: Final = 6.0
"""Electrons."""


@dataclass(frozen=True)
class Sensor:
    """A phone's camera.

    Attributes:
        noise: Scale of the model's noise.
        grain_px, blur_px: Standard deviations of the noise's grain and of the lens.
        vignetting: Loss in the corners.
        sharpening: Strength of an unsharp mask.
        response: (gamma, contrast) about sRGB's curve; (1, 0) is sRGB itself.
    """

    noise: float = 1.0
    grain_px: float = 0.5
    blur_px: float = 0.4
    vignetting: float = 0.0
    sharpening: float = 0.0
    response: tuple[float, float] = (1.0, 0.0)

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Sensor":
        """Draw a sensor at random."""
        own = rng.random() < OWN_RESPONSE_SHARE
        gamma, contrast = rng.uniform(0.95, 1.05), rng.uniform(-0.06, 0.06)
        return cls(
            noise=float(np.exp(rng.normal(0, 0.5))),
            grain_px=float(rng.uniform(0.3, 0.8)),
            blur_px=float(rng.uniform(0.25, 0.7)),
            vignetting=float(rng.uniform(0, 0.12)) if rng.random() < 0.6 else 0.0,
            sharpening=float(rng.uniform(0, 0.5)) if rng.random() < 0.5 else 0.0,
            response=(float(gamma), float(contrast)) if own else (1.0, 0.0),
        )

    @property
    def exact_response(self) -> bool:
        """Whether the tone curve is exactly sRGB's."""
        return self.response == (1.0, 0.0)


def develop(
    radiance: Float[np.ndarray, "h w 3"],
    sensor: Sensor,
    rng: np.random.Generator,
    *,
    multiplier: float,
    gains: Float[np.ndarray, "3"],
) -> UInt8[np.ndarray, "h w 3"]:
    """Develop radiance (kcd/m2) to an 8-bit sRGB picture, with the exposure and gains of `exposure.expose`.

    Shot and read noise are added after amplification, and smoothed as denoising leaves them without changing their
    deviation; what exceeds 1.0 clips. The same generator state gives the same bytes.
    """
    image = np.asarray(radiance, np.float32) * (gains * multiplier).astype(np.float32)
    image = np.minimum(image, np.float32(64.0))  # six stops over white: an 8-bit picture shows nothing brighter
    if sensor.vignetting:
        image *= _vignette(image.shape[0], image.shape[1], sensor.vignetting)[..., None]
    image = cv2.GaussianBlur(image, (0, 0), sensor.blur_px)
    gain = max(1.0, multiplier / BASE_MULTIPLIER)
    electrons = _FULL_WELL / gain
    variance = np.minimum(image, np.float32(1.0)) / electrons + (_READ_NOISE / electrons) ** 2
    image += np.sqrt(variance) * (sensor.noise * _grain(rng, image.shape[0], image.shape[1], sensor.grain_px))
    image = np.clip(image, 0, 1)
    if sensor.sharpening:
        image = np.clip(image + sensor.sharpening * (image - cv2.GaussianBlur(image, (0, 0), 1.2)), 0, 1)
    if sensor.exact_response:
        return linear_to_srgb8(image)
    gamma, contrast = sensor.response
    encoded = linear_to_srgb(image) ** np.float32(gamma)
    encoded += (
        np.float32(contrast) * encoded * (1 - encoded) * (2 * encoded - 1) * 2
    )  # an S curve that keeps 0, 1/2 and 1
    return np.rint(np.clip(encoded, 0, 1) * 255).astype(np.uint8)


def clipped_radiance(
    radiance: Float[np.ndarray, "h w 3"],
    picture: UInt8[np.ndarray, "h w 3"],
    *,
    multiplier: float,
    gains: Float[np.ndarray, "3"],
) -> Float16[np.ndarray, "h w 3"]:
    """Return the radiance of the picture's clipped pixels in units of its own white, 0 elsewhere.

    Pixels that exceed a half float are dimmed without changing their hue. `develop` made the picture from the radiance
    (kcd/m2), which is without lens, vignetting and noise, with this multiplier and these gains.
    """
    scaled = np.asarray(radiance, np.float32) * (gains * multiplier).astype(np.float32)
    scaled *= np.minimum(1, np.float32(HALF_MAX) / np.maximum(scaled.max(axis=2, keepdims=True), 1))
    return np.where((picture >= CLIPPED_SRGB8).any(axis=2, keepdims=True), scaled, 0).astype(np.float16)


def _vignette(height: int, width: int, loss: float) -> Float[np.ndarray, "{height} {width}"]:
    """Return the share of light left by a falloff like cos^4: 1 in the middle, 1 - loss in the corners."""
    y = (np.arange(height, dtype=np.float32) + 0.5) / height * 2 - 1
    x = (np.arange(width, dtype=np.float32) + 0.5) / width * 2 - 1
    return 1 - np.float32(loss) * (0.5 * (x**2 + y[:, None] ** 2)) ** 1.5


def _grain(
    rng: np.random.Generator, height: int, width: int, size_px: float
) -> Float[np.ndarray, "{height} {width} 3"]:
    """Draw noise of deviation 1, correlated over pixels and partly over channels, as demosaicing leaves it."""
    noise = rng.standard_normal((height, width, 3), np.float32)
    noise = cv2.GaussianBlur(0.8 * noise + 0.6 * noise[..., 1:2], (0, 0), size_px)
    kernel = cv2.getGaussianKernel(int(2 * np.ceil(4 * size_px) + 1), size_px).ravel()
    weight = np.array([1.0, 1.4, 1.0], np.float32)  # of 0.8 n + 0.6 n_green: for green both are the same noise
    return noise / (weight * np.float32((kernel**2).sum()))
