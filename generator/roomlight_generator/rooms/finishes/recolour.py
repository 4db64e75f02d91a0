"""Recolouring of furniture: one change of hue, chroma and lightness for all parts of a piece.

Works on a material's albedo, so a texture keeps its pattern and is tinted. Materials whose colour is characteristic are
unchanged: mirrors, glass, lamp shades, screens, metal, plants, skin.
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
"""Roles sold in any colour; plants, people, food and pictures are not."""

_FIXED_MATERIALS: Final = re.compile(
    "screen|shade|daylit|glass|mirror|chrome|metal|steel|alumin|inox|brass|gold|silver|iron|leaf|leaves|plant|grass|flower"
    "|skin|hair|face|bulb|light|water|screw|keyboard|wheel",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class ColourChange:
    """A hue rotation (radians), factors of chroma and reflectance, and a tint for greys: OKLab a and b."""

    hue_shift: float
    chroma: float
    reflectance_factor: float
    tint: tuple[float, float]

    @classmethod
    def random(cls, rng: np.random.Generator) -> "ColourChange":
        """Draw a change: 40 % only lighten, darken or fade; the rest also rotate the hue or tint greys."""
        reflectance = float(np.exp(rng.normal(0, 0.45)))
        if rng.random() < 0.4:
            return cls(0.0, float(rng.uniform(0.4, 1.15)), reflectance, (0.0, 0.0))
        angle = np.radians(hue(rng))
        strength = float(rng.choice([0.0, 0.04, 0.08])) * rng.uniform(0.6, 1.4)
        tint = (float(strength * np.cos(angle)), float(strength * np.sin(angle)))
        return cls(float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.5, 1.3)), reflectance, tint)

    def apply(self, material: Material) -> Material:
        """Return the material in its new colour, or unchanged if its colour is characteristic."""
        fixed = material.mirror > 0 or material.glass or material.emits or _FIXED_MATERIALS.search(material.name)
        if fixed:
            return material
        reflectance = luminance(material.albedo)
        if reflectance < 0.02 and material.texture is None:
            return material  # feet, castors, gaps: black stays black
        _, a, b = (float(value) for value in linear_to_oklab(np.array(material.albedo)))
        chroma, angle = float(np.hypot(a, b)), float(np.arctan2(b, a))
        hue_shift, tint = self.hue_shift, self.tint
        if 0.03 < chroma < 0.13 and np.radians(35) < angle < np.radians(95) and reflectance < 0.5:
            hue_shift, tint = 0.0, (0.0, 0.0)  # wood: lighter or darker, never blue
        a = self.chroma * chroma * np.cos(angle + hue_shift) + tint[0]
        b = self.chroma * chroma * np.sin(angle + hue_shift) + tint[1]
        # A texture already encodes darkness; its tint must not make it darker than half.
        factor = (
            float(np.clip(self.reflectance_factor, 0.55, 1.0))
            if material.texture is not None
            else self.reflectance_factor
        )
        darkest = 0.02 if material.texture is None else 0.3
        new = float(np.clip(reflectance * factor, min(reflectance, darkest), max(reflectance, 0.82)))
        strength = min(float(np.hypot(a, b)), 0.16 if material.texture is None else 0.07)
        return replace(material, albedo=paint(new, strength, float(np.degrees(np.arctan2(b, a)))))


def recolour(material: Material, rng: np.random.Generator) -> Material:
    """Return one material in another plausible colour. For a whole piece use `recoloured`, or its parts will not
    match."""
    return ColourChange.random(rng).apply(material)


def recoloured(materials: Sequence[Material], rng: np.random.Generator) -> tuple[Material, ...]:
    """Return all materials of one piece under the same change of colour."""
    change = ColourChange.random(rng)
    return tuple(change.apply(material) for material in materials)
