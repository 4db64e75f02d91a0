"""Convert MTL materials to scene materials: reflectance, gloss, glass, mirrors, screens, shades.

MTL colours are display colours, so they are decoded as sRGB. Their specular terms carry little information (half of all
materials have the exporter's default), so gloss follows keywords in material names and the model's role, with the
shininess as a hint. Free choices are made by a hash of the model's and the material's name.
"""

import re
import zlib
from typing import Final

import numpy as np

from roomlight.conventions import srgb_to_linear
from roomlight_generator.rooms.furniture.files.obj import MtlMaterial
from roomlight_generator.rooms.roles import LAMP_ROLES
from roomlight_generator.rooms.scene import Material, Rgb, Texture

ALBEDO: Final = (0.03, 0.88)
"""Range of albedo: black plastic to fresh white paint."""

_LIFT: Final = 1.15

_GLASS: Final = re.compile(r"glass|vidr[io]|verre|crista[l]|vitre|\bpane|transparen|clear_?plastic|water|agua")
_MIRROR: Final = re.compile(r"mirror|espejo|miroir|specchio|spiegel")
_CHROME: Final = re.compile(r"chrom|crom[oa]\b|inox|stainless|polish")
_METAL: Final = re.compile(r"metal|steel|iron|hierro|\balu|alumin|brass|gold|silver|copper|argent|bronze|ferr|acero")
_WOOD: Final = re.compile(r"wood|madera|\bbois|legno|oak|walnut|venge|teak|\bpine\b|holz|parquet|mogano|cherry")
_CERAMIC: Final = re.compile(r"ceramic|porcelain|enamel|sanit|lavabo|email|loza|marble|granit|tile")
_PLASTIC: Final = re.compile(r"plastic|gloss|lacquer|paint|varnish|leather|cuir|cuero|skai")
_MATTE: Final = re.compile(
    r"fabric|cloth|textile|cushion|cosin|pillow|mat+ress|couch|carpet|rug|towel|toalla|sheet|blanket|tela|wool|hair|"
    r"skin|paper|book|cardboard|soil|earth|ground|stone|brick|concrete|matte|leaf|leaves|bread|tissu|sofa|bark|trunk"
)
_SHADE: Final = re.compile(r"shade|abat|pantalla|lampshade|globe|bulb|bombilla|flame|neon|tube|light(?!_?brown|er)")
_SCREEN: Final = re.compile(r"screen|pantalla|ecran|display|\blcd|\btft")

_SOFT_ROLES: Final = frozenset({"sofa", "armchair", "bed", "child_bed", "rug", "person", "pet", "curtain"})
_CERAMIC_ROLES: Final = frozenset({"bathtub", "toilet", "washbasin", "shower", "tableware"})
_SMOOTH_ROLES: Final = frozenset(
    {"kitchen_unit", "wall_unit", "oven", "fridge", "dishwasher", "washing_machine", "piano", "laptop", "computer",
     "television", "wall_television", "electronics", "kitchen_appliance", "hood", "vase", "exercise", "toy"}
)  # fmt: skip
_SCREEN_ROLES: Final = frozenset({"television", "wall_television", "computer", "laptop", "tv_stand", "electronics"})


