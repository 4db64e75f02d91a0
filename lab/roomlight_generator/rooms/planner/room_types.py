"""Room types: sizes, openings, and the furnishing programme as an ordered list of steps."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

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
from roomlight_generator.rooms.planner.groups.public_rooms import benches, double_rows, row_along
from roomlight_generator.rooms.planner.groups.seating_groups import conversation_group, reading_corner, tv_lounge
from roomlight_generator.rooms.planner.groups.tables import cafe_tables, desk, desk_islands, dining, reading_tables


def fill_spare_space(arrangement: Arrangement) -> int:
    """Place further furniture groups while a large room is still mostly empty; return their number."""
    done = 0
    groups = arrangement.shuffled(
        (
            partial(dining, seats=(2, 6)),
            conversation_group,
            reading_corner,
            desk,
            partial(row_along, role="bookcase", longest=2.6),
        )
    )
    for group in groups[:3]:
        if arrangement.free_cells().sum() * arrangement.floor.cell_m**2 < max(9.0, 0.42 * arrangement.area_m2):
            break
        done += bool(group(arrangement))
    return done


@dataclass(frozen=True)
class Step:
    """A furnishing step with a probability; `fallback` runs if the step is skipped or does not fit."""

    place: Callable[[Arrangement], object]
    chance: float = 1.0
    fallback: Callable[[Arrangement], object] | None = None


@dataclass(frozen=True)
class RoomType:
    """A type of room. Ranges are (least, most).

    Attributes:
        split: "test" reserves the type for the test split; types of "train" are used in both.
        area_m2: Floor area of the main room.
        aspect: Long to short side.
        p_windowless, p_attic, p_l_shape, p_second_room: Probabilities of a room without any window, of slanted
            ceilings, of an L-shaped plan, of an open door or passage to a second room or corridor.
        wall_items: Mean numbers by role.
        ceiling: Probabilities of kinds of ceiling light.
        clutter: Range, from bare (0) to crowded (1).
        people, pets: Probabilities.
        radiators: Probability of a radiator below a window.
        public: Rooms other than homes: larger surfaces, other finishes.
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
    public: bool = False

    def furnish(self, arrangement: Arrangement) -> None:
        """Run the furnishing programme."""
        for step in self.programme:
            if arrangement.chance(step.chance) and step.place(arrangement):
                continue
            if step.fallback is not None:
                step.fallback(arrangement)


_HOME_WALLS: Final = (
    ("picture", 2.2), ("mirror", 0.3), ("clock", 0.3), ("wall_shelf", 0.6), ("wall_lamp", 0.5),
    ("air_conditioner", 0.12), ("wall_clutter", 0.15),
)  # fmt: skip

_CORNER_ITEMS: Final = (
    Step(partial(place_in_corners, role="floor_lamp", number=0.6)),
    Step(partial(place_in_corners, role="plant", number=1.1)),
)

_LIVING: Final = ("bookcase", "bookcase", "sideboard", "dresser", "side_table", "armchair", "plant", "stool")

_CLUTTER: Final = Step(partial(scatter_on_floor, role="floor_clutter", number=0.9, by_walls=0.75))


