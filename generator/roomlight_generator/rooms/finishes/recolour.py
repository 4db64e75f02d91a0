"""Other colours for furniture: one change of hue, strength and lightness for all parts of a piece.

Works on a material's albedo, so a texture keeps its figure and takes a tint. What is no colour of choice stays:
mirrors, glass, lamps' shades, screens, metal, plants, skin.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roomlight_generator.rooms.colour import linear_to_oklab, luminance, paint
from roomlight_generator.rooms.finishes.palettes import hue
from roomlight_generator.rooms.scene import Material

RECOLOURABLE_ROLES: Final = frozenset(
    (
        "sofa", "armchair", "chair", "office_chair", "stool", "bench", "dining_table", "coffee_table", "side_table",
        "desk", "bed", "child_bed", "nightstand", "wardrobe", "dresser", "bookcase", "sideboard", "tv_stand",
        "kitchen_unit", "floor_lamp", "table_lamp", "ceiling_lamp", "wall_unit", "wall_shelf", "wall_lamp", "vase",
        "floor_toy", "toy", "floor_clutter", "rug", "towel_rack", "piano", "exercise",
    )
)  # fmt: skip
"""What people buy in any colour; a plant, a person, a dish of food or a picture is not among it."""

_KEPT: Final = re.compile(
    "screen|shade|daylit|glass|mirror|chrome|metal|steel|alumin|inox|brass|gold|silver|iron|leaf|leaves|plant|grass|flower"
    "|skin|hair|face|bulb|light|water|screw|keyboard|wheel",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Change:
    """A turn of the hue (radians), factors of chroma and reflectance, and the colour that greys are given: OKLab a and
    b."""

    turn: float
    chroma: float
    level: float
    tint: tuple[float, float]

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Change":
        """Half of all changes only lighten, darken or fade; the rest turn the hue or dye what was grey."""
        level = float(np.exp(rng.normal(0, 0.45)))
        if rng.random() < 0.4:
            return cls(0.0, float(rng.uniform(0.4, 1.15)), level, (0.0, 0.0))
        angle = np.radians(hue(rng))
        strength = float(rng.choice([0.0, 0.04, 0.08])) * rng.uniform(0.6, 1.4)
        tint = (float(strength * np.cos(angle)), float(strength * np.sin(angle)))
        return cls(float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.5, 1.3)), level, tint)

    def applied(self, material: Material) -> Material:
        """The same material in its new colour; what is no colour of choice is returned as it is."""
        fixed = material.mirror > 0 or material.glass or material.emits or _KEPT.search(material.name)
        if fixed:
            return material
        level = luminance(material.albedo)
        if level < 0.02 and material.texture is None:
            return material  # feet, castors, gaps: black stays black
        _, a, b = (float(value) for value in linear_to_oklab(np.array(material.albedo)))
        chroma, angle = float(np.hypot(a, b)), float(np.arctan2(b, a))
        turn, tint = self.turn, self.tint
        if 0.03 < chroma < 0.13 and np.radians(35) < angle < np.radians(95) and level < 0.5:
            turn, tint = 0.0, (0.0, 0.0)  # wood: lighter or darker, never blue
        a = self.chroma * chroma * np.cos(angle + turn) + tint[0]
        b = self.chroma * chroma * np.sin(angle + turn) + tint[1]
        # A texture already says how dark things are; its tint must not make it darker than half.
        factor = float(np.clip(self.level, 0.55, 1.0)) if material.texture is not None else self.level
        darkest = 0.02 if material.texture is None else 0.3
        new = float(np.clip(level * factor, min(level, darkest), max(level, 0.82)))
        strength = min(float(np.hypot(a, b)), 0.16 if material.texture is None else 0.07)
        return replace(material, albedo=paint(new, strength, float(np.degrees(np.arctan2(b, a)))))


def recolour(material: Material, rng: np.random.Generator) -> Material:
    """One material in another plausible colour. For a whole piece use `recoloured`, or its parts will not match."""
    return Change.drawn(rng).applied(material)


def recoloured(materials: Sequence[Material], rng: np.random.Generator) -> tuple[Material, ...]:
    """All materials of one piece under the same change of colour."""
    change = Change.drawn(rng)
    return tuple(change.applied(material) for material in materials)
