"""Images on televisions and computers: 144 x 256 pixels relative to the screen's white, v down."""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import paint, to_srgb
from roomlight_generator.rooms.finishes.noise import fbm, flat, grid_uv, to_texture
from roomlight_generator.rooms.finishes.palettes import dyes, hue
from roomlight_generator.rooms.finishes.prints import scenery
from roomlight_generator.rooms.scene import Texture

_SHAPE: Final = (144, 256)
_SIZE: Final = (1.2, 0.675)

Image = Float[np.ndarray, "144 256 3"]


def _opencv_colour(level: int | float, chroma: int | float, angle: int | float) -> list[float]:
    return [float(c) for c in to_srgb(paint(level, chroma, angle))]


def _text(
    rng: np.random.Generator, image: Image, box: tuple[int, int, int, int], ink: list[float], *, line: int = 4
) -> None:
    """Draw grey lines of words in the box (x0, y0, x1, y1)."""
    for y in range(box[1], box[3], line):
        x = box[0] + int(rng.choice([0, 0, 4, 8]))
        stop = box[0] + int((box[2] - box[0]) * rng.uniform(0.3, 1.0))
        while x < stop:
            wide = int(rng.integers(2, 12))
            cv2.line(image, (x, y), (min(x + wide, stop), y), ink, 1)
            x += wide + 2


def film(rng: np.random.Generator) -> Texture:
    """Make a paused film: a landscape, sometimes with letterbox bars and a person in front."""
    image = scenery(rng, _SHAPE) * np.float32(rng.uniform(0.4, 1.0))
    u, v = grid_uv(_SHAPE)
    if rng.random() < 0.5:
        x, size = rng.uniform(0.2, 0.8), rng.uniform(0.08, 0.2)
        x_scaled = (u - x) * np.float32(16 / 9)
        head = np.hypot(x_scaled, v - 0.4) < size
        body = np.hypot(x_scaled / 2, v - 0.4 - 2.8 * size) < 1.6 * size
        lit = (0.8 + 1.2 * x_scaled)[..., None]
        image = np.where(body[..., None], to_srgb(paint(rng.uniform(0.03, 0.4), 0.05, hue(rng))) * lit, image)
        image = np.where(head[..., None], to_srgb(paint(rng.uniform(0.1, 0.5), 0.05, 55)) * lit, image)
    if rng.random() < 0.4:
        image = np.where((np.abs(v - 0.5) > 0.39)[..., None], 0.0, image)
    return to_texture(np.clip(image, 0, 1).astype(np.float32), _SIZE)


def news(rng: np.random.Generator) -> Texture:
    """Make a news studio: bright panels, a speaker, a banner below."""
    angle = hue(rng)
    image = flat(paint(rng.uniform(0.05, 0.3), 0.1, angle), _SHAPE).copy()
    for _ in range(5):
        x = int(rng.integers(0, 230))
        cv2.rectangle(
            image, (x, 0), (x + int(rng.integers(6, 50)), 144), _opencv_colour(rng.uniform(0.1, 0.7), 0.08, angle), -1
        )
    x = int(rng.integers(60, 190))
    cv2.ellipse(
        image, (x, 140), (38, 62), 0, 0, 360, _opencv_colour(rng.uniform(0.02, 0.2), 0.04, 255), -1, cv2.LINE_AA
    )
    cv2.ellipse(image, (x, 66), (15, 21), 0, 0, 360, _opencv_colour(rng.uniform(0.1, 0.5), 0.05, 55), -1, cv2.LINE_AA)
    cv2.rectangle(image, (12, 112), (244, 132), _opencv_colour(0.7, 0.01, 90), -1)
    cv2.rectangle(image, (12, 112), (60, 132), _opencv_colour(0.15, 0.16, 28), -1)
    _text(rng, image, (66, 117, 238, 131), _opencv_colour(0.03, 0.0, 0), line=6)
    return to_texture(np.clip(image, 0, 1), _SIZE)


def sport(rng: np.random.Generator) -> Texture:
    """Make a pitch from above with players."""
    u, v = grid_uv(_SHAPE)
    mown = ((u + 0.15 * v) * 12).astype(np.int32) % 2
    grass = paint(rng.uniform(0.15, 0.3), 0.12, 140)
    image = (to_srgb(grass) * (0.94 + 0.1 * mown)[..., None]).astype(np.float32)
    stand = v < 0.2
    crowd = rng.uniform(0.1, 0.7, (*_SHAPE, 3)).astype(np.float32)
    image = np.where(stand[..., None], cv2.GaussianBlur(crowd, (0, 0), 1), image).astype(np.float32)
    cv2.line(
        image, (int(rng.integers(60, 200)), 30), (int(rng.integers(40, 220)), 143), [0.95, 0.95, 0.95], 2, cv2.LINE_AA
    )
    teams = [_opencv_colour(0.12, 0.16, 28), _opencv_colour(0.7, 0.01, 90)]
    for k in range(14):
        x, y = int(rng.integers(8, 248)), int(rng.integers(36, 134))
        cv2.ellipse(image, (x, y), (2, 5), 0, 0, 360, teams[k % 2], -1, cv2.LINE_AA)
    cv2.rectangle(image, (10, 8), (84, 20), _opencv_colour(0.03, 0.02, 255), -1)
    return to_texture(np.clip(image, 0, 1), _SIZE)


