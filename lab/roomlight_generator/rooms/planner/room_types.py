"""Room types: sizes, openings, and the furnishing programme as an ordered list of steps."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.planner.arrangement import Arrangement
from roomlight_generator.rooms.planner.groups.bathroom import bathroom
from roomlight_generator.rooms.planner.groups.beds import bed
from roomlight_generator.rooms.planner.groups.ceiling import CeilingLight
from roomlight_generator.rooms.planner.groups.kitchen import kitchen
from roomlight_generator.rooms.planner.groups.loose_items import (
    fill_walls,
    place_along_walls,
    place_in_corners,
    place_rug,
    scatter_on_floor,
)
from roomlight_generator.rooms.planner.groups.public_rooms import benches, bookcase_row, double_rows
from roomlight_generator.rooms.planner.groups.seating_groups import conversation_group, reading_corner, tv_lounge
from roomlight_generator.rooms.planner.groups.tables import cafe_tables, desk, desk_islands, dining, reading_tables
from roomlight_generator.rooms.tables import read_table


def fill_spare_space(arrangement: Arrangement) -> None:
    """Place further furniture groups while a large room is still mostly empty."""
    groups = arrangement.shuffled(
        (partial(dining, seats=(2, 6)), conversation_group, reading_corner, desk, partial(bookcase_row, longest=2.6))
    )
    for group in groups[:3]:
        if arrangement.free_cells().sum() * arrangement.floor.cell_m**2 < max(9.0, 0.42 * arrangement.area_m2):
            break
        group(arrangement)


@dataclass(frozen=True)
class Step:
    """A furnishing step with a probability; `fallback` runs if the step is skipped or `place` returns nothing."""

    place: Callable[[Arrangement], object]
    chance: float = 1.0
    fallback: Callable[[Arrangement], object] | None = None


@dataclass(frozen=True)
class RoomType:
    """A type of room. Ranges are (least, most).

    Attributes:
        split: "test" reserves the type for the test split; types of "train" are used in both.
        aspect: Long to short side.
        p_windowless, p_attic, p_l_shape, p_second_room: Probabilities of a room without any window, of slanted
            ceilings, of an L-shaped plan, of an open door or passage to a second room or corridor.
        wall_items: Mean numbers by role.
        ceiling: Probabilities of kinds of ceiling light.
        clutter: Range, from bare (0) to crowded (1).
        radiators: Probability of a radiator below a window.
    """

    name: str
    programme: tuple[Step, ...]
    split: Split = "train"
    area_m2: tuple[float, float] = (12.0, 30.0)
    aspect: tuple[float, float] = (1.0, 1.7)
    height_m: tuple[float, float] = (2.35, 3.0)
    windows: tuple[int, int] = (1, 3)
    doors: tuple[int, int] = (1, 2)
    p_windowless: float = 0.03
    p_attic: float = 0.05
    p_l_shape: float = 0.12
    p_second_room: float = 0.45
    wall_items: tuple[tuple[str, float], ...] = ()
    ceiling: tuple[tuple[CeilingLight, float], ...] = (("middle", 0.6), ("spots", 0.3), ("none", 0.1))
    clutter: tuple[float, float] = (0.1, 1.0)
    people: float = 0.06
    pets: float = 0.02
    radiators: float = 0.45

    def furnish(self, arrangement: Arrangement) -> None:
        """Run the furnishing programme."""
        for step in self.programme:
            if arrangement.chance(step.chance) and step.place(arrangement):
                continue
            if step.fallback is not None:
                step.fallback(arrangement)


_GROUPS: Final[dict[str, Callable[..., object]]] = {
    group.__name__: group
    for group in (
        bathroom, bed, benches, bookcase_row, cafe_tables, conversation_group, desk, desk_islands, dining, double_rows,
        fill_spare_space, fill_walls, kitchen, place_along_walls, place_in_corners, place_rug, reading_corner,
        reading_tables, scatter_on_floor, tv_lounge,
    )
}  # fmt: skip
"""What a step of `room_types.toml` can place, by name."""


def _step(place: str, *, chance: float = 1.0, fallback: str | None = None, **options: Any) -> Step:
    if "roles" in options:
        options["roles"] = tuple(options["roles"].split())
    if fallback is not None and _GROUPS[place].__annotations__["return"] is None:
        raise ValueError(f"{place} does not say whether it placed anything, so it has no fallback")
    return Step(partial(_GROUPS[place], **options), chance, None if fallback is None else _GROUPS[fallback])


ROOM_TYPES: Final[dict[str, RoomType]] = {
    name: RoomType(name, **table | {"programme": tuple(_step(**step) for step in table["programme"])})
    for name, table in read_table(Path(__file__).with_name("room_types.toml")).items()
}
"""Room types by name, from `room_types.toml`."""
