"""Wallpapers: vertical stripes, damask, flowers, leaves and geometric figures. u to the right, v down the wall."""

import cv2
import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import to_srgb
from roomlight_generator.rooms.finishes.noise import blurred, fbm, flat, grid_uv, lerp, speckle, to_texture
from roomlight_generator.rooms.finishes.palettes import companion, dyes, neutral_wall, wall_colour
from roomlight_generator.rooms.scene import Rgb, Texture

_SIDE = 384


def _ground(rng: np.random.Generator) -> Rgb:
    return neutral_wall(rng) if rng.random() < 0.55 else wall_colour(rng)


def _figure(rng: np.random.Generator, ground: Rgb) -> Rgb:
    """Choose the figure's colour: close to the ground or in strong contrast to it."""
    other = companion(rng, ground)
    keep = float(rng.choice([0.0, 0.3, 0.6, 0.75]))
    return (
        ground[0] * keep + other[0] * (1 - keep),
        ground[1] * keep + other[1] * (1 - keep),
        ground[2] * keep + other[2] * (1 - keep),
    )


def _paper(rng: np.random.Generator, image: Float[np.ndarray, "h w 3"], size: tuple[float, float]) -> Texture:
    grain = speckle(rng, (image.shape[0], image.shape[1]), (0.6, 0.6))
    return to_texture((image * (1 + 0.008 * grain)[..., None]).astype(np.float32), size)


def stripes(rng: np.random.Generator) -> Texture:
    """Make vertical stripes, wide and narrow."""
    ground = _ground(rng)
    colours = np.stack([to_srgb(c) for c in (ground, _figure(rng, ground), _figure(rng, ground))])
    count = int(rng.choice([2, 2, 4, 6]))
    weights = rng.uniform(0.2, 1.0, count)
    weights[0] += 0.8
    edges = np.cumsum(weights / weights.sum()) * _SIDE
    picks = np.arange(count) % 2 + (rng.random(count) < 0.3) * (np.arange(count) % 2)
    which = np.searchsorted(edges, np.arange(_SIDE) + 0.5)
    line = colours[picks[np.minimum(which, count - 1)]]
    width = float(rng.uniform(0.08, 0.5))
    return _paper(rng, blurred(np.broadcast_to(line, (64, _SIDE, 3)).astype(np.float32), 0.7), (width, width))