def desktop(rng: np.random.Generator) -> Texture:
    """Make a desktop: windows over a wallpaper picture."""
    if rng.random() < 0.5:
        image = scenery(rng, _SHAPE).copy()
    else:
        first, second = to_srgb(paint(rng.uniform(0.02, 0.3), 0.1, hue(rng))), to_srgb(paint(0.2, 0.12, hue(rng)))
        share = np.clip(0.5 + fbm(rng, _SHAPE, (2, 2), octaves=2), 0, 1)[..., None]
        image = (first + (second - first) * share).astype(np.float32)
    dark = rng.random() < 0.45
    for _ in range(int(rng.integers(1, 4))):
        x, y = int(rng.integers(0, 120)), int(rng.integers(0, 60))
        right, low = min(x + int(rng.integers(70, 180)), 255), min(y + int(rng.integers(50, 100)), 134)
        ground = _opencv_colour(0.02, 0.01, 255) if dark else _opencv_colour(0.85, 0.0, 0)
        cv2.rectangle(image, (x, y), (right, low), ground, -1)
        cv2.rectangle(image, (x, y), (right, y + 6), _opencv_colour(0.06 if dark else 0.55, 0.02, 255), -1)
        ink = _opencv_colour(0.4, rng.uniform(0, 0.1), hue(rng)) if dark else _opencv_colour(0.08, 0.02, 255)
        _text(rng, image, (x + 6, y + 12, right - 4, low - 3), ink)
        if rng.random() < 0.4:
            cv2.rectangle(image, (x + 5, y + 14), (x + 40, y + 40), _opencv_colour(0.3, 0.12, hue(rng)), -1)
    cv2.rectangle(image, (0, 136), (255, 143), _opencv_colour(0.04 if dark else 0.6, 0.02, 255), -1)
    return to_texture(np.clip(image, 0, 1), _SIZE)


def document(rng: np.random.Generator) -> Texture:
    """Make a full-screen page, table or editor."""
    dark = rng.random() < 0.4
    image = flat(paint(0.02 if dark else 0.8, 0.008, 255), _SHAPE).copy()
    if rng.random() < 0.4:
        rule = _opencv_colour(0.06 if dark else 0.5, 0.0, 0)
        for x in range(10, 256, int(rng.integers(18, 40))):
            cv2.line(image, (x, 12), (x, 143), rule, 1)
        for y in range(12, 144, 8):
            cv2.line(image, (0, y), (255, y), rule, 1)
            _text(rng, image, (12, y + 4, 250, y + 5), _opencv_colour(0.35 if dark else 0.1, 0.0, 0))
    else:
        for _ in range(3):
            ink = _opencv_colour(0.45, 0.08, hue(rng)) if dark else _opencv_colour(0.06, 0.0, 0)
            _text(rng, image, (int(rng.integers(20, 50)), 18, int(rng.integers(150, 240)), 140), ink, line=12)
    cv2.rectangle(image, (0, 0), (255, 9), _opencv_colour(rng.uniform(0.05, 0.6), 0.06, hue(rng)), -1)
    return to_texture(np.clip(image, 0, 1), _SIZE)


def menu(rng: np.random.Generator) -> Texture:
    """Make a television's menu: rows of coloured cards on a dark ground."""
    u, v = grid_uv(_SHAPE)
    image = flat(paint(0.02, 0.03, hue(rng)), _SHAPE) * (0.7 + 0.6 * (u - v))[..., None]
    image = np.ascontiguousarray(np.clip(image, 0, 1), dtype=np.float32)
    wide = int(rng.integers(34, 60))
    for y in (20, 62, 104):
        for x in range(14, 256, wide + 6):
            card = dyes(rng, 3)[int(rng.integers(0, 3))]
            cv2.rectangle(image, (x, y), (min(x + wide, 255), y + 32), [float(c) for c in to_srgb(card)], -1)
            cv2.circle(
                image,
                (x + wide // 2, y + 18),
                8,
                _opencv_colour(rng.uniform(0.05, 0.6), 0.1, hue(rng)),
                -1,
                cv2.LINE_AA,
            )
    return to_texture(image, _SIZE)
