"""Bathroom fixtures along the walls."""

from roomlight_generator.rooms.planner.arrangement import Layout, Piece
from roomlight_generator.rooms.planner.wall_space import Where, stand


def bathroom(layout: Layout) -> list[Piece]:
    """Bath or shower, toilet, washbasin, and what else finds room; what was put."""
    placed: list[Piece] = []

    def add(
        role: str,
        *,
        where: Where,
        clear_m: float,
        width: tuple[float, float] = (0.0, 9.0),
        depth: tuple[float, float] = (0.0, 9.0),
    ) -> bool:
        for clear in (clear_m, clear_m, 0.8 * clear_m, 0.7 * clear_m):
            model = layout.pick(role, width=width, depth=depth)
            piece = stand(layout, model, where=where, clear_m=clear, tries=14)
            if piece is not None:
                placed.append(piece)
                return True
        return False

    small = layout.area_m2 < 5
    longest = max(wall.length_m for wall in layout.shell.walls)
    bath = add("bathtub", where="corner", clear_m=0.45, width=(0.8, longest - 0.02)) if layout.chance(0.65) else False
    if not bath or (layout.area_m2 > 6 and layout.chance(0.5)):
        add("shower", where="corner", clear_m=0.45)
    add("washbasin", where="any", clear_m=0.5, width=(0.25, 0.9 if small else 1.6))
    if layout.chance(0.9):
        add("toilet", where="any", clear_m=0.45)
    if layout.area_m2 > 8 and layout.chance(0.35):
        add("washbasin", where="any", clear_m=0.5)
    if layout.chance(0.4):
        add("washing_machine", where="corner", clear_m=0.5)
    for _ in range(layout.count(1.0 if small else 2.2)):
        role = layout.shuffled(("dresser", "sideboard", "stool", "bookcase", "floor_clutter"))[0]
        add(role, where="any", clear_m=0.2, width=(0.2, 0.9), depth=(0.15, 0.5))
    return placed
