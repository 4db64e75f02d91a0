"""Lamps that hang from the ceiling: one in the middle, several in a grid, one over each table."""

import math
from typing import Final, Literal

import numpy as np

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.planner.arrangement import UNDER_CEILING_M, Layout, Piece
from roomlight_generator.rooms.planner.body import Body

CeilingLight = Literal["middle", "panels", "spots", "pendants", "none"]

HEAD_M: Final = 2.0
"""Lamps over free floor hang higher."""

MOST_LAMPS: Final = 20
"""About so many in a grid: every lamp costs light."""

OVERHEAD_M: Final = 1.9
"""Lower than this a lamp is in a walker's way, whatever the ceiling."""

OVER_TABLE_M: Final = 0.6
"""Lamps over a table leave that much above it."""


def light_ceiling(layout: Layout, kinds: tuple[tuple[CeilingLight, float], ...]) -> None:
    """Lamps over tables, then one of the kinds by its share."""
    over = _over_tables(layout)
    shares = np.array([share for _, share in kinds])
    kind = kinds[int(layout.rng.choice(len(kinds), p=shares / shares.sum()))][0]
    if kind == "panels":
        _grid(layout, _panel(layout), layout.between(1.8, 2.9))
    elif kind == "spots":
        _grid(layout, _spot(layout), layout.between(1.0, 1.7))
    elif kind == "pendants":
        _grid(layout, _hanging(layout, layout.shell.height_m - HEAD_M), layout.between(2.0, 3.2))
    elif kind == "middle" and not (over and layout.area_m2 < 16):
        _middle(layout)


def _flat(layout: Layout, lowest: float) -> FurnitureModel | None:
    return layout.pick("ceiling_lamp", height=(0.0, max(lowest, 0.12)))


def _panel(layout: Layout) -> FurnitureModel | None:
    def fits(model: FurnitureModel) -> bool:
        name = f"{model.id} {model.name}".lower()
        return "panel" in name or "fluorescent" in name or (max(model.width_m, model.depth_m) > 0.45)

    return layout.pick("ceiling_lamp", height=(0.0, 0.16), also=fits) or _flat(layout, 0.3)


def _spot(layout: Layout) -> FurnitureModel | None:
    small = layout.pick("ceiling_lamp", width=(0.0, 0.22), depth=(0.0, 0.22), height=(0.0, 0.3))
    return small or _flat(layout, 0.2)


def _hanging(layout: Layout, longest: float) -> FurnitureModel | None:
    return layout.pick("ceiling_lamp", height=(0.2, max(longest, 0.2))) or _flat(layout, longest)


def _hang(
    layout: Layout, model: FurnitureModel | None, x: float, z: float, degrees: float, *, lowest: float = OVERHEAD_M
) -> Piece | None:
    """Its top just under the lowest ceiling over its footprint; None where it would hang lower than `lowest`."""
    if model is None:
        return None
    probe = Body.of(x, z, degrees, width=model.width_m, depth=model.depth_m, high=0.1)
    top = min(layout.shell.ceiling_at(*corner) for corner in [*probe.corners(), (x, z)]) - UNDER_CEILING_M
    # Where a beam is, from the beam.
    lamp = Body.of(x, z, degrees, width=model.width_m, depth=model.depth_m, low=top - 0.01, high=top)
    beams = [one.low - UNDER_CEILING_M for one in layout.fixed if one.low > HEAD_M and one.overlaps(lamp, -0.01)]
    y = min([top, *beams]) - model.height_m
    return layout.put(model, x, z, degrees, y=y, layer="ceiling") if y >= lowest else None


def _over_tables(layout: Layout) -> int:
    """Pendants over the tables that people sit at; how many tables have one."""
    if not layout.tables or layout.chance(0.2):
        return 0
    lowest = max(piece.model.height_m for piece in layout.tables) + OVER_TABLE_M
    longest = layout.shell.height_m - lowest
    model = _hanging(layout, longest)
    if model is None or model.height_m > longest:
        return 0
    done = 0
    for table in layout.tables:
        body = table.body
        two = 2 * body.half_width > 1.7 and model.width_m < 0.5 and layout.chance(0.7)
        for right in (-body.half_width / 2, body.half_width / 2) if two else (0.0,):
            x, z = body.out(right, 0.0)
            done += _hang(layout, model, x, z, table.degrees, lowest=body.high + 0.4) is not None
    return done


def _middle(layout: Layout) -> None:
    """One lamp at the point furthest from the walls, or two along a long room; now and then a fan."""
    free_height = layout.shell.height_m - HEAD_M - UNDER_CEILING_M
    model: FurnitureModel | None = None
    if layout.chance(0.07) and layout.shell.height_m > 2.45:
        model = layout.pick("ceiling_fan", height=(0.0, free_height))
    if model is None:
        model = layout.pick("ceiling_lamp", height=(0.0, max(free_height, 0.15)), width=(0.12, 1.3), depth=(0.05, 1.3))
    if model is None:
        model = _flat(layout, free_height)
    if model is None:
        return
    longest = max(layout.shell.walls, key=lambda wall: wall.length_m)
    if layout.area_m2 > 22 and longest.length_m > 5 and layout.chance(0.6):
        _grid(layout, model, longest.length_m / 2)
        return
    x, z = _centre(layout)
    for _ in range(4):
        if _hang(layout, model, x, z, longest.facing_degrees()) is not None:
            return
        x, z = x + layout.between(-0.4, 0.4), z + layout.between(-0.4, 0.4)


def _centre(layout: Layout) -> tuple[float, float]:
    """The middle of the floor, or of its widest part where the room has a corner there."""
    polygon = layout.shell.polygon
    middle = (polygon.min(0) + polygon.max(0)) / 2
    if layout.shell.contains(float(middle[0]), float(middle[1]), 0.6):
        return float(middle[0]), float(middle[1])
    points = layout.floor.points()
    if not len(points):
        return float(middle[0]), float(middle[1])
    walls = polygon, np.roll(polygon, -1, axis=0)
    gaps = np.full(len(points), np.inf)
    for start, end in zip(*walls, strict=True):
        edge = end - start
        along = np.clip((points - start) @ edge / max(float(edge @ edge), 1e-12), 0, 1)
        gaps = np.minimum(gaps, np.linalg.norm(points - start - along[:, None] * edge, axis=1))
    x, z = points[gaps >= gaps.max() - 0.05].mean(0)
    return float(x), float(z)


def _grid(layout: Layout, model: FurnitureModel | None, spacing: float) -> None:
    """The same lamp in rows and columns along the longest wall."""
    if model is None:
        return
    wall = max(layout.shell.walls, key=lambda one: one.length_m)
    polygon = layout.shell.polygon
    along = (polygon - wall.start) @ (wall.end - wall.start) / wall.length_m
    away = (polygon - wall.start) @ wall.inward
    starts = float(along.min()), float(away.min())
    sizes = float(np.ptp(along)), float(np.ptp(away))
    spacing = max(spacing, (sizes[0] * sizes[1] / MOST_LAMPS) ** 0.5)
    counts = [max(1, min(round(size / spacing), 8)) for size in sizes]
    turn = wall.facing_degrees() + (90.0 if layout.chance(0.3) else 0.0)
    for row in range(counts[1]):
        for column in range(counts[0]):
            place = wall.at(
                starts[0] + (column + 0.5) * sizes[0] / counts[0], starts[1] + (row + 0.5) * sizes[1] / counts[1]
            )
            if math.isfinite(float(place[0])):
                _hang(layout, model, float(place[0]), float(place[1]), turn)
