"""Holes in a wall: windows, doors, passages, niches; their sizes and designs, without geometry.

Rectangles are (s0, s1, h0, h1) in the plane of the side (or slope) they are in: the hole in the wall itself.
"""

from dataclasses import dataclass
from typing import Final, Literal

from roomlight_generator.rooms.plan import Gap
from roomlight_generator.rooms.shell.polygons import Rect
from roomlight_generator.rooms.shell.style import CoverKind, WindowKind

FULL_COVERS: Final[tuple[CoverKind, ...]] = ("drawn_curtains", "sheer", "sheer_and_curtains", "roller_down")
CURTAINS: Final[tuple[CoverKind, ...]] = (
    "open_curtains",
    "half_curtains",
    "drawn_curtains",
    "sheer",
    "sheer_and_curtains",
)


@dataclass(frozen=True)
class Cover:
    """A window covering: curtains or a blind.

    Attributes:
        spread_m: How far curtains reach beyond the hole at each side.
        lift_m: How far their rod is above the hole.
        bottom_m: Height of their hem.
        share: Covered share of the width (half curtains) or of the height (blinds).
        tilt_degrees: Angle of slats, 0 level.
        pitch_m: Spacing of slats, or width of a fold.
    """

    kind: CoverKind
    spread_m: float = 0.0
    lift_m: float = 0.0
    bottom_m: float = 0.0
    share: float = 1.0
    tilt_degrees: float = 0.0
    pitch_m: float = 0.05
    translucent: bool = False

    @property
    def full(self) -> bool:
        """Whether the whole window is covered."""
        return self.kind in FULL_COVERS

    @property
    def curtains(self) -> bool:
        """Whether it hangs in front of the wall, not in the reveal."""
        return self.kind in CURTAINS


@dataclass(frozen=True)
class WindowDesign:
    """A window's design: sashes side by side, glazing bars in each sash (rows, columns), bar sizes, and depth in the
    wall.

    Attributes:
        inset: Share of the wall's thickness in front of the frame.
        sill_m: How far the sill protrudes (0: none).
    """

    kind: WindowKind
    columns: int
    bars: tuple[int, int]
    frame_m: float
    thickness_m: float
    inset: float
    sill_m: float
    transom: float = 0.0


@dataclass(frozen=True)
class Hole:
    """A rectangular hole in a side, `depth_m` through (or into) the wall."""

    side: int
    rect: Rect
    depth_m: float


@dataclass(frozen=True)
class Window(Hole):
    """A window to the outdoors; in a slope, `side` is an index of slopes."""

    design: WindowDesign
    cover: Cover
    in_slope: bool = False

    def gaps(self) -> list[Gap]:
        """Return the gap in its wall. Curtains that are open at the sides also cover the wall to the right and left
        of it."""
        s0, s1, h0, h1 = self.rect
        cover = self.cover
        clear = 0.5 if h0 < 0.2 else 0.0
        if not cover.curtains:
            sill = h0 - 0.04 if self.design.sill_m else h0 - 0.01
            return [Gap("window", s0 - 0.02, s1 + 0.02, max(sill, 0.0), h1 + 0.02, clear, cover.kind != "none")]
        low, top = cover.bottom_m if cover.bottom_m > 0.1 else 0.0, h1 + cover.lift_m + 0.03
        depth = 0.18 if low == 0 else 0.0
        wide0, wide1 = s0 - cover.spread_m, s1 + cover.spread_m
        if cover.kind != "open_curtains":
            return [Gap("window", wide0, wide1, min(low, h0), top, max(clear, depth), covered=True)]
        return [
            Gap("window", wide0, s0, low, top, depth, covered=True),
            Gap("window", s0, s1, max(h0 - 0.04, 0.0), top, clear),
            Gap("window", s1, wide1, low, top, depth, covered=True),
        ]


@dataclass(frozen=True)
class DoorDesign:
    """A door's design.

    Attributes:
        hinge_right: As seen from the main room.
        open_degrees: 0 is closed.
        swings_in: Into the main room.
    """

    leaf: Literal["flush", "panels"]
    panels: tuple[int, int] = (1, 1)
    leaves: int = 1
    hinge_right: bool = False
    open_degrees: float = 0.0
    swings_in: bool = True
    architrave_m: float = 0.07


@dataclass(frozen=True)
class Door(Hole):
    """A door. Closed, its hole is a blind recess; open, it leads to the second room."""

    design: DoorDesign
    to_second_room: bool = False
    keep_clear_m: float = 0.8

    def gaps(self) -> list[Gap]:
        """Return the doorway with its architrave."""
        s0, s1, _, h1 = self.rect
        edge = self.design.architrave_m
        return [Gap("door", s0 - edge, s1 + edge, 0.0, h1 + edge, self.keep_clear_m)]


@dataclass(frozen=True)
class Passage(Hole):
    """A doorway without a door, arched by `arch_m` at its top, lined with boards or plain."""

    arch_m: float
    lined: bool
    keep_clear_m: float = 0.8

    def gaps(self) -> list[Gap]:
        """Return the doorway."""
        s0, s1, _, h1 = self.rect
        edge = 0.07 if self.lined else 0.0
        return [Gap("passage", s0 - edge, s1 + edge, 0.0, h1 + edge, self.keep_clear_m)]


@dataclass(frozen=True)
class Niche(Hole):
    """A recess with shelves at the given heights."""

    shelves_m: tuple[float, ...]

    def gaps(self) -> list[Gap]:
        """Return the recess."""
        s0, s1, h0, h1 = self.rect
        return [Gap("niche", s0, s1, h0, h1)]


AnyHole = Window | Door | Passage | Niche


def leads_to_second_room(hole: AnyHole) -> bool:
    """Return whether the hole is a way to the second room."""
    return isinstance(hole, Passage) or (isinstance(hole, Door) and hole.to_second_room)


def edge_m(hole: AnyHole) -> tuple[float, float]:
    """Return where along the side its gaps begin and end."""
    gaps = hole.gaps()
    return min(gap.start_m for gap in gaps), max(gap.end_m for gap in gaps)
