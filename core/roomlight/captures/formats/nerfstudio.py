"""Captures described by a `transforms.json`: nerfstudio, instant-ngp, nerf-synthetic, NeRFCapture, ScanNet++.

Schema: `frames: [{file_path, depth_file_path | depth_path, transform_matrix, timestamp?, intrinsics?, mask_path?,
is_bad?}]`; intrinsics `fl_x fl_y cx cy w h` per frame or once, or `camera_angle_x` (rad), or
instant-ngp's `x_fov` (degrees). Colour names may lack their suffix.
Pixels of a mask that are 0 are not seen; instant-ngp's `dynamic_mask_NAME.png` beside an image is the other way round;
nor are pixels of a fisheye farther than `fisheye_crop_radius` from the centre of the image.
Frames that are marked `is_bad` are skipped.

Conventions: camera-to-world, OpenGL camera. The world is z-up (nerfstudio), unless the file has `world_up` (x, y, z,
-x, -y, -z or three numbers), or is NeRFCapture's (`depth_path` or `*integer_*scale` without instant-ngp's other keys,
or with a lens in each frame), whose world is ARKit's, y-up. Until 2024 nerfstudio turned COLMAP's world so that its
-y, taken for up, became -x (`applied_transform`; until March 2023 without this key, but with COLMAP's own
`colmap/sparse/0/cameras.bin`; Spectacular AI, whose world is z-up, writes `cameras.txt` there), and ScanNet++ its own
z-up one in this way so that up became -z. cx and cy are used unchanged: pixel centres at half integers, as nerfstudio
and ARKit have them. Translations are divided by `applied_scale`. Without depth, the scale of photogrammetry is noted:
of COLMAP, Metashape and RealityCapture, and of frames with `sharpness`, which instant-ngp's scripts write; with depth
too where frames have `colmap_im_id`: nerfstudio makes depth of COLMAP's points, in COLMAP's unit.

Depth: 16-bit PNG, .npy, TIFF or EXR times `depth_unit_scale_factor`, or `integer_depth_scale` (metres a step, of
NeRFCapture's script); without them integers are millimetres and floats metres. NeRFCapture's app writes a placeholder
of 1.0 as `depth_integer_scale`; a unit of 0.1 m and more is therefore ignored there. The depth that it saves itself is
a coloured PNG of 8 bits, cut off at 1 m, and not read.

Frames are put in order of `timestamp` if all have one, else of the numbers in their file names, as
nerfstudio does. `probes: [{position, file_path}]` are ground-truth panoramas in the same world. Lenses are those of
`roomlight.captures.lenses`. Pictures and masks of ScanNet++ lie in folders beside the index's.
"""

import math
import os
import re
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, ReadRecord
from roomlight.captures.decoding import DEPTH_SUFFIXES, read_mask, read_rgbd, with_mask
from roomlight.captures.formats.listed import probes_of
from roomlight.captures.formats.polycam import is_polycam
from roomlight.captures.lenses import MODEL_KEYS, Lens, lens_of, straightened
from roomlight.captures.options import CaptureOptions, up_vector
from roomlight.captures.source import MAX_FRAMES, read_index
from roomlight.errors import CaptureError, FrameError
from roomlight.files import FolderSource
from roomlight.images import ColourImage
from roomlight.notes import Note, unread_keys

