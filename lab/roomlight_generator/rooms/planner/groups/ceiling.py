"""Ceiling lamps: in the middle, in a grid, over tables."""

from typing import Final, Literal

import numpy as np

from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.plan import inside_outline
from roomlight_generator.rooms.planner.arrangement import UNDER_CEILING_M, Arrangement, Piece
from roomlight_generator.rooms.planner.body import Body

CeilingLight = Literal["middle", "panels", "spots", "pendants", "none"]

HEADROOM_M: Final = 2.0
"""Minimum height of lamps over free floor."""

MAX_GRID_LAMPS: Final = 20
"""Approximate maximum number of lamps in a grid: every lamp adds to the cost of light transport."""

MIN_LAMP_HEIGHT_M: Final = 1.9
"""Minimum height of a lamp under any ceiling, so that it does not block people."""

TABLE_CLEARANCE_M: Final = 0.6
"""Minimum distance between a table and a lamp over it."""


def light_ceiling(arrangement: Arrangement, kinds: tuple[tuple[CeilingLight, float], ...]) -> None:
    """Hang lamps over tables, then a kind of ceiling light by its probability."""
    lamps_over_tables = _hang_over_tables(arrangement)
    shares = np.array([share for _, share in kinds])
    kind = kinds[int(arrangement.rng.choice(len(kinds), p=shares / shares.sum()))][0]
    if kind == "panels":
        _hang_grid(arrangement, _pick_panel(arrangement), arrangement.uniform(1.8, 2.9))
    elif kind == "spots":
        model = arrangement.pick("ceiling_lamp", width=(0.0, 0.22), depth=(0.0, 0.22), height=(0.0, 0.3))
        _hang_grid(arrangement, model or _pick_flat_lamp(arrangement, 0.2), arrangement.uniform(1.0, 1.7))
    elif kind == "pendants":
        model = _pick_pendant(arrangement, arrangement.shell.height_m - HEADROOM_M)
        _hang_grid(arrangement, model, arrangement.uniform(2.0, 3.2))
    elif kind == "middle" and not (lamps_over_tables and arrangement.area_m2 < 16):
        _hang_in_middle(arrangement)


def _pick_flat_lamp(arrangement: Arrangement, lowest: float) -> FurnitureModel | None:
    return arrangement.pick("ceiling_lamp", height=(0.0, max(lowest, 0.12)))


def _pick_panel(arrangement: Arrangement) -> FurnitureModel | None:
    def fits(model: FurnitureModel) -> bool:
        name = f"{model.id} {model.name}".lower()
        return "panel" in name or "fluorescent" in name or (max(model.width_m, model.depth_m) > 0.45)

    return arrangement.pick("ceiling_lamp", height=(0.0, 0.16), also=fits) or _pick_flat_lamp(arrangement, 0.3)


def _pick_pendant(arrangement: Arrangement, longest: float) -> FurnitureModel | None:
    return arrangement.pick("ceiling_lamp", height=(0.2, max(longest, 0.2))) or _pick_flat_lamp(arrangement, longest)


def _hang_lamp(
    arrangement: Arrangement,
    model: FurnitureModel | None,
    x: float,
    z: float,
    degrees: float,
    *,
    lowest: float = MIN_LAMP_HEIGHT_M,
) -> Piece | None:
    """Hang a lamp just under the lowest ceiling over its footprint; None if its bottom were below `lowest`."""
    if model is None:
        return None
    probe = Body.of(x, z, degrees, width=model.width_m, depth=model.depth_m, high=0.1)
    top = min(arrangement.shell.ceiling_at(*corner) for corner in [*probe.corners(), (x, z)]) - UNDER_CEILING_M
    # Under a beam it hangs from the beam.
    lamp = Body.of(x, z, degrees, width=model.width_m, depth=model.depth_m, low=top - 0.01, high=top)
    beams = [
        obstacle.low - UNDER_CEILING_M
        for obstacle in arrangement.fixed
        if obstacle.low > HEADROOM_M and obstacle.overlaps(lamp, -0.01)
    ]
    y = min([top, *beams]) - model.height_m
    return arrangement.place(model, x, z, degrees, y=y, layer="ceiling") if y >= lowest else None


