"""Upright and grand pianos."""

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, prism, tube


def _grand_outline(width: Number, depth: Number) -> np.ndarray:
    """Return the outline of a grand piano from above, keys at +z: the left side straight, the right one curved in."""
    half = width / 2
    bend = [
        (half, 0.5),
        (half, 0.18),
        (half * 0.86, -0.02),
        (half * 0.5, -0.2),
        (half * 0.2, -0.36),
        (-half * 0.2, -0.48),
    ]
    return np.array([(-half, 0.5 * depth), *((x, z * depth) for x, z in bend), (-half * 0.7, -0.5 * depth),
                     (-half, -0.44 * depth)])  # fmt: skip


def piano(rng: np.random.Generator) -> Draft:
    """Make an upright piano, sometimes a grand."""
    if rng.random() < 0.3:
        width, depth, height = uniform(rng, 1.44, 1.54), uniform(rng, 1.5, 1.95), uniform(rng, 0.98, 1.04)
        return Draft("grand piano", (width, height, depth), lambda: _grand(rng, width, depth, height))
    width, depth, height = uniform(rng, 1.4, 1.52), uniform(rng, 0.54, 0.64), uniform(rng, 1.05, 1.28)
    return Draft("piano", (width, height, depth), lambda: _upright(rng, width, depth, height), top_m=height)


def _case(rng: np.random.Generator) -> Material:
    return palette.black(rng) if rng.random() < 0.35 else palette.wood(rng)


def _add_keys(parts: Parts, rng: np.random.Generator, width: Number, y: Number, front: Number) -> None:
    white = palette.plastic(rng, palette.neutral(rng, 222, 240))
    parts.slab(white, (width - 0.2, 0.02, 0.14), (0, y, front - 0.08), radius=0)
    step = (width - 0.2) / 52
    low = -(width - 0.2) / 2
    sharps = [(low + step * (k + 1)) for k in range(51) if k % 7 not in (1, 4)]
    parts.blocks(palette.black(rng), [(step * 0.55, 0.012, 0.085, x, y + 0.02, front - 0.108) for x in sharps])


def _upright(rng: np.random.Generator, width: Number, depth: Number, height: Number) -> Mesh:
    parts = Parts()
    case = _case(rng)
    bed, body = 0.6, depth * 0.58
    parts.slab(case, (width, height - 0.03, body), (0, 0, -depth / 2 + body / 2))
    parts.slab(case, (width, 0.03, body + 0.02), (0, height - 0.03, -depth / 2 + body / 2 + 0.01))
    parts.slab(case, (width, 0.06, depth - body), (0, bed, depth / 2 - (depth - body) / 2), radius=0.004)
    for x in (-1, 1):
        parts.slab(case, (0.05, bed, 0.06), (x * (width / 2 - 0.03), 0, depth / 2 - 0.05), radius=0)
        parts.slab(case, (0.09, 0.14, depth - body), (x * (width / 2 - 0.045), bed, depth / 2 - (depth - body) / 2))
    _add_keys(parts, rng, width, bed + 0.06, depth / 2)
    parts.slab(case, (width * 0.6, 0.22, 0.012), (0, bed + 0.24, -depth / 2 + body + 0.035), radius=0, pitch=-12)
    return parts.mesh()


def _grand(rng: np.random.Generator, width: Number, depth: Number, height: Number) -> Mesh:
    parts = Parts()
    case = _case(rng)
    outline = _grand_outline(width, depth)
    parts.add(prism(outline * np.array([1.0, 0.9]) - np.array([0.0, 0.05 * depth]), 0.3), case, (0, height - 0.32, 0))
    parts.add(prism(outline * np.array([1.0, 0.86]) - np.array([0.0, 0.07 * depth]), 0.02), case, (0, height - 0.02, 0))
    parts.slab(case, (width, 0.07, depth * 0.2), (0, height - 0.38, depth * 0.4), radius=0)
    _add_keys(parts, rng, width, height - 0.31, depth / 2)
    for x in (-1, 1):
        parts.slab(case, (0.09, 0.2, depth * 0.16), (x * (width / 2 - 0.045), height - 0.32, depth * 0.41))
    for x, z in ((-0.42, 0.36), (0.42, 0.36), (-0.25, -0.36)):
        parts.bar(case, (x * width, 0, z * depth), (x * width, height - 0.3, z * depth), 0.035, 0.055)
    parts.add(
        tube(
            [
                (-0.1, height - 0.3, depth * 0.25),
                (-0.1, 0.1, depth * 0.25),
                (0.1, 0.1, depth * 0.25),
                (0.1, height - 0.3, depth * 0.25),
            ],
            0.015,
        ),
        case,
    )
    return parts.mesh()
