"""Lens models of index files, and their removal: a pinhole camera remains.

The models of COLMAP, nerfstudio and instant-ngp that OpenCV knows are removed; the others (panoramas, orthographic
pictures, Aria's FISHEYE624, F-theta) are refused by name, because a pinhole in their place is wrong by tens of degrees.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.errors import FrameError
from roomlight.images import ColourImage
from roomlight.notes import Note

_PERSPECTIVE: Final = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "PERSPECTIVE"),
    *("PLUMB_BOB", "RADTAN", "BROWN"),
)
_FISHEYE: Final = (
    "OPENCV_FISHEYE",
    "OPENCVFISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "FISHEYE",
    "SIMPLE_FISHEYE",
    "EQUIDISTANT",
    "KANNALA_BRANDT",
    "KB4",
)
_NAMES: Final = ("file_path", "depth_file_path", "depth_path", "mask_path", "name")
_FOREIGN_KEY: Final = re.compile(
    r"ftheta|(equirectangular|orthographic|latlong|fisheye|xi|s[1-4]|b[12]|skew)$|dist(ortion)?_?(coef|param)"
)
"""Keys of lenses that no pinhole stands for."""
_FOREIGN_LENS: Final = re.compile(r"fish.?eye|equirect|equidistant|panoram|spherical|omnidir|orthograph|kannala", re.I)
COEFFICIENTS: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Keys of a lens in OpenCV's order."""
_MODEL_KEYS: Final = ("camera_model", "lens_mode", "lens", "model", "camera_type", "distortion_model")
_MAX_TANGENT: Final = math.tan(math.radians(60))
"""A straightened camera sees at most 120 degrees: beyond it pixels at the edge are stretched four times."""
_HORIZON: Final = math.tan(math.radians(84.9))
_MAX_ERROR_PX: Final = 0.25
_MOST_RESAMPLED: Final = 16
_SHRINKS: Final = 12
"""Steps of 5 % by which the view is reduced until the lens model can be inverted everywhere."""
MODEL_KEYS: Final = (*_MODEL_KEYS, *COEFFICIENTS, "is_fisheye", "distortion_params", "distortion", "ortho")


@dataclass(frozen=True)
class Lens:
    """A lens: OpenCV's model and its coefficients.

    Attributes:
        coefficients: k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4 of a fisheye.
        fisheye: Whether it is OpenCV's fisheye model (equidistant), which bends also with coefficients of 0.
    """

    coefficients: tuple[float, ...] = ()
    fisheye: bool = False

    @property
    def straight(self) -> bool:
        """Whether the lens is a pinhole."""
        return not self.fisheye and not any(self.coefficients)


def fitted(picture: ColourImage, intrinsics: Intrinsics, name: str) -> tuple[ColourImage, Intrinsics]:
    """Return the camera at the picture's size if that is the same view resampled, and note it.

    Trainers keep halves and quarters of their pictures beside the intrinsics of the whole ones.

    Raises:
        FrameError: It is the view of the picture turned, as EXIF may show it.
    """
    height, width = picture.image.shape[:2]
    stated = intrinsics.width, intrinsics.height
    if width != height and stated == (height, width):
        exif = next((note.left_out for note in picture.notes if ": EXIF orientation" in note.left_out), name)
        raise FrameError(
            f"{exif}: the image is stored as {width} x {height} but its intrinsics are for {height} x {width}, the "
            "image turned; turn its pixels (and depth), or give the intrinsics and the pose of the stored image"
        )
    difference = abs(width * stated[1] - height * stated[0])
    if (width, height) == stated or difference > max(stated) or max(stated) > _MOST_RESAMPLED * max(width, height):
        return picture, intrinsics
    note = Note(
        f"{name}: is {width} x {height}, its intrinsics are for {stated[0]} x {stated[1]}",
        "the camera is scaled to the picture",
        "nothing to do if the picture was resampled; a part of a larger one needs its own cx and cy",
    )
    return replace(picture, notes=(*picture.notes, note)), intrinsics.resized(width, height)


