"""Recognise a capture's format by the files in its folder, and say what the nearest format lacks."""

import os
import re
import zipfile
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from typing import Final

from roomlight.captures.formats import native, nerfstudio, record3d, scannetpp, stray_scanner
from roomlight.captures.formats.arkit_scenes import TRAJECTORY
from roomlight.captures.formats.colmap import model_folder
from roomlight.captures.formats.polycam import is_polycam
from roomlight.captures.formats.ros.container import is_bag
from roomlight.captures.formats.rtabmap import export_name
from roomlight.captures.formats.scanner_app import is_scanner_app
from roomlight.captures.formats.scannet import intrinsics_file
from roomlight.captures.formats.tum import pose_file
from roomlight.captures.source import ZipSource
from roomlight.captures.video import DEMUXERS
from roomlight.errors import UnknownFormatError
from roomlight.files import FolderSource

_PARTS: Final[dict[str, tuple[str, ...]]] = {
    "roomlight": (native.INDEX,),
    "nerfstudio": (nerfstudio.INDEX,),
    "stray-scanner": (stray_scanner.VIDEO, stray_scanner.ODOMETRY, stray_scanner.MATRIX),
    "record3d": ("metadata|metadata.json", "rgbd|rgb"),
    "tum": ("rgb.txt|associat*.txt", "depth.txt|associat*.txt", "groundtruth.txt|*.gt.freiburg"),
    "seven-scenes": ("frame-*.color.*", "frame-*.depth.*", "frame-*.pose.txt"),
    "polycam": ("keyframes/images|images", "keyframes/cameras|cameras"),
    "3d-scanner-app": ("frame_*.jpg", "frame_*.json"),
    "arkitscenes": ("lowres_wide|vga_wide|wide", "lowres_depth|highres_depth", "*wide_intrinsics", TRAJECTORY),
    "scannet": ("color", "pose", "intrinsic/intrinsic_color.txt"),
    "scannetpp": (scannetpp.INDEX, "rgb|rgb.mkv"),
    "rtabmap": ("*rgb", "*calib", "*camera_poses.txt"),
    "ros-bag": ("metadata.yaml", "*.db3|*.mcap"),
    "colmap": ("sparse/0/cameras.*|sparse/cameras.*", "sparse/0/images.*|sparse/images.*", "images"),
}
"""Files and folders that each format needs; `|` stands between alternatives."""

_COMMON: Final = ("metadata", "metadata.json", "rgb", "*rgb", "color", "pose", "images", "cameras")
"""Names that many programs write; one of them alone tells no format."""

_IMAGES: Final = (".jpg", ".jpeg", ".png", ".exr", ".heic", ".heif", ".avif", ".webp", ".tif", ".tiff", ".bmp")
VIDEOS: Final = (*DEMUXERS, ".avi", ".wmv", ".mts", ".m2ts", ".ts", ".mpg", ".mpeg", ".hevc", ".gif", ".lrv")
"""Ends of names of videos, also of those that are not read."""
_PANORAMAS: Final = (".insv", ".360", ".insp")
_ARCHIVES: Final = (".tar", ".gz", ".tgz", ".7z", ".rar", ".xz", ".bz2")
_MODELS: Final = (
    *(".usdz", ".usda", ".usdc", ".glb", ".gltf", ".obj", ".ply", ".fbx", ".stl", ".dae"),
    *(".spz", ".splat", ".ksplat", ".las", ".laz", ".e57", ".pts", ".xyz"),
)
_CAMERAS: Final = (
    *("sfm_data.json", "bundle.out", ".chan", ".abc"),
    *("reconstruction.json", "poses_bounds.npy", "cameras_sphere.npz", "traj.txt", "trajectory.log"),
)
"""Files of cameras, by name or ending: of OpenMVG, Bundler, Nuke, Alembic, OpenSfM, LLFF, NeuS, Replica, and Open3D."""
_CAMERAS_BELOW: Final = re.compile(
    r"(.*/)?(cameras\.(txt|bin|json)|sfm_data\.bin|[^/]+\.sfm|extrinsics/[^/]+|transformations\w*\.json)", re.IGNORECASE
)
"""Paths of further files of cameras: of COLMAP, Gaussian splatting, OpenMVG, Meshroom, SUN3D, and MuSHRoom."""
_PROGRAMS: Final = {".csv": ("RealityCapture", b"#name,", 6), ".xml": ("Metashape", b"<chunk", 1000)}
"""Programs that write cameras into files of these endings, and the text that is among so many first bytes of them."""
_STAGES: Final = (".fbx", ".usd", ".usda", ".usdc", ".usdz")
"""Models that may be cameras where pictures are in a folder beside them."""
_PICTURES: Final = ("images", "image", "input", "rgb", "color", "frames", "results", "plate", "plates")
_RECORDINGS: Final = (".svo", ".svo2", ".oni", ".vrs", ".klg")
_SMALL_COPIES: Final = ("thumb", "thumbnail", "preview")
_LISTED: Final = 1000
"""Most files of a folder that are looked at for a message."""
_MOST_FOLDERS: Final = 100
"""Most folders in which files of cameras are looked for."""


