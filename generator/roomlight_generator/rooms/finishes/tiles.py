"""Tiles, bricks, mosaics, terrazzo: hard blocks with grout between."""

import cv2
import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import paint, to_srgb
from roomlight_generator.rooms.finishes.noise import (
    Blocks,
    blurred,
    fbm,
    flat,
    grid_uv,
    hexagon_blocks,
    row_blocks,
    shaded,
    speckle,
    to_texture,
)
from roomlight_generator.rooms.finishes.palettes import glaze, stone_colour
from roomlight_generator.rooms.finishes.stone import veined
from roomlight_generator.rooms.scene import Rgb, Texture


def _grout(rng: np.random.Generator, tile: Rgb) -> Float[np.ndarray, "3"]:
    """Choose white, grey or dark grout, sometimes the tile's own colour."""
    pick = rng.random()
    if pick < 0.25:
        return to_srgb(tile) * np.float32(0.8)
    level = rng.uniform(0.5, 0.75) if pick < 0.55 else rng.uniform(0.18, 0.45) if pick < 0.9 else rng.uniform(0.04, 0.1)
    return to_srgb(paint(level, 0.012, 80))


def _clay(rng: np.random.Generator, blocks: Blocks, colour: Rgb) -> Float[np.ndarray, "h w 3"]:
    """Return glazed or matt ceramics: a clouded tone with a different cutout for each tile."""
    cloud = blocks.sample(rng, fbm(rng, blocks.index.shape, (6, 6), octaves=5, gain=0.65))
    image = shaded(colour, 1 + np.float32(rng.uniform(0.0, 0.055)) * cloud)
    return image * blocks.tones(rng, float(rng.choice([0.008, 0.02, 0.06])), 0.004)


def _surface(rng: np.random.Generator, blocks: Blocks, *, floor: bool) -> tuple[Rgb, Float[np.ndarray, "h w 3"]]:
    """Return plain, stone-like or veined tiles."""
    if rng.random() < 0.3:
        colour = stone_colour(rng)
        field = veined(rng, blocks.index.shape, strength=float(rng.uniform(0.05, 0.3)))
        return colour, shaded(colour, 1 + blocks.sample(rng, field)) * blocks.tones(rng, 0.03)
    colour = stone_colour(rng) if floor and rng.random() < 0.6 else glaze(rng)
    return colour, _clay(rng, blocks, colour)


def square(rng: np.random.Generator, *, floor: bool = True) -> Texture:
    """Make square tiles, 10 to 60 cm."""
    side = float(rng.choice([0.3, 0.33, 0.45, 0.6, 0.2] if floor else [0.1, 0.15, 0.2, 0.15]))
    count = 4
    blocks = row_blocks(rng, (384, 384), rows=count, columns=count, shift=0.0)
    colour, image = _surface(rng, blocks, floor=floor)
    width = max(1.5, float(rng.uniform(0.002, 0.005)) / (side * count) * 384)
    return to_texture(blocks.grout(image, _grout(rng, colour), width, bevel=0.06), (side * count, side * count))


def subway(rng: np.random.Generator, *, floor: bool = False) -> Texture:
    """Make oblong glossy tiles, brick-laid or stacked."""
    rows, columns = 8, 4
    blocks = row_blocks(rng, (384, 384), rows=rows, columns=columns, shift=float(rng.choice([0.5, 0.5, 0.0])))
    colour, image = _surface(rng, blocks, floor=floor)
    high = float(rng.uniform(0.15, 0.3) if floor else rng.uniform(0.06, 0.1))
    size = (columns * high * float(rng.choice([2.0, 2.0, 3.0])), rows * high)
    return to_texture(blocks.grout(image, _grout(rng, colour), float(rng.uniform(1.5, 3.5)), bevel=0.1), size)


