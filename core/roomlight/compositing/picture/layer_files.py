"""Composited frames as files: one picture, or the layers apart."""

from collections.abc import Mapping
from typing import Final, Literal

import cv2
import numpy as np

from roomlight.compositing.picture.layers import Composite
from roomlight.errors import OutputError
from roomlight.images import encode_channel_exr, encode_exr, encode_png

PictureFormat = Literal["png", "jpeg", "exr"]
PICTURE_ENDINGS: Final[dict[PictureFormat, str]] = {"png": "png", "jpeg": "jpg", "exr": "exr"}
LAYER_FILES: Final = ("image.png", "frame.exr", "objects.exr", "alpha.png", "shadow.exr", "depth.exr", "object_id.exr")
_JPEG_QUALITY: Final = 95


def layer_path(layer: str, number: str) -> str:
    """Return where a layer of a recording's frame is, a folder each: programs want a sequence's number at the end."""
    name, ending = layer.split(".")
    return f"{name}/{name}.{number}.{ending}"


def encode_picture(
    made: Composite, picture_format: PictureFormat, *, metadata: Mapping[str, object] | None = None
) -> bytes:
    """Encode the composite: png and jpeg are 8-bit sRGB, exr is linear radiance without added noise (half floats).

    `metadata` goes into the header of an EXR file.

    Raises:
        OutputError: The picture cannot be encoded.
    """
    if picture_format == "exr":
        return encode_exr(made.radiance, metadata=metadata)
    if picture_format == "png":
        return encode_png(made.image)
    ok, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(made.image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    if not ok:
        raise OutputError(f"a JPEG of {made.image.shape[1]} x {made.image.shape[0]} cannot be encoded")
    return data.tobytes()


def encode_layers(made: Composite, *, metadata: Mapping[str, object] | None = None) -> dict[str, bytes]:
    """Encode the layers by file name; `frame x shadow x (1 - alpha) + objects` is the composite in linear radiance.

    The objects' file has alpha as the channel A too; depth is the channel Z and `object_id` the channel id, in floats.
    `metadata` goes into the headers of EXR files.

    Raises:
        OutputError: A layer cannot be encoded.
    """
    alpha = np.clip(made.alpha, 0, 1)
    layers = (
        encode_png(made.image),
        encode_exr(made.plate, metadata=metadata),
        encode_exr(np.dstack([made.objects, alpha]), metadata=metadata),
        encode_png(np.rint(alpha * 65535).astype(np.uint16)),
        encode_exr(made.shadow, metadata=metadata),
        encode_channel_exr("Z", made.depth_m, metadata=metadata),
        encode_channel_exr("id", made.object_id, metadata=metadata),
    )
    return dict(zip(LAYER_FILES, layers, strict=True))