INDEX: Final = "transforms.json"
INDICES: Final = "transforms*.json"
"""Names of parts of a data set, which are read where one is named."""
_DEPTH_MAP: Final = re.compile(r"depth(_\w+)?_file_path")
_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".exr", ".heic", ".webp", ".tif", ".tiff", ".bmp")
_PICTURE_FOLDERS: Final = ("../images", "../resized_images", "../resized_undistorted_images")
_SMALL_PICTURES: Final = ("images_2", "images_4", "images_8")
"""Folders of nerfstudio's smaller copies; data sets such as DL3DV hold one of them alone."""
_MASK_FOLDERS: Final = ("../masks", "../resized_anon_masks", "../resized_undistorted_masks")
_SCANNETPP: Final = "resized_"
"""Beginning of the folders of ScanNet++'s own pictures."""
_SWAPPED: Final = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]
"""`applied_transform` of the COLMAP worlds that nerfstudio wrote until 2024."""
_TURNS: Final = (
    _SWAPPED,
    [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]],
    [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0]],
)
"""`applied_transform` of nerfstudio for COLMAP, until and since 2024, and for Metashape."""
_OF_PHOTOGRAMMETRY: Final = ("colmap_im_id", "sharpness")
"""Keys of frames: of nerfstudio's COLMAP, and of instant-ngp's scripts (colmap2nerf, agi2nerf, mr2nerf)."""
_MODEL: Final = "colmap/sparse/0/cameras.bin"
"""Where nerfstudio leaves COLMAP's model."""
_LENS_KEYS: Final = {"fl_x": "fl_y", "camera_angle_x": "camera_angle_y", "x_fov": "y_fov"}
_NERFCAPTURE_SCALES: Final = ("integer_depth_scale", "depth_integer_scale")
_OF_INSTANT_NGP: Final = ("enable_depth_loading", "aabb", "aabb_scale", "camera_angle_x")
"""Keys that NeRFCapture's app and script never write."""
_EIGHT_BITS: Final = (b"\x08\x02", b"\x08\x06")
"""Bytes 24 and 25 of an RGB or RGBA PNG of 8 bits."""
_READ: Final = frozenset(
    {
        *("frames", "probes", "file_path", "depth_file_path", "depth_path", "transform_matrix", "timestamp"),
        *(
            "fl_x",
            "fl_y",
            "cx",
            "cy",
            "w",
            "h",
            "camera_angle_x",
            "camera_angle_y",
            "x_fov",
            "y_fov",
            "world_up",
            "depth_unit_scale_factor",
            "applied_scale",
        ),
        *("mask_path", "is_bad", "fisheye_crop_radius", *_NERFCAPTURE_SCALES, *MODEL_KEYS),
    }
)
_HARMLESS: Final = frozenset(  # what trainers of radiance fields need, and names
    {
        *("aabb_scale", "scale", "offset", "applied_transform", "ply_file_path", "train_filenames", "val_filenames"),
        *("test_filenames", "test_frames", "sharpness", "colmap_im_id", "has_mask", "name", "id"),
        *("version", "format", "fps", "n_frames", "camera_id", "frame_id", "orientation_override", "rotation"),
        *("auto_scale_poses_override", "camera_linear_velocity", "camera_angular_velocity", "motion_blur_score"),
        "enable_depth_loading",
    }
)


def leads_to_depth(source: FolderSource) -> bool:
    """Whether a frame of the index has a key of depth; also of a broken index, whose reader says what is wrong."""
    try:
        index = fields.parse_json(read_index(source, INDEX), INDEX)
        return any("depth" in key for frame in fields.objects(index.get("frames"), "frames") for key in frame)
    except (CaptureError, ValueError):
        return True