def _types() -> list[RoomType]:
    return [
        RoomType(
            "living_room",
            (
                Step(tv_lounge, 0.75, conversation_group),
                Step(partial(place_along_walls, roles=("fireplace",)), 0.15),
                Step(partial(dining, seats=(2, 6)), 0.3),
                Step(partial(place_along_walls, roles=("bookcase", "bookcase", "sideboard", "dresser"), number=(1, 3))),
                Step(partial(place_along_walls, roles=("piano",)), 0.08),
                Step(reading_corner, 0.35),
                Step(desk, 0.1),
                Step(fill_spare_space, 0.8),
                *_CORNER_ITEMS,
                Step(partial(fill_walls, roles=_LIVING, share=(0.2, 0.36)), 0.8),
                Step(partial(place_along_walls, roles=("side_table", "stool", "bench"), number=(0, 1))),
                _CLUTTER,
                Step(partial(scatter_on_floor, role="floor_toy", number=0.6), 0.2),
                Step(partial(place_rug, probability=0.2)),
            ),
            area_m2=(14.0, 42.0),
            height_m=(2.4, 3.4),
            windows=(2, 5),
            p_l_shape=0.2,
            wall_items=_HOME_WALLS,
        ),
        RoomType(
            "bedroom",
            (
                Step(bed),
                Step(partial(place_along_walls, roles=("wardrobe",), number=(1, 2)), 0.85),
                Step(partial(place_along_walls, roles=("dresser", "dresser", "sideboard", "bookcase"), number=(0, 2))),
                Step(desk, 0.25),
                Step(reading_corner, 0.25),
                *_CORNER_ITEMS,
                Step(partial(fill_walls, roles=("wardrobe", "dresser", "bookcase", "bench"), share=(0.25, 0.42)), 0.8),
                _CLUTTER,
                Step(partial(place_along_walls, roles=("exercise",), depth=2.0), 0.05),
                Step(partial(place_rug, probability=0.2)),
            ),
            area_m2=(9.0, 24.0),
            windows=(1, 3),
            p_attic=0.12,
            wall_items=(("picture", 1.8), ("mirror", 0.5), ("wall_shelf", 0.4), ("wall_lamp", 0.4), ("clock", 0.15),
                        ("air_conditioner", 0.2)),
        ),
        RoomType(
            "kitchen",
            (
                Step(kitchen),
                Step(partial(dining, seats=(2, 4)), 0.55),
                Step(partial(place_along_walls, roles=("fridge", "sideboard", "bookcase", "dresser"), number=(0, 1))),
                Step(partial(place_along_walls, roles=("stool", "chair"), number=(0, 1))),
                Step(partial(place_in_corners, role="plant", number=0.4)),
                Step(partial(scatter_on_floor, role="floor_clutter", number=0.8, by_walls=0.9)),
                Step(partial(place_rug, probability=0.15, small=True)),
            ),
            area_m2=(7.0, 22.0),
            windows=(1, 3),
            p_attic=0.03,
            wall_items=(("clock", 0.5), ("wall_shelf", 0.8), ("picture", 0.8), ("wall_clutter", 0.2)),
            ceiling=(("middle", 0.45), ("spots", 0.35), ("panels", 0.15), ("none", 0.05)),
        ),
        RoomType(
            "dining_room",
            (
                Step(partial(dining, seats=(4, 8), prefer="middle")),
                Step(
                    partial(place_along_walls, roles=("sideboard", "sideboard", "bookcase", "dresser"), number=(1, 3))
                ),
                Step(partial(place_along_walls, roles=("fireplace", "piano")), 0.15),
                Step(reading_corner, 0.2),
                *_CORNER_ITEMS,
                Step(partial(fill_walls, roles=_LIVING), 0.8),
                _CLUTTER,
            ),
            area_m2=(10.0, 28.0),
            height_m=(2.4, 3.4),
            wall_items=_HOME_WALLS,
        ),
        RoomType(
            "bathroom",
            (
                Step(bathroom),
                Step(partial(scatter_on_floor, role="floor_clutter", number=0.6, by_walls=0.9, tallest=0.8)),
                Step(partial(place_in_corners, role="plant", number=0.25, widest=0.5)),
                Step(partial(place_rug, probability=0.45, small=True)),
            ),
            area_m2=(3.4, 11.0),
            aspect=(1.0, 2.0),
            height_m=(2.25, 2.8),
            windows=(0, 1),
            doors=(1, 1),
            p_windowless=0.3,
            p_attic=0.1,
            p_l_shape=0.06,
            wall_items=(("mirror", 1.2), ("towel_rack", 1.3), ("wall_shelf", 0.5), ("wall_lamp", 0.7), ("picture", 0.3),
                        ("wall_clutter", 0.3), ("wall_unit", 0.3)),
            ceiling=(("middle", 0.55), ("spots", 0.35), ("panels", 0.1)),
            people=0.03,
            radiators=0.3,
        ),
        RoomType(
            "home_office",
            (
                Step(partial(desk, facing_room=0.3)),
                Step(desk, 0.2),
                Step(partial(place_along_walls, roles=("bookcase", "bookcase", "sideboard", "dresser"), number=(1, 3))),
                Step(partial(place_along_walls, roles=("sofa",), depth=1.1), 0.15),
                Step(reading_corner, 0.3),
                Step(partial(place_along_walls, roles=("exercise",), depth=2.0), 0.08),
                *_CORNER_ITEMS,
                Step(partial(fill_walls, roles=("bookcase", "bookcase", "dresser", "sideboard", "armchair")), 0.8),
                _CLUTTER,
                Step(partial(place_rug, probability=0.4)),
            ),
            area_m2=(7.0, 18.0),
            windows=(1, 3),
            p_attic=0.1,
            wall_items=(("picture", 1.6), ("wall_shelf", 1.0), ("clock", 0.4), ("whiteboard", 0.25), ("wall_lamp", 0.2),
                        ("wall_clutter", 0.2)),
        ),
        RoomType(
            "children_room",
            (
                Step(partial(bed, role="child_bed", widest=1.4, rug=0.5)),
                Step(partial(bed, role="child_bed", widest=1.2, rug=0.0), 0.2),
                Step(partial(place_along_walls, roles=("wardrobe", "dresser"), number=(1, 2))),
                Step(partial(desk, seat="chair"), 0.6),
                Step(
                    partial(
                        place_along_walls,
                        roles=("bookcase", "dresser", "side_table"),
                        number=(0, 2),
                        height=(0.0, 1.9),
                    )
                ),
                Step(partial(scatter_on_floor, role="floor_toy", number=2.2, by_walls=0.3)),
                Step(partial(place_rug, probability=0.6)),
                Step(partial(fill_walls, roles=("bookcase", "dresser", "wardrobe", "bench"), share=(0.2, 0.4)), 0.7),
                Step(partial(place_in_corners, role="floor_lamp", number=0.3)),
                _CLUTTER,
                Step(partial(place_in_corners, role="plant", number=0.3)),
            ),
            area_m2=(8.0, 18.0),
            windows=(1, 3),
            p_attic=0.12,
            wall_items=(("picture", 2.2), ("wall_shelf", 0.8), ("clock", 0.2), ("wall_lamp", 0.3),
                        ("wall_clutter", 0.4)),
            clutter=(0.3, 1.0),
        ),
        RoomType(
            "hallway",
            (
                Step(
                    partial(
                        place_along_walls,
                        roles=("sideboard", "dresser", "bench", "bookcase"),
                        number=(1, 2),
                        depth=0.5,
                    )
                ),
                Step(partial(place_along_walls, roles=("wardrobe", "bookcase"), depth=0.65), 0.4),
                Step(partial(place_along_walls, roles=("chair", "stool", "side_table"), number=(0, 1), depth=0.6)),
                Step(partial(place_in_corners, role="plant", number=0.5, widest=0.5)),
                Step(partial(place_in_corners, role="floor_lamp", number=0.2, widest=0.45)),
                Step(partial(scatter_on_floor, role="floor_clutter", number=1.2, by_walls=0.95)),
                Step(partial(place_rug, probability=0.5, narrow=True)),
            ),
            area_m2=(4.5, 16.0),
            aspect=(1.8, 5.0),
            windows=(0, 2),
            doors=(2, 4),
            p_windowless=0.4,
            p_attic=0.0,
            p_second_room=0.7,
            wall_items=(("picture", 1.8), ("mirror", 0.6), ("wall_clutter", 0.5), ("wall_lamp", 0.8), ("clock", 0.2),
                        ("wall_shelf", 0.3)),
            ceiling=(("middle", 0.5), ("spots", 0.3), ("pendants", 0.2)),
            people=0.04,
        ),
        RoomType(
            "studio",
            (
                Step(partial(kitchen, longest=3.2, corner=0.3, island=0.15)),
                Step(partial(bed, widest=1.8)),
                Step(tv_lounge, 0.6, conversation_group),
                Step(partial(dining, seats=(2, 4)), 0.6),
                Step(desk, 0.4),
                Step(partial(place_along_walls, roles=("wardrobe", "bookcase", "sideboard", "dresser"), number=(1, 3))),
                Step(partial(place_along_walls, roles=("exercise",), depth=2.0), 0.06),
                Step(fill_spare_space, 0.6),
                *_CORNER_ITEMS,
                Step(partial(fill_walls, roles=(*_LIVING, "wardrobe"), share=(0.22, 0.38)), 0.8),
                _CLUTTER,
                Step(partial(place_rug, probability=0.25)),
            ),
            area_m2=(20.0, 46.0),
            aspect=(1.0, 2.0),
            height_m=(2.4, 3.6),
            windows=(2, 6),
            p_l_shape=0.35,
            wall_items=(*_HOME_WALLS, ("picture", 1.0)),
            ceiling=(("middle", 0.5), ("spots", 0.3), ("pendants", 0.15), ("none", 0.05)),
        ),
        RoomType(
            "attic_room",
            (
                Step(bed, 0.65, reading_corner),
                Step(desk, 0.5),
                Step(conversation_group, 0.35),
                Step(partial(place_along_walls, roles=("dresser", "bookcase", "sideboard", "wardrobe"), number=(1, 3))),
                Step(reading_corner, 0.4),
                Step(fill_spare_space, 0.5),
                *_CORNER_ITEMS,
                Step(partial(fill_walls, roles=(*_LIVING, "wardrobe", "bench")), 0.8),
                Step(partial(scatter_on_floor, role="floor_clutter", number=1.8, by_walls=0.8)),
                Step(partial(place_rug, probability=0.5)),
            ),
            area_m2=(10.0, 32.0),
            windows=(1, 3),
            p_attic=1.0,
            p_l_shape=0.08,
            wall_items=_HOME_WALLS,
            ceiling=(("middle", 0.5), ("spots", 0.25), ("none", 0.25)),
        ),
        RoomType(
            "open_office",
            (
                Step(desk_islands),
                Step(partial(dining, seats=(4, 8), prefer="middle"), 0.3),
                Step(partial(row_along, role="bookcase", longest=3.0), 0.6),
                Step(conversation_group, 0.2),
                Step(partial(place_along_walls, roles=("sideboard", "dresser", "bookcase"), number=(0, 3))),
                Step(desk, 0.4),
                Step(partial(fill_walls, roles=("bookcase", "sideboard", "dresser", "desk"), share=(0.16, 0.3)), 0.8),
                Step(partial(place_in_corners, role="plant", number=2.2)),
                Step(partial(place_in_corners, role="floor_lamp", number=0.3)),
                Step(partial(scatter_on_floor, role="floor_clutter", number=2.0, by_walls=0.7)),
            ),
            area_m2=(22.0, 80.0),
            aspect=(1.0, 2.2),
            height_m=(2.5, 3.4),
            windows=(3, 8),
            p_windowless=0.05,
            p_attic=0.0,
            p_l_shape=0.1,
            wall_items=(("whiteboard", 1.2), ("picture", 1.5), ("clock", 0.7), ("air_conditioner", 0.5),
                        ("wall_shelf", 0.3)),
            ceiling=(("panels", 0.75), ("pendants", 0.12), ("spots", 0.13)),
            clutter=(0.2, 1.0),
            people=0.08,
            pets=0.0,
            public=True,
        ),
        RoomType(
            "classroom",
            (
                Step(reading_tables, 1.0),
                Step(desk_islands, 0.4),
                Step(partial(desk, facing_room=0.8), 0.8),
                Step(partial(row_along, role="bookcase", longest=3.0), 0.5),
                Step(partial(fill_walls, roles=("bookcase", "sideboard", "dresser", "bench"), share=(0.1, 0.25)), 0.7),
                Step(partial(place_in_corners, role="plant", number=0.8)),
                Step(partial(scatter_on_floor, role="floor_clutter", number=1.0, by_walls=0.7)),
            ),
            area_m2=(35.0, 85.0),
            aspect=(1.0, 1.8),
            height_m=(2.7, 4.0),
            windows=(3, 8),
            p_windowless=0.03,
            p_attic=0.0,
            p_l_shape=0.0,
            p_second_room=0.2,
            wall_items=(("whiteboard", 1.8), ("picture", 1.5), ("clock", 0.7), ("wall_shelf", 0.2)),
            ceiling=(("panels", 0.7), ("pendants", 0.2), ("none", 0.1)),
            clutter=(0.1, 0.8),
            people=0.08,
            pets=0.0,
            public=True,
        ),
        RoomType(
            "hall",
            (
                Step(reading_tables, 0.3),
                Step(conversation_group, 0.5),
                Step(partial(dining, seats=(4, 8), prefer="middle"), 0.35),
                Step(benches, 0.7),
                Step(partial(row_along, role="bookcase", longest=4.0), 0.3),
                Step(partial(place_along_walls, roles=("piano", "fireplace")), 0.2),
                Step(partial(place_along_walls, roles=("sideboard", "bench", "chair", "dresser"), number=(1, 4))),
                Step(partial(place_in_corners, role="plant", number=1.5)),
                Step(partial(place_in_corners, role="floor_lamp", number=1.2)),
                Step(partial(scatter_on_floor, role="floor_clutter", number=1.5, by_walls=0.6)),
            ),
            area_m2=(50.0, 130.0),
            aspect=(1.0, 2.4),
            height_m=(3.2, 6.0),
            windows=(2, 9),
            p_windowless=0.08,
            p_attic=0.1,
            p_l_shape=0.1,
            p_second_room=0.4,
            wall_items=(("picture", 2.0), ("wall_lamp", 1.5), ("clock", 0.3), ("mirror", 0.2)),
            ceiling=(("pendants", 0.4), ("panels", 0.25), ("spots", 0.15), ("none", 0.2)),
            clutter=(0.0, 0.6),
            people=0.1,
            pets=0.0,
            public=True,
        ),
        RoomType(
            "library",
            (
                Step(partial(row_along, role="bookcase", longest=8.0)),
                Step(partial(row_along, role="bookcase", longest=5.0), 0.8),
                Step(reading_tables, 0.75),
                Step(double_rows, 0.55),
                Step(reading_corner, 0.7),
                Step(conversation_group, 0.25),
                Step(partial(row_along, role="bookcase", longest=3.0), 0.6),
                Step(desk, 0.3),
                Step(fill_spare_space, 0.7),
                *_CORNER_ITEMS,
                Step(
                    partial(fill_walls, roles=("bookcase", "bookcase", "armchair", "sideboard"), share=(0.2, 0.36)),
                    0.8,
                ),
                Step(partial(place_rug, probability=0.5)),
            ),
            split="test",
            area_m2=(16.0, 60.0),
            height_m=(2.5, 3.8),
            windows=(1, 5),
            p_attic=0.04,
            wall_items=(("picture", 1.5), ("clock", 0.5), ("wall_lamp", 0.8)),
            ceiling=(("middle", 0.3), ("pendants", 0.4), ("panels", 0.3)),
            public=True,
        ),
        RoomType(
            "cafe",
            (
                Step(partial(kitchen, longest=3.6, corner=0.25, island=0.7)),
                Step(cafe_tables),
                Step(partial(place_along_walls, roles=("sideboard", "fridge", "bookcase"), number=(0, 2))),
                Step(benches, 0.5),
                Step(conversation_group, 0.35),
                Step(partial(place_in_corners, role="plant", number=2.0)),
                Step(partial(place_in_corners, role="floor_lamp", number=0.5)),
                Step(partial(scatter_on_floor, role="stool", number=0.7, by_walls=0.6)),
            ),
            split="test",
            area_m2=(20.0, 70.0),
            aspect=(1.0, 2.0),
            height_m=(2.6, 4.0),
            windows=(1, 5),
            p_attic=0.0,
            p_l_shape=0.2,
            wall_items=(("picture", 3.0), ("mirror", 0.4), ("clock", 0.4), ("wall_lamp", 1.5), ("wall_shelf", 0.8),
                        ("wall_clutter", 0.5)),
            ceiling=(("pendants", 0.45), ("spots", 0.35), ("middle", 0.2)),
            clutter=(0.3, 1.0),
            people=0.15,
            pets=0.01,
            radiators=0.3,
            public=True,
        ),
    ]  # fmt: skip


ROOM_TYPES: Final[dict[str, RoomType]] = {room_type.name: room_type for room_type in _types()}
"""Room types by name."""
