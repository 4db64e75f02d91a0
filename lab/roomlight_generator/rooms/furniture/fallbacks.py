"""Ten plain models of boxes and bars, for roles without a fitting model of the furniture library.

Model frame: metres, y up, front +z, standing on y = 0, centre of the footprint at the origin.
"""

from collections.abc import Callable
from functools import partial
from typing import Final
from zlib import crc32

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture_model import FurnitureModel, LightSource
from roomlight_generator.rooms.palettes import cloth_colour, dark_wall, neutral_wall, wall_colour, white, wood_colour
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, block, lathe, sphere, with_material

VARIANTS: Final = 3
"""Models of each kind and split."""

_SPLIT_KEYS: Final[dict[Split, int]] = {"train": 1, "test": 2}

Box = tuple[Material, tuple[Number, Number, Number], tuple[Number, Number, Number]]
"""A material, a size (width, height, depth) and the place of the bottom's centre."""

Model = tuple[Mesh, float | None, tuple[LightSource, ...]]
"""A mesh, the height of its level top (None: nothing stands on it), and its bulbs."""


def fallback_models(split: Split) -> tuple[FurnitureModel, ...]:
    """Return every variant of every kind for a split.

    The id, "fallback/<kind>/<split><number>", alone determines a model: the same id gives a byte-identical mesh.
    """
    return tuple(_model(kind, split, number) for kind in KINDS for number in range(VARIANTS))


def _model(kind: str, split: Split, number: int) -> FurnitureModel:
    mesh, top, lights = KINDS[kind](np.random.default_rng([crc32(kind.encode()), _SPLIT_KEYS[split], number]))
    low, high = mesh.bounds()
    width, height, depth = (float(length) for length in high - low)
    return FurnitureModel(
        id=f"fallback/{kind}/{split}{number}",
        name=kind.replace("_", " "),
        role=kind,
        split=split,
        width_m=width,
        height_m=height,
        depth_m=depth,
        load=lambda: mesh,
        elevation_m=1.3 if kind == "picture" else 0.0,
        top_m=top,
        lights=lights,
    )


def _joined(boxes: list[Box], *others: Mesh) -> Mesh:
    parts = [with_material(block(*size), material).placed(*(float(x) for x in at)) for material, size, at in boxes]
    return Mesh.joined([*parts, *others])


def _legs(material: Material, width: Number, height: Number, depth: Number, *, thick: Number = 0.05) -> list[Box]:
    x, z = (width - thick) / 2, (depth - thick) / 2
    return [(material, (thick, height, thick), (sx * x, 0, sz * z)) for sx in (-1, 1) for sz in (-1, 1)]


def _wood(rng: np.random.Generator) -> Material:
    return Material("wood", wood_colour(rng), roughness=float(rng.uniform(0.12, 0.4)) if rng.random() < 0.5 else None)


def _sofa(rng: np.random.Generator) -> Model:
    width, depth, seat = rng.uniform(1.5, 2.4), rng.uniform(0.8, 0.95), rng.uniform(0.4, 0.46)
    arm, height, back = rng.uniform(0.14, 0.22), rng.uniform(0.72, 0.9), rng.uniform(0.18, 0.26)
    cloth, foot = Material("cloth", cloth_colour(rng)), _wood(rng)
    inner = width - 2 * arm
    boxes: list[Box] = [
        (cloth, (inner, seat - 0.1, depth - back), (0, 0.1, back / 2)),
        (cloth, (inner, height - 0.1, back), (0, 0.1, (back - depth) / 2)),
    ]
    boxes += [(cloth, (arm, seat + 0.08, depth), (side * (width - arm) / 2, 0.1, 0)) for side in (-1, 1)]
    return _joined(boxes + _legs(foot, width, 0.1, depth)), None, ()


def _chair(rng: np.random.Generator) -> Model:
    width, depth, seat = rng.uniform(0.4, 0.5), rng.uniform(0.42, 0.52), rng.uniform(0.43, 0.48)
    height = rng.uniform(0.8, 0.98)
    wood = _wood(rng)
    cover = Material("cloth", cloth_colour(rng)) if rng.random() < 0.5 else wood
    boxes: list[Box] = [
        (cover, (width, 0.04, depth), (0, seat - 0.04, 0)),
        (cover, (width, height - seat, 0.03), (0, seat, 0.015 - depth / 2)),
    ]
    return _joined(boxes + _legs(wood, width, seat - 0.04, depth, thick=0.035)), None, ()


def _table(rng: np.random.Generator, low: tuple[float, float, float], high: tuple[float, float, float]) -> Model:
    width, height, depth = (float(x) for x in rng.uniform(low, high))
    wood = _wood(rng)
    top: Box = (wood, (width, 0.03, depth), (0, height - 0.03, 0))
    return _joined([top, *_legs(wood, width, height - 0.03, depth, thick=0.06)]), height, ()


def _bed(rng: np.random.Generator) -> Model:
    width, depth, height = rng.uniform(0.95, 1.85), rng.uniform(2.0, 2.15), rng.uniform(0.45, 0.58)
    wood, sheet, cover = _wood(rng), Material("sheet", white(rng)), Material("cloth", cloth_colour(rng))
    board = rng.uniform(0.75, 1.1)
    boxes: list[Box] = [
        (wood, (width, 0.3, depth - 0.05), (0, 0, 0.025)),
        (wood, (width, board, 0.05), (0, 0, (0.05 - depth) / 2)),
        (sheet, (width - 0.06, height - 0.3, depth - 0.1), (0, 0.3, 0.03)),
        (cover, (width - 0.02, 0.03, 0.62 * depth), (0, height, 0.17 * depth)),
    ]
    boxes += [(sheet, (0.36 * width, 0.1, 0.35), (side * 0.24 * width, height, 0.3 - depth / 2)) for side in (-1, 1)]
    return _joined(boxes), None, ()