def lens_of(entry: Mapping[str, Any], shared: Mapping[str, Any]) -> Lens:
    """Read the lens of a frame; its own keys override those of all frames.

    Raises:
        ValueError: The model is not read, or a coefficient is out of range; names the model.
    """
    stated = fields.first_of(entry, shared, *_MODEL_KEYS)
    model = str(stated or "").strip().upper().replace("-", "_").replace(" ", "_")
    fisheye = fields.flag(fields.first_of(entry, shared, "is_fisheye")) or model in _FISHEYE
    if model and not fisheye and model not in _PERSPECTIVE:
        raise ValueError(f"camera_model {stated!r} is not read; undistort the images to a pinhole camera first")
    for key in sorted({*entry, *shared} - {*MODEL_KEYS, *_NAMES}):
        value = fields.first_of(entry, shared, key)
        if _is_set(value) and (_FOREIGN_KEY.match(key) or (isinstance(value, str) and _FOREIGN_LENS.search(value))):
            raise ValueError(
                f"the lens of {key!r} ({str(value)[:40]}) is not read; state camera_model with k1, k2, p1, p2; or "
                "undistort the images to a pinhole camera first"
            )
    listed = fields.first_of(entry, shared, "distortion_params", "distortion")
    if isinstance(listed, list) and any(listed):
        raise ValueError(
            f"distortion_params of {len(listed)} values is not read; state k1, k2, p1, p2 or undistort the images"
        )
    values = {key: fields.of_text(fields.first_of(entry, shared, key)) for key in COEFFICIENTS}
    known = {key: 0.0 if value is None else fields.number(value, key) for key, value in values.items()}
    if max(abs(value) for value in known.values()) > 100:
        raise ValueError(f"the lens distortion {known} is out of range; coefficients are at most 100")
    if fisheye:
        if known["p1"] or known["p2"]:
            raise ValueError("a fisheye lens with p1 and p2 is not read; undistort the images first")
        return Lens(tuple(known[key] for key in ("k1", "k2", "k3", "k4")), fisheye=True)
    if known["k4"] and not (known["k5"] or known["k6"] or model == "FULL_OPENCV"):
        raise ValueError(
            "k4 of a polynomial lens (Metashape, RealityCapture) is not read; undistort the images, or state is_fisheye"
        )
    return Lens(tuple(known[key] for key in COEFFICIENTS))


def undistorted(
    images: list[tuple[np.ndarray, int]], intrinsics: Intrinsics, lens: Lens
) -> tuple[list[np.ndarray], Intrinsics]:
    """Remove lens distortion from images of one view, each given with its OpenCV interpolation.

    The new camera is cropped to pixels that the old one saw: black padding would count as measured darkness. Width and
    aspect of pixels stay, the height follows the view. Images may differ in size; each uses K scaled to its own size.

    Raises:
        ValueError: The lens bends back on itself within the image, or sees too little to be straightened.
    """
    straight = _straight_camera(intrinsics, lens)
    results: list[np.ndarray] = []
    for image, interpolation in images:
        height, width = image.shape[:2]
        size = width, max(2, round(height * straight.height / intrinsics.height))
        old_k, new_k = _opencv_matrix(intrinsics.resized(width, height)), _opencv_matrix(straight.resized(*size))
        build = cv2.fisheye.initUndistortRectifyMap if lens.fisheye else cv2.initUndistortRectifyMap
        columns, rows = build(old_k, np.array(lens.coefficients), np.eye(3), new_k, size, cv2.CV_32FC1)
        results.append(cv2.remap(image, columns, rows, interpolation, borderMode=cv2.BORDER_REPLICATE))
    return results, straight


def straightened(
    picture: ColourImage, depth_m: Float[np.ndarray, "dh dw"], intrinsics: Intrinsics, lens: Lens, name: str
) -> tuple[ColourImage, Float[np.ndarray, "rows dw"], Intrinsics, Intrinsics]:
    """Remove lens distortion from a picture and its depth; returns them with the pinhole camera, and `fitted`'s.

    Raises:
        FrameError: As `fitted`.
        ValueError: As `undistorted`.
    """
    picture, stated = fitted(picture, intrinsics, name)
    if lens.straight or picture.image.shape[:2] != (stated.height, stated.width):
        return picture, depth_m, stated, stated
    views = [
        (picture.image, cv2.INTER_LINEAR),
        (picture.clipped.astype(np.uint8), cv2.INTER_NEAREST),
        (depth_m, cv2.INTER_NEAREST),
    ]
    if picture.seen is not None:
        views.append((picture.seen.astype(np.uint8), cv2.INTER_NEAREST))
    (image, clipped, depth, *seen), straight = undistorted(views, stated, lens)
    mask = seen[0] > 0 if seen else None
    return replace(picture, image=image, clipped=clipped > 0, seen=mask), depth, straight, stated


