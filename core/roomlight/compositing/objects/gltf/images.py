"""Images of a glTF, decoded when they are asked for and within the limits. Colour profiles count for nothing: glTF
defines what its textures hold."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import UInt8

from roomlight.compositing.objects.beside import FilesBeside
from roomlight.compositing.objects.gltf.container import resource
from roomlight.compositing.objects.gltf.ktx2 import KTX2, decode_ktx2
from roomlight.compositing.objects.gltf.schema import Gltf, Sampler
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.pictures import PictureReader
from roomlight.errors import ObjectError

_SOURCES = ("EXT_texture_webp", "EXT_texture_avif")
_BASIS = "KHR_texture_basisu"
REPEAT, MIRRORED, CLAMPED = 10497, 33648, 33071
_NEAREST = 9728


class Images:
    """The images behind a file's textures."""

    def __init__(
        self, gltf: Gltf, views: Sequence[memoryview], beside: FilesBeside, name: str, limits: ObjectLimits
    ) -> None:
        limits.check("images", len(gltf.images), name)
        self._beside = beside
        self._gltf, self._views, self._name = gltf, views, name
        self._decoded: dict[int, UInt8[np.ndarray, "h w c"]] = {}
        self._pictures = PictureReader(limits)

    def pixels(self, texture: int, label: str) -> UInt8[np.ndarray, "h w c"] | None:
        """Return a texture's 8-bit RGB or RGBA; None if it is KTX2 that is not read (`gltf.ktx2`).

        Raises:
            ObjectError: There is no such texture, it does not decode, or it passes a limit.
        """
        if texture >= len(self._gltf.textures):
            raise ObjectError(f"{label}: texture {texture} of {len(self._gltf.textures)} does not exist")
        stated = self._gltf.textures[texture]
        extensions = [stated.extensions[key] for key in _SOURCES if isinstance(stated.extensions.get(key), dict)]
        sources = (*(extension.get("source") for extension in extensions), stated.source)
        basis = stated.extensions.get(_BASIS)
        if isinstance(basis, dict):
            sources = (*sources, basis.get("source"))
        source = next((index for index in sources if isinstance(index, int)), None)
        if source is None or not 0 <= source < len(self._gltf.images):
            raise ObjectError(f"{label}: texture {texture} has no image")
        if source not in self._decoded:
            image = self._image(source)
            if image is None:
                return None
            self._decoded[source] = image
        return self._decoded[source]

    def wraps(self, texture: int) -> tuple[int, int]:
        """Return how a texture goes on outside [0, 1] across and down: REPEAT, MIRRORED or CLAMPED."""
        sampler = self._sampler(texture)
        return sampler.wrapS, sampler.wrapT

    def is_nearest(self, texture: int) -> bool:
        """Return whether texels have edges from near."""
        return self._sampler(texture).magFilter == _NEAREST

    def _sampler(self, texture: int) -> Sampler:
        stated = self._gltf.textures[texture] if texture < len(self._gltf.textures) else None
        if stated is None or stated.sampler is None or stated.sampler >= len(self._gltf.samplers):
            return Sampler()
        return self._gltf.samplers[stated.sampler]

    def _image(self, index: int) -> UInt8[np.ndarray, "h w c"] | None:
        label = f"{self._name}: images.{index}"
        data = self._bytes(index, label)
        if data[:8] == KTX2:
            return decode_ktx2(data, label, partial(self._pictures.count, label=label))
        return self._pictures.read(data, label)

    def _bytes(self, index: int, label: str) -> bytes:
        image = self._gltf.images[index]
        if image.uri is not None:
            return resource(image.uri, self._beside, label)
        if image.bufferView is None or image.bufferView >= len(self._views):
            raise ObjectError(f"{label}: bufferViews.{image.bufferView} of {len(self._views)} does not exist")
        return bytes(self._views[image.bufferView])
