"""Images and cameras of ROS messages."""

import re
import struct
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.decoding import decode_depth_map
from roomlight.captures.lenses import Lens, lens_of
from roomlight.conventions import srgb8_to_linear
from roomlight.depth import clean_depth
from roomlight.frame import clipped_pixels
from roomlight.images import MAX_PIXELS, ColourImage, decode_picture

_ORDERS: Final = {
    "rgb8": "RGB",
    "bgr8": "BGR",
    "rgba8": "RGBA",
    "bgra8": "BGRA",
    "8uc3": "BGR",
    "mono8": "L",
    "8uc1": "L",
}
_CONVERSIONS: Final = {  # OpenCV names Bayer patterns by their second row
    "bayer_rggb8": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr8": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGB2RGB,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
    "yuyv": cv2.COLOR_YUV2RGB_YUY2,
}
_PLUMB_BOB: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_MODELS: Final = (
    *("plumb_bob", "radtan", "rational_polynomial"),
    *("brown_conrady", "inverse_brown_conrady", "modified_brown_conrady"),
)
"""Names of OpenCV's polynomial; the last three are librealsense's, whose code projects points by it."""
_FISHEYES: Final = ("equidistant", "fisheye", "kannala_brandt4")
_VIDEO: Final = re.compile("[hx].?26[45]|hevc|avc|av1|vp[89]|theora|ffmpeg")
_NO_DEPTH: Final = "; record them, or let a network estimate depth (--depth network)"
_BENDING: Final = re.compile("fish|equi|kannala|theta|omni|mei|atan|fov|sphere|unified")
"""Words of models that bend lines even where all of D is 0."""


def seconds(header: Any) -> float:
    """Return the time of a header."""
    return float(header.stamp.sec) + float(header.stamp.nanosec) * 1e-9


def pose_values(position: Any, turn: Any) -> Float[np.ndarray, "7"]:
    """Return translation and quaternion (x, y, z, w). Raises ValueError."""
    numbers = [position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w]
    return fields.coordinates(numbers, "a pose")


def camera_of(info: Any, size: tuple[int, int], *, raw: bool) -> Intrinsics:
    """Return the camera of images of this width and height: K of raw ones, P of rectified ones. Raises ValueError.

    Both are of the whole sensor: where an image has the size of `roi` after binning, the camera is that part's.
    """
    k, p = _matrix(info, "k"), _matrix(info, "p")
    fx, fy, cx, cy = (k[0], k[4], k[2], k[5]) if raw or not p[0] else (p[0], p[5], p[2], p[6])
    camera = Intrinsics(fx, fy, cx + 0.5, cy + 0.5, int(info.width), int(info.height))
    roi = info.roi
    window = int(roi.width) or camera.width, int(roi.height) or camera.height
    binned = window[0] // max(1, int(info.binning_x)), window[1] // max(1, int(info.binning_y))
    if size != binned:
        return camera
    return Intrinsics(fx, fy, camera.cx - roi.x_offset, camera.cy - roi.y_offset, *window).resized(*binned)


def lens_of_raw(info: Any) -> Lens:
    """Return the lens of raw images: D. Raises ValueError for a model that is not read, by name."""
    d, model = _matrix(info, "d"), re.sub(r"[\s-]+", "_", info.distortion_model.strip().lower())
    keys = ("k1", "k2", "k3", "k4") if model in _FISHEYES else _PLUMB_BOB
    known = model in (*_FISHEYES, *_MODELS) or not (any(d) or _BENDING.search(model))
    if not known or any(d[len(keys) :]):
        raise ValueError(
            f"distortion_model {info.distortion_model[:40]!r} with D of {len(d)} values is not read, but plumb_bob, "
            "rational_polynomial of 8 and equidistant of 4; rectify the images (image_proc), or calibrate it as such"
        )
    stated: dict[str, Any] = dict(zip(keys, d, strict=False))
    if len(keys) == 4 and stated:
        stated["camera_model"] = "OPENCV_FISHEYE"
    elif len(d) > 5:
        stated["camera_model"] = "FULL_OPENCV"
    return lens_of(stated, {})


def _matrix(info: Any, key: str) -> list[float]:
    """Return K, D or P, whose names ROS 2 writes in small letters."""
    return np.asarray(getattr(info, key, getattr(info, key.upper(), ()))).tolist()


