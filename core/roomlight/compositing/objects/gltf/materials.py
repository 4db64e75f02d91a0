"""glTF's materials as `Material`: textures brought to one set of coordinates, extensions converted or noted."""

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from roomlight.compositing.objects.gltf.container import extension
from roomlight.compositing.objects.gltf.images import CLAMPED, MIRRORED, Images
from roomlight.compositing.objects.gltf.ktx2 import ktx2_available
from roomlight.compositing.objects.gltf.schema import (
    Clearcoat,
    EmissiveStrength,
    GltfMaterial,
    Ior,
    Sheen,
    Specular,
    SpecularGlossiness,
    TextureInfo,
    TextureTransform,
    Transmission,
    Volume,
)
from roomlight.compositing.objects.limits import PassedLimitError
from roomlight.compositing.objects.materials import MAX_IOR, TEXTURES, Colour, Material, colour_of
from roomlight.compositing.objects.textures import MAX_TEXTURE_SIZE, Texture
from roomlight.conventions import LUMINANCE, linear_to_srgb8, srgb8_to_linear
from roomlight.errors import ObjectError
from roomlight.notes import Note

_COLOURS = ("base", "emissive", "sheen")
_DIELECTRIC = 0.04
_TIMES = 16
_ENLARGED_TEXELS = 4 * MAX_TEXTURE_SIZE**2
"""Of all textures that are enlarged, so that their texels keep their edges."""
_MAX_GLASS_IOR = 3.0
_REPEATED_TEXELS = 16 * MAX_TEXTURE_SIZE**2
"""Of all textures that are made anew for other coordinates."""
_EVEN = 0.02
"""Deviation of what is called even."""
_MOST_CLEAR = 0.1
"""Roughness of glass above which what is behind it would be blurred."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A material and the texture coordinates that it reads.

    Attributes:
        uv_set: Number of the set of texture coordinates.
        uv_transform: What its textures do to these coordinates.
        opaque: Whether alpha counts for nothing.
        double_sided: Whether the file says that it shows from behind.
        unlit: Whether the surface shows its base colour as it is (`unlit_of`, after vertex colours).
        attenuation: Colour of glass as thick as its attenuation distance.
        thickness: Of glass, in attenuation distances, where its node does not scale it.
        notes: What was left out.
    """

    material: Material
    uv_set: int = 0
    uv_transform: Float[np.ndarray, "2 3"] = field(default_factory=lambda: np.eye(2, 3))
    opaque: bool = True
    unlit: bool = False
    double_sided: bool = False
    attenuation: Colour = (1.0, 1.0, 1.0)
    thickness: float = 0.0
    notes: tuple[Note, ...] = ()

    def scaled(self, scale: float) -> Material:
        """Return the material under a node of this scale."""
        if self.thickness == 0:
            return self.material
        share = np.array(self.attenuation) ** (self.thickness * scale)
        return replace(self.material, base_colour=colour_of(np.array(self.material.base_colour) * share))


@dataclass(frozen=True, eq=False)
class _Slot:
    """One texture of a material: its pixels and the coordinates that it reads."""

    key: str
    pixels: UInt8[np.ndarray, "h w c"]
    uv_set: int
    transform: Float[np.ndarray, "3 3"]
    clamped: tuple[bool, bool]