def hexagon(rng: np.random.Generator, *, floor: bool = True) -> Texture:
    """Make hexagons in one colour, or some of them in a second."""
    columns, rows = (6, 4) if rng.random() < 0.5 else (4, 2)
    blocks = hexagon_blocks((384, 384), columns=columns, rows=rows)
    colour, image = _surface(rng, blocks, floor=floor)
    if rng.random() < 0.5:
        chosen = rng.random(int(blocks.index.max()) + 1) < rng.uniform(0.1, 0.5)
        image = np.where(chosen[blocks.index][..., None], _clay(rng, blocks, glaze(rng)), image)
    width = float(rng.uniform(0.06, 0.22) if floor else rng.uniform(0.03, 0.08))
    size = (columns * width, rows * width * float(np.sqrt(3)))
    return to_texture(blocks.grout(image, _grout(rng, colour), float(rng.uniform(2, 4)), bevel=0.05), size)


def checkerboard(rng: np.random.Generator, *, floor: bool = True) -> Texture:
    """Make two alternating colours, light and dark."""
    blocks = row_blocks(rng, (256, 256), rows=4, columns=4, shift=0.0)
    u, v = grid_uv((256, 256))
    odd = ((u * 4).astype(int) + (v * 4).astype(int)) % 2 == 1
    light = paint(rng.uniform(0.45, 0.75), rng.uniform(0, 0.03), rng.uniform(60, 110))
    dark = (
        glaze(rng) if rng.random() < 0.4 else paint(rng.uniform(0.03, 0.2), rng.uniform(0, 0.05), rng.uniform(0, 360))
    )
    marble = veined(rng, (256, 256), strength=float(rng.uniform(0.0, 0.2)))
    image = np.where(odd[..., None], flat(light, (256, 256)), flat(dark, (256, 256))) * (1 + marble[..., None])
    side = float(rng.uniform(0.2, 0.45) if floor else rng.uniform(0.08, 0.15))
    return to_texture(blocks.grout(image.astype(np.float32), _grout(rng, dark), 1.5), (4 * side, 4 * side))


def mosaic(rng: np.random.Generator, *, floor: bool = True) -> Texture:
    """Make small squares in shades of one or two colours."""
    count = int(rng.integers(12, 20))
    blocks = row_blocks(rng, (384, 384), rows=count, columns=count, shift=0.0)
    first = glaze(rng)
    second = glaze(rng) if rng.random() < 0.6 else first
    share = rng.random(count * count).astype(np.float32) < rng.uniform(0.1, 0.5)
    image = np.where(share[blocks.index][..., None], flat(second, (384, 384)), flat(first, (384, 384)))
    image = image * blocks.tones(rng, float(rng.uniform(0.02, 0.22)), 0.03)
    side = float(rng.uniform(0.03, 0.05) if floor else rng.uniform(0.02, 0.04)) * count
    return to_texture(blocks.grout(image, _grout(rng, first), float(rng.uniform(2, 4))), (side, side))


def ornament(rng: np.random.Generator) -> Texture:
    """Make cement tiles, each printed with the same figure of discs, stars and quarter rings."""
    count, px = 3, 128
    u, v = grid_uv((px, px))
    x, y = np.abs(u - 0.5) * 2, np.abs(v - 0.5) * 2
    centre, corner = np.hypot(x, y), np.hypot(1 - x, 1 - y)
    dyes = [
        paint(rng.uniform(0.5, 0.75), 0.02, 85),
        glaze(rng),
        paint(rng.uniform(0.06, 0.25), 0.04, rng.uniform(0, 360)),
    ]
    tile = flat(dyes[0], (px, px))
    turn = np.arctan2(v - 0.5, u - 0.5)
    petals = int(rng.choice([4, 8]))
    star = centre < rng.uniform(0.35, 0.6) * (1 + 0.35 * np.cos(petals * turn))
    ring = np.abs(corner - rng.uniform(0.4, 0.7)) < rng.uniform(0.05, 0.14)
    blob = corner < rng.uniform(0.2, 0.35)
    for mask, dye in ((star, dyes[1]), (ring, dyes[2]), (blob, dyes[1]), (centre < rng.uniform(0.1, 0.25), dyes[2])):
        tile[mask] = to_srgb(dye)
    image = np.tile(blurred(tile, 0.8), (count, count, 1))
    shape = image.shape[:2]
    image *= (1 + 0.04 * fbm(rng, shape, (5, 5), octaves=4))[..., None]
    blocks = row_blocks(rng, shape, rows=count, columns=count, shift=0.0)
    side = float(rng.uniform(0.15, 0.3)) * count
    return to_texture(blocks.grout(image.astype(np.float32), _grout(rng, dyes[0]), 1.5), (side, side))


