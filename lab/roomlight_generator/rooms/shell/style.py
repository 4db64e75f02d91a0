"""Parameters of a shell: size ranges, probabilities of features, counts and weights of windows and doors."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

Range = tuple[float, float]

WindowKind = Literal["casement", "sash", "picture", "french", "office", "bathroom"]
CoverKind = Literal[
    "none",
    "open_curtains",
    "half_curtains",
    "drawn_curtains",
    "sheer",
    "sheer_and_curtains",
    "roller",
    "roller_down",
    "venetian",
    "vertical",
]
"""Kinds of window coverings. drawn_curtains, sheer, sheer_and_curtains and roller_down cover the whole window: it
has no `Opening`, and (except for drawn_curtains) cloth with a material named "daylit-..." emits the daylight."""

LowerKind = Literal["none", "tiles", "wainscot", "backsplash"]

_WINDOW_KINDS: Final[tuple[tuple[WindowKind, float], ...]] = (
    ("casement", 0.35),
    ("sash", 0.15),
    ("picture", 0.25),
    ("french", 0.25),
)
_COVERS: Final[tuple[tuple[CoverKind, float], ...]] = (
    ("none", 0.54),
    ("open_curtains", 0.22),
    ("half_curtains", 0.04),
    ("drawn_curtains", 0.02),
    ("sheer", 0.04),
    ("sheer_and_curtains", 0.03),
    ("roller", 0.05),
    ("roller_down", 0.02),
    ("venetian", 0.04),
)


@dataclass(frozen=True)
class ShellStyle:
    """Parameters of a shell. Ranges are (least, most), probabilities 0 to 1, weights any positive numbers.

    A room gets at most one second room. A room with no door of any kind gets a closed door.

    Attributes:
        area_m2: Floor area of the main room.
        aspect: Long over short side of the main rectangle.
        slanted, two_slopes, skylights: Probability of slopes, of slopes on two sides, of windows in them (never if
            windows are (0, 0)).
        windows, doors: Counts, both ends included; doors are closed. Fewer are built if no wall has space for them.
        open_door, passage: Probability of a second room behind an open door; else behind a doorway without a door.
        second_window: Probability of a wide window in the second room.
        accent_wall: Probability of an accent wall, if the finishes have its material.
        lower_wall: Kind of finish of the walls' lower part: tiles or wainscot all round up to lower_wall_m, or a
            backsplash as a band on the wall with the most space for units.
        lower_wall_chance: Probability of that finish.
    """

    area_m2: Range = (12.0, 30.0)
    aspect: Range = (1.0, 1.7)
    height_m: Range = (2.4, 2.9)
    least_width_m: float = 1.1
    l_shape: float = 0.15
    alcove: float = 0.12
    bay: float = 0.06
    chamfer: float = 0.05
    chimney_breast: float = 0.08
    niche: float = 0.1
    slanted: float = 0.06
    two_slopes: float = 0.45
    skylights: float = 0.75
    beams: float = 0.08
    windows: tuple[int, int] = (1, 3)
    window_kinds: tuple[tuple[WindowKind, float], ...] = _WINDOW_KINDS
    covers: tuple[tuple[CoverKind, float], ...] = _COVERS
    doors: tuple[int, int] = (0, 2)
    open_door: float = 0.3
    passage: float = 0.12
    second_window: float = 0.15
    wall_m: Range = (0.1, 0.35)
    skirting: float = 0.9
    crown_moulding: float = 0.25
    accent_wall: float = 1.0
    lower_wall: LowerKind = "wainscot"
    lower_wall_chance: float = 0.1
    lower_wall_m: Range = (0.85, 1.2)

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a range is reversed or negative, or the room is too low, too small or has an aspect below 1.
        """
        for name in ("area_m2", "aspect", "height_m", "windows", "doors", "wall_m", "lower_wall_m"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise ValueError(f"{name} is {(low, high)}: give (least, most), both at least 0")
        if self.height_m[0] < 2.1 or self.area_m2[0] < 1.5 or self.aspect[0] < 1:
            raise ValueError(
                "a room needs at least 2.1 m of height, 1.5 m2 of floor and an aspect (long over short) of 1"
            )


STYLES: Final[dict[str, ShellStyle]] = {
    "living_room": ShellStyle(
        area_m2=(14.0, 42.0), height_m=(2.4, 3.4), windows=(1, 4), l_shape=0.22, bay=0.1, chimney_breast=0.15,
        crown_moulding=0.35, passage=0.2,
    ),
    "bedroom": ShellStyle(area_m2=(9.0, 24.0), height_m=(2.3, 3.1), windows=(1, 2), slanted=0.15, chimney_breast=0.06),
    "children_room": ShellStyle(area_m2=(8.0, 18.0), height_m=(2.3, 2.9), windows=(1, 2), slanted=0.2),
    "kitchen": ShellStyle(
        area_m2=(7.0, 22.0), height_m=(2.3, 3.0), windows=(1, 2), lower_wall="backsplash", lower_wall_chance=0.75,
        lower_wall_m=(1.35, 1.55), chimney_breast=0.03, bay=0.02, passage=0.25,
        covers=(("none", 0.5), ("roller", 0.2), ("venetian", 0.15), ("open_curtains", 0.15)),
    ),
    "dining_room": ShellStyle(area_m2=(10.0, 28.0), height_m=(2.4, 3.4), bay=0.1, lower_wall_chance=0.25, passage=0.25),
    "bathroom": ShellStyle(
        area_m2=(3.2, 11.0), aspect=(1.0, 2.0), height_m=(2.2, 2.8), windows=(0, 1), l_shape=0.08, alcove=0.12, bay=0.0,
        chimney_breast=0.0, slanted=0.1, beams=0.02, crown_moulding=0.05, skirting=0.0, passage=0.0, lower_wall="tiles",
        lower_wall_chance=0.85, lower_wall_m=(1.2, 2.1), window_kinds=(("bathroom", 0.7), ("casement", 0.3)),
        covers=(("none", 0.6), ("roller_down", 0.15), ("venetian", 0.15), ("roller", 0.1)),
    ),
    "home_office": ShellStyle(area_m2=(7.0, 18.0), height_m=(2.3, 3.0), windows=(1, 2), slanted=0.12),
    "open_office": ShellStyle(
        area_m2=(14.0, 60.0), aspect=(1.0, 2.2), height_m=(2.5, 3.2), windows=(2, 7), slanted=0.0, beams=0.03,
        chimney_breast=0.0, alcove=0.05, bay=0.0, crown_moulding=0.0, lower_wall="none", passage=0.15,
        window_kinds=(("office", 0.85), ("picture", 0.15)),
        covers=(("none", 0.4), ("venetian", 0.25), ("vertical", 0.15), ("roller", 0.15), ("roller_down", 0.05)),
    ),
    "hallway": ShellStyle(
        area_m2=(4.5, 15.0), aspect=(2.6, 6.0), height_m=(2.3, 3.2), least_width_m=1.15, l_shape=0.0, bay=0.0,
        alcove=0.2, chimney_breast=0.0, slanted=0.0, beams=0.04, windows=(0, 1), doors=(1, 4), open_door=0.5,
        passage=0.3,
    ),
    "attic_room": ShellStyle(
        area_m2=(10.0, 32.0), height_m=(2.3, 3.2), slanted=1.0, skylights=0.85, beams=0.35, windows=(0, 2),
        l_shape=0.08, alcove=0.0, bay=0.0, crown_moulding=0.0,
    ),
    "studio": ShellStyle(
        area_m2=(20.0, 55.0), aspect=(1.0, 2.2), height_m=(2.5, 3.6), windows=(2, 5), l_shape=0.35, beams=0.15,
        passage=0.2, window_kinds=(("picture", 0.35), ("french", 0.25), ("office", 0.2), ("casement", 0.2)),
    ),
    "classroom": ShellStyle(
        area_m2=(35.0, 85.0), aspect=(1.0, 1.8), height_m=(2.7, 4.0), windows=(3, 8), l_shape=0.0, alcove=0.03, bay=0.0,
        chamfer=0.0, chimney_breast=0.0, slanted=0.0, beams=0.08, crown_moulding=0.0, lower_wall_chance=0.1,
        passage=0.05, window_kinds=(("office", 0.7), ("casement", 0.15), ("sash", 0.15)),
        covers=(("none", 0.65), ("venetian", 0.12), ("vertical", 0.05), ("roller", 0.15), ("roller_down", 0.03)),
    ),
    "hall": ShellStyle(
        area_m2=(50.0, 130.0), aspect=(1.0, 2.4), height_m=(3.2, 6.0), windows=(2, 9), l_shape=0.1, alcove=0.08,
        bay=0.03, chimney_breast=0.03, slanted=0.1, beams=0.25, crown_moulding=0.2, lower_wall_chance=0.2, passage=0.3,
        window_kinds=(("picture", 0.35), ("office", 0.35), ("french", 0.2), ("sash", 0.1)),
        covers=(("none", 0.85), ("open_curtains", 0.1), ("roller", 0.05)),
    ),
    "library": ShellStyle(
        area_m2=(18.0, 60.0), aspect=(1.0, 2.0), height_m=(2.7, 3.6), windows=(1, 5), beams=0.12, crown_moulding=0.35,
        chimney_breast=0.1, lower_wall_chance=0.15, passage=0.2,
    ),
    "cafe": ShellStyle(
        area_m2=(18.0, 70.0), aspect=(1.0, 2.2), height_m=(2.6, 3.6), windows=(1, 5), l_shape=0.25, beams=0.2,
        passage=0.3,
        lower_wall_chance=0.35, lower_wall_m=(0.9, 1.5),
        window_kinds=(("picture", 0.5), ("casement", 0.2), ("sash", 0.1), ("french", 0.2)),
        covers=(("none", 0.6), ("open_curtains", 0.15), ("venetian", 0.1), ("roller", 0.15)),
    ),
}  # fmt: skip
"""Default shells by the planner's room types; use one as it is or change it with `dataclasses.replace`."""


def uniform(rng: np.random.Generator, span: Range) -> float:
    """Return a uniform random number from a range."""
    return float(rng.uniform(span[0], span[1]))
