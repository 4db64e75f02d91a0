"""Stone, concrete, plaster and cork: surfaces without joints."""

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import paint, to_srgb
from roomlight_generator.rooms.finishes.noise import fbm, grid_uv, row_blocks, shaded, speckle, to_texture
from roomlight_generator.rooms.finishes.palettes import stone_colour
from roomlight_generator.rooms.scene import Rgb, Texture


def veined(rng: np.random.Generator, shape: tuple[int, int], *, strength: float) -> Float[np.ndarray, "h w"]:
    """Return clouds and veins of marble around 0, tileable; `strength` is the depth of the darkest vein."""
    u, v = grid_uv(shape)
    warp = fbm(rng, shape, (2, 2), octaves=6, gain=0.42)
    across, down = int(rng.integers(1, 3)), int(rng.integers(-2, 3))
    wave = np.sin(np.pi * 2 * (across * u + down * v + rng.uniform(0.5, 1.1) * warp))
    veins = np.exp(-np.abs(wave) * np.float32(rng.uniform(7, 22))) * np.clip(0.7 + warp[::-1], 0.1, 1)
    cloud = fbm(rng, shape, (2, 2), octaves=4)
    sign = -1 if rng.random() < 0.75 else 0.6
    return (sign * strength * veins + 0.3 * strength * cloud).astype(np.float32)


def marble(rng: np.random.Generator) -> Texture:
    """Make polished slabs with hairline joints."""
    shape = (384, 384)
    colour = paint(rng.uniform(0.5, 0.75), rng.uniform(0, 0.02), rng.uniform(60, 250)) if rng.random() < 0.55 else None
    colour = colour or stone_colour(rng)
    blocks = row_blocks(rng, shape, rows=2, columns=2, shift=0.0)
    field = blocks.sample(rng, veined(rng, shape, strength=float(rng.uniform(0.15, 0.45))))
    image = blocks.grout(shaded(colour, 1 + field), to_srgb(colour) * np.float32(0.75), 1.5)
    side = float(rng.uniform(1.0, 2.0))
    return to_texture(image, (side, side))


def concrete(rng: np.random.Generator) -> Texture:
    """Make cast or floated concrete: clouds, stains and pores."""
    shape = (512, 512)
    colour = paint(rng.uniform(0.14, 0.42), rng.uniform(0, 0.015), rng.uniform(60, 110))
    cloud = fbm(rng, shape, (2, 2), octaves=6, gain=0.6)
    grain = speckle(rng, shape, (0.6, 0.6))
    pores = (speckle(rng, shape, (1.2, 1.2)) > rng.uniform(2.6, 3.3)).astype(np.float32)
    shade = 1 + np.float32(rng.uniform(0.04, 0.14)) * cloud + 0.012 * grain - 0.2 * pores
    return to_texture(shaded(colour, shade), (2.0, 2.0))


def plaster(rng: np.random.Generator, *, depth: float | None = None) -> Texture:
    """Make the faint relief of rolled or floated paint around white, to be tinted by the material's albedo."""
    shape = (256, 256)
    depth = float(rng.uniform(0.003, 0.016)) if depth is None else depth
    coarse = int(rng.choice([4, 12, 24]))
    depth *= 0.5 if coarse == 4 else 1.0  # broad clouds are visible from a distance
    field = fbm(rng, shape, (coarse, coarse), octaves=4, gain=0.7)
    shade = 0.975 + depth * field + 0.3 * depth * speckle(rng, shape, (0.7, 0.7))
    return to_texture(shaded((1.0, 1.0, 1.0), np.minimum(shade, 1)), (1.2, 1.2))


def limewash(rng: np.random.Generator, colour: Rgb) -> Texture:
    """Make broad cloudy brushwork."""
    shape = (256, 256)
    cloud = fbm(rng, shape, (3, 3), octaves=5, gain=0.62)
    return to_texture(shaded(colour, 1 + np.float32(rng.uniform(0.04, 0.11)) * cloud), (2.4, 2.4))


def cork(rng: np.random.Generator) -> Texture:
    """Make pressed cork, or speckled rubber and linoleum."""
    shape = (256, 256)
    if rng.random() < 0.4:
        colour = paint(rng.uniform(0.16, 0.3), 0.06, rng.uniform(58, 70))
    else:
        colour = paint(rng.uniform(0.08, 0.4), rng.uniform(0.0, 0.06), rng.uniform(0, 360))
    fleck = speckle(rng, shape, (1.0, 1.0))
    return to_texture(shaded(colour, 1 + np.float32(rng.uniform(0.02, 0.08)) * fleck), (0.6, 0.6))
