"""Rugs: each image is one whole rug (not tileable), u along its length, for texture coordinates 0 to 1."""

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import to_srgb
from roomlight_generator.rooms.finishes.noise import blurred, fbm, flat, grid_uv, shaded, speckle, to_texture
from roomlight_generator.rooms.finishes.palettes import cloth_colour, companion, dyes
from roomlight_generator.rooms.scene import Texture


def _woven(rng: np.random.Generator, image: Float[np.ndarray, "h w 3"], size_m: tuple[float, float]) -> Texture:
    shape = (image.shape[0], image.shape[1])
    pile = speckle(rng, shape, (0.7, 0.7))
    wear = fbm(rng, shape, (3, 4), octaves=4)
    shade = 0.97 + 0.035 * pile + np.float32(rng.uniform(0.0, 0.08)) * wear
    return to_texture((blurred(image, 0.6) * shade[..., None]).astype(np.float32), size_m)


def _size(rng: np.random.Generator) -> tuple[tuple[int, int], tuple[float, float]]:
    long = float(rng.uniform(1.4, 3.2))
    aspect = float(rng.choice([0.67, 0.7, 0.6, 0.75]))
    return (2 * round(192 * aspect), 384), (long, long * aspect)


def oriental(rng: np.random.Generator) -> Texture:
    """Make an oriental rug: a medallion in a field of small figures inside borders, mirrored both ways."""
    shape, size_m = _size(rng)
    height, width = shape[0] // 2, shape[1] // 2
    colours = [to_srgb(dye) for dye in dyes(rng, 6)]
    if rng.random() < 0.5:
        colours[1], colours[2] = to_srgb((0.13, 0.015, 0.018)), to_srgb((0.018, 0.025, 0.07))
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) + 0.5
    # One quarter: distances from the outer edges, and from the centre.
    edge = np.minimum(x, y)
    cx, cy = width - x, height - y
    image = np.broadcast_to(colours[1], (height, width, 3)).astype(np.float32)
    cell = float(rng.uniform(14, 26))
    fx, fy = np.abs(cx / cell % 1 - 0.5), np.abs(cy / cell % 1 - 0.5)
    figures = np.cos(2 * np.pi * int(rng.integers(1, 4)) * fx) + np.cos(2 * np.pi * int(rng.integers(1, 4)) * fy)
    figures = figures + 0.8 * np.cos(2 * np.pi * (fx + fy) * int(rng.integers(1, 3)))
    for low, dye in ((1.3, 3), (1.9, 0)):
        image = np.where((figures > low)[..., None], colours[dye], image)
    turn = np.arctan2(cy, cx)
    lobes = int(rng.choice([4, 6, 8, 12]))
    radius = np.hypot(cx / width * 1.5, cy / height) * (1 + 0.12 * np.cos(lobes * turn))
    for low, dye in ((0.62, 4), (0.57, 2), (0.4, 0), (0.36, 1), (0.2, 3), (0.1, 0)):
        inside = radius < low
        image = np.where(inside[..., None], colours[dye], image)
        if dye in (2, 1):
            image = np.where((inside & (figures > 1.5))[..., None], colours[5], image)
    corner = np.hypot(x - 40, y - 40) * (1 + 0.1 * np.cos(6 * np.arctan2(y - 40, x - 40))) < rng.uniform(25, 50)
    image = np.where(corner[..., None], colours[2], image)
    image = np.where((corner & (figures > 1.2))[..., None], colours[0], image)
    run = np.maximum(x, y)
    main = float(rng.uniform(16, 26))
    for outer, inner, dye, motif in (
        (main + 16, 0, 0, 5),
        (main + 12, main + 6, 3, 0),
        (main + 4, 6, 2, 3),
        (4, 0, 4, 4),
    ):
        band = (edge < outer) & (edge >= inner)
        image = np.where(band[..., None], colours[dye], image)
        middle = (outer + inner) / 2
        beads = np.hypot((run % 12) - 6, (edge - middle) * 1.2) < 0.33 * min(outer - inner, 12)
        image = np.where((band & beads)[..., None], colours[motif], image)
    half = np.concatenate([image, image[:, ::-1]], 1)
    return _woven(rng, np.concatenate([half, half[::-1]]).astype(np.float32), size_m)


