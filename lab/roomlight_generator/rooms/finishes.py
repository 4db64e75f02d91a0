"""Materials of a room's surfaces: flat colours with or without a coat.

About 64 % of the walls are white, grey or beige, the rest clearly coloured.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roomlight_generator.rooms.colour import paint
from roomlight_generator.rooms.palettes import (
    cloth_colour,
    dark_wall,
    glaze,
    grey,
    neutral_wall,
    off_white,
    pale_cloth,
    stone_colour,
    wall_colour,
    white,
    wood_colour,
)
from roomlight_generator.rooms.scene import Material, Rgb


@dataclass(frozen=True, eq=False)
class RoomFinishes:
    """The large surfaces of one room.

    Attributes:
        accent_wall: Finish of a single wall; the shell chooses the longest wall without a window. None: all walls are
            alike.
        lower_wall: Finish of the lower part of walls where the shell's style has one (bathroom tiles, a kitchen's
            backsplash, wainscot). None: walls have no separate lower part.
    """

    wall: Material
    floor: Material
    ceiling: Material
    skirting: Material
    accent_wall: Material | None = None
    lower_wall: Material | None = None


@dataclass(frozen=True, eq=False)
class Finishes:
    """All materials that `build_shell` applies.

    Attributes:
        second: The room or corridor visible through an open door or a passage.
        frame: Window frames, sills and mullions.
        door, door_frame: Leaves; their linings and architraves.
        handle: Door and window handles and curtain rods (metal).
        moulding: Crown mouldings and picture rails.
        curtain, blind: Opaque cloth and slats, open at the sides or drawn.
        sheer, translucent_blind: Cloth that covers a window and glows by day. The shell applies it under the names
            "daylit-curtain" and "daylit-blind", with a material object for each window, so that the lighting can set
            the emission of each window.
    """

    room: RoomFinishes
    second: RoomFinishes
    frame: Material
    door: Material
    door_frame: Material
    handle: Material
    moulding: Material
    beam: Material
    curtain: Material
    blind: Material
    sheer: Material
    translucent_blind: Material


_FLOOR_SHADE: Final = (0.53, 0.9)
_WALL_SHADE: Final = (0.82, 1.0)
_CEILING_SHADE: Final = (0.64, 0.96)
"""Range of the factor on a reflectance: surfaces are worn, dusty or oiled darker than new samples of them.

