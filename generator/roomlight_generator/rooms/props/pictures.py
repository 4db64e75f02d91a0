"""Pictures for frames, screens and rugs: one image over unit texture coordinates, sRGB, 64 to 192 pixels."""

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from roomlight_generator.rooms.props.draft import uniform
from roomlight_generator.rooms.props.palette import cloth_colour, hue, neutral, paint_colour
from roomlight_generator.rooms.props.textures import noise, to_srgb
from roomlight_generator.rooms.scene import Rgb, Texture
from roomlight_generator.rooms.shapes import Number

Image = Float[np.ndarray, "h w 3"]
Painter = Callable[[np.random.Generator, int, int], Image]


def _bytes(image: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)


def _shown(colour: Rgb) -> Float[np.ndarray, "3"]:
    return to_srgb(np.array(colour, np.float64))


def _any(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    return _shown(paint_colour(rng) if rng.random() < 0.5 else hue(rng, (0.3, 0.95), (0.3, 0.95)))


def _flat(rng: np.random.Generator, height: int, width: int, colour: Float[np.ndarray, "3"]) -> Image:
    image = np.empty((height, width, 3), np.float64)
    image[:] = colour
    return image * (1 + 0.015 * rng.standard_normal((height, width, 1)))


def _landscape(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint a sky, ridges that darken toward the viewer, and sometimes a sun and water."""
    top, low = _shown(hue(rng, (0.2, 0.7), (0.4, 0.95))), _shown(hue(rng, (0.05, 0.5), (0.7, 0.98)))
    y = np.linspace(0, 1, height)[:, None, None]
    horizon = uniform(rng, 0.35, 0.65)
    blend = np.clip(y / horizon, 0, 1)
    image = top * (1 - blend) + low * blend + 0.04 * np.clip(noise(rng, height, width, 6, 4), 0, 2)[..., None]
    if rng.random() < 0.4:
        rows, columns = np.mgrid[0:height, 0:width]
        sun = (columns - uniform(rng, 0.2, 0.8) * width) ** 2 + (rows - uniform(rng, 0.1, 0.9) * horizon * height) ** 2
        image[sun < (uniform(rng, 0.03, 0.09) * width) ** 2] = [0.98, 0.93, 0.8]
    ground = _shown(hue(rng, (0.2, 0.7), (0.2, 0.6)))
    layers = int(rng.integers(2, 5))
    rows = np.arange(height)[:, None]
    for layer in range(layers):
        near = (layer + 1) / layers
        ridge = noise(rng, 4, width, 2, int(rng.integers(3, 9)))[0] * 0.05 * (1.3 - near) + horizon
        ridge = ridge + (near - 1 / layers) * (1 - horizon) * 0.9
        colour = ground * near + low * (1 - near) * 0.9
        mask = rows > ridge[None] * height
        texture = 1 + 0.12 * near * noise(rng, height, width, 16, 12)
        image = np.where(mask[..., None], colour * texture[..., None], image)
    return image


def _colour_fields(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint soft bands of colour on a ground."""
    image = _flat(rng, height, width, _any(rng))
    y = uniform(rng, 0.04, 0.1)
    soft = np.clip(np.minimum(np.linspace(0, 12, width), np.linspace(12, 0, width)), 0, 1)[None, :, None]
    while y < 0.9:
        height_m = uniform(rng, 0.12, 0.45)
        a, b = int(y * height), min(int((y + height_m) * height), int(0.95 * height))
        if b - a > 3:
            image[a:b] = image[a:b] * (1 - soft) + soft * _any(rng)
        y += height_m + 0.04
    return cv2.GaussianBlur(image, (5, 5), 0) * (1 + 0.04 * noise(rng, height, width, 16, 16))[..., None]


def _blocks(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint recursively split rectangles, with or without black bars between them."""
    image = _flat(rng, height, width, _shown(neutral(rng, 215, 240)))
    stack = [(0, 0, width, height)]
    bar = int(rng.choice([0, 1, 3]))
    dark = _shown(neutral(rng, 15, 50))
    palette = [_any(rng) for _ in range(4)]
    while stack:
        x, y, w, h = stack.pop()
        if max(w, h) > width // 4 and rng.random() < 0.85 and min(w, h) > 8:
            cut = uniform(rng, 0.25, 0.75)
            if w > h:
                stack += [(x, y, int(w * cut), h), (x + int(w * cut), y, w - int(w * cut), h)]
            else:
                stack += [(x, y, w, int(h * cut)), (x, y + int(h * cut), w, h - int(h * cut))]
            continue
        if rng.random() < 0.6:
            image[y : y + h, x : x + w] = palette[int(rng.integers(4))]
        if bar:
            image[y : y + bar, x : x + w] = dark
            image[y : y + h, x : x + bar] = dark
    return image


def _rounds(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint overlapping discs and rings."""
    image = np.ascontiguousarray(_flat(rng, height, width, _any(rng)))
    for _ in range(int(rng.integers(3, 12))):
        middle = (int(rng.integers(width)), int(rng.integers(height)))
        radius = int(uniform(rng, 0.05, 0.4) * width)
        thickness = -1 if rng.random() < 0.65 else max(1, radius // 5)
        cv2.circle(image, middle, radius, _any(rng).tolist(), thickness, cv2.LINE_AA)
    return image


def _strokes(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint broad strokes along a flow field."""
    image = np.ascontiguousarray(_flat(rng, height, width, _any(rng)))
    palette = [_any(rng) for _ in range(5)]
    flow = noise(rng, height, width, 3, 3)
    for _ in range(90):
        x, y = int(rng.integers(width)), int(rng.integers(height))
        angle, length = 2.0 * flow[y, x], uniform(rng, 0.06, 0.25) * width
        end = (int(x + length * np.cos(angle)), int(y + length * np.sin(angle)))
        cv2.line(image, (x, y), end, palette[int(rng.integers(5))].tolist(), int(rng.integers(2, 8)), cv2.LINE_AA)
    return image * (1 + 0.04 * noise(rng, height, width, 32, 32))[..., None]


def _botanical(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint leaves on a stem in one or two colours on paper."""
    image = np.ascontiguousarray(_flat(rng, height, width, _shown(neutral(rng, 205, 240))))
    ink = _shown(hue(rng, (0.3, 0.8), (0.15, 0.6)))
    foot, lean = 0.92 * height, uniform(rng, -0.15, 0.15) * width
    count = int(rng.integers(4, 9))
    for k in range(count):
        t = (k + 1) / count
        x, y = width / 2 + lean * t * t, foot - 0.78 * height * t
        cv2.line(image, (int(width / 2 + lean * (t - 1 / count) ** 2), int(y + 0.78 * height / count)),
                 (int(x), int(y)), ink.tolist(), 1, cv2.LINE_AA)  # fmt: skip
        size = (int(width * 0.2 * (1.15 - t)) + 2, int(width * 0.055) + 1)
        for side in (-1, 1):
            middle = (int(x + side * size[0] * 0.9), int(y - size[0] * 0.4))
            cv2.ellipse(
                image, middle, size, -28.0 * side, 0, 360, (ink * uniform(rng, 0.8, 1.4)).tolist(), -1, cv2.LINE_AA
            )
    return image


def _photograph(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint out-of-focus shapes with grain, often black and white: a head and shoulders, or a street's buildings."""
    image = np.ascontiguousarray(_flat(rng, height, width, _shown(neutral(rng, 30, 220))))
    if rng.random() < 0.5:
        skin, coat = _shown(hue(rng, (0.3, 0.5), (0.4, 0.9))), _any(rng)
        x = int(width * uniform(rng, 0.4, 0.6))
        cv2.ellipse(image, (x, height), (int(width * 0.36), int(height * 0.34)), 0, 0, 360, coat.tolist(), -1)
        cv2.ellipse(
            image, (x, int(height * 0.45)), (int(width * 0.15), int(height * 0.2)), 0, 0, 360, skin.tolist(), -1
        )
        hair = _shown(hue(rng, (0.2, 0.6), (0.05, 0.6)))
        cv2.ellipse(
            image, (x, int(height * 0.4)), (int(width * 0.17), int(height * 0.19)), 0, 180, 360, hair.tolist(), -1
        )
    else:
        for _ in range(14):
            x, w = int(rng.integers(width)), int(uniform(rng, 0.06, 0.2) * width)
            image[int(uniform(rng, 0.15, 0.7) * height) :, x : x + w] = _any(rng) * uniform(rng, 0.4, 1)
    image = cv2.GaussianBlur(image, (7, 7), 0)
    image *= (1 + 0.18 * noise(rng, height, width, 3, 3))[..., None]
    if rng.random() < 0.55:
        image[:] = image.mean(2, keepdims=True) * np.array([1.0, uniform(rng, 0.94, 1.0), uniform(rng, 0.85, 1.0)])
    return image + 0.015 * rng.standard_normal((height, width, 1))


def _poster(rng: np.random.Generator, height: int, width: int) -> Image:
    """Paint a block of colour with lines of text."""
    image = np.ascontiguousarray(_flat(rng, height, width, _any(rng)))
    ink = _any(rng)
    y = uniform(rng, 0.08, 0.5)
    while y < 0.92:
        size = uniform(rng, 0.02, 0.12)
        x, end = uniform(rng, 0.06, 0.12), uniform(rng, 0.5, 0.94)
        while x < end:
            w = uniform(rng, 0.3, 0.9) * size * height / width
            image[int(y * height) : int((y + size) * height), int(x * width) : int((x + w) * width)] = ink
            x += w * 1.3
        y += size * 1.7
    return image


_PRINTS: Final[tuple[Painter, ...]] = (
    _landscape,
    _landscape,
    _colour_fields,
    _blocks,
    _rounds,
    _strokes,
    _strokes,
    _botanical,
    _photograph,
    _photograph,
    _poster,
)


def print_texture(rng: np.random.Generator, aspect: Number) -> Texture:
    """Make a picture with this aspect (width over height), sometimes with a white margin."""
    height = int(np.clip(144 / np.sqrt(aspect), 72, 200))
    width = int(np.clip(height * aspect, 72, 240))
    image = np.clip(_PRINTS[int(rng.integers(len(_PRINTS)))](rng, height, width), 0, 1)
    if rng.random() < 0.45:
        edge = int(uniform(rng, 0.06, 0.16) * min(height, width))
        page = _flat(rng, height, width, _shown(neutral(rng, 215, 240)))
        small = cv2.resize(image, (width - 2 * edge, height - 2 * edge), interpolation=cv2.INTER_AREA)
        page[edge : height - edge, edge : width - edge] = small
        image = page
    return Texture(_bytes(image))


def rug_texture(rng: np.random.Generator, aspect: Number, *, round_one: bool = False) -> Texture:
    """Make a rug seen from above: bordered with a medallion, striped, lozenges, plain, shaggy, blots, or rings."""
    height = 128
    width = int(np.clip(height * aspect, 48, 384))
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    colours = [_shown(cloth_colour(rng)) for _ in range(4)]
    image = _flat(rng, height, width, colours[0])
    kind = int(rng.integers(7))
    if round_one and kind in (0, 1):
        kind = 6
    if kind == 0:
        knots = noise(rng, height, width, 16, 16)
        knots = knots + knots[::-1]
        knots = knots + knots[:, ::-1]
        for level, colour in zip((-0.3, 1.0, 2.2), colours[1:], strict=True):
            image[knots > level] = colour
        away = np.minimum((1 - np.abs(x)) * aspect, 1 - np.abs(y))
        for low, high, colour in ((0.02, 0.06, colours[2]), (0.06, 0.2, colours[1]), (0.2, 0.23, colours[3])):
            band = (away > low) & (away < high)
            image[band] = 0.75 * colour + 0.25 * image[band]
        medallion = (np.abs(x) * 2.4 + np.abs(y) * 1.6 < 1) & (knots < 1.5)
        image[medallion] = 0.7 * colours[2] + 0.3 * image[medallion]
    elif kind == 1:
        count = int(rng.integers(3, 14))
        stripe = ((x if rng.random() < 0.5 else y) * count / 2 % 1 * 4).astype(int)
        for k in range(1, 4):
            image[stripe == k] = colours[k if rng.random() < 0.6 else 0]
    elif kind == 2:
        u, v = (x * aspect * uniform(rng, 1.5, 3)) % 1 - 0.5, (y * uniform(rng, 1.5, 3)) % 1 - 0.5
        lozenge = np.abs(u) + np.abs(v)
        image[lozenge < 0.42] = colours[1]
        image[lozenge < 0.26] = colours[2]
        image[lozenge < 0.12] = colours[3]
    elif kind == 3:
        edge = uniform(rng, 0.03, 0.15)
        image[(np.minimum((1 - np.abs(x)) * aspect, 1 - np.abs(y)) < edge) & (rng.random() < 0.6)] = colours[1]
    elif kind == 4:
        image *= 1 + uniform(rng, 0.05, 0.14) * noise(rng, height, width, 64, 32)[..., None]
    elif kind == 5:
        blots = noise(rng, height, width, 4, 4)
        for level, colour in zip((0.0, 0.7, 1.4), colours[1:], strict=True):
            image[blots > level] = colour
    else:
        rings = (np.hypot(x, y) * uniform(rng, 3, 9)).astype(int) % 4
        for k in range(1, 4):
            image[rings == k] = colours[k]
    pile = 1 + 0.04 * rng.standard_normal((height, width, 1)) + 0.03 * noise(rng, height, width, 8, 8)[..., None]
    return Texture(_bytes(np.clip(image * pile, 0, 0.97)))


def clock_texture(rng: np.random.Generator) -> Texture:
    """Make a dial with marks and hands."""
    size = 96
    face, ink = neutral(rng, 210, 240), neutral(rng, 16, 60)
    if rng.random() < 0.3:
        face, ink = (ink, face) if rng.random() < 0.5 else (hue(rng, (0.3, 0.8), (0.3, 0.9)), ink)
    image = np.ascontiguousarray(_flat(rng, size, size, _shown(face)))
    line: list[float] = _shown(ink).tolist()

    def at(turn: Number, reach: Number) -> tuple[int, int]:
        angle = 2 * np.pi * turn
        return int(size / 2 + reach * size / 2 * np.sin(angle)), int(size / 2 - reach * size / 2 * np.cos(angle))

    for hour in range(12):
        cv2.line(image, at(hour / 12, 0.76), at(hour / 12, 0.88), line, 3 if hour % 3 == 0 else 1, cv2.LINE_AA)
    now = uniform(rng, 0, 1)
    cv2.line(image, at(now, -0.06), at(now, 0.45), line, 3, cv2.LINE_AA)
    cv2.line(image, at(now * 12, -0.08), at(now * 12, 0.68), line, 2, cv2.LINE_AA)
    return Texture(_bytes(image))
