"""Parameters of a shell: size ranges, probabilities of features, counts and weights of windows and doors."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from roomlight_generator.rooms.tables import read_table

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
        aspect: Long over short side of the main rectangle.
        slanted, two_slopes, skylights: Probability of slopes, of slopes on two sides, of windows in them (never if
            windows are (0, 0)).
        windows, doors: Counts, both ends included; doors are closed. Fewer are built if no wall has space for them.
        open_door, passage: Probability of a second room behind an open door; else behind a doorway without a door.
        second_window: Probability of a wide window in the second room.
        accent_wall: Probability of an accent wall, if the finishes have its material.
        lower_wall: Kind of finish of the walls' lower part: tiles or wainscot all round up to lower_wall_m, or a
            backsplash as a band on the wall with the most space for units.
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
    name: ShellStyle(**table) for name, table in read_table(Path(__file__).with_name("styles.toml")).items()
}
"""Default shells by the planner's room types; change a copy with `dataclasses.replace`."""


def uniform(rng: np.random.Generator, span: Range) -> float:
    """Return a uniform random number from a range."""
    return float(rng.uniform(span[0], span[1]))
