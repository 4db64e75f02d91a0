"""glTF's materials and images as `Material` and `Texture`."""

import base64
import binascii
from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from jaxtyping import UInt8

from roomlight.compositing.objects.gltf_schema import Gltf, GltfMaterial, TextureInfo
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.textures import Texture
from roomlight.errors import ImageError, ObjectError
from roomlight.images import peek_size
from roomlight.imaging.limits import check_jpeg, check_png

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"


def read_materials(gltf: Gltf, views: Sequence[memoryview], name: str, limits: ObjectLimits) -> list[Material]:
    """Make the materials; each image is decoded once for each use (colour or values). Raises ObjectError."""
    limits.check("materials", len(gltf.materials), name)
    limits.check("images", len(gltf.images), name)
    images = _Images(gltf, views, name, limits)
    return [_material(one, images, f"{name}: materials.{index}") for index, one in enumerate(gltf.materials)]


def data_uri(uri: str, label: str) -> bytes:
    """Decode a base64 data URI. Raises ObjectError for any other address: nothing outside the file is read."""
    head, comma, body = uri.partition(",")
    if not head.startswith("data:") or not head.endswith(";base64") or not comma:
        raise ObjectError(f"{label} is at {uri[:60]!r}, outside the file; export as one GLB file")
    try:
        return base64.b64decode(body, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ObjectError(f"{label}: its base64 is damaged") from error


class _Images:
    """Decodes images when they are asked for, within the limits."""

    def __init__(self, gltf: Gltf, views: Sequence[memoryview], name: str, limits: ObjectLimits) -> None:
        self._gltf, self._views, self._name, self._limits = gltf, views, name, limits
        self._decoded: dict[tuple[int, str], Texture] = {}
        self._pixels = 0

    def texture(self, info: TextureInfo | None, use: Literal["colour", "values"], label: str) -> Texture | None:
        """Return the texture, sRGB if it holds colour and linear if it holds values."""
        if info is None:
            return None
        if info.texCoord != 0:
            raise ObjectError(f"{label} uses TEXCOORD_{info.texCoord}; only TEXCOORD_0 is read")
        if info.index >= len(self._gltf.textures):
            raise ObjectError(f"{label}: texture {info.index} of {len(self._gltf.textures)} does not exist")
        source = self._gltf.textures[info.index].source
        if source is None or source >= len(self._gltf.images):
            raise ObjectError(f"{label}: texture {info.index} has no PNG or JPEG image")
        if (source, use) not in self._decoded:
            pixels = self._image(source)
            made = Texture.from_srgb8(pixels) if use == "colour" else Texture.from_linear8(pixels)
            self._decoded[source, use] = made
        return self._decoded[source, use]

    def _image(self, index: int) -> UInt8[np.ndarray, "h w c"]:
        label = f"{self._name}: images.{index}"
        data = self._bytes(index, label)
        try:
            if data[:8] == _PNG:
                check_png(data, label)
            elif data[:3] == _JPEG:
                check_jpeg(data, label)
            else:
                raise ObjectError(f"{label} is neither PNG nor JPEG (it starts with {data[:4].hex()})")
            width, height = peek_size(data, label)
        except ImageError as error:
            raise ObjectError(str(error)) from error
        if width < 1 or height < 1:
            raise ObjectError(f"{label} has no pixels")
        self._limits.check("image_pixels", width * height, label)
        self._pixels += width * height
        self._limits.check("total_pixels", self._pixels, label)
        return _decode(data, label, (height, width))

    def _bytes(self, index: int, label: str) -> bytes:
        image = self._gltf.images[index]
        if image.uri is not None:
            return data_uri(image.uri, label)
        if image.bufferView is None or image.bufferView >= len(self._views):
            raise ObjectError(f"{label}: bufferViews.{image.bufferView} of {len(self._views)} does not exist")
        return bytes(self._views[image.bufferView])


def _decode(data: bytes, label: str, size: tuple[int, int]) -> UInt8[np.ndarray, "h w c"]:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ObjectError(f"{label} does not decode ({error.err})") from error
    if image is None or image.shape[:2] != size:  # pyright: ignore[reportUnnecessaryComparison]  (the stub lacks None)
        raise ObjectError(f"{label} does not decode; the file is truncated or damaged")
    if image.dtype == np.uint16:
        image = np.right_shift(image.astype(np.uint16), 8).astype(np.uint8)
    if image.dtype != np.uint8:
        raise ObjectError(f"{label} has values of {image.dtype}; 8 or 16 bits are read")
    if image.ndim == 2:
        image = image[..., None]
    channels = image.shape[2]
    if channels <= 2:
        grey = np.repeat(image[..., :1], 3, axis=2)
        return grey if channels == 1 else np.concatenate([grey, image[..., 1:]], axis=2)
    order = [2, 1, 0, 3] if channels == 4 else [2, 1, 0]
    return np.ascontiguousarray(image[..., order])


def _material(one: GltfMaterial, images: _Images, label: str) -> Material:
    surface, extra = one.pbrMetallicRoughness, one.extensions
    red, green, blue, alpha = surface.baseColorFactor
    strength = extra.KHR_materials_emissive_strength.emissiveStrength
    emissive = tuple(channel * strength for channel in one.emissiveFactor)
    solid = one.alphaMode == "OPAQUE"
    base = images.texture(surface.baseColorTexture, "colour", f"{label}.baseColorTexture")
    if solid and base is not None and base.texels[..., 3].min() < 65535:
        texels = base.texels.copy()
        texels[..., 3] = 65535  # OPAQUE ignores alpha
        base = Texture(texels)
    return Material(
        base_colour=(red, green, blue),
        metallic=surface.metallicFactor,
        roughness=surface.roughnessFactor,
        specular=extra.KHR_materials_specular.specularFactor,
        ior=extra.KHR_materials_ior.ior,
        transmission=extra.KHR_materials_transmission.transmissionFactor,
        opacity=1.0 if solid else alpha,
        alpha_cutoff=one.alphaCutoff if one.alphaMode == "MASK" else None,
        emissive=(emissive[0], emissive[1], emissive[2]),
        base_colour_texture=base,
        metallic_roughness_texture=images.texture(
            surface.metallicRoughnessTexture, "values", f"{label}.metallicRoughnessTexture"
        ),
        normal_texture=images.texture(one.normalTexture, "values", f"{label}.normalTexture"),
        normal_scale=1.0 if one.normalTexture is None else one.normalTexture.scale,
        emissive_texture=images.texture(one.emissiveTexture, "colour", f"{label}.emissiveTexture"),
    )
