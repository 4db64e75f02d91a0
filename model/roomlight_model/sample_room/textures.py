"""Procedural textures: wood, planks, cloth, a rug, prints for the walls and what the television shows.

All are linear RGB reflectance, float32 [h, w, 3], made from a seeded generator; image row 0 is the top.
"""

from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.conventions import srgb_to_linear

Texture = Float[np.ndarray, "h w 3"]


def srgb(*colour: int | float) -> tuple[float, float, float]:
    """A colour as one reads it off a screen (0 to 255), as linear reflectance."""
    linear = srgb_to_linear(np.array(colour, np.float32) / np.float32(255))
    return float(linear[0]), float(linear[1]), float(linear[2])


def noise(
    rng: np.random.Generator, height: int, width: int, *, cells: tuple[int, int], octaves: int = 4
) -> Float[np.ndarray, "{height} {width}"]:
    """Smooth fractal noise around 0 (about -1 to 1); `cells` are the coarsest octave's rows and columns."""
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        rows, columns = min(cells[0] << octave, height), min(cells[1] << octave, width)
        grid = rng.uniform(-1, 1, (rows, columns)).astype(np.float32)
        total += cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC) * np.float32(0.55**octave)
    return total * np.float32(0.7)


def wood(
    rng: np.random.Generator, colour: tuple[float, float, float], *, height: int = 128, width: int = 512
) -> Texture:
    """Grain that runs along the rows' direction (u)."""
    fine = noise(rng, height, width, cells=(48, 3), octaves=3)
    broad = noise(rng, height, width, cells=(6, 2), octaves=2)
    rings = np.sin((np.linspace(0, 26, height)[:, None] + 5 * broad) * 1.2)
    shade = 1 + 0.16 * fine + 0.10 * rings + 0.10 * broad
    return (np.array(colour, np.float32) * np.clip(shade, 0.4, 1.7)[..., None] ** [1.0, 1.15, 1.3]).astype(np.float32)


def planks(rng: np.random.Generator, *, height: int, width: int, plank: int = 44, length: int = 420) -> Texture:
    """Floor boards along u: each with its own tone and grain, joints dark and staggered (sizes in texels)."""
    floor = np.empty((height, width, 3), np.float32)
    oak = np.array(srgb(176, 128, 84), np.float32)
    for top in range(0, height, plank):
        rows = min(plank, height - top)
        left = -int(rng.integers(0, length))
        while left < width:
            columns = int(length * rng.uniform(0.75, 1.2))
            tone = rng.uniform(0.72, 1.2) * oak * np.array([1.0, rng.uniform(0.95, 1.03), rng.uniform(0.88, 1.05)])
            board = wood(rng, (float(tone[0]), float(tone[1]), float(tone[2])), height=rows, width=columns)
            board[:2] *= 0.45
            board[:, :2] *= 0.45
            low, high = max(left, 0), max(min(left + columns, width), 0)
            if high > low:
                floor[top : top + rows, low:high] = board[:, low - left : high - left]
            left += columns
    return floor