def recognised(path: Path) -> str:
    """Return the format's name by the files in the folder or the archive.

    Raises:
        UnknownFormatError: It is none that is known; says what the nearest one lacks.
    """
    if name := format_of(path):
        return name
    if reason := _known_otherwise(path) or _part_of(path):
        raise UnknownFormatError(f"{path}: {reason}")
    if hint := _nearest(path) or _bare_images(path):
        raise UnknownFormatError(f"{path}: no capture format recognised. {hint}")
    known = "; ".join(f"{name}: {', '.join(parts).replace('|', ' or ')}" for name, parts in _PARTS.items())
    raise UnknownFormatError(
        f"{path}: no capture format recognised. Set `format` to force one. Known are .r3d (record3d), .sens (scannet), "
        f".bag, .mcap and .db3 (ros-bag) and video files, and folders of {known}"
    )


def format_of(path: Path) -> str | None:
    """Return the format's name by the files in the folder or the archive; None if it is none that is known."""

    def has(*names: str) -> bool:
        return any(source.has(name) for name in names)

    source = FolderSource(path)
    if is_bag(path):
        return "ros-bag"
    if path.is_file():
        if path.suffix.lower() == ".r3d":
            return "record3d"
        if path.suffix.lower() == ".sens":
            return "scannet"
        if path.suffix.lower() in DEMUXERS:
            return "video"
        if is_record3d_archive(path):
            return "record3d"
    elif has(native.INDEX):
        return "roomlight"
    elif has(scannetpp.INDEX):
        return "scannetpp"
    elif has(nerfstudio.INDEX):
        return _beside_index(source) or "nerfstudio"
    elif has(stray_scanner.ODOMETRY, stray_scanner.MATRIX):
        return "stray-scanner"
    elif record3d.is_record3d(source):
        return "record3d"
    elif has(pose_file(source)) or (has("rgb.txt") and has("depth.txt")):
        return "tum"
    elif any(path.glob("frame-*.*.*")):
        return "seven-scenes"
    elif is_polycam(source):
        return "polycam"
    elif has(TRAJECTORY):
        return "arkitscenes"
    elif intrinsics_file(source) is not None:
        return "scannet"
    elif export_name(source) is not None:
        return "rtabmap"
    elif model_folder(source) is not None:
        return "colmap"
    elif is_scanner_app(source):
        return "3d-scanner-app"
    elif record3d.is_record3d(source, *record3d.LENS_KEYS):  # its reader says what the index lacks
        return "record3d"
    return None


def _part_of(path: Path) -> str:
    """Say to which recording, one or two folders above, a file or a folder belongs; empty if to none."""
    with suppress(OSError):
        for folder in path.absolute().parents[:2]:
            if name := format_of(folder):
                return f"is part of the {name} recording {folder}; open that"
    return ""


def _beside_index(source: FolderSource) -> str | None:
    """Return the format of the recording that a trainer's `transforms.json` without depth was made from; else None."""
    name = "record3d" if record3d.is_record3d(source) else "polycam" if is_polycam(source) else None
    return None if name is None or nerfstudio.leads_to_depth(source) else name


def _nearest(path: Path) -> str:
    """Return which format has most of its parts there, and what it lacks, as a sentence."""
    best: tuple[float, int, str] = (0.0, 0, "")
    if not path.is_dir():
        return ""
    for name, parts in _PARTS.items():
        there = [part for part in parts if _is_there(path, part)]
        share = len(there) / len(parts)
        own = any(pattern not in _COMMON and _is_there(path, pattern) for part in there for pattern in part.split("|"))
        if (own or len(there) > 1) and share < 1 and (share, len(there)) > best[:2]:
            lacking = " and ".join(part.replace("|", " or ") for part in parts if part not in there)
            best = share, len(there), f"The nearest is {name}, which lacks {lacking}"
    return best[2]


def _is_there(path: Path, part: str) -> bool:
    return any(next(iter(path.glob(pattern)), None) is not None for pattern in part.split("|"))


