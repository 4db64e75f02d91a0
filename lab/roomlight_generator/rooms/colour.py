"""Physically based colours: black-body light sources, and paints of a given reflectance.

All colours are linear RGB (Rec. 709 primaries, D65 white); luminance is Rec. 709's Y.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import LUMINANCE
from roomlight_generator.rooms.scene import Rgb

_XYZ_TO_RGB: Final = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)

# Ottosson's OKLab (2020): a perceptual space in which hue stays constant when lightness or chroma change.
_RGB_TO_LMS: Final = np.array(
    [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
     [0.0883024619, 0.2817188376, 0.6299787005]]
)  # fmt: skip
_LMS_TO_LAB: Final = np.array(
    [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
     [0.0259040371, 0.7827717662, -0.8086757660]]
)  # fmt: skip
_LMS_TO_RGB: Final = np.linalg.inv(_RGB_TO_LMS)
_LAB_TO_LMS: Final = np.linalg.inv(_LMS_TO_LAB)

_DARKEST, _BRIGHTEST = 0.012, 0.93
"""Limits of a paint's reflectance in any channel."""


@lru_cache(maxsize=512)
def blackbody_rgb(kelvin: float | int) -> Rgb:
    """Return the linear RGB colour of a black body at luminance 1.

    Planck's law against the CIE 1931 observer in the analytic form of Wyman, Sloan and Shirley (JCGT 2013), whose
    chromaticities lie within 0.004 of the tabulated ones. Negative channels (blue below 1,900 K) are clipped to 0.

    Raises:
        ValueError: kelvin lies outside 800 to 100,000 K.
    """
    if not 800 <= kelvin <= 100_000:
        raise ValueError(f"a colour temperature must lie between 800 and 100,000 K, got {kelvin}")
    nm = np.arange(380.0, 781.0, 5.0)
    power = nm**-5.0 / np.expm1(1.438776877e7 / (nm * kelvin))
    rgb = np.maximum(_XYZ_TO_RGB @ (_observer(nm) @ power), 0)
    rgb /= LUMINANCE @ rgb
    return float(rgb[0]), float(rgb[1]), float(rgb[2])


def _observer(nm: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3 n"]:
    def lobe(mean: float, below: float, above: float) -> Float[np.ndarray, " n"]:
        return np.exp(-0.5 * ((nm - mean) * np.where(nm < mean, below, above)) ** 2)

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323) - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    return np.stack([x, y, z])


def oklab_to_linear(lab: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Convert OKLab to linear RGB; channels of colours outside the gamut are negative or above 1."""
    return (lab @ _LAB_TO_LMS.T) ** 3 @ _LMS_TO_RGB.T


def paint(reflectance: float | int, chroma: float | int = 0.0, hue: float | int = 0.0) -> Rgb:
    """Return a paint colour of the given luminous reflectance (0.015 to 0.92), OKLab chroma (0 to 0.2) and hue in
    degrees (red 25, orange 55, yellow 100, green 145, teal 195, blue 255, violet 305, pink 350).

    A colour with a channel outside 0.012 to 0.93 is desaturated toward the grey of the same reflectance.
    """
    grey = float(np.clip(reflectance, 0.015, 0.92))
    angle = np.radians(hue)
    lab = np.array([np.cbrt(grey), chroma * np.cos(angle), chroma * np.sin(angle)])
    rgb = np.maximum(oklab_to_linear(lab), 1e-4)
    rgb *= grey / (LUMINANCE @ rgb)
    away = rgb - grey
    room = np.where(away > 0, _BRIGHTEST - grey, grey - _DARKEST) / np.maximum(np.abs(away), 1e-9)
    rgb = grey + away * min(1.0, max(0.0, float(room.min())))
    return float(rgb[0]), float(rgb[1]), float(rgb[2])