class MaterialReader:
    """Makes the materials of one file."""

    def __init__(self, images: Images, clamped: list[str]) -> None:
        self._images, self._clamped = images, clamped
        self._unread: dict[int, str] = {}
        self._textures: dict[tuple[int, str], tuple[np.ndarray, Texture]] = {}
        self._enlarged: dict[tuple[int, bool], UInt8[np.ndarray, "h w c"]] = {}
        self._repeats: dict[tuple[int, bytes, bool], tuple[np.ndarray, np.ndarray]] = {}
        self._mirrored: dict[tuple[int, tuple[int, int], bool], tuple[np.ndarray, np.ndarray]] = {}
        self._edged: dict[tuple[Texture, tuple[bool, bool]], Texture] = {}

    def surface(self, stated: GltfMaterial, label: str) -> Surface:
        """Convert a material. Raises ObjectError."""
        notes: list[Note] = []
        base = stated.pbrMetallicRoughness
        glossy = extension(SpecularGlossiness, stated, "KHR_materials_pbrSpecularGlossiness", label, self._clamped)
        coat = extension(Clearcoat, stated, "KHR_materials_clearcoat", label, self._clamped) or Clearcoat()
        sheen = extension(Sheen, stated, "KHR_materials_sheen", label, self._clamped) or Sheen()
        textures = {
            "base": base.baseColorTexture if glossy is None else glossy.diffuseTexture,
            "rough": base.metallicRoughnessTexture if glossy is None else glossy.specularGlossinessTexture,
            "normal": stated.normalTexture,
            "emissive": stated.emissiveTexture,
            "coat": coat.clearcoatTexture,
            "coat roughness": coat.clearcoatRoughnessTexture,
            "sheen": sheen.sheenColorTexture,
            "sheen roughness": sheen.sheenRoughnessTexture,
        }
        converted = () if glossy is None else ("base", "rough")  # by texel, in float64: not enlarged
        slots = {key: self._slot(info, label, key, notes, edged=key not in converted) for key, info in textures.items()}
        in_order = (slots[key] for key in ("base", "normal", "rough", *list(slots)[3:]))
        first = next((slot for slot in in_order if slot is not None), None)  # the mesh has one set of coordinates
        uv_set, transform = (0, np.eye(3)) if first is None else (first.uv_set, first.transform)
        pixels, means = {}, {}
        for key, slot in slots.items():
            pixels[key], means[key] = self._brought(slot, uv_set, transform, label, notes)
        clear = extension(Transmission, stated, "KHR_materials_transmission", label, self._clamped) or Transmission()
        material = self._factors(stated, clear, label, notes)
        if stated.emissiveTexture is not None and slots["emissive"] is None:
            material = replace(material, emissive=(0.0, 0.0, 0.0))  # else all of it would glow
        if glossy is not None:
            material = self._from_glossy(material, glossy, stated.alphaMode == "OPAQUE", pixels, means)
        else:
            material = self._from_metallic(material, stated, pixels, means)
            material = _without_clear_metal(material, clear.transmissionFactor, pixels["rough"], label, notes)
        volume = extension(Volume, stated, "KHR_materials_volume", label, self._clamped) or Volume()
        if material.transmission > 0 and volume.thicknessFactor == 0:
            material = replace(material, is_thin=True)
        thickness = self._thickness(volume, label, notes) if material.transmission > 0 else 0.0
        material = self._rest(material, stated, coat, sheen, pixels, means)
        material = self._with_edges(material, slots)
        blended = stated.alphaMode == "BLEND" and material.transmission == 0
        if (blended or material.is_thin) and not stated.doubleSided:
            material = replace(material, one_sided=True)
        grains = pixels["rough"]
        frosted = material.roughness * (1.0 if grains is None else float(grains[..., 1].mean()) / 255)
        if material.transmission > 0 and frosted > _MOST_CLEAR:
            frosting = f"{label}: the roughness of its glass ({frosted:.2g})"
            notes.append(Note(frosting, "it is clear, not frosted", "use alphaMode BLEND to veil what is behind"))
        if coat.clearcoatNormalTexture is not None:
            notes.append(Note(f"{label}: relief of its clear coat", "the coat is smooth", "nothing to do"))
        if stated.occlusionTexture is not None:
            file = label.rpartition(":")[0]  # one note for all its materials
            effect = "objects shade themselves by ray tracing instead"
            notes.append(Note(f"{file}: occlusion textures", effect, "nothing to do"))
        return Surface(
            material,
            uv_set,
            transform[:2],
            stated.alphaMode == "OPAQUE",
            "KHR_materials_unlit" in stated.extensions,
            stated.doubleSided,
            volume.attenuationColor,
            thickness,
            tuple(notes),
        )

    def _slot(self, info: TextureInfo | None, label: str, key: str, notes: list[Note], *, edged: bool) -> _Slot | None:
        if info is None:
            return None
        where = f"{label}, {key} texture"
        effect = "it does not glow" if key == "emissive" else "the factor alone is used"
        pixels = self._pixels(info, where, notes, effect)
        if pixels is None:
            return None
        moved = extension(TextureTransform, info, "KHR_texture_transform", where, self._clamped) or TextureTransform()
        uv_set = info.texCoord if moved.texCoord is None else moved.texCoord
        wraps, transform = self._images.wraps(info.index), _matrix(moved)
        if self._images.is_nearest(info.index):
            if edged:
                pixels = self._with_edged_texels(pixels, MIRRORED in wraps)
            else:
                notes.append(Note(f"{where}: its sampler NEAREST", "its texels are smoothed", "use metallic-roughness"))
        if MIRRORED in wraps:  # the texture beside its mirror image repeats
            which = id(pixels), wraps, key in _COLOURS
            if which not in self._mirrored:  # the pixels are kept, so that their id stays theirs
                self._mirrored[which] = pixels, _beside_mirror_image(pixels, wraps, colour=key in _COLOURS)
            pixels = self._mirrored[which][1]
            transform[:2] /= [[1 + (wrap == MIRRORED)] for wrap in wraps]
        return _Slot(key, pixels, uv_set, transform, (wraps[0] == CLAMPED, wraps[1] == CLAMPED))

    def _brought(
        self, slot: _Slot | None, uv_set: int, transform: Float[np.ndarray, "3 3"], label: str, notes: list[Note]
    ) -> tuple[UInt8[np.ndarray, "h w c"] | None, Float[np.ndarray, "4"]]:
        """Return a texture in the common coordinates, and factors: where it cannot be brought there, its mean."""
        if slot is None:
            return None, np.ones(4)
        if slot.uv_set == uv_set and np.allclose(slot.transform, transform, atol=1e-6):
            return slot.pixels, np.ones(4)
        if slot.uv_set == uv_set and not any(slot.clamped) and abs(np.linalg.det(transform)) > 1e-9:
            relative = slot.transform @ np.linalg.inv(transform)
            if np.abs(relative[:2, :2] - np.rint(relative[:2, :2])).max() < 1e-3:  # both repeat with the unit square
                pixels = self._repeated(slot, relative)
                if pixels is not None:
                    return pixels, np.ones(4)
        notes.append(
            Note(
                f"{label}, {slot.key} texture: coordinates other than the first texture's",
                "the surface is plain there" if slot.key == "normal" else "its mean is used everywhere",
                "bake the material's textures onto one set of coordinates",
            )
        )
        if slot.key == "normal":
            return None, np.ones(4)
        return None, _mean_of(slot.pixels, of_values=slot.key in ("rough", "coat", "coat roughness"))

    def _repeated(self, slot: _Slot, relative: Float[np.ndarray, "3 3"]) -> UInt8[np.ndarray, "h w c"] | None:
        """Return a texture as other coordinates read it, made once; None beyond what all may have."""
        colour = slot.key in _COLOURS
        key = id(slot.pixels), relative.tobytes(), colour
        if key not in self._repeats:  # the pixels are kept, so that their id stays theirs
            if sum(made.shape[0] * made.shape[1] for _, made in self._repeats.values()) >= _REPEATED_TEXELS:
                return None
            self._repeats[key] = slot.pixels, _resampled(slot.pixels, relative, colour=colour)
        return self._repeats[key][1]

    def _with_edged_texels(self, pixels: UInt8[np.ndarray, "h w c"], mirrored: bool) -> UInt8[np.ndarray, "h2 w2 c"]:
        """Repeat each texel, so that filtering blurs a small part of it alone; an image is enlarged once."""
        key = id(pixels), mirrored  # the images are kept, so that their id stays theirs
        if key not in self._enlarged:
            height, width = pixels.shape[:2]
            left = _ENLARGED_TEXELS - sum(image.shape[0] * image.shape[1] for image in self._enlarged.values())
            longest = max(height, width) * (1 + mirrored)
            times = min(_TIMES, MAX_TEXTURE_SIZE // longest, math.isqrt(max(left, 0) // (height * width)))
            if times < 2:
                return pixels
            self._enlarged[key] = np.repeat(np.repeat(pixels, times, axis=0), times, axis=1)
        return self._enlarged[key]

    def _pixels(
        self, info: TextureInfo, where: str, notes: list[Note], effect: str = "the factor alone is used"
    ) -> UInt8[np.ndarray, "h w c"] | None:
        """Return a texture's picture; None, with a note, if it cannot be read. Raises ObjectError beyond the limits."""
        try:
            pixels = None if info.index in self._unread else self._images.pixels(info.index, where)
        except PassedLimitError:
            raise
        except ObjectError as error:
            pixels, self._unread[info.index] = None, str(error)
        if pixels is None and info.index in self._unread:
            notes.append(Note(self._unread[info.index], effect, "put a PNG or JPEG beside it, or export as GLB"))
        elif pixels is None:
            extra = "" if ktx2_available() else "pip install 'roomlight[ktx2]', or "
            notes.append(Note(f"{where}: its KTX2 image", effect, f"{extra}export it as PNG, JPEG or WebP"))
        return pixels

    def _mean(
        self, info: TextureInfo | None, label: str, notes: list[Note], *, of_values: bool = False
    ) -> Float[np.ndarray, "4"]:
        """Return the mean of a texture that is read as a factor; linear RGB, and alpha."""
        pixels = None if info is None else self._pixels(info, label, notes)
        if pixels is None:
            return np.ones(4)
        notes.append(Note(label, "its mean is used everywhere", "bake it into the base colour if it matters"))
        return _mean_of(pixels, of_values=of_values)

    def _factors(self, stated: GltfMaterial, clear: Transmission, label: str, notes: list[Note]) -> Material:
        """Return the material of what the extensions state, before base colour and textures."""
        ior = extension(Ior, stated, "KHR_materials_ior", label, self._clamped) or Ior()
        specular = extension(Specular, stated, "KHR_materials_specular", label, self._clamped) or Specular()
        key = "KHR_materials_emissive_strength"
        glow = extension(EmissiveStrength, stated, key, label, self._clamped) or EmissiveStrength()
        transmission = clear.transmissionFactor * float(
            self._mean(clear.transmissionTexture, f"{label}.transmissionTexture", notes, of_values=True)[0]
        )
        share = specular.specularFactor * float(
            self._mean(specular.specularTexture, f"{label}.specularTexture", notes)[3]
        )
        tint = self._mean(specular.specularColorTexture, f"{label}.specularColorTexture", notes)[:3]
        colour = tint * np.array(specular.specularColorFactor)
        material = Material(
            specular=share,
            transmission=transmission,
            emissive=colour_of(min(channel * glow.emissiveStrength, 1e6) for channel in stated.emissiveFactor),
            alpha_cutoff=min(stated.alphaCutoff, 1.0) if stated.alphaMode == "MASK" else None,
        )
        return _with_reflectance(material, ior.ior, colour, label, notes)

    def _from_metallic(
        self,
        material: Material,
        stated: GltfMaterial,
        pixels: dict[str, np.ndarray | None],
        means: dict[str, np.ndarray],
    ) -> Material:
        base = stated.pbrMetallicRoughness
        colour = np.array(base.baseColorFactor) * means["base"]
        return replace(
            material,
            base_colour=colour_of(colour[:3]),
            metallic=base.metallicFactor * float(means["rough"][2]),
            roughness=base.roughnessFactor * float(means["rough"][1]),
            opacity=1.0 if stated.alphaMode == "OPAQUE" else float(colour[3]),
            base_colour_texture=self._texture(pixels["base"], "opaque" if stated.alphaMode == "OPAQUE" else "colour"),
            metallic_roughness_texture=self._texture(pixels["rough"], "values"),
        )

    def _thickness(self, volume: Volume, label: str, notes: list[Note]) -> float:
        """Return the stated thickness in attenuation distances; a distance of 0 is not stated."""
        if volume.thicknessFactor == 0 or volume.attenuationDistance == 0:
            return 0.0
        texture = volume.thicknessTexture
        pixels = None if texture is None else self._pixels(texture, f"{label}.thicknessTexture", notes)
        share = 1.0 if pixels is None else float(pixels[..., 1].mean()) / 255
        return volume.thicknessFactor * share / volume.attenuationDistance

    def _from_glossy(
        self,
        material: Material,
        glossy: SpecularGlossiness,
        opaque: bool,
        pixels: dict[str, np.ndarray | None],
        means: dict[str, np.ndarray],
    ) -> Material:
        """Convert specular-glossiness, texel by texel where it has textures."""
        diffuse, alpha = np.array(glossy.diffuseFactor[:3]), 1.0 if opaque else glossy.diffuseFactor[3]
        specular, gloss = np.array(glossy.specularFactor), glossy.glossinessFactor
        if pixels["base"] is None and pixels["rough"] is None:
            base, metallic = metal_of(diffuse * means["base"][:3], specular * means["rough"][:3])
            return replace(
                material,
                base_colour=colour_of(base),
                metallic=float(metallic),
                roughness=1 - gloss * float(means["rough"][3]),
                opacity=alpha if opaque else alpha * float(means["base"][3]),
            )
        sizes = (image.shape[:2] for image in (pixels["base"], pixels["rough"]) if image is not None)
        size = max(sizes, key=lambda shape: shape[0] * shape[1])
        colours, alphas = _planes(pixels["base"], size, means["base"])
        speculars, glosses = _planes(pixels["rough"], size, means["rough"])
        base, metallic = metal_of(colours * diffuse, speculars * specular)
        values = np.stack([np.zeros(size), 1 - gloss * glosses, metallic], axis=-1)
        return replace(
            material,
            base_colour=(1.0, 1.0, 1.0),
            metallic=1.0,
            roughness=1.0,
            opacity=alpha,
            base_colour_texture=Texture.from_linear((base if opaque else np.dstack([base, alphas])).astype(np.float32)),
            metallic_roughness_texture=Texture.from_linear(values.astype(np.float32)),
        )

    def _rest(
        self,
        material: Material,
        stated: GltfMaterial,
        coat: Clearcoat,
        sheen: Sheen,
        pixels: dict[str, np.ndarray | None],
        means: dict[str, np.ndarray],
    ) -> Material:
        """Add emission, relief, clear coat and sheen."""
        return replace(
            material,
            emissive=colour_of(np.array(material.emissive) * means["emissive"][:3]),
            emissive_texture=self._texture(pixels["emissive"], "colour"),
            normal_texture=self._texture(pixels["normal"], "values"),
            normal_scale=1.0 if stated.normalTexture is None else stated.normalTexture.scale,
            clearcoat=coat.clearcoatFactor * float(means["coat"][0]),
            clearcoat_roughness=coat.clearcoatRoughnessFactor * float(means["coat roughness"][1]),
            sheen=colour_of(np.array(sheen.sheenColorFactor) * means["sheen"][:3]),
            sheen_roughness=sheen.sheenRoughnessFactor * float(means["sheen roughness"][3]),
            clearcoat_texture=self._texture(pixels["coat"], "values"),
            clearcoat_roughness_texture=self._texture(pixels["coat roughness"], "values"),
            sheen_texture=self._texture(pixels["sheen"], "colour"),
            sheen_roughness_texture=self._texture(pixels["sheen roughness"], "values"),
        )

    def _with_edges(self, material: Material, slots: dict[str, _Slot | None]) -> Material:
        """Let textures end in their edges where their samplers say so; equal ones are one object."""
        changed: dict[str, Texture] = {}
        for key, name in zip(slots, TEXTURES, strict=True):
            slot, texture = slots[key], getattr(material, f"{name}_texture")
            if slot is not None and texture is not None and any(slot.clamped):
                edged = replace(texture, clamped=slot.clamped)
                changed[f"{name}_texture"] = self._edged.setdefault((texture, slot.clamped), edged)
        return replace(material, **changed)

    def _texture(self, pixels: UInt8[np.ndarray, "h w c"] | None, use: str) -> Texture | None:
        """Make a texture of colour, of colour that ignores alpha, or of values; equal ones are one object."""
        if pixels is None:
            return None
        key = id(pixels), use
        if key not in self._textures:  # the pixels are kept, so that their id stays theirs
            if use == "values":
                made = Texture.from_linear8(pixels)
            else:
                made = Texture.from_srgb8(pixels[..., :3] if use == "opaque" else pixels)
            self._textures[key] = pixels, made
        return self._textures[key][1]


def metal_of(
    diffuse: Float[np.ndarray, "*n 3"], specular: Float[np.ndarray, "*n 3"]
) -> tuple[Float[np.ndarray, "*n 3"], Float[np.ndarray, "*n"]]:
    """Convert diffuse and specular reflectance to base colour and metallic: Khronos' conversion.

    The metallic share m solves: the brightness of the base that the diffuse part asks for is that which the specular
    part asks for, where a dielectric reflects 0.04.
    """
    weights = np.array([0.299, 0.587, 0.114])
    diffuse_light = np.sqrt((diffuse**2 * weights).sum(axis=-1))
    specular_light = np.sqrt((specular**2 * weights).sum(axis=-1))
    left = 1 - specular.max(axis=-1)
    b = diffuse_light * left / (1 - _DIELECTRIC) + specular_light - 2 * _DIELECTRIC
    c = _DIELECTRIC - specular_light
    root = np.sqrt(np.maximum(b * b - 4 * _DIELECTRIC * c, 0))
    metallic = np.where(specular_light < _DIELECTRIC, 0.0, np.clip((root - b) / (2 * _DIELECTRIC), 0, 1))
    m = metallic[..., None]
    of_diffuse = diffuse * (left[..., None] / (1 - _DIELECTRIC)) / np.maximum(1 - m, 1e-6)
    of_specular = (specular - _DIELECTRIC * (1 - m)) / np.maximum(m, 1e-6)
    return np.clip(of_diffuse + (of_specular - of_diffuse) * m * m, 0, 1), metallic


def _with_reflectance(
    material: Material, ior: float, colour: Float[np.ndarray, "3"], label: str, notes: list[Note]
) -> Material:
    """Set the index of refraction whose reflectance is that of `ior` times the specular colour."""
    full = ((ior - 1) / (ior + 1)) ** 2  # 1 for an ior of 0, as its extension says
    reflectance = np.minimum(full * colour, 1.0)
    if (colour == 1).all() and 1 <= ior <= (MAX_IOR if material.transmission == 0 else _MAX_GLASS_IOR):
        return replace(material, ior=ior)
    if material.transmission > 0:
        if not 1 <= ior <= _MAX_GLASS_IOR:
            notes.append(
                Note(f"{label}: an ior of {ior:g} with transmission", "it is a mirror", "use 1 to 3 for glass")
            )
            return replace(material, transmission=0.0, ior=MAX_IOR)
        return replace(material, ior=ior)
    if reflectance.max() - reflectance.min() > 0.02:
        notes.append(
            Note(f"{label}: its coloured reflection", "the reflection is grey", "use metallic for coloured reflections")
        )
    mean = min(float(LUMINANCE @ reflectance), ((MAX_IOR - 1) / (MAX_IOR + 1)) ** 2)
    root = math.sqrt(mean)
    return replace(material, ior=min(max((1 + root) / (1 - root), 1.0), MAX_IOR))


def _without_clear_metal(
    material: Material, factor: float, values: UInt8[np.ndarray, "h w c"] | None, label: str, notes: list[Note]
) -> Material:
    """Return the material with glass where it is no metal; textures count by their means.

    `factor` is the transmission without its texture. Where metal is uneven, that texture is taken to leave it out.
    """
    metals = np.array([255]) if values is None else values[..., 2]
    metallic = material.metallic * float(metals.mean()) / 255
    if material.transmission == 0 or metallic == 0:
        return material
    clear = material.transmission * (1 - metallic)
    if material.metallic * float(metals.std()) > 255 * _EVEN:
        lost = f"{label}: where its glass is metal"
        notes.append(Note(lost, "it is glass everywhere, in the mean share", "give the metal its own material"))
        clear = min(material.transmission, factor * (1 - metallic))
    return replace(material, transmission=clear, metallic=min(material.metallic / (1 - clear), 1.0))


def unlit_of(material: Material) -> Material:
    """Return a surface that emits its base colour and reflects nothing."""
    return replace(
        material,
        base_colour=(0.0, 0.0, 0.0),
        metallic=0.0,
        specular=0.0,
        transmission=0.0,
        clearcoat=0.0,
        sheen=(0.0, 0.0, 0.0),
        emissive=material.base_colour,
        emissive_texture=material.base_colour_texture,
        # its alpha still cuts the surface out
        metallic_roughness_texture=None,
        normal_texture=None,
    )


def _beside_mirror_image(
    pixels: UInt8[np.ndarray, "h w c"], wraps: tuple[int, int], *, colour: bool
) -> UInt8[np.ndarray, "h2 w2 c"]:
    """Return a texture beside its mirror image, at most `MAX_TEXTURE_SIZE` together."""
    height, width = pixels.shape[:2]
    scale = MAX_TEXTURE_SIZE / max(width * (1 + (wraps[0] == MIRRORED)), height * (1 + (wraps[1] == MIRRORED)))
    if scale < 1:
        size = max(1, round(width * scale)), max(1, round(height * scale))
        pixels = _shrunk(pixels, size, colour=colour)
    for axis, wrap in zip((1, 0), wraps, strict=True):
        if wrap == MIRRORED:
            pixels = np.concatenate([pixels, np.flip(pixels, axis)], axis=axis)
    return pixels


def _shrunk(pixels: UInt8[np.ndarray, "h w c"], size: tuple[int, int], *, colour: bool) -> UInt8[np.ndarray, "h2 w2 c"]:
    """Reduce a texture to (width, height) by area; colours in linear light."""
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    if colour:
        linear = srgb8_to_linear(np.ascontiguousarray(pixels[..., :3]))
        small[..., :3] = linear_to_srgb8(cv2.resize(linear, size, interpolation=cv2.INTER_AREA))
    return small


def _matrix(transform: TextureTransform) -> Float[np.ndarray, "3 3"]:
    """Return T R S of KHR_texture_transform; the rotation is counter-clockwise with v down."""
    c, s = math.cos(transform.rotation), math.sin(transform.rotation)
    (x, y), (u, v) = transform.offset, transform.scale
    return np.array([[c * u, s * v, x], [-s * u, c * v, y], [0, 0, 1]])


def _mean_of(pixels: UInt8[np.ndarray, "h w c"], *, of_values: bool = False) -> Float[np.ndarray, "4"]:
    """Return the mean of linear RGB and alpha."""
    linear = pixels[..., :3] / 255.0 if of_values else srgb8_to_linear(pixels[..., :3])
    alpha = pixels[..., 3].mean() / 255 if pixels.shape[2] == 4 else 1.0
    return np.array([*linear.mean(axis=(0, 1)), alpha])


def _resampled(
    pixels: UInt8[np.ndarray, "h w c"], relative: Float[np.ndarray, "3 3"], *, colour: bool = False
) -> UInt8[np.ndarray, "h2 w2 c"]:
    """Return the texture as the common coordinates read it, with as many texels as it repeats."""
    height, width = pixels.shape[:2]
    times = np.maximum(np.abs(relative[:2, :2]).max(axis=0), 1)
    columns = int(min(MAX_TEXTURE_SIZE, width * times[0]))
    rows = int(min(MAX_TEXTURE_SIZE, height * times[1]))
    repeats = np.clip((np.abs(relative[:2, :2]) / [columns, rows]).max(axis=1), 0, 1)  # from one texel to the next
    steps = zip((width, height), repeats.tolist(), strict=True)
    width, height = (round(1 / max(step, 1 / size)) for size, step in steps)
    if (height, width) != pixels.shape[:2]:
        pixels = _shrunk(pixels, (width, height), colour=colour)
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    source_u = (relative[0, 0] * u + relative[0, 1] * v + relative[0, 2]) % 1.0
    source_v = (relative[1, 0] * u + relative[1, 1] * v + relative[1, 2]) % 1.0
    at = [(coordinate * size - 0.5).astype(np.float32) for coordinate, size in ((source_u, width), (source_v, height))]
    return cv2.remap(pixels, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def _planes(
    pixels: UInt8[np.ndarray, "h w c"] | None, size: tuple[int, int], mean: Float[np.ndarray, "4"]
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """Return linear RGB and alpha at a size; without pixels the mean."""
    if pixels is None:
        return np.broadcast_to(mean[:3], (*size, 3)), np.broadcast_to(mean[3], size)
    whole = cv2.resize(pixels, (size[1], size[0]), interpolation=cv2.INTER_LINEAR)
    alpha = whole[..., 3] / 255.0 if whole.shape[2] == 4 else np.ones(size)
    return srgb8_to_linear(np.ascontiguousarray(whole[..., :3])).astype(np.float64), alpha
