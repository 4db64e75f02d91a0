"""Beds with their bedding, children's beds, cots and bunk beds."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.seating import add_legs
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, cushion, double_sided_sheet

_TUCKED: Final = (0.03, 0.06)
"""How far a duvet hangs down, metres, if a frame holds it in."""


def add_duvet(
    parts: Parts, rng: np.random.Generator, cover: Material, width: Number, length: Number, top: Number, drop: Number
) -> None:
    """Add a cover over a mattress whose top is at `top`, hanging down by `drop` at its sides and foot, with creases.

    It covers z from length/2 (the foot) up to two thirds toward the head.
    """
    start = -length / 2 + length * uniform(rng, 0.22, 0.42)
    side, foot = width / 2 + 0.015, length / 2 + 0.015
    xs = np.concatenate([[-side - 0.02], np.linspace(-side, side, 9), [side + 0.02]])
    zs = np.concatenate([np.linspace(start, foot, 8), [foot + 0.02]])
    points = np.empty((len(zs), len(xs), 3), np.float32)
    points[..., 0], points[..., 2] = xs[None], zs[:, None]
    points[..., 1] = top + 0.03 + 0.012 * rng.standard_normal((len(zs), len(xs)))
    for edge in (0, -1):
        points[:, edge, 1] = top - drop * rng.uniform(0.85, 1.1, len(zs))
    points[-1, 1:-1, 1] = top - drop * rng.uniform(0.85, 1.1, len(xs) - 2)
    # A corner hangs lower than the edges beside it, so that it is folded outward.
    points[-1, [0, -1], 1] = points[-2:, [0, -1], 1].min() - 0.03
    # Rows run from foot to head so that the upper layer faces up.
    parts.add(double_sided_sheet(points[::-1].copy(), thickness=0.012), cover)


@dataclass(frozen=True)
class Mattress:
    """Size of a mattress and the height of its bottom, metres."""

    width: Number
    length: Number
    bottom: Number
    thickness: Number


def add_bedding(
    parts: Parts,
    rng: np.random.Generator,
    mattress: Mattress,
    *,
    pillows: int,
    head_m: Number = 0.0,
    hang: tuple[Number, Number] = (0.08, 0.28),
) -> None:
    """Add a mattress, a duvet, pillows at the head (-z), and sometimes a throw over the foot.

    Pillows may lean on a headboard as high as head_m; the duvet hangs down by `hang`.
    """
    width, length, low, thickness = mattress.width, mattress.length, mattress.bottom, mattress.thickness
    linen, cover = palette.cloth(rng, patterned=0.0), palette.cloth(rng, patterned=0.35)
    parts.slab(linen, (width, thickness, length), (0, low, 0), radius=0.05, arcs=2)
    top = low + thickness
    if rng.random() < 0.9:
        add_duvet(parts, rng, cover, width, length, top, uniform(rng, *hang))
    case = cover if rng.random() < 0.4 else palette.cloth(rng, patterned=0.2)
    part_width = min(0.75, width / pillows - 0.04)
    for k in range(pillows):
        x = (-0.5 + (k + 0.5) / pillows) * width
        depth_m = uniform(rng, 0.4, 0.5)
        shape = cushion(part_width, 0.16, depth_m, plump=0.75, radius=0.06, step=0.16, arcs=1)
        if rng.random() < 0.4 and top + depth_m * 0.92 < head_m:
            parts.add(shape, case, (x, top + depth_m * 0.42, -length / 2 + 0.16), pitch=62)
        else:
            parts.add(shape, case, (x, top - 0.01, -length / 2 + depth_m / 2 + 0.04), yaw=uniform(rng, -6, 6))
    if rng.random() < 0.35:
        throw = palette.cloth(rng, patterned=0.5)
        span = uniform(rng, 0.35, 0.6)
        grid = np.array(
            [
                [[x, top + (0.055 if abs(x) < width / 2 + 0.03 else -0.12), z] for x in
                 (-width / 2 - 0.05, -width / 2 - 0.02, 0.0, width / 2 + 0.02, width / 2 + 0.05)]
                for z in (length / 2 - 0.12, length / 2 - 0.12 - span)
            ],
            np.float32,
        )  # fmt: skip
        parts.add(double_sided_sheet(grid, thickness=0.012), throw)


def bed(rng: np.random.Generator) -> Draft:
    """Make a single or double bed: divan, wooden, upholstered or metal frame, with various headboards."""
    width = float(rng.choice([0.9, 1.0, 1.4, 1.6, 1.8], p=[0.15, 0.05, 0.3, 0.3, 0.2])) + uniform(rng, 0.02, 0.1)
    length, height = uniform(rng, 2.02, 2.2), uniform(rng, 0.75, 1.3)

    def build() -> Mesh:
        parts = Parts()
        kind = int(rng.integers(4))
        frame = (palette.wood, palette.upholstery, palette.wood_or_paint, palette.metal)[kind](rng)
        leg, thickness = uniform(rng, 0.08, 0.2), uniform(rng, 0.18, 0.3)
        rail = uniform(rng, 0.12, 0.22)
        board = 0.1 if kind == 1 else 0.045
        inside = length - board - 0.04
        z = board / 2 - 0.01
        parts.slab(frame, (width, rail, inside + 0.04), (0, leg, z), radius=0.03 if kind == 1 else 0.006)
        add_legs(parts, frame, (width - 0.1, length - 0.12), leg + 0.02, thickness=0.03, square=rng.random() < 0.6)
        made = Parts()
        add_bedding(
            made,
            rng,
            Mattress(width - 0.06, inside - 0.03, leg + rail - 0.06, thickness),
            pillows=2 if width > 1.3 else 1,
            head_m=height,
        )
        parts.add_mesh(made.mesh(), (0, 0, z))
        back = -length / 2
        if kind == 3:
            for x in (-1, 1):
                parts.bar(
                    frame,
                    (x * (width / 2 - 0.02), 0, back + 0.02),
                    (x * (width / 2 - 0.02), height, back + 0.02),
                    0.018,
                )
            parts.bar(
                frame,
                (-width / 2 + 0.02, height - 0.02, back + 0.02),
                (width / 2 - 0.02, height - 0.02, back + 0.02),
                0.015,
            )
            for x in np.linspace(-0.44, 0.44, int(rng.integers(5, 12))) * width:
                parts.bar(frame, (x, leg + rail, back + 0.02), (x, height - 0.02, back + 0.02), 0.009, segments=6)
        elif kind == 1 and rng.random() < 0.6:
            count = int(rng.integers(2, 7))
            for k in range(count):
                x = (-0.5 + (k + 0.5) / count) * width
                parts.slab(
                    frame, (width / count - 0.004, height - leg, board), (x, leg, back + board / 2), radius=0.035
                )
        else:
            parts.slab(
                frame, (width, height - leg * 0.5, board), (0, leg * 0.5, back + board / 2), radius=min(0.04, board / 3)
            )
            if kind == 2:
                parts.slab(frame, (width, leg + rail + 0.16, 0.04), (0, 0, length / 2 - 0.02), radius=0.006)
        return parts.mesh()

    return Draft("double bed" if width > 1.3 else "single bed", (width + 0.06, height, length), build)


def child_bed(rng: np.random.Generator) -> Draft:
    """Make a low bed with rails, a cot with bars, or a bunk bed."""
    kind = int(rng.integers(3))
    if kind == 1:
        return _cot(rng)
    if kind == 2:
        return _bunk(rng)
    width, length, height = uniform(rng, 0.78, 0.98), uniform(rng, 1.5, 2.0), uniform(rng, 0.55, 0.85)

    def build() -> Mesh:
        parts = Parts()
        frame = palette.wood_or_paint(rng, 0.5)
        for z, height_m in ((-1, height), (1, height * uniform(rng, 0.6, 1))):
            parts.slab(frame, (width, height_m, 0.03), (0, 0, z * (length / 2 - 0.015)), radius=0.012)
        for x in (-1, 1):
            parts.slab(frame, (0.025, 0.2, length - 0.05), (x * (width / 2 - 0.013), 0.14, 0), radius=0)
        parts.slab(frame, (0.025, 0.14, length * 0.5), (-width / 2 + 0.013, 0.4, -length * 0.2), radius=0.008)
        add_bedding(
            parts, rng, Mattress(width - 0.13, length - 0.14, 0.2, 0.14), pillows=1, head_m=height, hang=_TUCKED
        )
        return parts.mesh()

    return Draft("child's bed", (width, height, length), build)


def _cot(rng: np.random.Generator) -> Draft:
    width, length, height = uniform(rng, 0.64, 0.78), uniform(rng, 1.24, 1.46), uniform(rng, 0.82, 1.0)

    def build() -> Mesh:
        parts = Parts()
        frame = palette.wood_or_paint(rng, 0.5)
        for x in (-1, 1):
            for z in (-1, 1):
                parts.slab(
                    frame, (0.045, height, 0.045), (x * (width / 2 - 0.023), 0, z * (length / 2 - 0.023)), radius=0
                )
        bars: list[tuple[float, ...]] = []
        for x in (-1, 1):
            edge = x * (width / 2 - 0.023)
            bars += [(0.025, 0.04, length - 0.08, edge, y, 0) for y in (0.25, height - 0.06)]
            bars += [(0.014, height - 0.33, 0.014, edge, 0.28, float(z)) for z in np.linspace(-0.42, 0.42, 12) * length]
        for z in (-1, 1):
            bars.append((width - 0.08, height - 0.3, 0.018, 0, 0.25, z * (length / 2 - 0.02)))
        parts.blocks(frame, bars)
        add_bedding(parts, rng, Mattress(width - 0.15, length - 0.15, 0.3, 0.12), pillows=1, hang=_TUCKED)
        return parts.mesh()

    return Draft("cot", (width, height, length), build)


def _bunk(rng: np.random.Generator) -> Draft:
    width, length, height = uniform(rng, 0.95, 1.08), uniform(rng, 2.02, 2.12), uniform(rng, 1.55, 1.75)

    def build() -> Mesh:
        parts = Parts()
        frame = palette.wood_or_paint(rng, 0.6) if rng.random() < 0.7 else palette.metal(rng)
        for x in (-1, 1):
            for z in (-1, 1):
                parts.slab(
                    frame, (0.07, height, 0.07), (x * (width / 2 - 0.035), 0, z * (length / 2 - 0.035)), radius=0
                )
        boards: list[tuple[float, ...]] = []
        for y in (0.26, height - 0.5):
            boards += [(0.025, 0.14, length - 0.1, x * (width / 2 - 0.03), y, 0) for x in (-1, 1)]
            boards += [(width - 0.1, 0.14, 0.025, 0, y, z * (length / 2 - 0.03)) for z in (-1, 1)]
            add_bedding(parts, rng, Mattress(width - 0.17, length - 0.17, y + 0.08, 0.12), pillows=1, hang=_TUCKED)
        for x in (-1, 1):
            boards.append((0.02, 0.09, length - 0.1, x * (width / 2 - 0.03), height - 0.12, 0))
        for z in (-1, 1):
            boards += [(width - 0.1, 0.09, 0.02, 0, y, z * (length / 2 - 0.03)) for y in (height - 0.12, 0.55)]
        boards += [(0.03, height - 0.35, 0.03, width / 2 - 0.015, 0, length / 2 - d) for d in (0.15, 0.55)]
        boards += [
            (0.03, 0.03, 0.4, width / 2 - 0.015, float(y), length / 2 - 0.35)
            for y in np.linspace(0.25, height - 0.45, 4)
        ]
        parts.blocks(frame, boards)
        return parts.mesh()

    return Draft("bunk bed", (width, height, length), build)
