"""Images of a glTF, decoded when they are asked for and within the limits. Colour profiles count for nothing: glTF
defines what its textures hold."""

import io
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from roomlight.compositing.objects.gltf.container import data_uri
from roomlight.compositing.objects.gltf.schema import Gltf
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import ImageError, ObjectError
from roomlight.images import peek_size
from roomlight.imaging.limits import check_png

_PNG, _JPEG, _KTX2 = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"\xabKTX 20\xbb"
_SOURCES = ("EXT_texture_webp", "EXT_texture_avif")
REPEAT = 10497


class Images:
    """The images behind a file's textures."""

    def __init__(self, gltf: Gltf, views: Sequence[memoryview], name: str, limits: ObjectLimits) -> None:
        limits.check("images", len(gltf.images), name)
        self._gltf, self._views, self._name, self._limits = gltf, views, name, limits
        self._decoded: dict[int, UInt8[np.ndarray, "h w c"]] = {}
        self._pixels = 0

    def pixels(self, texture: int, label: str) -> UInt8[np.ndarray, "h w c"] | None:
        """Return a texture's 8-bit RGB or RGBA; None if it is stored in a form that is not read (KTX2).

        Raises:
            ObjectError: There is no such texture, it does not decode, or it passes a limit.
        """
        if texture >= len(self._gltf.textures):
            raise ObjectError(f"{label}: texture {texture} of {len(self._gltf.textures)} does not exist")
        stated = self._gltf.textures[texture]
        extensions = [stated.extensions[key] for key in _SOURCES if isinstance(stated.extensions.get(key), dict)]
        sources = (*(extension.get("source") for extension in extensions), stated.source)
        source = next((index for index in sources if isinstance(index, int)), None)
        if source is None and "KHR_texture_basisu" in stated.extensions:
            return None
        if source is None or not 0 <= source < len(self._gltf.images):
            raise ObjectError(f"{label}: texture {texture} has no image")
        if source not in self._decoded:
            image = self._image(source)
            if image is None:
                return None
            self._decoded[source] = image
        return self._decoded[source]

    def repeats(self, texture: int) -> bool:
        """Return whether a texture repeats outside [0, 1] in both directions."""
        stated = self._gltf.textures[texture] if texture < len(self._gltf.textures) else None
        if stated is None or stated.sampler is None or stated.sampler >= len(self._gltf.samplers):
            return True
        sampler = self._gltf.samplers[stated.sampler]
        return sampler.wrapS == REPEAT and sampler.wrapT == REPEAT

    def _image(self, index: int) -> UInt8[np.ndarray, "h w c"] | None:
        label = f"{self._name}: images.{index}"
        data = self._bytes(index, label)
        if data[:8] == _KTX2:
            return None
        try:
            if data[:8] == _PNG:
                check_png(data, label)
            width, height = (
                peek_size(data, label) if data[:8] == _PNG or data[:3] == _JPEG else _other_size(data, label)
            )
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


def _other_size(data: bytes, label: str) -> tuple[int, int]:
    """Read (width, height) of WebP or AVIF. Raises ObjectError for other files."""
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP", "AVIF")) as image:
            return image.size
    except Exception as error:  # Pillow raises whatever the damaged bytes lead to
        raise ObjectError(f"{label} is neither PNG, JPEG, WebP nor AVIF (it starts with {data[:4].hex()})") from error


def _decode(data: bytes, label: str, size: tuple[int, int]) -> UInt8[np.ndarray, "h w c"]:
    if data[:8] != _PNG and data[:3] != _JPEG:
        try:
            with Image.open(io.BytesIO(data)) as picture:
                return np.asarray(picture.convert("RGBA" if "A" in picture.getbands() else "RGB"))
        except Exception as error:  # as above
            raise ObjectError(f"{label} does not decode ({error})") from error
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
