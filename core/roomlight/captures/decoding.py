"""Depth, confidence and pinhole parameters as the phone and robot formats store them. Metres and pixels."""

import io

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from roomlight.camera import Intrinsics
from roomlight.captures.source import FolderSource
from roomlight.depth import clean_depth
from roomlight.errors import ImageError
from roomlight.images import MAX_PIXELS, decode_colour, decode_depth, decode_grey8


def read_rgbd(
    source: FolderSource, colour_name: str, depth_name: str, *, unit_m: float
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"], Float[np.ndarray, "dh dw"]]:
    """Read one record's linear image, its mask of clipped pixels and its depth in metres (0 = unknown)."""
    image, clipped = decode_colour(source.read(colour_name), source.label(colour_name))
    depth_m = decode_depth_map(source.read(depth_name), source.label(depth_name), unit_m=unit_m)
    return image, clipped, depth_m


def decode_depth_map(data: bytes, label: str, *, unit_m: float) -> Float[np.ndarray, "h w"]:
    """Decode depth in metres (0 = unknown) from 16-bit PNG or .npy in units of `unit_m`, or float EXR in metres.

    Raises:
        ImageError: The data is damaged, too large or no depth map; the message begins with `label`.
    """
    if data[:6] != b"\x93NUMPY":
        return decode_depth(data, label, unit_m=unit_m)
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream, max_header_size=4096)
        if len(shape) != 2 or dtype.kind not in "uif" or not 0 < shape[0] * shape[1] <= MAX_PIXELS:
            raise ImageError(f"{label}: depth must be an array [h, w] of numbers, this is {dtype} {shape}")
        stream.seek(0)
        depth = np.load(stream, allow_pickle=False)
    except (ValueError, EOFError, SyntaxError, OSError, TypeError) as error:
        raise ImageError(f"{label}: the .npy file is damaged ({error})") from error
    with np.errstate(over="ignore", invalid="ignore"):
        return clean_depth((depth.astype(np.float64) * unit_m).astype(np.float32))


def decode_confidence(data: bytes, label: str) -> UInt8[np.ndarray, "h w"]:
    """Decode confidence levels from an 8-bit grey PNG. Raises ImageError."""
    return decode_grey8(data, label)


def intrinsics_without_size(
    matrix: Float[np.ndarray, "3 3"], *, width: int, height: int, shift: float = 0.0
) -> Intrinsics:
    """Build intrinsics from a K that is stored without an image size, for an image of this size.

    Args:
        matrix: K, in pixels.
        width: The image's width in pixels.
        height: The image's height in pixels.
        shift: Added to the principal point: 0.5 for a K with pixel centres at whole numbers (OpenCV).

    Raises:
        ValueError: The principal point is far from the image's centre, so K is for another size.
    """
    cx, cy = float(matrix[0, 2]) + shift, float(matrix[1, 2]) + shift
    if not (0.2 * width <= cx <= 0.8 * width and 0.2 * height <= cy <= 0.8 * height):
        raise ValueError(
            f"the image is {width} x {height} but its principal point would be ({cx:g}, {cy:g}): "
            "the intrinsics are for another size"
        )
    return Intrinsics(float(matrix[0, 0]), float(matrix[1, 1]), cx, cy, width, height)


def undistorted(
    images: list[tuple[np.ndarray, int]], intrinsics: Intrinsics, *, coefficients: list[float], fisheye: bool
) -> tuple[list[np.ndarray], Intrinsics]:
    """Remove lens distortion from images of one view, each given with its OpenCV interpolation.

    The new camera is cropped to pixels that the old one saw: black padding would count as measured darkness.
    Images may differ in size; each uses K scaled to its own size.
    """
    size = (intrinsics.width, intrinsics.height)
    distortion = np.array(coefficients, np.float64)
    matrix = _opencv_matrix(intrinsics)
    if fisheye:
        new = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(matrix, distortion, size, np.eye(3), balance=0.0)
    else:
        new, _ = cv2.getOptimalNewCameraMatrix(matrix, distortion, size, 0)
    straight = Intrinsics(float(new[0, 0]), float(new[1, 1]), float(new[0, 2]) + 0.5, float(new[1, 2]) + 0.5, *size)
    results: list[np.ndarray] = []
    for image, interpolation in images:
        height, width = image.shape[:2]
        old_k, new_k = (_opencv_matrix(camera.resized(width, height)) for camera in (intrinsics, straight))
        build = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
        columns, rows = build(old_k, distortion, np.eye(3), new_k, (width, height), cv2.CV_32FC1)
        results.append(cv2.remap(image, columns, rows, interpolation, borderMode=cv2.BORDER_REPLICATE))
    return results, straight


def _opencv_matrix(camera: Intrinsics) -> Float[np.ndarray, "3 3"]:
    """Return K with pixel centres at whole numbers, as OpenCV expects."""
    return np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]], np.float64)