def _straight_camera(intrinsics: Intrinsics, lens: Lens) -> Intrinsics:
    """Return the pinhole camera whose view lies within the lens's, checked by the way back; of the same pixel aspect.

    Corners that the lens model cannot reach are left out.
    """
    width, height = intrinsics.width, intrinsics.height
    steps = np.linspace(0, 1, 65)[:, None]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64)
    bounds: list[float] = []
    for start, end, axis in ((0, 3, 0), (0, 1, 1), (1, 2, 0), (3, 2, 1)):  # left, top, right, bottom
        side = corners[start] + (corners[end] - corners[start]) * steps
        tangents = _tangents(side, intrinsics, lens)
        reached = np.abs(_pixels(tangents, intrinsics, lens) - side).max(axis=1) < _MAX_ERROR_PX
        if lens.fisheye:
            reached |= np.hypot(*tangents.T) > _HORIZON
        if not reached[32]:
            raise ValueError("the lens distortion folds the image: its coefficients do not fit fl_x and the size")
        inner = np.clip(tangents[reached, axis], -_MAX_TANGENT, _MAX_TANGENT)
        bounds.append(float(inner.max() if start == 0 else inner.min()))
    for _ in range(_SHRINKS):
        x0, y0, x1, y1 = bounds
        if not (x0 < 0 < x1 and y0 < 0 < y1):
            break
        fx = width / (x1 - x0)
        fy = fx * intrinsics.fy / intrinsics.fx
        rows = 2 * max(1, round(fy * (y1 - y0) / 2))  # even, as films need
        grid = np.stack(np.meshgrid(np.linspace(x0, x1, 17), np.linspace(y0, y1, 17)), axis=-1).reshape(-1, 2)
        pixels = _pixels(grid, intrinsics, lens)
        error_px = np.abs((_tangents(pixels, intrinsics, lens) - grid) * [fx, fy]).max()
        if error_px < _MAX_ERROR_PX and (pixels > -1).all() and (pixels < [width + 1, height + 1]).all():
            return Intrinsics(fx, fy, -x0 * fx, (rows - (y0 + y1) * fy) / 2, width, rows)
        bounds = [0.95 * bound for bound in bounds]
    raise ValueError("the lens distortion cannot be undone; undistort the images to a pinhole camera first")


def _tangents(pixels: Float[np.ndarray, "n 2"], intrinsics: Intrinsics, lens: Lens) -> Float[np.ndarray, "n 2"]:
    """Return where pixels look on the plane z = 1; rays of 85 degrees and more, and none at all, lie at its bound."""
    k, coefficients = _opencv_matrix(intrinsics), np.array(lens.coefficients)
    points = (pixels - 0.5)[:, None].astype(np.float64)
    if not lens.fisheye:
        tangents = cv2.undistortPoints(points, k, coefficients)[:, 0]
        for _ in range(30):  # OpenCV stops after five steps
            tangents = tangents + (pixels - _pixels(tangents, intrinsics, lens)) / np.diag(k)[:2]
        return tangents
    # OpenCV gives up on rays near 90 degrees; the radius of an equidistant lens is inverted by a table here.
    offset = (points[:, 0] - k[:2, 2]) / np.diag(k)[:2]
    radius = np.hypot(*offset.T)
    angles = np.linspace(0, math.radians(85), 2000)
    radii = _fisheye_radius(angles, lens)
    end = int(np.argmax(np.diff(radii) <= 0)) if (np.diff(radii) <= 0).any() else len(radii) - 1
    angle = np.interp(radius, radii[: end + 1], angles[: end + 1])
    return offset * (np.tan(angle) / np.maximum(radius, 1e-12))[:, None]


def _fisheye_radius(angle: Float[np.ndarray, " n"], lens: Lens) -> Float[np.ndarray, " n"]:
    squared = angle**2
    return angle * (1 + sum(k * squared ** (power + 1) for power, k in enumerate(lens.coefficients)))


def _pixels(tangents: Float[np.ndarray, "n 2"], intrinsics: Intrinsics, lens: Lens) -> Float[np.ndarray, "n 2"]:
    """Project points of the plane z = 1 through the lens (OpenCV)."""
    k, coefficients = _opencv_matrix(intrinsics), np.array(lens.coefficients)
    if lens.fisheye:
        return cv2.fisheye.distortPoints(tangents[:, None], k, coefficients)[:, 0] + 0.5
    points = np.concatenate([tangents, np.ones((len(tangents), 1))], axis=1)
    return cv2.projectPoints(points[:, None], np.zeros(3), np.zeros(3), k, coefficients)[0][:, 0] + 0.5


def _opencv_matrix(camera: Intrinsics) -> Float[np.ndarray, "3 3"]:
    """Return K with pixel centres at whole numbers, as OpenCV expects."""
    return np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]], np.float64)


def _is_set(value: object) -> bool:
    """Whether a key's value is more than its default."""
    if isinstance(value, list):
        return any(map(_is_set, value))
    return value is not None and value is not False and value != 0