def modern(rng: np.random.Generator) -> Texture:
    """Make a modern rug of large shapes: blocks, arcs, waves, stripes or a Berber lattice."""
    shape, size_m = _size(rng)
    u, v = grid_uv(shape)
    u = u * np.float32(shape[1] / shape[0])
    colours = [to_srgb(dye) for dye in dyes(rng, 5)]
    image = np.broadcast_to(colours[0], (*shape, 3)).astype(np.float32)
    kind = int(rng.integers(5))
    if kind == 0:
        for _ in range(int(rng.integers(4, 10))):
            a, b = np.sort(rng.uniform(0, u.max(), 2)), np.sort(rng.uniform(0, 1, 2))
            mask = (u > a[0]) & (u < a[1]) & (v > b[0]) & (v < b[1])
            image = np.where(mask[..., None], colours[int(rng.integers(0, 5))], image)
    elif kind == 1:
        for _ in range(int(rng.integers(3, 7))):
            at, radius = rng.uniform((0, 0), (u.max(), 1)), rng.uniform(0.15, 0.6)
            distance = np.hypot(u - at[0], v - at[1])
            mask = distance < radius if rng.random() < 0.6 else np.abs(distance - radius) < 0.05
            image = np.where(mask[..., None], colours[int(rng.integers(1, 5))], image)
    elif kind == 2:
        bent = v + 0.12 * fbm(rng, shape, (2, 3), octaves=2) + 0.06 * np.sin(2 * np.pi * u * rng.uniform(0.5, 1.5))
        bands = np.clip(bent * rng.integers(5, 14), 0, None).astype(np.int32)
        image = np.stack(colours)[bands * int(rng.integers(1, 4)) % 5].astype(np.float32)
    elif kind == 3:
        lattice = rng.uniform(3, 6)
        line = np.minimum(np.abs(((u + v) * lattice) % 1 - 0.5), np.abs(((u - v) * lattice) % 1 - 0.5))
        wobble = 0.04 * fbm(rng, shape, (10, 14), octaves=2)
        image = np.where((line + wobble < rng.uniform(0.05, 0.12))[..., None], colours[int(rng.integers(1, 5))], image)
    else:
        bands = (np.searchsorted(np.sort(rng.uniform(0, u.max(), int(rng.integers(6, 20)))), u)).astype(np.int32)
        image = np.stack(colours)[(bands * 2 + bands // 3) % 5].astype(np.float32)
    if rng.random() < 0.4:
        edge = np.minimum(np.minimum(u, u.max() - u), np.minimum(v, 1 - v))
        image = np.where((edge < rng.uniform(0.02, 0.08))[..., None], colours[int(rng.integers(1, 5))], image)
    return _woven(rng, image.astype(np.float32), size_m)


def plain(rng: np.random.Generator) -> Texture:
    """Make a rug in one colour with long or short pile, sometimes with a border."""
    shape, size_m = _size(rng)
    ground = cloth_colour(rng)
    tufts = speckle(rng, shape, (1.0, 2.5)) + speckle(rng, shape, (2.5, 1.0))
    image = shaded(ground, 1 + np.float32(rng.uniform(0.02, 0.1)) * tufts)
    if rng.random() < 0.4:
        u, v = grid_uv(shape)
        edge = np.minimum(np.minimum(u, 1 - u) * np.float32(shape[1] / shape[0]), np.minimum(v, 1 - v))
        border = flat(companion(rng, ground), shape)
        image = np.where((np.abs(edge - 0.07) < 0.03)[..., None], border, image)
    return _woven(rng, image.astype(np.float32), size_m)
