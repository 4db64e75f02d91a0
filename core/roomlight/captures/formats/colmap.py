"""A COLMAP model with images and depth: `sparse/0/{cameras,images}.{bin,txt}`, `images/NAME` and `depth/STEM.png`.

COLMAP knows neither metres nor gravity: a capture must have been scaled to metres, unless camera_height_m is given, and
its up direction is assumed to be -y, that of a camera held level; both are noted. Depth maps lie in `depth`, `depths`
or `depth_maps`, named like the image, in the model's unit (integers: a thousandth of it); or COLMAP's own,
`stereo/depth_maps/NAME.geometric.bin`. Those of a folder `dense` are read with its `sparse` and `images`, which are
undistorted. Beside a model's `depth_params.json` of 3D Gaussian splatting they are relative: 1 / depth is a value of 16
bits / 65536 x scale + offset. Pixels that are 0 in `masks/NAME.png` are not seen.

Conventions: world-to-camera quaternions (w, x, y, z), OpenCV camera. Principal points have pixel centres at half
integers and are used unchanged. Lens models are those of `roomlight.captures.lenses`.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import TextIOWrapper
from itertools import islice
from pathlib import Path, PurePosixPath
from statistics import median
from typing import Any, BinaryIO, Final

import numpy as np
from jaxtyping import Float, UInt16

from roomlight.camera import Intrinsics, pose_from_quaternion
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame
from roomlight.captures.decoding import DEPTH_SUFFIXES, read_mask, read_picture, read_rgbd, with_mask
from roomlight.captures.formats.listed import ListedReader, files_of
from roomlight.captures.lenses import Lens, lens_of, straightened
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES, read_index
from roomlight.depth import clean_depth
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.images import decode_grey16
from roomlight.notes import Note

_DISTORTED: Final = "distorted/sparse/0"
"""The model of the pictures in `input`, as 3D Gaussian splatting has it before it undistorts them."""
FOLDERS: Final = ("sparse/0", "sparse", "colmap/sparse/0", "dense/sparse", _DISTORTED, "")
_DEPTH: Final = (
    "depth",
    "depths",
    "depth_maps",
    "stereo/depth_maps",
    "dense/stereo/depth_maps",
    "dense/0/stereo/depth_maps",
)
_PICTURES: Final = ("images", "images_2", "images_4", "images_8", "resized_images", "input")
_OF_MODELS: Final = (".bin", ".txt", ".ply", ".ini")
_FITS: Final = "depth_params.json"
_PRISM: Final = ("s0", "s1", "s2", "s3")
_MODELS: Final = {  # in the order of COLMAP's numbers
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "FOV": ("fx", "fy", "cx", "cy", "omega"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "THIN_PRISM_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
    "RAD_TAN_THIN_PRISM_FISHEYE": ("fx", "fy", "cx", "cy", *(f"k{at}" for at in range(6)), "p0", "p1", *_PRISM),
    "SIMPLE_DIVISION": ("f", "cx", "cy", "k"),
    "DIVISION": ("fx", "fy", "cx", "cy", "k"),
    "SIMPLE_FISHEYE": ("f", "cx", "cy"),
    "FISHEYE": ("fx", "fy", "cx", "cy"),
    "EUCM": ("fx", "fy", "cx", "cy", "alpha", "beta"),
    "EQUIRECTANGULAR": ("w", "h"),
}
_NAMES: Final = tuple(_MODELS)
_LONGEST_NAME: Final = 4096


@dataclass(frozen=True)
class _Camera:
    intrinsics: Intrinsics
    lens: Lens


@dataclass(frozen=True)
class _Image:
    name: str
    camera: int
    pose: Float[np.ndarray, "4 4"] | str
    """World-to-camera; a text says why there is none."""


def model_folder(source: FolderSource, *folders: str) -> str | None:
    """Return the first of these folders that holds a model, by default of `FOLDERS`; None without one.

    By default, a folder `colmap` or `dense` that alone holds the pictures too is a capture of its own.
    """
    for folder in folders or FOLDERS:
        prefix = f"{folder}/" if folder else ""
        top = folder.partition("/")[0]
        if not folders and top in ("colmap", "dense") and source.has(f"{top}/images") and not source.has("images"):
            continue
        if any(source.has(f"{prefix}cameras.{end}") and source.has(f"{prefix}images.{end}") for end in ("bin", "txt")):
            return folder
    return None


def _workspace(folder: Path) -> tuple[Path, str | None]:
    """Return the folder of the pictures, and the model's in it; None where that is to be looked for.

    A folder with nothing but a model (`sparse/0`) is part of the first above it that has pictures.
    """
    source, whole = FolderSource(folder), folder.absolute()
    others = (name for name in source.names() if name[0] != "." and not name.lower().endswith(_OF_MODELS))
    if model_folder(source, "") is None or any(others):
        return folder, None
    above = whole.parents[: 2 if whole.parent.name == "sparse" else 1]
    holders = (parent for parent in above if any(map(FolderSource(parent).has, _PICTURES)))
    parent = next(holders, None)
    return (folder, None) if parent is None else (parent, whole.relative_to(parent).as_posix())


class ColmapReader(ListedReader):
    """Reads a folder with a COLMAP model, its images and depth maps."""

    format = "colmap"
    conventions = PoseConventions("opencv", "world-to-camera", (0.0, -1.0, 0.0))

    def __init__(self, folder: Path, options: CaptureOptions) -> None:
        opened, (folder, stated) = folder, _workspace(folder)
        source = FolderSource(folder)
        self._depth = next(filter(source.holds_files, _DEPTH), None)
        self._base, lacking = "", list[Note]()
        if stated is not None:
            text = f"pictures and depth are read from {folder}"
            lacking.append(Note(f"{opened}: it is a model alone", text, "open that folder"))
        if self._depth is not None and self._depth.startswith("dense/"):
            self._base = self._depth.removesuffix("stereo/depth_maps")
            whole = model_folder(source, f"{self._base}sparse") is not None and source.has(f"{self._base}images")
            if not whole or stated is not None:
                other = f"{stated} is of others" if whole else f"{self._base} lacks sparse or images"
                text = f"is not read: it is of undistorted images, and {other}"
                advice = f"open {folder}" if whole else "copy all of that folder"
                lacking.append(Note(source.label(self._depth), text, advice))
                self._base, self._depth = "", None
        model = stated or (model_folder(source, f"{self._base}sparse") if self._base else model_folder(source))
        if model is None:
            raise CaptureError(f"{folder}: has no COLMAP model (sparse/0/cameras.bin and images.bin, or .txt)")
        prefix = f"{model}/" if model else ""
        binary = source.has(f"{prefix}cameras.bin") and source.has(f"{prefix}images.bin")
        end = "bin" if binary else "txt"
        cameras = read_index(source, f"{prefix}cameras.{end}")
        label = source.label(f"{prefix}cameras.{end}")
        try:
            with fields.naming(label, CaptureError):
                self._cameras = _cameras_of_bytes(cameras) if binary else _cameras_of_text(cameras, label)
            label = source.label(f"{prefix}images.{end}")
            images = source.path(f"{prefix}images.{end}", max_bytes=None)
            with fields.naming(label, CaptureError), images.open("rb") as file:
                listed = _images_of_bytes(file, images.stat().st_size) if binary else _images_of_text(file)
        except FrameError as error:
            raise CaptureError(str(error)) from error
        except (struct.error, UnicodeDecodeError, OSError) as error:
            raise CaptureError(f"{label}: the model is truncated or damaged ({error})") from error
        self._images = sorted(listed, key=lambda image: fields.natural_key(image.name))
        first = "input" if model == _DISTORTED else f"{self._base}images"
        root = next(filter(source.has, (first, *_PICTURES)), "")
        colour = [f"{root}/{image.name}" if root else image.name for image in self._images]
        if not root and colour and not any(map(source.has, colour)):
            raise CaptureError(
                f"{folder}: has no pictures ({', '.join(_PICTURES)}); copy {colour[0]} and the others there"
            )
        super().__init__(folder, options, colour, expected=f"image in {label}")
        note = Note(
            f"{folder}: COLMAP's scale and up direction",
            "the model is taken for metres, and up for the opposite of its y axis",
            "state world_up, and camera_height_m (--camera-height) or scale the model to metres",
        )
        self.notes = [note, *lacking]
        ends = tuple({PurePosixPath(image.name).suffix.lower() for image in self._images})
        taken = {name: len(files_of(source, name, ends)) for name in ("input", "images", root)}
        most = max(taken, key=taken.__getitem__)
        if taken[most] > self.count:
            text = f"{source.label(most)}: the model placed {self.count} of {taken[most]} pictures"
            self.notes.append(Note(text, "the others are not read", "let COLMAP match them again if many are lacking"))
        if not self._reads_depth:
            self._depth = None
        self._fits = None
        if source.has(f"{prefix}{_FITS}"):
            self._fits = fields.parse_json(read_index(source, f"{prefix}{_FITS}"), source.label(f"{prefix}{_FITS}"))
            scales = (fit.get("scale") for fit in self._fits.values() if isinstance(fit, dict))
            positive = [scale for scale in scales if isinstance(scale, int | float) and 0 < scale < 1e30]
            self._median_scale = median(positive) if positive else 1.0
            maps = source.names(self._depth) if self._depth is not None else []
            if other := next((name for name in maps if name.endswith(DEPTH_SUFFIXES) and name[-4:] != ".png"), ""):
                text = f"{folder}: {_FITS} beside {self._depth}/{other}"
                self.notes.append(Note(text, "such files are read as depth, as stored", "store relative depth as PNG"))
        if self._base and source.has("masks"):
            effect = "are not read: the images read are the undistorted ones"
            self.notes.append(Note(source.label("masks"), effect, f"undistort them into {self._base}masks"))
        models = [f"{name}/sparse" for name in source.names("dense")] if self._base else source.names("sparse")
        others = [name for name in models if name != model and model_folder(source, name) is not None]
        if others:
            text = f"{folder}: the models {', '.join(others[:4])}"
            self.notes.append(Note(text, f"{model or folder} alone is read", "name one model, or merge them"))

    def _read(self, index: int) -> RawFrame:
        image, label = self._images[index], self.name_of(index)
        stem = str(PurePosixPath(image.name).with_suffix(""))
        depth_name = None
        if self._depth is not None and self._depth.endswith("stereo/depth_maps"):
            maps = [f"{self._depth}/{image.name}.{kind}.bin" for kind in ("geometric", "photometric")]
            depth_name = next(filter(self._source.has, maps), maps[0])
        elif self._depth is not None:
            depth_name = self._source.with_suffix(f"{self._depth}/{stem}", DEPTH_SUFFIXES)
            if not self._source.has(depth_name):
                whole = (f"{self._depth}/{image.name}{suffix}" for suffix in DEPTH_SUFFIXES)
                depth_name = next(filter(self._source.has, whole), depth_name)
        with fields.naming(label, FrameError):
            if isinstance(image.pose, str):
                raise ValueError(image.pose)
            camera = self._cameras.get(image.camera)
            if camera is None:
                raise ValueError(f"its camera {image.camera} is not in the model, or its lens is not read")
            if isinstance(camera, str):
                raise ValueError(camera)
        depth_label = depth_name and self._source.label(depth_name)
        if self._fits is not None and depth_name is not None and depth_name.endswith(".png"):
            picture = read_picture(self._source, self._colour[index])
            stored = decode_grey16(self._source.read(depth_name), str(depth_label))
            with fields.naming(f"{label}: {_FITS}", FrameError):
                depth_m = _from_relative(stored, self._fits.get(stem), self._median_scale)
            depth_m *= np.float32(self._unit_m or 1.0)
        else:
            picture, depth_m = read_rgbd(self._source, self._colour[index], depth_name, unit_m=self._unit_m)
        for mask in (f"{self._base}masks/{image.name}.png", f"{self._base}masks/{stem}.png"):
            if self._source.has(mask):
                picture = with_mask(picture, read_mask(self._source, mask))
                break
        with fields.naming(label, FrameError):
            straight = straightened(picture, depth_m, camera.intrinsics, camera.lens, label)
        picture, depth_m, intrinsics, stated = straight
        return RawFrame(
            name=label,
            picture=picture,
            depth_m=depth_m,
            depth_name=depth_label,
            intrinsics=intrinsics,
            pose=image.pose,
            stated=stated,
        )


def _camera(model: str, width: int, height: int, parameters: list[float]) -> _Camera | str:
    """Return a camera, or why it cannot be used."""
    try:
        names = _MODELS.get(model)
        if names is None:
            raise ValueError("it is not read; undistort the images to a pinhole camera first")
        if len(names) != len(parameters):
            raise ValueError(f"has {len(parameters)} parameters where {len(names)} are needed")
        values = dict(zip(names, parameters, strict=True))
        fx, fy = values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))
        distortion = {key: value for key, value in values.items() if key[0] in "kp"}
        lens = lens_of({"camera_model": model, **distortion}, {})
        return _Camera(Intrinsics(fx, fy, values["cx"], values["cy"], width, height), lens)
    except ValueError as error:
        return f"its camera model {model[:40]} cannot be used: {error}"


def _from_relative(stored: UInt16[np.ndarray, "h w"], fit: Any, median_scale: float) -> Float[np.ndarray, "h w"]:
    """Return depth in the model's unit by the fit of an image to the model's points.

    Raises:
        ValueError: There is no fit, or its scale is one at which 3D Gaussian splatting ignores depth.
    """
    if not isinstance(fit, dict):
        raise ValueError("has no entry of this image, whose depth is relative")
    scale, offset = (fields.number(fit.get(key), key) for key in ("scale", "offset"))
    if scale <= 0:
        raise ValueError(f"scale is {scale:g}, as where the image shows too few of the model's points")
    if not 0.2 * median_scale <= scale <= 5 * median_scale:
        raise ValueError(f"scale is {scale:g}, not 0.2 to 5 times the median of all images, {median_scale:g}")
    with np.errstate(divide="ignore"):
        depth = 1 / (stored * (scale / 65536) + offset)
    return clean_depth(np.where(stored > 0, depth, 0))


def _pose(quaternion_wxyz: list[float], translation: list[float]) -> Float[np.ndarray, "4 4"] | str:
    try:
        numbers = fields.coordinates([*quaternion_wxyz, *translation], "the pose")
        return pose_from_quaternion(numbers[[1, 2, 3, 0]], numbers[4:])
    except ValueError as error:
        return str(error)


def _cameras_of_text(data: bytes, label: str) -> dict[int, _Camera | str]:
    cameras: dict[int, _Camera | str] = {}
    for line in fields.parse_text(data, label):
        words = line.split()
        if words and not words[0].startswith("#"):
            if len(words) < 5:
                raise ValueError(f"has a line that is no camera: {line[:60]!r}")
            width, height = fields.pixels(float(words[2]), "width"), fields.pixels(float(words[3]), "height")
            cameras[int(words[0])] = _camera(words[1], width, height, [float(word) for word in words[4:]])
    return cameras


def _is_image(line: str) -> bool:
    """Whether a line ends in a file's name; those of points hold numbers alone."""
    words = line.split(maxsplit=9)
    return len(words) == 10 and re.fullmatch(r"[-+.\deE\s]+", words[9]) is None