def _hang_over_tables(arrangement: Arrangement) -> int:
    """Hang pendants over the tables with seats; return the number of tables that have a pendant."""
    if not arrangement.tables or arrangement.chance(0.2):
        return 0
    lowest = max(piece.model.height_m for piece in arrangement.tables) + TABLE_CLEARANCE_M
    longest = arrangement.shell.height_m - lowest
    model = _pick_pendant(arrangement, longest)
    if model is None or model.height_m > longest:
        return 0
    done = 0
    for table in arrangement.tables:
        body = table.body
        two = 2 * body.half_width > 1.7 and model.width_m < 0.5 and arrangement.chance(0.7)
        for right in (-body.half_width / 2, body.half_width / 2) if two else (0.0,):
            x, z = body.to_plan(right, 0.0)
            done += _hang_lamp(arrangement, model, x, z, table.degrees, lowest=body.high + 0.4) is not None
    return done


def _hang_in_middle(arrangement: Arrangement) -> None:
    """Hang one lamp at the point furthest from the walls, or two along a long room; sometimes a fan."""
    free_height = arrangement.shell.height_m - HEADROOM_M - UNDER_CEILING_M
    model: FurnitureModel | None = None
    if arrangement.chance(0.07) and arrangement.shell.height_m > 2.45:
        model = arrangement.pick("ceiling_fan", height=(0.0, free_height))
    if model is None:
        model = arrangement.pick(
            "ceiling_lamp", height=(0.0, max(free_height, 0.15)), width=(0.12, 1.3), depth=(0.05, 1.3)
        )
    if model is None:
        model = _pick_flat_lamp(arrangement, free_height)
    if model is None:
        return
    longest = max(arrangement.shell.walls, key=lambda wall: wall.length_m)
    if arrangement.area_m2 > 22 and longest.length_m > 5 and arrangement.chance(0.6):
        _hang_grid(arrangement, model, longest.length_m / 2)
        return
    x, z = _centre(arrangement)
    for _ in range(4):
        if _hang_lamp(arrangement, model, x, z, longest.facing_degrees()) is not None:
            return
        x, z = x + arrangement.uniform(-0.4, 0.4), z + arrangement.uniform(-0.4, 0.4)


def _centre(arrangement: Arrangement) -> tuple[float, float]:
    """Return the middle of the floor, or of its widest part if the middle is at a reentrant corner."""
    polygon = arrangement.shell.polygon
    middle = (polygon.min(0) + polygon.max(0)) / 2
    if arrangement.shell.contains(float(middle[0]), float(middle[1]), 0.6):
        return float(middle[0]), float(middle[1])
    points = arrangement.floor.points()
    if not len(points):
        return float(middle[0]), float(middle[1])
    gaps = np.sqrt(inside_outline(polygon, points[:, 0], points[:, 1])[1])
    x, z = points[gaps >= gaps.max() - 0.05].mean(0)
    return float(x), float(z)


def _hang_grid(arrangement: Arrangement, model: FurnitureModel | None, spacing: float) -> None:
    """Hang copies of a lamp in rows and columns along the longest wall."""
    if model is None:
        return
    wall = max(arrangement.shell.walls, key=lambda side: side.length_m)
    polygon = arrangement.shell.polygon
    along = (polygon - wall.start) @ (wall.end - wall.start) / wall.length_m
    away = (polygon - wall.start) @ wall.inward
    starts = float(along.min()), float(away.min())
    sizes = float(np.ptp(along)), float(np.ptp(away))
    spacing = max(spacing, (sizes[0] * sizes[1] / MAX_GRID_LAMPS) ** 0.5)
    counts = [max(1, min(round(size / spacing), 8)) for size in sizes]
    yaw = wall.facing_degrees() + (90.0 if arrangement.chance(0.3) else 0.0)
    for row in range(counts[1]):
        for column in range(counts[0]):
            x, z = wall.at(
                starts[0] + (column + 0.5) * sizes[0] / counts[0], starts[1] + (row + 0.5) * sizes[1] / counts[1]
            )
            _hang_lamp(arrangement, model, x, z, yaw)