class NerfstudioReader:
    """Reads a folder with a `transforms.json`, or a file in its form."""

    format = "nerfstudio"

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        folder, index = (path.parent, path.name) if path.is_file() else (path, INDEX)
        self._source = FolderSource(folder)
        self._label = self._source.label(index)
        self._shared = fields.parse_json(read_index(self._source, index), self._label)
        with fields.naming(self._label, CaptureError):
            self._frames = _in_order(fields.objects(self._shared.get("frames"), "frames"))
            own_lenses = all("fl_x" in frame and "w" in frame for frame in self._frames)  # users add `aabb_scale`
            self._nerfcapture = (own_lenses or self._shared.keys().isdisjoint(_OF_INSTANT_NGP)) and (
                any(key in self._shared for key in _NERFCAPTURE_SCALES)
                or any("depth_path" in frame for frame in self._frames)
            )
            self._stated_unit_m = options.depth_unit_m
            self._depth_unit({})  # refuses the capture for what concerns all frames
            fields.positive(self._shared.get("applied_scale", 1.0), "applied_scale")
            self.probes = probes_of(self._shared, "file_path", self._source, self._label)
        if len(self._frames) > MAX_FRAMES:
            raise CaptureError(f"{self._label}: lists {len(self._frames)} frames; up to {MAX_FRAMES} are read")
        self.count = len(self._frames)
        self._depth_keys = self._choose_depth(options)
        self._refuse_broken_lens()
        self._cut_off_noted = False
        self.notes = [*self._unread_keys(), *self._made_relative()]
        small = None if self._source.has("images") else next(filter(self._source.has, _SMALL_PICTURES), None)
        for frame in self._frames:
            if small is not None and isinstance(frame.get("file_path"), str):
                frame["file_path"] = re.sub(r"^(\./)?images/", f"{small}/", frame["file_path"])
        self._pictures = self._source_of("file_path", _PICTURE_FOLDERS)
        self._masks = self._source_of("mask_path", _MASK_FOLDERS)
        with fields.naming(self._label, CaptureError):
            self.conventions = PoseConventions("opengl", "camera-to-world", self._world_up())
        has_metres = self._depth_keys and not any("colmap_im_id" in frame for frame in self._frames)
        if self._is_photogrammetry() and not has_metres and options.camera_height_m is None:
            advice = "state camera_height_m (--camera-height), or scale its poses to metres"
            text = f"{self._label}: the scale of COLMAP, Metashape, Meshroom or RealityCapture"
            self.notes.append(Note(text, "its poses are taken for metres", advice))

    def name_of(self, index: int) -> str:
        """Return the colour file as the index names it."""
        name = self._frames[index].get("file_path")
        return self._pictures.label(name[:300]) if isinstance(name, str) else f"{self._label}: frame {index}"

    def timestamps(self) -> list[float | None]:
        """Return the frames' timestamps."""
        return [fields.time(frame.get("timestamp")) for frame in self._frames]

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Return the function that reads a record; no file is held open."""
        yield self._read

    def _read(self, index: int) -> RawFrame:
        entry = self._frames[index]
        where = f"{self._label}: frame {index}"
        with fields.naming(where, FrameError):
            if fields.flag(entry.get("is_bad")):
                raise ValueError("is marked is_bad")
            pose = fields.matrix4(entry.get("transform_matrix"), "transform_matrix")
            scale = fields.first_of(entry, self._shared, "applied_scale")
            pose[:3, 3] /= 1.0 if scale is None else fields.positive(scale, "applied_scale")
            unit_m = self._stated_unit_m or self._depth_unit(entry)
            colour_name = self._pictures.with_suffix(fields.text(entry.get("file_path"), "file_path"), _SUFFIXES)
            depth_name = fields.first_of(entry, {}, *self._depth_keys)
            if depth_name is None and self._depth_keys:
                raise FrameError(f"{where}: has no depth ({' or '.join(self._depth_keys)})")
            if depth_name is not None:
                depth_name = fields.text(depth_name, "the depth file's name")
                depth_name = self._source.with_suffix(depth_name, DEPTH_SUFFIXES)
                if self._nerfcapture and self._is_cut_off(depth_name):
                    depth_name = None
            lens = lens_of(entry, self._shared)
        colour_label = self._pictures.label(colour_name)
        picture, depth_m = read_rgbd(self._source, colour_name, depth_name, unit_m=unit_m, pictures=self._pictures)
        picture = self._masked(entry, picture, where, lens)
        with fields.naming(f"{where} ({colour_label})", FrameError):
            intrinsics = self._intrinsics(entry, picture.image.shape[1], picture.image.shape[0])
            picture, depth_m, camera, stated = straightened(picture, depth_m, intrinsics, lens, colour_label)
        return RawFrame(
            name=colour_label,
            picture=picture,
            depth_m=depth_m,
            depth_name=None if depth_name is None else self._source.label(depth_name),
            intrinsics=camera,
            pose=pose,
            stated=stated,
        )

    def _is_cut_off(self, depth_name: str) -> bool:
        """Whether depth is a coloured PNG of 8 bits, which NeRFCapture's app saves; the first is noted."""
        start = self._source.read(depth_name)[:26]
        if start[:4] != b"\x89PNG" or start[24:] not in _EIGHT_BITS:
            return False
        if not self._cut_off_noted:
            self._cut_off_noted = True
            text, effect = f"{self._source.label(depth_name)}: an 8-bit picture of depth", "it is not read as depth"
            advice = "stream from NeRFCapture to its script, which writes 16 bits, for measured depth"
            self.notes.append(Note(text, effect, advice))
        return True

    def _masked(self, entry: dict[str, Any], picture: ColourImage, where: str, lens: Lens) -> ColourImage:
        stated = fields.first_of(entry, self._shared, "mask_path")
        if stated is not None and fields.first_of(entry, self._shared, "has_mask") is not False:
            with fields.naming(where, FrameError):
                name = self._masks.with_suffix(fields.text(stated, "mask_path"), _SUFFIXES)
            picture = with_mask(picture, read_mask(self._masks, name))
        radius = fields.first_of(entry, self._shared, "fisheye_crop_radius")
        if radius is not None and lens.fisheye:
            with fields.naming(where, FrameError):
                stated_width = fields.first_of(entry, self._shared, "w")
                height, width = picture.image.shape[:2]
                share = width / (width if stated_width is None else fields.pixels(stated_width, "w"))
                inside = fields.positive(radius, "fisheye_crop_radius") * share
            rows, columns = np.ogrid[:height, :width]
            off_centre = np.hypot(rows + 0.5 - height / 2, columns + 0.5 - width / 2)
            picture = with_mask(picture, off_centre <= inside)
        path = PurePosixPath(str(entry["file_path"]).replace("\\", "/"))
        moving = str(path.with_name(f"dynamic_mask_{path.stem}.png"))
        return with_mask(picture, ~read_mask(self._pictures, moving)) if self._pictures.has(moving) else picture

    def _made_relative(self) -> list[Note]:
        """Make absolute paths names in the folder; one of another folder is noted."""
        guessed: list[tuple[str, str]] = []
        for frame in self._frames:
            for key in ("file_path", "mask_path", *self._depth_keys):
                if isinstance(stated := frame.get(key), str):
                    frame[key] = self._source.within(stated)
                    if frame[key] != stated and str(self._source.root.absolute()) not in stated:
                        guessed.append((stated, frame[key]))
        if not guessed:
            return []
        text = f"{self._label}: {guessed[0][0][:200]} is a path of another folder"
        return [Note(text, f"{guessed[0][1]} in this folder is read, others likewise", "write relative paths")]

    def _source_of(self, key: str, folders: tuple[str, ...]) -> FolderSource:
        """Return where a key's files are: the index's folder, or one beside it, as ScanNet++ has them; that is noted.

        ScanNet++ names pictures without their folder.
        """
        names = [name for frame in self._frames if isinstance(name := frame.get(key), str) and "/" not in name]
        if not names or any(map(self._source.has, names)):
            return self._source
        root = self._source.root.absolute()
        siblings = (FolderSource(Path(os.path.normpath(root / folder))) for folder in folders)
        sibling = next((source for source in siblings if any(map(source.has, names))), None)
        if sibling is None:
            return self._source
        self.notes.append(
            Note(f"{self._label}: {names[0]} is not beside it", f"{sibling.root} is read", "name folders")
        )
        return sibling

    def _unread_keys(self) -> list[Note]:
        keys = {key for entry in (self._shared, *self._frames) for key in entry} - _READ - _HARMLESS
        return unread_keys(
            self._label,
            {key for key in keys if not key.startswith(("ftheta", "aabb")) and not _DEPTH_MAP.fullmatch(key)},
        )

    def _intrinsics(self, entry: dict[str, Any], image_width: int, image_height: int) -> Intrinsics:
        """Build intrinsics: a frame's values override global ones, also those of another kind (angles, focal lengths).

        A missing size is the image's.
        """
        stated_w, stated_h = (fields.first_of(entry, self._shared, key) for key in ("w", "h"))
        width = image_width if stated_w is None else fields.pixels(stated_w, "w")
        height = image_height if stated_h is None else fields.pixels(stated_h, "h")
        own = next((key for key in _LENS_KEYS if entry.get(key) is not None), None)
        shared = self._shared if own is None else {_LENS_KEYS[own]: self._shared.get(_LENS_KEYS[own])}
        fl_x, angle = fields.first_of(entry, shared, "fl_x"), _angle(entry, shared, "x")
        if fl_x is not None:
            fx = fields.positive(fl_x, "fl_x")
        elif angle is not None:
            fx = 0.5 * width / math.tan(0.5 * angle)
        else:
            raise ValueError("has neither fl_x nor camera_angle_x nor x_fov")
        fl_y, high = fields.first_of(entry, shared, "fl_y"), _angle(entry, shared, "y")
        fy = fx if fl_y is None else fields.positive(fl_y, "fl_y")
        if fl_y is None and fl_x is None and high is not None:
            fy = 0.5 * height / math.tan(0.5 * high)
        cx, cy = (fields.first_of(entry, self._shared, key) for key in ("cx", "cy"))
        return Intrinsics(
            fx,
            fy,
            0.5 * width if cx is None else fields.number(cx, "cx"),
            0.5 * height if cy is None else fields.number(cy, "cy"),
            width,
            height,
        )

    def _refuse_broken_lens(self) -> None:
        """Refuse the capture if its global intrinsics are invalid and some frame needs them."""
        with fields.naming(self._label, CaptureError):
            for key in ("fl_x", "fl_y"):
                if self._shared.get(key) is not None and not all(key in frame for frame in self._frames):
                    fields.positive(self._shared[key], key)
            for key in ("w", "h"):
                if self._shared.get(key) is not None and not all(key in frame for frame in self._frames):
                    fields.pixels(self._shared[key], key)
            if self.count and not any(
                fields.first_of(frame, self._shared, *_LENS_KEYS) is not None for frame in self._frames
            ):
                raise ValueError("has no intrinsics: neither fl_x nor camera_angle_x nor x_fov, globally or in a frame")

    def _is_photogrammetry(self) -> bool:
        """Whether a program found the poses in pictures alone, as its converters' keys and files tell.

        ScanNet++, whose pictures lie elsewhere, and Polycam have the same keys, and metres.
        """
        if self._pictures is not self._source or is_polycam(self._source):
            return False
        stated = self._shared.get("applied_transform") in _TURNS or self._source.has(_MODEL)
        if "orientation_override" in self._shared:  # of RealityCapture, and of Polycam without k4
            stated |= any("k4" in frame for frame in self._frames)
        return stated or any(not frame.keys().isdisjoint(_OF_PHOTOGRAMMETRY) for frame in self._frames)

    def _world_up(self) -> tuple[float, float, float]:
        stated: Any = self._shared.get("world_up")
        if stated is None:
            if self._nerfcapture:
                return up_vector("y")
            if self._pictures is not self._source and self._pictures.root.name.startswith(_SCANNETPP):
                return up_vector("-z")
            turn: Any = self._shared.get("applied_transform", _SWAPPED if self._source.has(_MODEL) else None)
            return up_vector("-x" if isinstance(turn, list) and turn[:3] == _SWAPPED else "z")
        if isinstance(stated, list):
            components = fields.vector(stated, 3, "world_up").tolist()
            x, y, z = (fields.number(value, "world_up") for value in components)
            return up_vector((x, y, z))
        return up_vector(fields.text(stated, "world_up"))

    def _depth_unit(self, entry: dict[str, Any]) -> float | None:
        """Return the metres of one stored unit, of a frame or of all; None if the file does not state them."""
        for key in ("depth_unit_scale_factor", *_NERFCAPTURE_SCALES):
            stated = fields.first_of(entry, self._shared, key)
            if stated is not None:
                unit_m = fields.unit(stated, key)
                if key not in _NERFCAPTURE_SCALES or unit_m < 0.1:
                    return unit_m
        return None

    def _choose_depth(self, options: CaptureOptions) -> tuple[str, ...]:
        """Return the keys of depth; none if the frames have no depth, which is then estimated."""
        if options.depth == "network":
            return ()
        depth_key = options.depth_key
        keys = (depth_key,) if depth_key is not None else ("depth_file_path", "depth_path")
        if self._frames and not any(key in frame for frame in self._frames for key in keys):
            present = sorted({key for frame in self._frames for key in frame if "depth" in key})
            if not (present or depth_key or options.depth == "file"):
                return ()
            names = ", ".join(present)
            hint = f"its frames have {names}; set depth_key" if present else "depth=auto estimates it"
            raise CaptureError(f"{self._label}: no frame has {' or '.join(keys)}; {hint}")
        return keys


def _angle(entry: dict[str, Any], shared: dict[str, Any], axis: str) -> float | None:
    """Return the stated angle of view in radians; None without one."""
    for key, radians, limit in ((f"camera_angle_{axis}", 1.0, "pi"), (f"{axis}_fov", math.pi / 180, "180 degrees")):
        if (stated := fields.first_of(entry, shared, key)) is not None:
            angle = fields.positive(stated, key)
            if angle * radians >= math.pi:
                raise ValueError(f"{key} is {angle}; it must be below {limit}")
            return angle * radians
    return None


def _in_order(frames: list[dict[str, Any]]) -> list[dict[str, Any]]:
    times = [math.nan if (time := fields.time(frame.get("timestamp"))) is None else time for frame in frames]
    if all(map(math.isfinite, times)):
        return [frames[at] for at in sorted(range(len(frames)), key=times.__getitem__)]
    if all(isinstance(frame.get("file_path"), str) for frame in frames):
        return sorted(frames, key=lambda frame: fields.natural_key(frame["file_path"]))
    return frames
