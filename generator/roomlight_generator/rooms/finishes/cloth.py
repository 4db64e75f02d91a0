"""Cloth, carpet and leather textures.

Stripes of `striped` run along u, so that they are vertical on curtains, whose u is their height.
"""

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import paint, to_srgb
from roomlight_generator.rooms.finishes.noise import fbm, flat, grid_uv, lerp, shaded, speckle, to_texture
from roomlight_generator.rooms.finishes.palettes import cloth_colour, companion, dyes
from roomlight_generator.rooms.scene import Rgb, Texture

_SIDE = 256


def _weave(rng: np.random.Generator, threads: int, *, depth: float) -> Float[np.ndarray, "h w"]:
    """Return the shade of a plain weave around 1, with uneven threads."""
    u, v = grid_uv((_SIDE, _SIDE))
    over = np.sin(np.pi * threads * u) ** 2
    under = np.sin(np.pi * threads * v) ** 2
    odd = ((u * threads).astype(np.int32) + (v * threads).astype(np.int32)) % 2 == 1
    shade = 1 - depth * (1 - np.where(odd, over, under))
    slubs = speckle(rng, (_SIDE, _SIDE), (0.7, 9)) + speckle(rng, (_SIDE, _SIDE), (9, 0.7))
    return (shade * (1 + 0.25 * depth * slubs)).astype(np.float32)


