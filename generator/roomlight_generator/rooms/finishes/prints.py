"""Pictures for walls, and rows of book spines: each image is one whole picture (not tileable), v down."""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import paint, to_srgb
from roomlight_generator.rooms.finishes.noise import fbm, flat, grid_uv, to_texture
from roomlight_generator.rooms.finishes.palettes import dyes, hue, white
from roomlight_generator.rooms.scene import Rgb, Texture

_LONG: Final = 256
"""Pixels along the longer side."""


def _canvas(aspect: float) -> tuple[int, int]:
    return (_LONG, max(64, round(_LONG * aspect))) if aspect < 1 else (max(64, round(_LONG / aspect)), _LONG)


def _opencv_colour(colour: Rgb) -> list[float]:
    return [float(c) for c in to_srgb(colour)]


def _mounted(rng: np.random.Generator, art: Float[np.ndarray, "h w 3"], *, chance: float = 0.45) -> Texture:
    """Add a white or coloured mount with the given probability."""
    image = art
    if rng.random() < chance:
        margin = int(min(art.shape[:2]) * rng.uniform(0.06, 0.2))
        image = flat(white(rng), (art.shape[0], art.shape[1])).copy()
        inner = cv2.resize(art, (art.shape[1] - 2 * margin, art.shape[0] - 2 * margin), interpolation=cv2.INTER_AREA)
        image[margin:-margin, margin:-margin] = inner
    long = float(rng.uniform(0.4, 1.2))
    scale = long / max(art.shape[:2])
    return to_texture(image, (art.shape[1] * scale, art.shape[0] * scale))


def landscape(rng: np.random.Generator, aspect: float) -> Texture:
    """Make a landscape with sky, ridges and water or meadow, painted or photographed, at a random time of day."""
    shape = _canvas(aspect)
    art = scenery(rng, shape)
    return _mounted(rng, art)