def damask(rng: np.random.Generator) -> Texture:
    """Make mirrored scrolls and leaves inside a pointed medallion, in half drop."""
    high, wide = 512, 256
    mask = np.zeros((high, wide), np.uint8)
    centre = (wide // 2, high // 4)

    def leaf(x: float, y: float, length: float, width: float, degrees: float) -> None:
        for place, turn in ((x, degrees), (-x, 180 - degrees)):
            at = (int(centre[0] + place), int(centre[1] + y))
            cv2.ellipse(mask, at, (int(length), int(width)), turn, 0, 360, 255, -1, cv2.LINE_AA)

    for _ in range(int(rng.integers(9, 18))):
        y = rng.uniform(-0.42, 0.42) * high / 2
        reach = (1 - (2 * y / high) ** 2 * 3.2) * wide * 0.36
        leaf(rng.uniform(0.1, 1) * reach, y, rng.uniform(12, 34), rng.uniform(4, 11), rng.uniform(-80, 80))
    for y in np.linspace(-0.3, 0.3, int(rng.integers(3, 6))) * high / 2:
        cv2.ellipse(
            mask,
            (centre[0], int(centre[1] + y)),
            (int(rng.uniform(8, 22)), int(rng.uniform(10, 26))),
            0,
            0,
            360,
            255,
            -1,
        )
        cv2.circle(mask, (centre[0], int(centre[1] + y)), int(rng.uniform(3, 7)), 0, -1, cv2.LINE_AA)
    frame = np.linspace(0, 1, 40)
    ogive = np.stack([np.sin(np.pi * frame) ** 0.8 * wide * 0.46, (frame - 0.5) * high * 0.96 / 2], 1)
    for sign in (1, -1):
        line = np.rint(ogive * [sign, 1] + centre).astype(np.int32)
        cv2.polylines(mask, [line], False, 255, int(rng.integers(2, 7)), cv2.LINE_AA)
    field = mask.astype(np.float32) / 255
    # Half drop: the same figure again, half a repeat lower and half a width to the side.
    field = np.maximum(field, np.roll(field, (high // 2, wide // 2), (0, 1)))
    ground = _ground(rng)
    width = float(rng.uniform(0.25, 0.53))
    return _paper(rng, lerp(ground, _figure(rng, ground), field), (width, 2 * width))


def floral(rng: np.random.Generator) -> Texture:
    """Make flowers and leaves scattered over a ground."""
    ground = _ground(rng)
    colours = dyes(rng, 5)
    image = flat(ground, (_SIDE, _SIDE)).copy()
    count = int(rng.integers(14, 40))
    scale = float(rng.uniform(0.35, 0.7)) * _SIDE / np.sqrt(count)
    softened = float(rng.choice([0.0, 0.3, 0.6]))
    for _ in range(count):
        place, turn = rng.uniform(0, _SIDE, 2), rng.uniform(0, 360)
        size = scale * rng.uniform(0.5, 1.1)
        leafy = rng.random() < 0.5
        dye = to_srgb(colours[int(rng.integers(1, 5))]) * (1 - softened) + to_srgb(ground) * softened
        heart = to_srgb(colours[0])
        petals = int(rng.integers(2, 4)) if leafy else int(rng.integers(5, 8))
        step = 42.0 if leafy else 360.0 / petals
        slim = 0.24 if leafy else 0.42
        for shift in _periodic_images(place, 1.3 * size):
            for k in range(petals):
                angle = turn + k * step
                middle = shift + size * 0.5 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
                axes = (max(int(size * 8), 1), max(int(size * slim * 8), 1))
                at = tuple(int(c) for c in np.rint(middle * 16))
                cv2.ellipse(image, at, axes, angle, 0, 360, [float(c) for c in dye], -1, cv2.LINE_AA, shift=4)
            if not leafy:
                at = (round(float(shift[0])), round(float(shift[1])))
                cv2.circle(image, at, max(int(size * 0.2), 1), [float(c) for c in heart], -1, cv2.LINE_AA)
    side = float(rng.uniform(0.3, 0.9))
    return _paper(rng, image, (side, side))


def _periodic_images(place: Float[np.ndarray, "2"], reach: float) -> list[Float[np.ndarray, "2"]]:
    """Return the point itself and its periodic images just across the edges."""
    shifts = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)]) * float(_SIDE)
    places = place + shifts
    near = ((places > -reach) & (places < _SIDE + reach)).all(1)
    return list(places[near])


def geometric(rng: np.random.Generator) -> Texture:
    """Make a trellis, chevrons, scales, triangles, dots, rings or hexagonal lines."""
    u, v = grid_uv((_SIDE, _SIDE))
    count = int(rng.choice([2, 4, 6]))
    x, y = u * count, v * count
    row = y.astype(np.int32)
    shifted = (x + 0.5 * (row % 2)) % 1 - 0.5
    kind = int(rng.integers(7))
    width = float(rng.uniform(0.05, 0.14))
    third = np.zeros_like(u)
    if kind == 0:
        bent = float(rng.uniform(0, 0.12)) * np.sin(2 * np.pi * x)
        share = np.minimum(np.abs((x + y + bent) % 1 - 0.5), np.abs((x - y - bent) % 1 - 0.5)) < width
    elif kind == 1:
        share = (y + np.abs(x % 1 - 0.5) * rng.choice([1.0, 2.0])) % 1 < rng.uniform(0.25, 0.6)
    elif kind == 2:
        # Scales: rings about points on half-dropped rows, the nearer row over the farther.
        below = np.hypot(shifted, y - row - 1)
        above = np.hypot((x + 0.5 * ((row + 1) % 2)) % 1 - 0.5, y - row)
        radius = np.where(below < 0.5, below, above)
        share = (radius * rng.integers(3, 6)) % 1 < 0.35
    elif kind == 3:
        lean = (x % 1) + (y % 1) < 1
        share = lean
        third = ((x.astype(np.int32) * 7 + row * 5) % 3 == 0) & ~lean
    elif kind == 4:
        share = np.hypot(shifted, y - row - 0.5) < 2.2 * width
    elif kind == 5:
        share = np.abs(np.hypot(x % 1 - 0.5, y % 1 - 0.5) - 0.46) < width / 2
        share |= np.abs(np.hypot((x + 0.5) % 1 - 0.5, (y + 0.5) % 1 - 0.5) - 0.46) < width / 2
    else:
        share = (np.abs(np.abs(shifted) + np.abs(y - row - 0.5) - 0.4) < width) | (np.abs(shifted) < width / 3)
    ground = _ground(rng)
    image = lerp(ground, _figure(rng, ground), np.asarray(share, np.float32))
    extra = to_srgb(_figure(rng, ground))
    image = image + (extra - image) * np.asarray(third, np.float32)[..., None]
    side = float(rng.uniform(0.12, 0.25) * count)
    return _paper(rng, blurred(image.astype(np.float32), 0.8), (side, side))


def grasscloth(rng: np.random.Generator) -> Texture:
    """Make woven fibres or raffia: horizontal lines in one muted colour."""
    ground = _ground(rng)
    fibres = speckle(rng, (_SIDE, _SIDE), (0.6, 40)) + 0.4 * speckle(rng, (_SIDE, _SIDE), (30, 0.6))
    cloud = fbm(rng, (_SIDE, _SIDE), (3, 3), octaves=3)
    share = 0.25 + float(rng.uniform(0.08, 0.2)) * fibres + 0.1 * cloud
    return _paper(rng, lerp(ground, _figure(rng, ground), share.astype(np.float32)), (0.6, 0.6))
