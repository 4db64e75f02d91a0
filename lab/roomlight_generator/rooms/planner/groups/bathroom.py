"""Bathroom fixtures along the walls."""

from roomlight_generator.rooms.planner.arrangement import Arrangement
from roomlight_generator.rooms.planner.wall_space import WallPreference, place_at_wall


def bathroom(arrangement: Arrangement) -> None:
    """Place a bath or shower, a toilet, a washbasin and optional fixtures."""

    def add(
        role: str,
        *,
        where: WallPreference,
        clear_m: float,
        width: tuple[float, float] = (0.0, 9.0),
        depth: tuple[float, float] = (0.0, 9.0),
    ) -> bool:
        for clear in (clear_m, clear_m, 0.8 * clear_m, 0.7 * clear_m):
            model = arrangement.pick(role, width=width, depth=depth)
            if place_at_wall(arrangement, model, where=where, clear_m=clear, tries=14) is not None:
                return True
        return False

    small = arrangement.area_m2 < 5
    longest = max(wall.length_m for wall in arrangement.shell.walls)
    bath = (
        add("bathtub", where="corner", clear_m=0.45, width=(0.8, longest - 0.02)) if arrangement.chance(0.65) else False
    )
    if not bath or (arrangement.area_m2 > 6 and arrangement.chance(0.5)):
        add("shower", where="corner", clear_m=0.45)
    add("washbasin", where="any", clear_m=0.5, width=(0.25, 0.9 if small else 1.6))
    if arrangement.chance(0.9):
        add("toilet", where="any", clear_m=0.45)
    if arrangement.area_m2 > 8 and arrangement.chance(0.35):
        add("washbasin", where="any", clear_m=0.5)
    if arrangement.chance(0.4):
        add("washing_machine", where="corner", clear_m=0.5)
    for _ in range(arrangement.poisson(1.0 if small else 2.2)):
        role = arrangement.shuffled(("dresser", "sideboard", "stool", "bookcase", "floor_clutter"))[0]
        add(role, where="any", clear_m=0.2, width=(0.2, 0.9), depth=(0.15, 0.5))