def scenery(rng: np.random.Generator, shape: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """Return the landscape as sRGB floats."""
    u, v = grid_uv(shape)
    warm = rng.random() < 0.4
    top = paint(rng.uniform(0.1, 0.45), rng.uniform(0.05, 0.12), rng.uniform(235, 262))
    low = paint(rng.uniform(0.45, 0.8), rng.uniform(0.03, 0.12) if warm else 0.02, 60 if warm else 230)
    horizon = float(rng.uniform(0.35, 0.65))
    sky = np.clip(v / horizon, 0, 1)[..., None] ** np.float32(rng.uniform(0.7, 1.6))
    image = to_srgb(top) + (to_srgb(low) - to_srgb(top)) * sky
    cloud = np.clip(fbm(rng, shape, (5, 3), octaves=5, gain=0.6) - rng.uniform(-0.1, 0.4), 0, 0.6)[..., None]
    image = image + (to_srgb((0.8, 0.78, 0.76)) - image) * cloud * np.clip(1.2 - sky, 0, 1)
    if warm:
        at = rng.uniform((0.15, horizon - 0.25), (0.85, horizon))
        glow = np.exp(-((u - at[0]) ** 2 * aspect_squared(shape) + (v - at[1]) ** 2) / rng.uniform(0.004, 0.03))[
            ..., None
        ]
        image = image + (np.array([1, 0.92, 0.7], np.float32) - image) * glow
    base = rng.uniform(90, 260)
    layers = int(rng.integers(2, 6))
    for layer in range(layers):
        near = (layer + 1) / layers
        ridge = fbm(rng, (8, shape[1]), (1, 2 + layer), octaves=5)[0]
        line = horizon + (near - 0.75) * 0.18 - rng.uniform(0.04, 0.2) * (1.1 - near) * (1 + ridge)
        colour = paint(0.05 + 0.35 * (1 - near) ** 1.5, 0.02 + 0.05 * near, base + rng.normal(0, 15))
        share = np.clip((v - line[None, :]) * shape[0], 0, 1)[..., None]
        image = image + (to_srgb(colour) - image) * share
    ground = paint(rng.uniform(0.05, 0.35), rng.uniform(0.03, 0.09), float(rng.choice([130, 110, 75, 240, 200])))
    streaks = fbm(rng, shape, (24, 3), octaves=4)
    below = np.clip((v - horizon - 0.03) * shape[0], 0, 1)[..., None]
    floor = to_srgb(ground) * (1 + np.float32(0.3) * streaks * (0.3 + v))[..., None]
    return np.clip(image + (floor - image) * below, 0, 1).astype(np.float32)


def aspect_squared(shape: tuple[int, int]) -> float:
    """Return width over height, squared; it makes a glow round."""
    return (shape[1] / shape[0]) ** 2


def abstract(rng: np.random.Generator, aspect: float) -> Texture:
    """Make an abstract picture of colour fields, brush strokes, discs and lines."""
    shape = _canvas(aspect)
    u, v = grid_uv(shape)
    colours = dyes(rng, 6)
    image = flat(colours[int(rng.integers(0, 2))], shape).copy()
    kind = int(rng.integers(5))
    if kind == 0:
        wobble = 0.03 * fbm(rng, shape, (6, 6), octaves=4)
        cuts = np.sort(rng.uniform(0.1, 0.95, int(rng.integers(1, 4))))
        for top, low in zip(cuts, [*cuts[1:], 0.96], strict=True):
            mask = np.clip(((v + wobble > top + 0.02) & (v + wobble < low) & (np.abs(u - 0.5) < 0.44)), 0, 1)
            image = np.where(mask[..., None], to_srgb(colours[int(rng.integers(1, 6))]), image)
    elif kind == 1:
        for _ in range(int(rng.integers(12, 50))):
            start, turn = rng.uniform((0, 0), (shape[1], shape[0])), rng.uniform(0, 2 * np.pi)
            path = [start]
            for _ in range(6):
                turn += rng.normal(0, 0.5)
                path.append(path[-1] + rng.uniform(8, 30) * np.array([np.cos(turn), np.sin(turn)]))
            line = np.rint(np.array(path)).astype(np.int32)
            cv2.polylines(
                image,
                [line],
                False,
                _opencv_colour(colours[int(rng.integers(0, 6))]),
                int(rng.integers(1, 16)),
                cv2.LINE_AA,
            )
    elif kind == 2:
        for _ in range(int(rng.integers(3, 9))):
            at, radius = rng.uniform((0, 0), (shape[1], shape[0])), float(rng.uniform(10, 80))
            ink = _opencv_colour(colours[int(rng.integers(1, 6))])
            line = -1 if rng.random() < 0.7 else int(rng.integers(1, 6))
            cv2.circle(image, (int(at[0]), int(at[1])), int(radius), ink, line, cv2.LINE_AA)
    elif kind == 3:
        field = fbm(rng, shape, (2, 2), octaves=3)
        levels = np.clip((field + 0.8) / 1.6 * 6, 0, 5).astype(np.int32)
        image = np.stack([to_srgb(c) for c in colours])[levels].astype(np.float32)
    else:
        wide, high = int(rng.integers(2, 6)), int(rng.integers(2, 6))
        picks = rng.integers(0, 6, (high, wide))
        cells = picks[np.minimum((v * high).astype(int), high - 1), np.minimum((u * wide).astype(int), wide - 1)]
        image = np.stack([to_srgb(c) for c in colours])[cells].astype(np.float32)
        gap = np.minimum(np.abs(u * wide - np.rint(u * wide)) / wide, np.abs(v * high - np.rint(v * high)) / high)
        image = np.where((gap < rng.uniform(0, 0.02))[..., None], to_srgb(colours[0]) * 0.2, image)
    strokes = fbm(rng, shape, (40, 8), octaves=3) * np.float32(rng.uniform(0, 0.08))
    return _mounted(rng, np.clip(image * (1 + strokes)[..., None], 0, 1).astype(np.float32))


def typographic(rng: np.random.Generator, aspect: float) -> Texture:
    """Make a poster: a headline in blocks, small lines of text, a figure."""
    shape = _canvas(aspect)
    colours = dyes(rng, 4)
    order = [0, 1, 2, 3] if rng.random() < 0.6 else [1, 0, 2, 3]
    image = flat(colours[order[0]], shape).copy()
    ink, second = _opencv_colour(colours[order[1]]), _opencv_colour(colours[order[2]])
    if rng.random() < 0.6:
        at = (int(rng.uniform(0.2, 0.8) * shape[1]), int(rng.uniform(0.3, 0.7) * shape[0]))
        cv2.circle(image, at, int(rng.uniform(0.12, 0.4) * min(shape)), second, -1, cv2.LINE_AA)
    left = int(0.1 * shape[1])
    y = float(rng.uniform(0.06, 0.5)) * shape[0]
    for _ in range(int(rng.integers(1, 4))):
        tall = float(rng.uniform(0.05, 0.13)) * shape[0]
        x = float(left)
        while x < 0.86 * shape[1]:
            wide = tall * rng.uniform(0.35, 0.8)
            if rng.random() < 0.85:
                cv2.rectangle(image, (int(x), int(y)), (int(x + wide), int(y + tall)), ink, -1)
                if rng.random() < 0.6:
                    hole = (int(x + wide * 0.35), int(y + tall * 0.3)), (int(x + wide * 0.7), int(y + tall * 0.6))
                    cv2.rectangle(image, *hole, _opencv_colour(colours[order[0]]), -1)
            x += wide * 1.25
        y += tall * 1.35
    for y in np.arange(0.8, 0.93, 0.025) * shape[0]:
        end = int(left + rng.uniform(0.4, 0.8) * shape[1])
        cv2.line(image, (left, int(y)), (end, int(y)), ink, 1)
    return _mounted(rng, image, chance=0.15)


def botanical(rng: np.random.Generator, aspect: float) -> Texture:
    """Make a botanical print: leaves on a stem, on paper."""
    shape = _canvas(aspect)
    image = flat(paint(rng.uniform(0.55, 0.82), 0.02, 85), shape).copy()
    ink = paint(rng.uniform(0.04, 0.25), rng.uniform(0.02, 0.1), float(rng.choice([145, 125, 165, hue(rng)])))
    foot = np.array([shape[1] * 0.5, shape[0] * 0.94])
    for _ in range(int(rng.integers(1, 4))):
        lean, length = rng.normal(0, 0.35), rng.uniform(0.5, 0.85) * shape[0]
        steps = int(rng.integers(5, 12))
        for k in range(steps + 1):
            t = k / steps
            at = foot + length * t * np.array([np.sin(lean * t), -np.cos(lean * t)])
            reach = 0.16 * length * np.sin(np.pi * (0.15 + 0.8 * t)) + 2
            for side in (-1, 1):
                angle = np.degrees(lean * t) - 90 + side * rng.uniform(35, 60)
                middle = at + reach * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
                place = (int(middle[0]), int(middle[1]))
                cv2.ellipse(
                    image,
                    place,
                    (int(reach), int(reach * 0.34) + 1),
                    angle,
                    0,
                    360,
                    _opencv_colour(ink),
                    -1,
                    cv2.LINE_AA,
                )
    return _mounted(rng, image, chance=0.3)


def portrait(rng: np.random.Generator, aspect: float) -> Texture:
    """Make a portrait, head and shoulders against a dim ground: a painting or a photograph, sometimes greyscale."""
    shape = _canvas(aspect)
    u, v = grid_uv(shape)
    u = (u - 0.5) * np.float32(shape[1] / shape[0])
    ground = paint(rng.uniform(0.03, 0.4), rng.uniform(0, 0.06), hue(rng))
    image = flat(ground, shape) * (1 + 0.25 * fbm(rng, shape, (2, 2), octaves=4) - 0.6 * np.abs(u))[..., None]
    skin = paint(rng.uniform(0.08, 0.55), rng.uniform(0.03, 0.07), rng.uniform(45, 65))
    hair = paint(rng.uniform(0.02, 0.3), rng.uniform(0.0, 0.06), rng.uniform(40, 80))
    dress = paint(rng.uniform(0.02, 0.5), rng.uniform(0, 0.12), hue(rng))
    side = float(rng.uniform(0.6, 1.4))
    light = (1 + 0.5 * (u * side - 0.1))[..., None]
    size = float(rng.uniform(0.11, 0.17))
    top = float(rng.uniform(0.3, 0.4))
    parts = (
        (np.hypot(u / (2.7 * size), (v - top - 4.6 * size) / (2.9 * size)), dress),
        (np.hypot(u / (1.25 * size), (v - top + 0.15 * size) / (1.5 * size)), hair),
        (np.hypot(u / (0.5 * size), (v - top - 1.3 * size) / size), skin),
        (np.hypot(u / size, (v - top - 0.15 * size) / (1.3 * size)), skin),
    )
    for distance, colour in parts:
        share = np.clip((1 - distance) * 25, 0, 1)[..., None]
        image = image + (to_srgb(colour) * light - image) * share
    if rng.random() < 0.35:
        image = np.repeat(image.mean(-1, keepdims=True), 3, -1)
    return _mounted(rng, np.clip(image, 0.02, 1).astype(np.float32))


def book_spines(rng: np.random.Generator) -> Texture:
    """Make a row of book spines that reach the top of the image."""
    shape = (128, 512)
    image = np.full((*shape, 3), 0.12, np.float32)
    x = 0
    series, left = paint(0.1, 0.05, 30), 0
    while x < shape[1] - 4:
        width = int(rng.integers(9, 30))
        if left <= 0 and rng.random() < 0.12:
            series, left = paint(rng.uniform(0.03, 0.5), rng.uniform(0, 0.12), hue(rng)), int(rng.integers(3, 9))
        pale = rng.random() < 0.35
        level = rng.uniform(0.4, 0.8) if pale else rng.uniform(0.02, 0.3)
        colour = series if left > 0 else paint(level, rng.uniform(0, 0.04 if pale else 0.13), hue(rng))
        left -= 1
        top = 4 if left > 0 else int(rng.integers(0, 34))
        profile = 0.75 + 0.25 * np.sin(np.pi * (np.arange(width) + 0.5) / width)
        end = min(x + width, shape[1])
        image[top:, x:end] = (to_srgb(colour) * profile[: end - x, None]).astype(np.float32)
        mark = to_srgb(paint(rng.uniform(0.5, 0.8) if level < 0.3 else rng.uniform(0.02, 0.1), 0.04, 85))
        if width > 11 and rng.random() < 0.75:
            start = top + int(rng.uniform(0.12, 0.4) * (shape[0] - top))
            stop = start + int(rng.uniform(0.2, 0.45) * (shape[0] - top))
            image[start:stop:2, x + width // 3 : min(x + 2 * width // 3, end)] = mark
        if rng.random() < 0.3:
            image[top + 8 : top + 11, x:end] = mark
        x += width
    return to_texture(image, (float(rng.uniform(0.7, 1.0)), float(rng.uniform(0.22, 0.28))))