def cloth(rng: np.random.Generator, *, size: int = 256, thread: int = 4, contrast: float = 0.22) -> Texture:
    """A plain weave around white, to be tinted."""
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    over = ((x // thread) + (y // thread)) % 2
    weave = np.where(over, np.sin(np.pi * (x % thread + 0.5) / thread), np.sin(np.pi * (y % thread + 0.5) / thread))
    uneven = noise(rng, size, size, cells=(16, 16), octaves=4)
    shade = 1 - contrast * (1 - weave) + 0.08 * uneven
    return np.repeat(np.clip(shade, 0, 1.1)[..., None], 3, axis=-1).astype(np.float32)


def stripes(rng: np.random.Generator, *, size: int = 256) -> Texture:
    """A striped cushion cover."""
    image = cloth(rng, size=size)
    bands = (np.arange(size) // (size // 16)) % 4 == 0
    image[:, bands] *= np.array(srgb(38, 70, 92), np.float32)
    image[:, ~bands] *= np.array(srgb(236, 226, 208), np.float32)
    return image


def rug(rng: np.random.Generator, *, height: int = 480, width: int = 720) -> Texture:
    """A flat-woven rug: a border, a field of diamonds, three dyes on cream."""
    cream, rust, navy, ochre = (
        np.array(srgb(*c), np.float32) for c in ((231, 220, 199), (168, 74, 48), (44, 62, 88), (205, 150, 70))
    )
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    image = np.broadcast_to(cream, (height, width, 3)).copy()
    cell = height / 4
    du, dv = np.abs((x / cell) % 1 - 0.5), np.abs((y / cell) % 1 - 0.5)
    diamond = du + dv
    image[np.abs(diamond - 0.46) < 0.035] = navy
    image[diamond < 0.34] = rust
    image[diamond < 0.22] = cream
    image[diamond < 0.13] = ochre
    edge = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    image[edge < 44] = cream
    image[(edge > 30) & (edge < 40)] = rust
    image[(edge > 12) & (edge < 26)] = navy
    teeth = (edge > 12) & (edge < 26) & (((x + y) // 10) % 2 < 1)
    image[teeth] = ochre
    weave = 1 + 0.10 * noise(rng, height, width, cells=(120, 180), octaves=2) + 0.06 * np.sin(y * np.pi / 1.5)
    return cv2.GaussianBlur((image * weave[..., None]).astype(np.float32), (0, 0), 0.8)


def _paper(height: int, width: int) -> Texture:
    return np.broadcast_to(np.array(srgb(243, 238, 226), np.float32), (height, width, 3)).copy()


def print_hills(rng: np.random.Generator, *, height: int = 256, width: int = 192) -> Texture:
    """Layered hills under a sun, in a paper mount."""
    image = _paper(height, width)
    margin = 18
    h, w = height - 2 * margin, width - 2 * margin
    rows = np.linspace(0, 1, h, dtype=np.float32)[:, None]
    top, low = np.array(srgb(240, 196, 140), np.float32), np.array(srgb(245, 226, 196), np.float32)
    art = np.broadcast_to((top + (low - top) * rows)[:, None, :], (h, w, 3)).copy()
    y, x = np.mgrid[0:h, 0:w]
    art[(x - 0.62 * w) ** 2 + (y - 0.3 * h) ** 2 < (0.13 * w) ** 2] = srgb(216, 84, 50)
    dyes = [srgb(168, 176, 160), srgb(112, 140, 136), srgb(66, 102, 110), srgb(34, 62, 74)]
    for layer, dye in enumerate(dyes):
        ridge = h * (0.45 + 0.13 * layer) + 0.08 * h * noise(rng, 1, w, cells=(1, 3 + layer), octaves=3)[0]
        art[y > ridge[None, :]] = dye
    image[margin:-margin, margin:-margin] = art
    return image


def print_shapes(rng: np.random.Generator, *, height: int = 256, width: int = 192) -> Texture:
    """Overlapping discs and arches in four dyes."""
    image = _paper(height, width)
    y, x = np.mgrid[0:height, 0:width]
    shapes = [
        ((x - 0.40 * width) ** 2 + (y - 0.36 * height) ** 2 < (0.24 * width) ** 2, srgb(214, 158, 66)),
        ((x - 0.62 * width) ** 2 + (y - 0.55 * height) ** 2 < (0.20 * width) ** 2, srgb(180, 72, 48)),
        (((x - 0.42 * width) ** 2 < (0.17 * width) ** 2) & (y > 0.6 * height) & (y < 0.86 * height), srgb(40, 84, 92)),
        ((x - 0.42 * width) ** 2 + (y - 0.6 * height) ** 2 < (0.17 * width) ** 2, srgb(40, 84, 92)),
        ((np.abs(y - 0.89 * height) < 2) & (np.abs(x - 0.5 * width) < 0.36 * width), srgb(40, 40, 44)),
    ]
    for mask, dye in shapes:
        image[mask] = dye
    image *= 1 + 0.04 * noise(rng, height, width, cells=(40, 30), octaves=2)[..., None]
    return cv2.GaussianBlur(np.clip(image, 0, 1), (0, 0), 0.7)


def print_leaf(rng: np.random.Generator, *, height: int = 192, width: int = 256) -> Texture:
    """A branch with leaves, ink on paper."""
    image = _paper(height, width)
    canvas = np.ascontiguousarray(image)
    ink = srgb(48, 86, 62)
    stem = [
        (int(width * (0.14 + 0.72 * t)), int(height * (0.8 - 0.55 * t + 0.1 * np.sin(4 * t))))
        for t in np.linspace(0, 1, 14)
    ]
    for low, high in pairwise(stem):
        cv2.line(canvas, low, high, ink, 2, cv2.LINE_AA)
    for at, (x, y) in enumerate(stem[1:]):
        for side in (-1, 1):
            angle = -37 + side * float(rng.uniform(48, 66))
            reach = 13 + 10 * np.sin(np.pi * at / 13)
            middle = (int(x + reach * np.cos(np.radians(angle))), int(y + reach * np.sin(np.radians(angle))))
            cv2.ellipse(canvas, middle, (int(reach), int(reach * 0.36)), angle, 0, 360, ink, -1, cv2.LINE_AA)
    return np.clip(canvas, 0, 1).astype(np.float32)


def screen(rng: np.random.Generator, *, height: int = 180, width: int = 320) -> Texture:
    """A paused film: a sea at dusk. Relative to the screen's white."""
    rows = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    high, low = np.array(srgb(44, 66, 140), np.float32), np.array(srgb(255, 160, 96), np.float32)
    image = np.broadcast_to(high + (low - high) * np.clip(rows / 0.55, 0, 1) ** 1.5, (height, width, 3)).copy()
    image *= 1 + 0.25 * noise(rng, height, width, cells=(6, 4), octaves=3)[..., None]
    y, x = np.mgrid[0:height, 0:width]
    image[(x - 0.66 * width) ** 2 + (y - 0.5 * height) ** 2 < 17**2] = srgb(255, 240, 200)
    sea = y > 0.58 * height
    glitter = 1 + 0.5 * noise(rng, height, width, cells=(60, 12), octaves=2)
    water = np.array(srgb(40, 92, 128), np.float32) * glitter[..., None]
    water += np.exp(-((x - 0.66 * width) ** 2) / 600.0)[..., None] * np.array(srgb(220, 140, 90), np.float32) * 0.7
    image[sea] = water[sea]
    ridge = 0.58 * height - 16 - 9 * noise(rng, 1, width, cells=(1, 6), octaves=3)[0]
    land = (y > ridge[None, :]) & (x < 0.42 * width) & ~sea
    image[land] = srgb(30, 36, 52)
    return np.clip(image, 0, 1).astype(np.float32)
