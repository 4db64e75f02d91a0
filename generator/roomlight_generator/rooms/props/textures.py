"""Small textures for furniture: wood grain, weaves, patterns, stone, pictures. sRGB images of 48 to 192 pixels.

Textures with a physical size tile: their noise is periodic.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from roomlight_generator.rooms.props.draft import uniform
from roomlight_generator.rooms.scene import Rgb, Texture
from roomlight_generator.rooms.shapes import Number

Image = Float[np.ndarray, "h w 3"]


def from_srgb(srgb: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Convert sRGB values to linear ones, both 0 to 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0.0) + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Convert linear values to sRGB ones, both 0 to 1."""
    clear = np.clip(linear, 0.0, 1.0)
    return np.where(clear <= 0.0031308, clear * 12.92, 1.055 * clear ** (1 / 2.4) - 0.055)


def _bytes(image: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)


def _stored(colour: Rgb) -> Float[np.ndarray, "3"]:
    """Return a colour, encoded, as a texture under an albedo of 0.95 stores it."""
    return to_srgb(np.minimum(np.array(colour, np.float64) / 0.95, 1.0))


def noise(
    rng: np.random.Generator, height: int, width: int, rows: int, columns: int
) -> Float[np.ndarray, "height width"]:
    """Return smooth periodic noise of about unit variance with `rows` x `columns` knots."""
    coarse = rng.standard_normal((rows, columns)).astype(np.float32)
    around = np.pad(coarse, 2, mode="wrap")
    fine = cv2.resize(
        around,
        (width + 4 * width // columns, height + 4 * height // rows),
        interpolation=cv2.INTER_CUBIC,
    )
    y, x = 2 * height // rows, 2 * width // columns
    return fine[y : y + height, x : x + width].astype(np.float64) * 1.3


def grain(rng: np.random.Generator, colour: Rgb) -> Texture:
    """Make wood grain: streaks along u, a slower change of tone, sometimes cathedral rings."""
    size = 128
    streaks = 0.6 * noise(rng, size, size, 64, 2) + 0.5 * noise(rng, size, size, 32, 4)
    if rng.random() < 0.5:
        rise = np.linspace(0, 2 * np.pi, size, endpoint=False)[:, None]
        bend = 6 * np.sin(rise) + 1.5 * noise(rng, size, size, 4, 2)
        streaks += 0.5 * np.sin(bend * uniform(rng, 1.0, 2.5))
    tone = 1 + uniform(rng, 0.03, 0.1) * streaks
    image = _stored(colour) * tone[..., None] ** np.array([0.8, 1.0, 1.2])
    length = uniform(rng, 0.6, 1.2)
    return Texture(_bytes(image), size_m=(length, uniform(rng, 0.25, 0.5)))


def weave(rng: np.random.Generator, colour: Rgb) -> Texture:
    """Make a mottled weave of threads."""
    size = 64
    y, x = np.mgrid[0:size, 0:size]
    period = int(rng.choice([4, 8]))
    over = ((x // (period // 2) + y // (period // 2)) % 2) * 2 - 1.0
    tone = 1 + uniform(rng, 0.01, 0.06) * over + uniform(rng, 0.01, 0.05) * noise(rng, size, size, 32, 32)
    tone += uniform(rng, 0.01, 0.05) * noise(rng, size, size, 4, 4)
    side = uniform(rng, 0.08, 0.3)
    return Texture(_bytes(_stored(colour) * tone[..., None]), size_m=(side, side))


def pattern(rng: np.random.Generator, first: Rgb, second: Rgb) -> Texture:
    """Make stripes, checks, spots, diamonds or leaves of a second colour."""
    size = 96
    y, x = np.mgrid[0:size, 0:size] / size
    kind = int(rng.integers(5))
    if kind == 0:
        share = (x * int(rng.integers(1, 5)) % 1 < uniform(rng, 0.2, 0.6)).astype(float)
    elif kind == 1:
        share = 0.5 * ((x * 2 % 1 < 0.5).astype(float) + (y * 2 % 1 < 0.5))
    elif kind == 2:
        u, v = x * 3 % 1 - 0.5, y * 3 % 1 - 0.5
        share = (u * u + v * v < uniform(rng, 0.04, 0.14)).astype(float)
    elif kind == 3:
        share = ((np.abs(x * 2 % 1 - 0.5) + np.abs(y * 2 % 1 - 0.5)) % 0.34 < 0.15).astype(float)
    else:
        share = (noise(rng, size, size, 8, 8) > uniform(rng, 0.1, 0.9)).astype(float)
    image = _stored(first) + share[..., None] * (_stored(second) - _stored(first))
    image = image * (1 + 0.03 * noise(rng, size, size, 48, 48))[..., None]
    side = uniform(rng, 0.12, 0.5)
    return Texture(_bytes(image), size_m=(side, side))


def speckle(rng: np.random.Generator, colour: Rgb, *, veins: Number = 0.5) -> Texture:
    """Make stone: grains, or, with probability `veins`, veins."""
    size = 96
    if rng.random() >= veins:
        tone = 1 + uniform(rng, 0.03, 0.2) * np.clip(noise(rng, size, size, 48, 48), -1.5, 2)
    else:
        warp = noise(rng, size, size, 3, 3) + 0.5 * noise(rng, size, size, 6, 6)
        tone = 1 - uniform(rng, 0.1, 0.4) * np.exp(-np.abs(warp) * 9) + 0.02 * noise(rng, size, size, 24, 24)
    side = uniform(rng, 0.3, 1.0)
    return Texture(_bytes(_stored(colour) * tone[..., None]), size_m=(side, side))


def wicker(rng: np.random.Generator, colour: Rgb) -> Texture:
    """Make plaited cane."""
    size = 64
    y, x = np.mgrid[0:size, 0:size] / size
    wave = np.sin(x * 8 * np.pi) * np.where((y * 8).astype(int) % 2 == 0, 1, -1)
    dark = 0.75 + 0.2 * wave + 0.12 * np.sin(y * 16 * np.pi) + 0.05 * noise(rng, size, size, 16, 16)
    side = uniform(rng, 0.08, 0.16)
    return Texture(_bytes(_stored(colour) * dark[..., None]), size_m=(side, side))


def flames(rng: np.random.Generator) -> Texture:
    """Make fire on black, brightest at the middle of the bottom."""
    height, width = 64, 96
    y = np.linspace(1, 0, height)[:, None]
    x = np.linspace(-1, 1, width)[None]
    tongues = 0.55 + 0.25 * noise(rng, height, width, 3, 10) - 0.5 * x**2
    heat = np.clip(1.6 * (tongues - y * 0.9), 0, 1)
    image = np.stack([heat**0.5, heat**1.1, heat**2.2], -1)
    return Texture(_bytes(image))


def keys(columns: int, rows: int, *, base: Number = 0.1, cap: Number = 0.2) -> Texture:
    """Make the keys of a keyboard on its deck, once over unit coordinates."""
    height, width = rows * 10, columns * 10
    y, x = np.mgrid[0:height, 0:width]
    on = (x % 10 > 1) & (x % 10 < 9) & (y % 10 > 1) & (y % 10 < 9)
    level = np.where(on, cap, base)
    return Texture(_bytes(np.repeat(level[..., None], 3, -1)))