In 38 real panoramas ceilings have 0.68 of the walls' radiance in the median (quartiles 0.36 and 1.6) and floors 0.30
(0.19 and 0.49), lamps and windows included."""

_FLOORS: Final[dict[str, tuple[float, float, float, float]]] = {
    # Probabilities of wood, tile, carpet, stone.
    "living": (0.62, 0.12, 0.14, 0.12),
    "bed": (0.58, 0.05, 0.32, 0.05),
    "kitchen": (0.33, 0.5, 0.0, 0.17),
    "bath": (0.06, 0.74, 0.0, 0.2),
    "work": (0.34, 0.08, 0.42, 0.16),
    "utility": (0.1, 0.3, 0.05, 0.55),
}
_FLOOR_COATS: Final = ((0.6, 0.1, 0.35), (0.75, 0.08, 0.32), (0.0, 0.1, 0.1), (0.6, 0.08, 0.35))
"""Probability of a coat on each kind of floor, and the range of its roughness."""

_KINDS: Final = (
    ("bath", ("bath", "shower", "toilet", "wc", "spa")),
    ("kitchen", ("kitchen", "cafe", "restaurant", "bar", "canteen")),
    ("bed", ("bed", "child", "kid", "nursery", "guest")),
    ("work", ("office", "study", "class", "meeting", "conference", "library", "shop", "waiting")),
    ("utility", ("laundry", "garage", "gym", "workshop", "utility", "basement", "cellar", "storage", "fitness")),
)


def room_kind(room_type: str) -> str:
    """Return the kind of finishes of a room type: bath, kitchen, bed, work, utility or living (any other)."""
    name = room_type.lower()
    return next((kind for kind, words in _KINDS if any(word in name for word in words)), "living")


def shell_finishes(room_type: str, rng: np.random.Generator) -> Finishes:
    """Choose materials for a whole shell."""
    chooser = _FinishChooser(rng)
    room = chooser.room(room_kind(room_type))
    second = chooser.room("living")
    if rng.random() < 0.5:
        second = replace(second, floor=room.floor)
    if rng.random() < 0.4:
        second = replace(second, wall=room.wall, ceiling=room.ceiling, skirting=room.skirting)
    joinery = chooser.joinery()
    door = joinery if rng.random() < 0.5 else chooser.joinery()
    return Finishes(
        room=room,
        second=second,
        frame=joinery,
        door=replace(door, name="door"),
        door_frame=replace(joinery if rng.random() < 0.6 else door, name="door_frame"),
        handle=chooser.metal(),
        moulding=Material("moulding", white(rng)),
        beam=Material("beam", white(rng) if rng.random() < 0.25 else wood_colour(rng)),
        curtain=Material("curtain", pale_cloth(rng) if rng.random() < 0.2 else cloth_colour(rng)),
        blind=chooser.blind(),
        sheer=Material("sheer", paint(rng.uniform(0.6, 0.82), rng.uniform(0, 0.025), rng.uniform(60, 110))),
        translucent_blind=Material("translucent_blind", pale_cloth(rng)),
    )


@dataclass(frozen=True)
class _FinishChooser:
    rng: np.random.Generator

    def room(self, kind: str) -> RoomFinishes:
        rng = self.rng
        wall = self.wall(kind)
        accent = self.accent() if rng.random() < 0.18 else None
        pick = rng.random()
        if pick < 0.62:
            skirting = Material("skirting", white(rng), roughness=self.optional_roughness(0.5, 0.2, 0.45))
        elif pick < 0.8 and kind not in ("bath", "kitchen"):
            skirting = Material("skirting", wood_colour(rng), roughness=self.optional_roughness(0.55, 0.12, 0.4))
        elif pick < 0.92:
            skirting = Material("skirting", wall.albedo, roughness=wall.roughness)
        else:
            dark = paint(rng.uniform(0.03, 0.2), 0.01, 250)
            skirting = Material("skirting", dark, roughness=self.optional_roughness(0.5, 0.2, 0.4))
        return RoomFinishes(wall, self.floor(kind), self.ceiling(wall), skirting, accent, self.lower_wall(kind))

    def shaded(self, colour: Rgb, shades: tuple[float, float]) -> Rgb:
        shade = float(self.rng.uniform(*shades))
        return (shade * colour[0], shade * colour[1], shade * colour[2])

    def optional_roughness(self, chance: float, low: float, high: float) -> float | None:
        return float(self.rng.uniform(low, high)) if self.rng.random() < chance else None

    def wall(self, kind: str) -> Material:
        """Choose the finish of most of the walls: mostly matt paint."""
        rng = self.rng
        if kind == "bath" and rng.random() < 0.3:
            return self.glazed("wall")
        if rng.random() < 0.64:
            colour = self.shaded(neutral_wall(rng), _WALL_SHADE)
            return Material("wall", colour, roughness=self.optional_roughness(0.14, 0.4, 0.6))
        return self.coloured("wall")

    def coloured(self, name: str) -> Material:
        colour = self.shaded(wall_colour(self.rng), _WALL_SHADE)
        return Material(name, colour, roughness=self.optional_roughness(0.14, 0.4, 0.6))

    def accent(self) -> Material:
        """Choose the finish of a contrasting accent wall."""
        return Material("accent_wall", dark_wall(self.rng)) if self.rng.random() < 0.2 else self.coloured("accent_wall")

    def lower_wall(self, kind: str) -> Material | None:
        """Choose tiles for wet rooms; elsewhere sometimes wainscot or a second paint."""
        rng = self.rng
        if kind in ("bath", "kitchen"):
            return self.glazed("lower_wall")
        if rng.random() > 0.35:
            return None
        kinds = (white, wall_colour, wood_colour)
        colour = kinds[int(rng.choice(3, p=(0.55, 0.2, 0.25)))](rng)
        return Material("lower_wall", colour, roughness=self.optional_roughness(0.6, 0.2, 0.45))

    def glazed(self, name: str) -> Material:
        """Choose the colour of wall tiles, mostly glazed."""
        return Material(name, glaze(self.rng), roughness=self.optional_roughness(0.85, 0.08, 0.3))

    def floor(self, kind: str) -> Material:
        rng = self.rng
        covering = int(rng.choice(4, p=_FLOORS[kind]))
        colour = self.shaded((wood_colour, stone_colour, cloth_colour, stone_colour)[covering](rng), _FLOOR_SHADE)
        return Material("floor", colour, roughness=self.optional_roughness(*_FLOOR_COATS[covering]))

    def ceiling(self, wall: Material) -> Material:
        """Choose the ceiling: white paint in four rooms of ten, otherwise the walls' paint, grey, boards, a colour."""
        if self.rng.random() < 0.15:
            return Material("ceiling", self.shaded(wall.albedo, _CEILING_SHADE))
        kinds = (white, grey, wood_colour, off_white, dark_wall)
        colour = kinds[int(self.rng.choice(5, p=(0.47, 0.24, 0.14, 0.06, 0.09)))](self.rng)
        return Material("ceiling", self.shaded(colour, _CEILING_SHADE))

    def joinery(self) -> Material:
        """Choose the finish of frames and doors: white, wood, anthracite or a colour."""
        rng = self.rng
        pick = rng.random()
        coat = self.optional_roughness(0.6, 0.12, 0.4)
        if pick < 0.52:
            return Material("frame", white(rng), roughness=coat)
        if pick < 0.8:
            return Material("frame", wood_colour(rng), roughness=coat)
        if pick < 0.9:
            return Material("frame", paint(rng.uniform(0.025, 0.08), 0.008, 250), roughness=coat)
        return Material("frame", grey(rng) if pick < 0.95 else wall_colour(rng), roughness=coat)

    def metal(self) -> Material:
        """Choose the metal of handles and rods: glossily coated grey or brass, as the renderer has no conductors."""
        rng = self.rng
        pick = rng.random()
        if pick < 0.6:
            colour = paint(rng.uniform(0.25, 0.55), 0.005, 240)
        elif pick < 0.8:
            colour = paint(rng.uniform(0.2, 0.4), rng.uniform(0.06, 0.1), 85)
        else:
            colour = paint(rng.uniform(0.02, 0.05), 0.0, 0)
        return Material("handle", colour, roughness=float(rng.uniform(0.08, 0.25)))

    def blind(self) -> Material:
        """Choose the finish of slats and roller blinds: mostly pale, some wood, some dark."""
        rng = self.rng
        pick = rng.random()
        if pick < 0.55:
            return Material("blind", pale_cloth(rng), roughness=self.optional_roughness(0.3, 0.25, 0.5))
        if pick < 0.7:
            return Material("blind", wood_colour(rng), roughness=self.optional_roughness(0.55, 0.12, 0.4))
        return Material("blind", cloth_colour(rng) if pick < 0.9 else dark_wall(rng))
