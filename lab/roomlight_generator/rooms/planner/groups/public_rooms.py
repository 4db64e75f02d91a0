"""Furniture of public rooms: rows of bookcases, counters and benches."""

from roomlight_generator.rooms.planner.arrangement import Arrangement
from roomlight_generator.rooms.planner.wall_space import (
    free_wall_spans,
    place_at_wall,
    place_with_floor,
    wall_point,
    wall_positions,
)


def bookcase_row(arrangement: Arrangement, *, longest: float) -> None:
    """Place bookcases of one model side by side along a wall."""
    model = arrangement.pick("bookcase", width=(0.3, 2.0), depth=(0.1, 0.7), height=(0.5, 3.0))
    if model is None:
        return
    spans = free_wall_spans(arrangement, model.depth_m + 0.04, low=0.0, high=model.height_m)
    best = sorted(spans, key=lambda span: -span.length_m * arrangement.uniform(0.6, 1.4))
    away = arrangement.uniform(0.012, 0.04)
    for span in best[:3]:
        wall = arrangement.shell.walls[span.wall]
        count = int(min(span.length_m - 0.04, longest) / (model.width_m + 0.003))
        slack = span.length_m - count * (model.width_m + 0.003)
        cursor = span.start_m + slack * arrangement.uniform(0.1, 0.9)
        done = 0
        for k in range(count):
            x, z = wall_point(wall, cursor + (k + 0.5) * (model.width_m + 0.003), model.depth_m, away)
            done += place_with_floor(arrangement, model, x, z, wall.facing_degrees(), 0.6) is not None
        if done:
            return


def double_rows(arrangement: Arrangement) -> None:
    """Place bookcases back to back, freestanding at right angles to a wall."""
    model = arrangement.pick("bookcase", width=(0.6, 1.6), depth=(0.2, 0.5), height=(1.0, 2.3))
    if model is None:
        return
    per_row = int(arrangement.rng.integers(1, 3))
    length, depth = per_row * (model.width_m + 0.003), 2 * model.depth_m + 0.02
    for _ in range(int(arrangement.area_m2 / 12)):
        spans = free_wall_spans(arrangement, length + 0.3, low=0.0, high=model.height_m)
        for index, along in wall_positions(arrangement, spans, depth + 1.5)[:3]:
            wall = arrangement.shell.walls[index]
            done = 0
            for k in range(per_row):
                for side in (-1, 1):
                    middle = along + side * (model.depth_m / 2 + 0.005)
                    x, z = wall.at(middle, 0.05 + (k + 0.5) * (model.width_m + 0.003))
                    yaw = wall.facing_degrees() + 90 * side
                    done += place_with_floor(arrangement, model, x, z, yaw, 0.65) is not None
            if done:
                break


def benches(arrangement: Arrangement) -> None:
    """Place benches along the walls."""
    for _ in range(arrangement.poisson(1.2)):
        model = arrangement.pick("bench", width=(0.6, 2.2), depth=(0.25, 0.7))
        place_at_wall(arrangement, model, clear_m=0.4)
