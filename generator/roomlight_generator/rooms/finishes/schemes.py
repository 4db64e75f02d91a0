"""Colour schemes: materials of the walls, floor, ceiling, frames, doors and curtains of one room.

About 64 % of the walls are white, grey or beige, 23 % clearly coloured and 13 % papered, of brick or panelled.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roomlight.conventions import srgb8_to_linear
from roomlight.dataset.recording import Split
from roomlight_generator.rooms.colour import luminance, paint
from roomlight_generator.rooms.finishes import cloth, stone, wood
from roomlight_generator.rooms.finishes.noise import split_rng
from roomlight_generator.rooms.finishes.palettes import (
    beige,
    cloth_colour,
    dark_wall,
    grey,
    neutral_wall,
    off_white,
    wall_colour,
    white,
)
from roomlight_generator.rooms.finishes.patterns import TextureGroup, fabric_texture, make_texture
from roomlight_generator.rooms.scene import Material, Rgb, Texture
from roomlight_generator.rooms.shell_finishes import Finishes, RoomFinishes

_PLAIN: Final[Rgb] = (0.95, 0.95, 0.95)
"""Albedo of textures that hold the whole colour."""

_FLOOR_SHADE: Final = (0.65, 0.95)
"""Range of the factor on a floor's texture: floors are worn, stained or oiled darker than new samples of them.