def make_material(
    mtl: MtlMaterial, texture: Texture | None, *, role: str, identity: str, kind: str | None = None
) -> Material:
    """Make the material of a part of the model that has this role and identity.

    A texture replaces the diffuse colour, as it does in Sweet Home 3D. `kind` overrides the keywords: mirror, glass,
    chrome, matte, glossy, screen, shade.
    """
    words = mtl.name.lower()
    kind = kind or _kind(words, mtl, texture, role)
    name = f"{kind} {mtl.name}" if kind in ("screen", "shade") else mtl.name
    albedo = (0.95, 0.95, 0.95) if texture is not None else _albedo(mtl.diffuse)
    if kind == "mirror":
        return Material(name=name, albedo=(0.88, 0.88, 0.88), mirror=0.88)
    if kind == "glass":
        return Material(name=name, albedo=albedo, glass=True)
    if kind == "chrome" and texture is None:
        return Material(name=name, albedo=albedo, mirror=min(0.6, 0.25 + 0.4 * max(albedo)))
    if kind == "screen":
        return Material(name=name, albedo=(0.02, 0.02, 0.02), roughness=0.06)
    chance = zlib.crc32(f"{identity}/{mtl.name}".encode()) / 2**32
    roughness = None if kind in ("matte", "shade") else _roughness(words, mtl, texture, role, chance, kind)
    return Material(name=name, albedo=albedo, texture=texture, roughness=roughness)


def looks_like_shade(name: str) -> bool:
    """Return whether the name of a lamp's material means a part that emits light."""
    return bool(_SHADE.search(name.lower())) and not _METAL.search(name.lower())


def _kind(words: str, mtl: MtlMaterial, texture: Texture | None, role: str) -> str | None:
    if role in _SCREEN_ROLES and _SCREEN.search(words):
        return "screen"
    if _MIRROR.search(words) and texture is None:
        return "mirror"
    clear = mtl.opacity < 0.5 or (mtl.opacity < 0.85 and _GLASS.search(words))
    if clear and role in LAMP_ROLES:
        return "shade"
    if clear and role not in ("tableware", "food", "bathroom_thing", "stationery", "person", "pet", "curtain", "rug"):
        return "glass"
    if clear:
        # Glass that passes rays straight through is invisible; a drinking glass must be visible.
        return "glossy"
    if _CHROME.search(words) and max(mtl.specular) > 0.15 and _saturation(mtl.diffuse) < 0.4:
        return "chrome"
    if _MATTE.search(words):
        return "matte"
    return None


def _roughness(
    words: str, mtl: MtlMaterial, texture: Texture | None, role: str, chance: float, kind: str | None
) -> float | None:
    """Return the GGX alpha of the coat, or None. The ranges roughly match measured household surfaces."""
    if kind == "glossy":
        return 0.05 + 0.1 * chance
    if kind == "chrome" or _METAL.search(words):
        return 0.1 + 0.2 * chance
    if _CERAMIC.search(words) or (role in _CERAMIC_ROLES and texture is None):
        return 0.05 + 0.07 * chance
    if _WOOD.search(words):
        return 0.12 + 0.35 * chance if chance < 0.65 else None
    if _PLASTIC.search(words):
        return 0.1 + 0.25 * chance
    if role in _SOFT_ROLES or role in ("plant", "small_plant", "food", "book"):
        return None
    if role in _SMOOTH_ROLES:
        return 0.08 + 0.3 * chance if chance < 0.8 else None
    if max(mtl.specular) >= 0.3 and mtl.shininess >= 20 and chance < 0.55:
        return float(np.clip(np.sqrt(2 / (mtl.shininess + 2)) * (0.7 + chance), 0.06, 0.45))
    return None


def _albedo(display: Rgb) -> Rgb:
    # Sweet Home 3D lights its scenes so that a diffuse colour of 0.8, many exporters' default white, appears white.
    colour = np.array(display, np.float32)
    lifted = srgb_to_linear(np.clip(colour * np.float32(_LIFT), 0, 1))
    # Light greys are whites and silvers that the exporter wrote as linear values; decoding them as sRGB would darken
    # them.
    grey = np.clip(1 - _saturation(display) / 0.2, 0, 1) * np.clip((colour.min() - 0.3) / 0.3, 0, 1)
    linear = np.clip(ALBEDO[1] * ((1 - grey) * lifted + grey * np.maximum(colour, lifted)), *ALBEDO)
    red, green, blue = (float(value) for value in linear)
    return (red, green, blue)


def _saturation(display: Rgb) -> float:
    return 1 - min(display) / max(max(display), 1e-6)