def terrazzo(rng: np.random.Generator) -> Texture:
    """Make chips of stone in a ground."""
    size = 384
    ground = paint(rng.uniform(0.25, 0.7), rng.uniform(0, 0.03), rng.uniform(0, 360))
    chips = [stone_colour(rng) for _ in range(int(rng.integers(2, 5)))]
    image = (flat(ground, (size, size)) * (1 + 0.02 * speckle(rng, (size, size), (0.6, 0.6)))[..., None]).copy()
    count = int(rng.integers(150, 420))
    places = rng.uniform(0, size, (count, 2))
    radii = rng.lognormal(np.log(rng.uniform(4, 8)), 0.45, count)
    turns = rng.uniform(0, 2 * np.pi, (count, 6))
    dyes = rng.integers(0, len(chips), count)
    for place, radius, turn, dye in zip(places, np.minimum(radii, 22), turns, dyes, strict=True):
        ring = place + radius * np.stack([np.cos(np.sort(turn)), np.sin(np.sort(turn))], 1)
        colour = [float(c) for c in to_srgb(chips[int(dye)])]
        for shift in _periodic_shifts(place, float(radius), size):
            cv2.fillPoly(image, [np.rint((ring + shift) * 16).astype(np.int32)], colour, cv2.LINE_AA, shift=4)
    side = float(rng.uniform(0.5, 0.9))
    return to_texture(image, (side, side))


def _periodic_shifts(place: Float[np.ndarray, "2"], radius: float, size: int) -> list[Float[np.ndarray, "2"]]:
    """Return the shifts under which a round shape also appears at the opposite side of the torus."""
    sides = [[0.0], [0.0]]
    for k in (0, 1):
        if place[k] < radius + 1:
            sides[k].append(float(size))
        if place[k] > size - radius - 1:
            sides[k].append(-float(size))
    return [np.array([x, y]) for x in sides[0] for y in sides[1]]


def brick(rng: np.random.Generator) -> Texture:
    """Make a brick wall: bare red, buff, or painted over."""
    rows, columns = 12, 4
    shape = (512, 512)
    blocks = row_blocks(rng, shape, rows=rows, columns=columns, shift=0.5)
    pick = rng.random()
    if pick < 0.5:
        colour = paint(rng.uniform(0.10, 0.24), rng.uniform(0.05, 0.10), rng.uniform(32, 50))
    elif pick < 0.65:
        colour = paint(rng.uniform(0.25, 0.45), rng.uniform(0.03, 0.06), rng.uniform(65, 85))
    elif pick < 0.92:
        colour = paint(rng.uniform(0.55, 0.8), rng.uniform(0, 0.02), rng.uniform(60, 100))
    else:
        colour = paint(rng.uniform(0.05, 0.12), rng.uniform(0, 0.02), 260)
    painted = pick >= 0.65
    rough = blocks.sample(rng, fbm(rng, shape, (10, 10), octaves=5, gain=0.75))
    image = shaded(colour, 1 + np.float32(0.04 if painted else 0.13) * rough)
    image = image * blocks.tones(rng, 0.015 if painted else float(rng.uniform(0.08, 0.22)), 0.0 if painted else 0.03)
    joint = to_srgb(colour) * np.float32(0.88) if painted else to_srgb(paint(rng.uniform(0.25, 0.55), 0.015, 80))
    wobble = Blocks(blocks.index, blocks.joint_px + np.float32(1.2) * fbm(rng, shape, (24, 24), octaves=2))
    image = wobble.grout(image, joint, float(rng.uniform(5, 8)), bevel=0.15)
    return to_texture(image, (columns * 0.25, rows * 0.078))