def plain(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make a plain weave in one colour, fine or coarse."""
    threads = int(rng.choice([32, 48, 64]))
    shade = _weave(rng, threads, depth=float(rng.uniform(0.08, 0.3)))
    side = float(threads * rng.uniform(0.0015, 0.006))
    return to_texture(shaded(colour or cloth_colour(rng), shade), (side, side))


def velvet(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make brushed pile or felt: soft clouds, no threads."""
    cloud = fbm(rng, (_SIDE, _SIDE), (2, 2), octaves=4)
    fine = speckle(rng, (_SIDE, _SIDE), (0.8, 0.8))
    shade = 1 + np.float32(rng.uniform(0.03, 0.1)) * cloud + 0.02 * fine
    return to_texture(shaded(colour or cloth_colour(rng), shade), (0.8, 0.8))


def tweed(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make tweed: flecked yarns of two colours, a herringbone twill or a plain weave."""
    first = colour or cloth_colour(rng)
    second = companion(rng, first)
    u, v = grid_uv((_SIDE, _SIDE))
    flecks = speckle(rng, (_SIDE, _SIDE), (0.8, 1.6))
    columns = int(rng.choice([4, 8]))
    zigzag = np.abs((u * columns) % 1 - 0.5) * 2
    twill = np.sin(2 * np.pi * (v * 32 + zigzag * 4))
    share = 0.45 + 0.22 * flecks + (0.3 * twill if rng.random() < 0.6 else 0)
    image = lerp(first, second, share) * _weave(rng, 64, depth=0.12)[..., None]
    return to_texture(image.astype(np.float32), (0.3, 0.3))


def plaid(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make a tartan or gingham: the same sequence of stripes both ways, blended where they cross."""
    colours = [colour or cloth_colour(rng)]
    colours += [companion(rng, colours[0]), cloth_colour(rng)]
    sett = _bands(rng, colours, mirrored=True)
    share = np.where((np.indices((_SIDE, _SIDE)).sum(0) // 2 % 2 == 0)[..., None], 0.65, 0.35).astype(np.float32)
    image = sett[None] * share + sett[:, None] * (1 - share)
    side = float(rng.uniform(0.08, 0.4))
    return to_texture((image * _weave(rng, 64, depth=0.1)[..., None]).astype(np.float32), (side, side))


def striped(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make stripes along u, of two to four colours."""
    colours = [colour or cloth_colour(rng)]
    colours += [companion(rng, colours[0]), cloth_colour(rng)][: int(rng.integers(1, 3))]
    image = _bands(rng, colours, mirrored=rng.random() < 0.5)[:, None] * _weave(rng, 64, depth=0.1)[..., None]
    side = float(rng.uniform(0.08, 0.5))
    return to_texture(image.astype(np.float32), (side, side))


def _bands(rng: np.random.Generator, colours: list[Rgb], *, mirrored: bool) -> Float[np.ndarray, "n 3"]:
    """Return a row of colours across the repeat."""
    count = int(rng.integers(2, 6))
    weights = rng.uniform(0.3, 1.0, count)
    weights[0] *= 2.5
    edges = np.cumsum(weights / weights.sum()) * (_SIDE // 2 if mirrored else _SIDE)
    which = np.searchsorted(edges, np.arange(_SIDE // 2 if mirrored else _SIDE) + 0.5)
    picks = np.array([0, *(int(k) for k in rng.integers(0, len(colours), count))])
    picks[1] = 1
    line = np.stack([to_srgb(c) for c in colours])[picks[np.minimum(which, count)]]
    return np.concatenate([line, line[::-1]]) if mirrored else line


def printed(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make cloth with scattered dots, leaves or blots."""
    ground = colour or cloth_colour(rng)
    image = flat(ground, (_SIDE, _SIDE))
    for _ in range(int(rng.integers(1, 3))):
        coarse = int(rng.choice([3, 4, 6]))
        field = fbm(rng, (_SIDE, _SIDE), (coarse, coarse), octaves=2)
        if rng.random() < 0.65:
            u, v = grid_uv((_SIDE, _SIDE))
            row = (v * coarse).astype(np.int32)
            along = (u * coarse + 0.5 * (row % 2)) % 1
            field = float(rng.uniform(0.2, 0.36)) - np.hypot(along - 0.5, v * coarse - row - 0.5) + 0.08 * field
            share = np.clip(field * 20, 0, 1) if coarse % 2 == 0 else np.clip((field - 0.1) * 20, 0, 1)
        else:
            share = np.clip((field - rng.uniform(0.1, 0.3)) * 14, 0, 1)
        dye = to_srgb(companion(rng, ground) if rng.random() < 0.6 else cloth_colour(rng))
        image = image + (dye - image) * share[..., None].astype(np.float32)
    side = float(rng.uniform(0.15, 0.6))
    return to_texture((image * _weave(rng, 64, depth=0.08)[..., None]).astype(np.float32), (side, side))


def leather(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make grained leather: brown, black, cream or dyed."""
    if colour is None:
        pick = rng.random()
        if pick < 0.45:
            colour = paint(rng.uniform(0.05, 0.25), rng.uniform(0.04, 0.09), rng.uniform(40, 62))
        elif pick < 0.7:
            colour = paint(rng.uniform(0.025, 0.06), rng.uniform(0, 0.01), 60)
        elif pick < 0.88:
            colour = paint(rng.uniform(0.35, 0.65), rng.uniform(0, 0.03), rng.uniform(60, 95))
        else:
            colour = cloth_colour(rng)
    pebbles = fbm(rng, (_SIDE, _SIDE), (40, 40), octaves=2)
    creases = np.exp(-12 * np.abs(fbm(rng, (_SIDE, _SIDE), (6, 6), octaves=4)))
    wear = fbm(rng, (_SIDE, _SIDE), (2, 2), octaves=3)
    shade = 1 + 0.08 * pebbles - np.float32(rng.uniform(0.02, 0.1)) * creases + 0.06 * wear
    return to_texture(shaded(colour, shade), (0.4, 0.4))


def loop_carpet(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make loop carpet as in offices: short loops in rows, one colour or mottled."""
    first = colour or cloth_colour(rng)
    second = companion(rng, first)
    u, v = grid_uv((_SIDE, _SIDE))
    loops = np.sin(2 * np.pi * 40 * v) * np.sin(2 * np.pi * 32 * u + np.pi * ((v * 40).astype(np.int32) % 2))
    mottle = speckle(rng, (_SIDE, _SIDE), (1.5, 1.5))
    share = float(rng.choice([0.0, 0.12, 0.3])) * (0.6 + 0.7 * mottle)
    image = lerp(first, second, share) * (0.94 + 0.1 * loops + 0.03 * mottle)[..., None]
    return to_texture(image.astype(np.float32), (0.4, 0.4))


def shag_carpet(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make long-pile carpet: tufts that lie in varying directions."""
    ground = colour or cloth_colour(rng)
    tufts = speckle(rng, (_SIDE, _SIDE), (1.0, 3.2)) + speckle(rng, (_SIDE, _SIDE), (3.2, 1.0))
    cloud = fbm(rng, (_SIDE, _SIDE), (3, 3), octaves=4)
    shade = 0.95 + np.float32(rng.uniform(0.05, 0.13)) * tufts + 0.08 * cloud
    return to_texture(shaded(ground, shade), (0.7, 0.7))


def patterned_carpet(rng: np.random.Generator, colour: Rgb | None = None) -> Texture:
    """Make carpet with figures in rows, as in hotels, or carpet tiles in alternating directions."""
    u, v = grid_uv((_SIDE, _SIDE))
    pile = speckle(rng, (_SIDE, _SIDE), (0.8, 0.8))
    if rng.random() < 0.35:
        ground = colour or cloth_colour(rng)
        odd = ((u * 2).astype(np.int32) + (v * 2).astype(np.int32)) % 2 == 1
        ribs = np.where(odd, np.sin(2 * np.pi * 48 * u), np.sin(2 * np.pi * 48 * v))
        shade = 1 + 0.04 * ribs + 0.03 * pile + np.where(odd, 0.02, -0.02)
        return to_texture(shaded(ground, shade.astype(np.float32)), (1.0, 1.0))
    colours = dyes(rng, 4)[1:]
    count = int(rng.choice([2, 4]))
    row = (v * count).astype(np.int32)
    x, y = (u * count + 0.5 * (row % 2)) % 1 - 0.5, v * count - row - 0.5
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    petals = int(rng.choice([3, 4, 6, 8]))
    flower = radius * (1 + 0.3 * np.cos(petals * turn))
    diamond = np.abs(x) + np.abs(y)
    image = flat(colour or colours[0], (_SIDE, _SIDE))
    image = np.where((np.abs(diamond - 0.46) < 0.03)[..., None], to_srgb(colours[1]), image)
    image = np.where((flower < rng.uniform(0.2, 0.32))[..., None], to_srgb(colours[2]), image)
    image = np.where((flower < rng.uniform(0.06, 0.14))[..., None], to_srgb(colours[1]), image)
    side = float(rng.uniform(0.5, 1.2))
    return to_texture((image * (0.97 + 0.04 * pile)[..., None]).astype(np.float32), (side, side))
