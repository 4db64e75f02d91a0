"""Rows of bookcases, counters and benches: what public rooms have more of than homes."""

from roomlight_generator.rooms.planner.arrangement import Layout, Piece
from roomlight_generator.rooms.planner.wall_space import at_wall, before, places, stand, stretches


def row_along(
    layout: Layout, *, role: str, longest: float, clear_m: float = 0.6, height: tuple[float, float] = (0.5, 3.0)
) -> list[Piece]:
    """Pieces of one model side by side along a wall; what was put."""
    model = layout.pick(role, width=(0.3, 2.0), depth=(0.1, 0.7), height=height)
    if model is None:
        return []
    found = stretches(layout, model.depth_m + 0.04, low=0.0, high=model.height_m)
    best = sorted(found, key=lambda one: -one.length_m * layout.between(0.6, 1.4))
    away = layout.between(0.012, 0.04)
    for stretch in best[:3]:
        wall = layout.shell.walls[stretch.wall]
        count = int(min(stretch.length_m - 0.04, longest) / (model.width_m + 0.003))
        slack = stretch.length_m - count * (model.width_m + 0.003)
        cursor = stretch.start_m + slack * layout.between(0.1, 0.9)
        row: list[Piece] = []
        for k in range(count):
            mark = layout.mark()
            x, z = at_wall(wall, cursor + (k + 0.5) * (model.width_m + 0.003), model.depth_m, away)
            piece = layout.put(model, x, z, wall.facing_degrees())
            if piece is None:
                continue
            if not layout.keep_free(before(piece, clear_m)):
                layout.back_to(mark)
                continue
            row.append(piece)
        if row:
            return row
    return []


def double_rows(layout: Layout) -> int:
    """Bookcases back to back, standing free at right angles to a wall; how many."""
    model = layout.pick("bookcase", width=(0.6, 1.6), depth=(0.2, 0.5), height=(1.0, 2.3))
    if model is None:
        return 0
    per_row = int(layout.rng.integers(1, 3))
    length, depth = per_row * (model.width_m + 0.003), 2 * model.depth_m + 0.02
    count = 0
    for _ in range(int(layout.area_m2 / 12)):
        found = stretches(layout, length + 0.3, low=0.0, high=model.height_m)
        for index, along in places(layout, found, depth + 1.5)[:3]:
            wall = layout.shell.walls[index]
            done = 0
            for k in range(per_row):
                for side in (-1, 1):
                    middle = along + side * (model.depth_m / 2 + 0.005)
                    x, z = wall.at(middle, 0.05 + (k + 0.5) * (model.width_m + 0.003))
                    mark = layout.mark()
                    piece = layout.put(model, float(x), float(z), wall.facing_degrees() + 90 * side)
                    if piece is not None and not layout.keep_free(before(piece, 0.65)):
                        layout.back_to(mark)
                        piece = None
                    done += piece is not None
            if done:
                count += done
                break
    return count


def benches(layout: Layout) -> int:
    """Benches along the walls; how many."""
    count = 0
    for _ in range(layout.count(1.2)):
        model = layout.pick("bench", width=(0.6, 2.2), depth=(0.25, 0.7))
        count += stand(layout, model, clear_m=0.4) is not None
    return count