def _known_otherwise(path: Path) -> str:
    """Say what a path is instead of a recording; empty if that is not known."""
    files = [path] if path.is_file() else [file for file in islice(path.iterdir(), _LISTED) if file.is_file()]
    files = [file for file in files if file.name[0] != "." and file.stem.lower() not in _SMALL_COPIES]
    ends = {file.suffix.lower() for file in files}
    if {"data.jsonl", "calibration.json"} <= {file.name for file in files}:
        return (
            "is a raw recording of Spectacular AI; process it (sai-cli process --format nerfstudio IN OUT), or open "
            "its video (data.mov) alone"
        )
    if parts := sorted(file.name for file in files if file.name.startswith("transforms_") and file.suffix == ".json"):
        return f"holds {', '.join(parts[:4])}, and no transforms.json; open one of them, or put their frames into one"
    kinds = (*_CAMERAS, *_STAGES) if any((path / name).is_dir() for name in _PICTURES) else _CAMERAS
    if cameras := next((file.name for file in files if file.name.lower() in kinds or file.suffix.lower() in kinds), ""):
        return f"the cameras in {cameras} are not read; write them into {nerfstudio.INDEX}, beside the pictures"
    models = [file.name for file in files if file.suffix.lower() in _MODELS]
    is_flat = path.is_file() or not any(file.is_dir() for file in islice(path.iterdir(), _LISTED))
    if models and not ends & {*_IMAGES, *VIDEOS, ".txt", ".csv"} and (is_flat or ".json" not in ends):
        return (
            f"{models[0]} is a model, not a recording; Scaniverse exports models only. Record the room with Record3D, "
            "Stray Scanner, NeRFCapture, Polycam (export raw data) or 3D Scanner App (export all data)"
        )
    if program := next((name for file in files if (name := _reconstruction_program(file))), ""):
        return f"holds the cameras that {program} found; export them from there as COLMAP, beside the pictures"
    if recording := next((file.name for file in files if file.suffix.lower() in _RECORDINGS), ""):
        return f"{recording} is a recording that is not read; export a ROS bag of it, or pictures with poses"
    if active := next((file.name for file in files if file.name.endswith(".bag.active")), ""):
        return f"{active} is a ROS bag that was not closed; rosbag reindex it, and rename it to {active[:-7]}"
    archives = [*path.glob("*.zip"), *path.glob("*/*.zip")]
    if archives and not ends & {*_IMAGES}:
        return f"holds the archive {archives[0].relative_to(path)}; unpack it, and open what it holds"
    if ends == {".db"} and files[0].name == "database.db" and (path / "images").is_dir():
        return "has COLMAP's database and no model; write the model too: colmap mapper makes sparse/0"
    if any(file.suffix.lower() == ".db" for file in files) and ends <= {".db"}:
        return "is RTAB-Map's database; export it: rtabmap-export --images --poses_camera FILE.db"
    if path.is_file() and path.suffix.lower() in VIDEOS:
        return f"is a video of a kind that is not read; convert it to {', '.join(DEMUXERS)} (ffmpeg -i IN OUT.mp4)"
    if path.is_file() and path.suffix.lower() in _PANORAMAS:
        return "is a camera's recording of all directions; export a reframed, flat video or picture with its program"
    if path.is_file() and path.suffix.lower() in _ARCHIVES:
        return "is an archive of a kind that is not read; unpack it and open what it holds, or pack it as .zip"
    if path.is_file() and path.suffix.lower() == ".dng":
        return "is a raw photo; export it as JPEG, TIFF or EXR, which `roomlight light IMAGE` lights"
    if path.is_file() and path.suffix.lower() in _IMAGES:
        return "is one photo; `roomlight light IMAGE` lights it"
    return ""


def _reconstruction_program(file: Path) -> str:
    """Return the program that found cameras and wrote them into a file; empty for another file."""
    if file.name.lower() == "cameras.xml":
        return "Metashape"
    if file.suffix.lower() == ".sfm":
        return "Meshroom"
    if file.suffix.lower() in _PROGRAMS:
        program, text, most = _PROGRAMS[file.suffix.lower()]
        with suppress(OSError), file.open("rb") as start:
            return program if text in start.read(most) else ""
    return ""


def _bare_images(path: Path) -> str:
    """Return what images without an index lack, as a sentence; empty if the folder and those in it hold none."""
    if not path.is_dir():
        return ""
    files = islice(chain(path.iterdir(), path.glob("*/*")), _LISTED)
    pictures = [file for file in files if file.suffix.lower() in _IMAGES and file.stem.lower() not in _SMALL_COPIES]
    names = sorted(file.relative_to(path).as_posix() for file in pictures)
    if not names:
        return ""
    listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    advice = (
        f"let COLMAP find them, add them in {nerfstudio.INDEX}, or film a video, which needs none; `roomlight light "
        "IMAGE` takes one photo"
    )
    if cameras := _cameras_below(path):
        advice = f"write those of {cameras} into {nerfstudio.INDEX}, or as COLMAP's into sparse/0, beside the pictures"
    return f"The folder holds {listed} without focal lengths and poses in a form that is read: {advice}"


def _cameras_below(path: Path) -> str:
    """Return a file of cameras in a form that is not read, up to three folders below; empty without one."""
    for root, folders, names in islice(os.walk(path), _MOST_FOLDERS):
        folder = Path(root).relative_to(path)
        folders[:] = sorted(folders) if len(folder.parts) < 3 else []
        for file in (folder / name for name in sorted(names)):
            if {file.name.lower(), file.suffix.lower()} & {*_CAMERAS} or _CAMERAS_BELOW.fullmatch(file.as_posix()):
                return file.as_posix()
    return ""


def is_record3d_archive(path: Path) -> bool:
    """Whether a file is a zip archive with Record3D's files, which are read in place."""
    if not zipfile.is_zipfile(path):
        return False
    return record3d.is_record3d(ZipSource(path), *record3d.LENS_KEYS)
