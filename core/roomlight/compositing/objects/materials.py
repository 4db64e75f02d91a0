"""Materials of virtual objects: glTF's metallic-roughness model, and smooth glass.

An opaque surface mixes a dielectric and a metal by `metallic` (glTF 2.0, appendix B), each a GGX microfacet lobe, the
dielectric's over a Lambertian base (Karis 2013):

    lobe(F0, F90) = D(h) G1(l) G1(v) F(v, h) / (4 (n.l) (n.v)) / (1 - Fm (1 - E1)),    Fm = F0 + (F90 - F0) / 21
    f = (1 - metallic) (lobe(d, specular) + base (1 - E(n.v)) / pi) + metallic lobe(base, 1)

with alpha = roughness^2, Smith's separable G, Schlick's F from F0 to F90, d = ((ior - 1) / (ior + 1))^2 specular, and E
the share of light that the dielectric's lobe reflects toward the viewer, E1 that of one that reflects all (a table).
The base gets what the lobe leaves, so that no surface reflects more light than it receives. The lobes are scaled for
light that bounces between microfacets (Fdez-Aguera 2019): a white metal reflects all light at any roughness, as in
Blender and three.js.

Over it lie sheen (KHR_materials_sheen: Charlie's distribution, spread over the directions of light as the base is)
and a clear coat of index 1.5 (KHR_materials_clearcoat), without the relief of the normal texture.

A share `transmission` of a surface is smooth glass: exact Fresnel reflection and refraction at `ior`, whatever the
roughness. Light that passes through a solid is multiplied by the base colour, by half at each of its two surfaces (the
square root); a thin wall multiplies it as a whole and does not bend it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from roomlight.compositing.objects.textures import Texture, TextureArrays, texture_arrays
from roomlight.errors import ObjectError

Colour = tuple[float, float, float]
"""Linear RGB."""
MAX_IOR = 1000.0
"""Converters of materials write it for a surface that reflects everything: 0.996 at normal incidence."""


_SHARES = (
    *("metallic", "roughness", "specular", "transmission", "opacity"),
    *("clearcoat", "clearcoat_roughness", "sheen_roughness"),
)


def colour_of(values: Iterable[float]) -> Colour:
    """Return three values as a colour."""
    red, green, blue = (float(value) for value in values)
    return red, green, blue


@dataclass(frozen=True)
class Material:
    """How a surface reflects, transmits and emits light.

    Attributes:
        base_colour: Linear RGB in [0, 1]: albedo of a dielectric, reflectance at normal incidence of a metal.
        metallic: 0 is a dielectric, 1 a metal.
        roughness: Perceptual, alpha = roughness^2; below 0.02 the lobe is a perfect mirror.
        specular: Scales the lobe of a dielectric; 0 leaves a Lambertian surface.
        ior: Index of refraction, 1 to `MAX_IOR`; glass has 1 to 3.
        transmission: Share of the surface that is smooth glass.
        is_thin: Whether glass is a thin wall; else its surface encloses a solid.
        opacity: Share of the surface that is there; rays pass straight through the rest.
        alpha_cutoff: If given, the surface is there where opacity x texture alpha reaches it, and nowhere else.
        one_sided: Whether the surface is not there for what the camera sees of its back.
        clearcoat: Strength of a clear coat over the surface.
        clearcoat_roughness: Of the coat, perceptual.
        sheen: Linear RGB that cloth reflects at grazing angles; black is none.
        sheen_roughness: Perceptual; at least 0.07 counts.
        emissive: Radiance that the surface emits, linear RGB.
        base_colour_texture: Multiplies base_colour and, by its alpha, opacity.
        metallic_roughness_texture: Green multiplies roughness, blue metallic.
        normal_texture: Tangent-space normals, x along u, y up the image (against v).
        normal_scale: Scales x and y of the normal texture.
        emissive_texture: Multiplies emissive.
        clearcoat_texture: Red multiplies clearcoat.
        clearcoat_roughness_texture: Green multiplies clearcoat_roughness.
        sheen_texture: Multiplies sheen.
        sheen_roughness_texture: Alpha multiplies sheen_roughness.

    Raises:
        ObjectError: A value is out of range.
    """

    base_colour: Colour = (0.8, 0.8, 0.8)
    metallic: float = 0.0
    roughness: float = 1.0
    specular: float = 1.0
    ior: float = 1.5
    transmission: float = 0.0
    is_thin: bool = False
    opacity: float = 1.0
    alpha_cutoff: float | None = None
    one_sided: bool = False
    clearcoat: float = 0.0
    clearcoat_roughness: float = 0.0
    sheen: Colour = (0.0, 0.0, 0.0)
    sheen_roughness: float = 0.0
    emissive: Colour = (0.0, 0.0, 0.0)
    base_colour_texture: Texture | None = None
    metallic_roughness_texture: Texture | None = None
    normal_texture: Texture | None = None
    normal_scale: float = 1.0
    emissive_texture: Texture | None = None
    clearcoat_texture: Texture | None = None
    clearcoat_roughness_texture: Texture | None = None
    sheen_texture: Texture | None = None
    sheen_roughness_texture: Texture | None = None

    def __post_init__(self) -> None:
        shares = {name: getattr(self, name) for name in _SHARES}
        for name in ("base_colour", "sheen"):
            shares |= {f"{name}[{channel}]": value for channel, value in enumerate(getattr(self, name))}
        if self.alpha_cutoff is not None:
            shares["alpha_cutoff"] = self.alpha_cutoff
        for name, value in shares.items():
            if not 0 <= value <= 1:
                raise ObjectError(f"material: {name} must be from 0 to 1, got {value}")
        if not 1 <= self.ior <= MAX_IOR:
            raise ObjectError(f"material: ior must be from 1 to {MAX_IOR:g}, got {self.ior}")
        for value in (*self.emissive, abs(self.normal_scale)):
            if not 0 <= value <= 1e6:
                raise ObjectError(f"material: emissive and normal_scale must be finite, at most 1e6, got {value}")


def mirror() -> Material:
    """Return a perfect mirror."""
    return Material(base_colour=(1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)


def rough_metal(roughness: float = 0.5, base_colour: Colour = (1.0, 1.0, 1.0)) -> Material:
    """Return a metal; white and of roughness 0.5 unless stated."""
    return Material(base_colour=base_colour, metallic=1.0, roughness=roughness)


def glossy(base_colour: Colour = (0.8, 0.8, 0.8), roughness: float = 0.2) -> Material:
    """Return Karis's glossy dielectric: albedo 0.8, roughness 0.2 and F0 = 0.05, as `roomlight.spheres`' glossy."""
    return Material(base_colour=base_colour, roughness=roughness, ior=1.576)


def diffuse(base_colour: Colour = (0.8, 0.8, 0.8)) -> Material:
    """Return a Lambertian surface."""
    return Material(base_colour=base_colour, specular=0.0)


def glass(ior: float = 1.5, tint: Colour = (1.0, 1.0, 1.0)) -> Material:
    """Return solid, smooth glass; `tint` is the share of light that passes through it, less what it reflects."""
    return Material(base_colour=tint, roughness=0.0, ior=ior, transmission=1.0)


class MaterialArrays(NamedTuple):
    """One row a material, as the kernels read them; texture -1 is none, cutoff -1 is none."""

    base: Float32[np.ndarray, "m 3"]
    metallic: Float32[np.ndarray, " m"]
    roughness: Float32[np.ndarray, " m"]
    specular: Float32[np.ndarray, " m"]
    ior: Float32[np.ndarray, " m"]
    transmission: Float32[np.ndarray, " m"]
    is_thin: Bool[np.ndarray, " m"]
    opacity: Float32[np.ndarray, " m"]
    cutoff: Float32[np.ndarray, " m"]
    one_sided: Bool[np.ndarray, " m"]
    clearcoat: Float32[np.ndarray, " m"]
    clearcoat_roughness: Float32[np.ndarray, " m"]
    sheen: Float32[np.ndarray, "m 3"]
    sheen_roughness: Float32[np.ndarray, " m"]
    emissive: Float32[np.ndarray, "m 3"]
    normal_scale: Float32[np.ndarray, " m"]
    texture: Int32[np.ndarray, "m 8"]


TEXTURES = (
    *("base_colour", "metallic_roughness", "normal", "emissive"),
    *("clearcoat", "clearcoat_roughness", "sheen", "sheen_roughness"),
)
"""Columns of `MaterialArrays.texture`."""


def material_arrays(materials: Sequence[Material]) -> tuple[MaterialArrays, TextureArrays]:
    """Make the tables of materials and of their textures; a texture that several use is stored once."""
    textures: dict[Texture, int] = {}
    rows: list[list[int]] = []
    for material in materials:
        used = [getattr(material, f"{name}_texture") for name in TEXTURES]
        rows.append([-1 if texture is None else textures.setdefault(texture, len(textures)) for texture in used])

    def column(name: str) -> Float32[np.ndarray, "m ..."]:
        return np.array([getattr(material, name) for material in materials], np.float32)

    cutoffs = [material.alpha_cutoff for material in materials]
    arrays = MaterialArrays(
        base=column("base_colour"),
        is_thin=np.array([material.is_thin for material in materials]),
        cutoff=np.array([-1 if cutoff is None else cutoff for cutoff in cutoffs], np.float32),
        one_sided=np.array([material.one_sided for material in materials]),
        texture=np.array(rows, np.int32),
        **{name: column(name) for name in (*_SHARES, "ior", "sheen", "emissive", "normal_scale")},
    )
    return arrays, texture_arrays(list(textures))


@lru_cache(maxsize=1)
def lobe_table() -> Float32[np.ndarray, "cosines roughnesses 3"]:
    """Return A and B of the lobe's reflected share E(n.v, roughness) = F0 A + F90 B (Karis's split sum), and sheen's E.

    Rows are cosines and columns roughnesses, both evenly from 0 to 1. 60 ms, once.
    """
    from roomlight.kernels.microfacets import fill_lobe_table

    table = np.empty((64, 32, 3), np.float32)
    fill_lobe_table(table, 1024)
    table.setflags(write=False)
    return table