def decode_colour_image(message: Any, label: str) -> ColourImage:
    """Decode an Image or a CompressedImage. Raises ValueError and ImageError."""
    if hasattr(message, "format"):
        if _VIDEO.search(message.format.lower()):
            raise ValueError(f"colour of {message.format[:40]!r} is a video's, which is not read; record JPEG or PNG")
        picture = decode_picture(bytes(message.data), label, as_stored=True)
        if message.format.startswith("bayer_") and not np.ptp(picture.image, axis=2).any():
            mosaic = message.format.split(";")[0][:40]
            raise ValueError(f"colour of {mosaic!r}, compressed, is not read; debayer the images (image_proc)")
        return picture
    encoding = message.encoding.lower()
    if encoding in _CONVERSIONS:
        values = _rows(message, np.dtype(np.uint8), 1 if "bayer" in encoding else 2)
        rgb = cv2.cvtColor(values, _CONVERSIONS[encoding])
    elif encoding in _ORDERS:
        order = _ORDERS[encoding]
        values = _rows(message, np.dtype(np.uint8), len(order))
        rgb = np.ascontiguousarray(values[..., [order.index(key) if key in order else 0 for key in "RGB"]])
    else:
        raise ValueError(f"colour of {message.encoding[:40]!r} is not read; record rgb8 or bgr8")
    return ColourImage(srgb8_to_linear(rgb), clipped_pixels(rgb))


def is_colour(message: Any) -> bool:
    """Whether an Image or a CompressedImage has an encoding of colours."""
    if hasattr(message, "format"):
        return any(word in message.format.lower() for word in ("rgb", "bgr", "mono8", "8uc", "jpeg", "jpg"))
    return message.encoding.lower() in (*_ORDERS, *_CONVERSIONS)


def is_range(message: Any) -> bool:
    """Whether a message is an Image of an encoding that distances have."""
    return getattr(message, "encoding", "").lower() in ("16uc1", "32fc1")


def decode_depth_image(message: Any, label: str, unit_m: float | None) -> Float[np.ndarray, "h w"]:
    """Return depth in metres of an Image or a CompressedImage (compressedDepth). Raises ValueError and ImageError."""
    if hasattr(message, "format"):  # 12 bytes of parameters, then a PNG
        data = bytes(message.data)
        at = data.find(b"\x89PNG", 0, 64)
        if at < 0 and data[:4] in (b"II*\0", b"MM\0*"):  # iai_kinect2's
            return decode_depth_map(data, label, unit_m=unit_m)
        inverse = "32FC1" in message.format
        if at < 0 or (inverse and at != 12):
            what = f"compressed depth of {message.format[:40]!r}"
            raise ValueError(f"{what} is not read, but 16UC1 and 32FC1 as PNG{_NO_DEPTH}")
        if not inverse:
            return decode_depth_map(data[at:], label, unit_m=unit_m)
        scale, offset = struct.unpack("<4x2f", data[:at])
        stored = decode_depth_map(data[at:], label, unit_m=1.0)
        with np.errstate(all="ignore"):
            return clean_depth(np.where(stored > 0, scale / (stored - offset) * np.float32(unit_m or 1.0), 0))
    kinds = {"16uc1": ("u2", 0.001), "mono16": ("u2", 0.001), "32fc1": ("f4", 1.0)}
    if message.encoding.lower() not in kinds:
        raise ValueError(f"depth of {message.encoding[:40]!r} is not read, but 16UC1 and 32FC1{_NO_DEPTH}")
    kind, default_m = kinds[message.encoding.lower()]
    stored = _rows(message, np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<"), 1)[..., 0]
    with np.errstate(over="ignore", invalid="ignore"):
        metres = stored.astype(np.float32) * np.float32(unit_m or default_m)
    if kind == "u2":
        metres[stored == 65535] = 0.0
    return clean_depth(metres)


def _rows(message: Any, dtype: np.dtype, channels: int) -> np.ndarray:
    """Return an image's values [h, w, channels]. Raises ValueError for a size that does not fit its bytes."""
    height, width, data = int(message.height), int(message.width), np.asarray(message.data, np.uint8)
    item = channels * dtype.itemsize
    step = int(message.step) or width * item
    if not 0 < height * width <= MAX_PIXELS or step < width * item or step * height > len(data):
        raise ValueError(f"{len(data)} bytes are no image of {width} x {height} {message.encoding[:20]}")
    lines = data[: step * height].reshape(height, step)[:, : width * item]
    return np.ascontiguousarray(lines).view(dtype).reshape(height, width, channels)