Floors of 38 real panoramas have 0.30 of the walls' radiance in the median (quartiles 0.19 and 0.49), lamps and windows
included."""

_FLOORS: Final[dict[str, tuple[float, float, float, float]]] = {
    # Probabilities of wood, tile, carpet, stone.
    "living": (0.62, 0.12, 0.14, 0.12),
    "bed": (0.58, 0.05, 0.32, 0.05),
    "kitchen": (0.33, 0.5, 0.0, 0.17),
    "bath": (0.06, 0.74, 0.0, 0.2),
    "work": (0.34, 0.08, 0.42, 0.16),
    "utility": (0.1, 0.3, 0.05, 0.55),
}

_KINDS: Final = (
    ("bath", ("bath", "shower", "toilet", "wc", "spa")),
    ("kitchen", ("kitchen", "cafe", "restaurant", "bar", "canteen")),
    ("bed", ("bed", "child", "kid", "nursery", "guest")),
    ("work", ("office", "study", "class", "meeting", "conference", "library", "shop", "waiting")),
    (
        "utility",
        ("laundry", "garage", "gym", "workshop", "utility", "basement", "cellar", "storage", "fitness"),
    ),
)


def room_kind(room_type: str) -> str:
    """Return the kind of finishes of a room type: bath, kitchen, bed, work, utility or living (any other)."""
    name = room_type.lower()
    return next((kind for kind, words in _KINDS if any(word in name for word in words)), "living")


def shell_finishes(
    room_type: str,
    split: Split,
    rng: np.random.Generator,
    *,
    wall_textures: Sequence[Texture] = (),
    floor_textures: Sequence[Texture] = (),
) -> Finishes:
    """Choose materials for a whole shell. The extra textures, if given, replace procedural ones in 35 % of floors
    and of textured walls."""
    chooser = _FinishChooser(split, split_rng(split, rng), tuple(wall_textures), tuple(floor_textures))
    own_rng = chooser.rng
    room = chooser.room(room_kind(room_type))
    second = chooser.room("living")
    if own_rng.random() < 0.5:
        second = replace(second, floor=room.floor)
    if own_rng.random() < 0.4:
        second = replace(second, wall=room.wall, ceiling=room.ceiling, skirting=room.skirting)
    joinery = chooser.joinery()
    door = joinery if own_rng.random() < 0.5 else chooser.joinery()
    return Finishes(
        room=room,
        second=second,
        frame=joinery,
        door=replace(door, name="door"),
        door_frame=replace(joinery if own_rng.random() < 0.6 else door, name="door_frame"),
        handle=chooser.metal(),
        moulding=replace(room.ceiling, name="moulding", texture=None, albedo=white(own_rng)),
        beam=chooser.beam(),
        curtain=chooser.curtain(),
        blind=chooser.blind(),
        sheer=Material("sheer", paint(own_rng.uniform(0.6, 0.82), own_rng.uniform(0, 0.025), own_rng.uniform(60, 110))),
        translucent_blind=Material("translucent_blind", chooser.pale_cloth()),
    )


@dataclass(frozen=True)
class _FinishChooser:
    split: Split
    rng: np.random.Generator
    wall_textures: tuple[Texture, ...]
    floor_textures: tuple[Texture, ...]

    def room(self, kind: str) -> RoomFinishes:
        """Choose the large surfaces of one room."""
        rng = self.rng
        wall = self.wall(kind)
        accent = self.accent(wall) if rng.random() < 0.18 else None
        floor = self.floor(kind)
        ceiling = self.ceiling(wall)
        pick = rng.random()
        if pick < 0.62:
            skirting = Material("skirting", white(rng), roughness=self.optional_roughness(0.5, 0.2, 0.45))
        elif pick < 0.8 and kind not in ("bath", "kitchen"):
            skirting = self.wooden("skirting")
        elif pick < 0.92:
            skirting = replace(wall, name="skirting", texture=None, albedo=_mean(wall))
        else:
            skirting = Material(
                "skirting", paint(rng.uniform(0.03, 0.2), 0.01, 250), roughness=self.optional_roughness(0.5, 0.2, 0.4)
            )
        return RoomFinishes(wall, floor, ceiling, skirting, accent, self.lower_wall(kind, wall))

    def optional_roughness(self, chance: float, low: float, high: float) -> float | None:
        """Return a coat's roughness with the given probability, else None."""
        return float(self.rng.uniform(low, high)) if self.rng.random() < chance else None

    def painted(self, name: str, colour: Rgb) -> Material:
        """Choose wall paint: mostly matt; half of it shows the relief of roller or float, some is limewash."""
        rng = self.rng
        roughness = self.optional_roughness(0.14, 0.4, 0.6)
        pick = rng.random()
        if pick < 0.06:
            return Material(name, _PLAIN, texture=stone.limewash(rng, colour))
        if pick < 0.5:
            lighter = (min(colour[0] / 0.95, 0.95), min(colour[1] / 0.95, 0.95), min(colour[2] / 0.95, 0.95))
            return Material(name, lighter, texture=stone.plaster(rng), roughness=roughness)
        return Material(name, colour, roughness=roughness)

    def wall(self, kind: str) -> Material:
        """Choose the finish of most of the walls."""
        rng = self.rng
        pick = rng.random()
        if kind == "bath" and rng.random() < 0.3:
            return self.tiled("wall")
        if pick < 0.64:
            return self.painted("wall", neutral_wall(rng))
        if pick < 0.87 or kind == "bath":
            return self.painted("wall", wall_colour(rng))
        return self.textured_wall("wall")

    def textured_wall(self, name: str) -> Material:
        """Choose wallpaper, brick, panelling, or one of the extra textures."""
        rng = self.rng
        if self.wall_textures and rng.random() < 0.35:
            return Material(name, _PLAIN, texture=self.wall_textures[int(rng.integers(len(self.wall_textures)))])
        pick = rng.random()
        if pick < 0.62:
            return Material(name, _PLAIN, texture=make_texture("wallpaper", self.split, rng))
        if pick < 0.78:
            return Material(name, _PLAIN, texture=make_texture("brick", self.split, rng))
        if pick < 0.9:
            colour = neutral_wall(rng) if rng.random() < 0.5 else wall_colour(rng)
            panels = wood.panelling(split_rng(self.split, rng), colour, painted=True)
            return Material(name, _PLAIN, texture=panels, roughness=self.optional_roughness(0.5, 0.3, 0.5))
        panels = make_texture("panelling", self.split, rng)
        return Material(name, _PLAIN, texture=panels, roughness=self.optional_roughness(0.4, 0.25, 0.5))

    def accent(self, wall: Material) -> Material:
        """Choose the finish of a contrasting accent wall."""
        rng = self.rng
        pick = rng.random()
        if pick < 0.35 and wall.texture is not None and wall.albedo == _PLAIN:
            return self.painted("accent_wall", neutral_wall(rng))
        if pick < 0.62:
            return self.painted("accent_wall", wall_colour(rng) if rng.random() < 0.7 else dark_wall(rng))
        return self.textured_wall("accent_wall")

    def lower_wall(self, kind: str, wall: Material) -> Material | None:
        """Choose tiles for wet rooms; elsewhere sometimes panelling, wainscot or a second paint."""
        rng = self.rng
        if kind in ("bath", "kitchen"):
            return self.tiled("lower_wall")
        if rng.random() > 0.35:
            return None
        if rng.random() < 0.45:
            colour = white(rng) if rng.random() < 0.6 else wall_colour(rng)
            return Material("lower_wall", colour, roughness=self.optional_roughness(0.6, 0.2, 0.45))
        colour = white(rng) if luminance(_mean(wall)) < 0.5 or rng.random() < 0.4 else None
        panels = wood.panelling(split_rng(self.split, rng), colour, painted=colour is not None)
        return Material("lower_wall", _PLAIN, texture=panels, roughness=self.optional_roughness(0.6, 0.2, 0.45))

    def tiled(self, name: str) -> Material:
        """Choose wall tiles, mostly glazed."""
        glaze = self.optional_roughness(0.85, 0.08, 0.3)
        return Material(name, _PLAIN, texture=make_texture("wall_tile", self.split, self.rng), roughness=glaze)

    def floor(self, kind: str) -> Material:
        """Choose the floor of a room of this kind."""
        rng = self.rng
        shade = float(rng.uniform(*_FLOOR_SHADE))
        albedo = (shade, shade, shade)
        if self.floor_textures and rng.random() < 0.35:
            texture = self.floor_textures[int(rng.integers(len(self.floor_textures)))]
            return Material("floor", albedo, texture=texture, roughness=self.optional_roughness(0.5, 0.1, 0.4))
        group: TextureGroup = ("wood_floor", "floor_tile", "carpet", "stone")[int(rng.choice(4, p=_FLOORS[kind]))]
        low, high, chance = {
            "wood_floor": (0.1, 0.35, 0.6),
            "floor_tile": (0.08, 0.32, 0.75),
            "stone": (0.08, 0.35, 0.6),
            "carpet": (0.0, 0.0, 0.0),
        }[group]
        return Material(
            "floor",
            albedo,
            texture=make_texture(group, self.split, rng),
            roughness=self.optional_roughness(chance, low, high),
        )

    def ceiling(self, wall: Material) -> Material:
        """Choose the ceiling: mostly white paint, otherwise boards, the walls' paint, another colour or concrete."""
        rng = self.rng
        pick = rng.random()
        if pick < 0.76:
            colour = white(rng)
        elif pick < 0.83:
            boards = make_texture("panelling", self.split, rng)
            return Material("ceiling", _PLAIN, texture=boards, roughness=self.optional_roughness(0.3, 0.25, 0.5))
        elif pick < 0.91:
            colour = _mean(wall)
        elif pick < 0.95:
            colour = off_white(rng) if rng.random() < 0.5 else wall_colour(rng)
        else:
            return Material("ceiling", _PLAIN, texture=stone.concrete(split_rng(self.split, rng)))
        return replace(self.painted("ceiling", colour), roughness=None)

    def wooden(self, name: str) -> Material:
        """Choose bare or varnished wood."""
        return Material(name, _PLAIN, texture=wood.board(self.rng), roughness=self.optional_roughness(0.55, 0.12, 0.4))

    def joinery(self) -> Material:
        """Choose the finish of frames and doors: white, wood, anthracite or a colour."""
        rng = self.rng
        pick = rng.random()
        coat = self.optional_roughness(0.6, 0.12, 0.4)
        if pick < 0.52:
            return Material("frame", white(rng), roughness=coat)
        if pick < 0.8:
            return replace(self.wooden("frame"), roughness=coat)
        if pick < 0.9:
            return Material("frame", paint(rng.uniform(0.025, 0.08), 0.008, 250), roughness=coat)
        if pick < 0.95:
            return Material("frame", grey(rng), roughness=coat)
        return Material("frame", wall_colour(rng), roughness=coat)

    def metal(self) -> Material:
        """Choose the metal of handles and rods: a grey or a brass with a glossy coat, since the renderer has no
        conductors."""
        rng = self.rng
        pick = rng.random()
        if pick < 0.6:
            colour = paint(rng.uniform(0.25, 0.55), 0.005, 240)
        elif pick < 0.8:
            colour = paint(rng.uniform(0.2, 0.4), rng.uniform(0.06, 0.1), 85)
        else:
            colour = paint(rng.uniform(0.02, 0.05), 0.0, 0)
        return Material("handle", colour, roughness=float(rng.uniform(0.08, 0.25)))

    def beam(self) -> Material:
        """Choose the wood of beams: old dark oak, fresh pine, or white."""
        rng = self.rng
        if rng.random() < 0.25:
            return Material("beam", white(rng))
        colour = paint(rng.uniform(0.04, 0.14), rng.uniform(0.02, 0.06), rng.uniform(40, 65))
        return Material("beam", _PLAIN, texture=wood.board(rng, colour if rng.random() < 0.6 else None))

    def curtain(self) -> Material:
        """Choose the cloth of curtains; half of them have no pattern."""
        rng = self.rng
        if rng.random() < 0.4:
            return Material("curtain", self.pale_cloth() if rng.random() < 0.4 else cloth_colour(rng))
        if rng.random() < 0.3:
            return Material("curtain", _PLAIN, texture=cloth.striped(split_rng(self.split, rng)))
        return Material("curtain", _PLAIN, texture=fabric_texture(self.split, rng))

    def blind(self) -> Material:
        """Choose the finish of slats and roller blinds: mostly pale, some wood, some dark."""
        rng = self.rng
        pick = rng.random()
        if pick < 0.55:
            return Material("blind", self.pale_cloth(), roughness=self.optional_roughness(0.3, 0.25, 0.5))
        if pick < 0.7:
            return self.wooden("blind")
        return Material("blind", cloth_colour(rng) if pick < 0.9 else dark_wall(rng))

    def pale_cloth(self) -> Rgb:
        """Choose a white, cream or grey cloth colour, sometimes a saturated one."""
        rng = self.rng
        if rng.random() < 0.12:
            return paint(rng.uniform(0.35, 0.6), rng.uniform(0.04, 0.1), rng.uniform(0, 360))
        kinds: tuple[Callable[[np.random.Generator], Rgb], ...] = (white, off_white, beige)
        return kinds[int(rng.choice(3, p=(0.4, 0.4, 0.2)))](rng)


def _mean(material: Material) -> Rgb:
    """Return a material's mean reflectance."""
    if material.texture is None:
        return material.albedo
    mean = srgb8_to_linear(material.texture.image[::4, ::4]).mean((0, 1)).astype(float)
    colour = mean * np.array(material.albedo)
    return float(colour[0]), float(colour[1]), float(colour[2])