def _bookcase(rng: np.random.Generator) -> Model:
    width, height, depth = rng.uniform(0.6, 1.2), rng.uniform(1.4, 2.1), rng.uniform(0.26, 0.36)
    wood = _wood(rng)
    shelves = int(height / 0.35)
    step = (height - 0.02) / shelves
    boxes: list[Box] = [(wood, (0.02, height, depth), (side * (width - 0.02) / 2, 0, 0)) for side in (-1, 1)]
    boxes.append((wood, (width - 0.04, height, 0.01), (0, 0, (0.01 - depth) / 2)))
    boxes += [(wood, (width - 0.04, 0.02, depth - 0.01), (0, step * k, 0.005)) for k in range(shelves + 1)]
    for k in range(shelves):
        long = (width - 0.06) * rng.uniform(0.3, 0.95)
        books = Material("books", wall_colour(rng))
        boxes.append(
            (books, (long, (step - 0.02) * rng.uniform(0.6, 0.85), 0.7 * depth),
             ((long - width + 0.06) / 2, step * k + 0.02, 0.0))
        )  # fmt: skip
    return _joined(boxes), None, ()


def _sideboard(rng: np.random.Generator) -> Model:
    width, height, depth = rng.uniform(1.0, 1.8), rng.uniform(0.6, 0.9), rng.uniform(0.36, 0.48)
    wood = _wood(rng)
    front = Material("paint", white(rng)) if rng.random() < 0.5 else wood
    doors = int(rng.integers(2, 5))
    wide = width / doors
    boxes: list[Box] = [(wood, (width, height - 0.08, depth - 0.02), (0, 0.08, -0.01))]
    boxes += [
        (front, (wide - 0.01, height - 0.12, 0.02), ((k + 0.5) * wide - width / 2, 0.1, depth / 2 - 0.01))
        for k in range(doors)
    ]
    return _joined(boxes + _legs(wood, width, 0.08, depth - 0.02)), height, ()


def _picture(rng: np.random.Generator) -> Model:
    width, height = rng.uniform(0.3, 1.1), rng.uniform(0.3, 0.8)
    frame = Material("frame", white(rng) if rng.random() < 0.4 else dark_wall(rng))
    paper, figure = Material("paper", neutral_wall(rng)), Material("print", wall_colour(rng))
    boxes: list[Box] = [
        (frame, (width, height, 0.02), (0, 0, -0.004)),
        (paper, (width - 0.06, height - 0.06, 0.004), (0, 0.03, 0.008)),
        (figure, (0.6 * width, 0.6 * height, 0.004), (0, 0.2 * height, 0.012)),
    ]
    return _joined(boxes), None, ()


def _shade(rng: np.random.Generator) -> Material:
    return Material("shade", white(rng))


def _bulb(y: Number) -> tuple[LightSource, ...]:
    return (LightSource(np.array([0.0, float(y), 0.0]), 0.06),)


def _floor_lamp(rng: np.random.Generator) -> Model:
    radius, height, tall = rng.uniform(0.15, 0.25), rng.uniform(1.4, 1.75), rng.uniform(0.2, 0.34)
    metal = Material("metal", dark_wall(rng), roughness=0.2)
    shade = with_material(
        lathe([[(radius, 0.0), (0.85 * radius, float(tall))]], segments=20), _shade(rng)
    ).placed(0.0, float(height - tall), 0.0)  # fmt: skip
    stand = height - 0.6 * tall
    boxes: list[Box] = [
        (metal, (1.2 * radius, 0.02, 1.2 * radius), (0, 0, 0)), (metal, (0.02, stand - 0.02, 0.02), (0, 0.02, 0)),
    ]  # fmt: skip
    return _joined(boxes, shade), None, _bulb(height - 0.5 * tall)


def _ceiling_lamp(rng: np.random.Generator) -> Model:
    """Make a flat panel, a small spot or a hanging globe: its top touches the ceiling."""
    kind = int(rng.integers(3))
    if kind < 2:
        side, height = (rng.uniform(0.45, 0.65), 0.06) if kind == 0 else (rng.uniform(0.08, 0.18), 0.1)
        shape: list[Box] = [(_shade(rng), (side, height, side), (0, 0, 0))]
        return _joined(shape), None, _bulb(height / 2)
    radius, cord = rng.uniform(0.12, 0.22), rng.uniform(0.15, 0.5)
    globe = with_material(sphere(radius, rings=8, segments=16), _shade(rng)).placed(0.0, float(radius), 0.0)
    metal = Material("metal", dark_wall(rng), roughness=0.2)
    hung: list[Box] = [(metal, (0.008, cord + 0.01, 0.008), (0, 2 * radius - 0.01, 0))]
    return _joined(hung, globe), None, _bulb(radius)


KINDS: Final[dict[str, Callable[[np.random.Generator], Model]]] = {
    "sofa": _sofa,
    "chair": _chair,
    "dining_table": partial(_table, low=(1.1, 0.72, 0.75), high=(2.0, 0.77, 1.0)),
    "coffee_table": partial(_table, low=(0.6, 0.35, 0.45), high=(1.2, 0.48, 0.7)),
    "bed": _bed,
    "bookcase": _bookcase,
    "sideboard": _sideboard,
    "picture": _picture,
    "floor_lamp": _floor_lamp,
    "ceiling_lamp": _ceiling_lamp,
}
"""Makers by kind; a kind is the role of its models."""