def _beginnings(file: BinaryIO) -> Iterator[str]:
    """Yield the beginning of each line, which holds all of an image's but not of its points'."""
    mark = file.read(2)
    file.seek(0)
    encoding, is_beginning = "utf-16" if mark in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", True
    with TextIOWrapper(file, encoding, "surrogateescape") as text:
        while part := text.readline(_LONGEST_NAME):
            if is_beginning:
                yield fields.decoded(part.encode(errors="surrogateescape"))
            is_beginning = part.endswith("\n")


def _images_of_text(file: BinaryIO) -> list[_Image]:
    lines: list[str] = []
    for line in islice((line for line in _beginnings(file) if not line.startswith("#")), 2 * MAX_FRAMES + 2):
        lines.append(line if len(lines) % 2 == 0 or _is_image(line) else "")
    images: list[_Image] = []
    without_points = any(map(_is_image, lines[1::2]))  # each image should have a second line of points
    for line in filter(_is_image, lines) if without_points else lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        if len(words) < 10:
            raise ValueError(f"has a line that is no image: {line[:60]!r}")
        values = [float(word) for word in words[1:8]]
        images.append(_Image(words[9].strip(), int(words[8]), _pose(values[:4], values[4:])))
    return images


def _cameras_of_bytes(data: bytes) -> dict[int, _Camera | str]:
    cameras: dict[int, _Camera | str] = {}
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(min(count, MAX_FRAMES)):
        number, kind, width, height = struct.unpack_from("<iiQQ", data, at)
        if not 0 <= kind < len(_NAMES):
            raise ValueError(f"has a camera model of number {kind}, which is not read; undistort the images first")
        names = _MODELS[_NAMES[kind]]
        parameters = list(struct.unpack_from(f"<{len(names)}d", data, at + 24))
        size = fields.pixels(width, "width"), fields.pixels(height, "height")
        cameras[number] = _camera(_NAMES[kind], *size, parameters)
        at += 24 + 8 * len(names)
    return cameras


def _images_of_bytes(file: BinaryIO, size: int) -> list[_Image]:
    """Read the images of a file of `size` bytes; their points, which are most of it, are passed over."""
    images: list[_Image] = []
    (count,), at = struct.unpack("<Q", file.read(8)), 8
    for _ in range(min(count, MAX_FRAMES + 1)):
        file.seek(min(at, size))
        data = file.read(64 + _LONGEST_NAME + 9)
        values = struct.unpack_from("<i7di", data)
        end = data.index(b"\0", 64)
        (points,) = struct.unpack_from("<Q", data, end + 1)
        images.append(_Image(fields.decoded(data[64:end]), values[8], _pose(list(values[1:5]), list(values[5:8]))))
        at += end + 9 + 24 * points
    return images
