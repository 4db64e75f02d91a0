"""Assumed conventions of poses, and intrinsics, are compared with what the pictures show."""

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import formats
import numpy as np
import pytest
from capture_checks import edit, notes_of

import box_room
from roomlight.camera import Intrinsics, pose_from_quaternion
from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import OPENCV_TO_OPENGL, linear_to_srgb8

CAMERA = Intrinsics(140.0, 140.0, 80.0, 60.0, 160, 120)
LENS = {"fl_x": 140, "fl_y": 140, "cx": 80, "cy": 60, "w": 160, "h": 120, "world_up": "y"}
BODY_AXES = np.array([[0.0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])


def walk(count: int = 7) -> list[np.ndarray]:
    """A camera that turns, nods and moves."""
    poses = []
    for k in range(count):
        nod = np.eye(4)
        c, s = np.cos(0.08 * np.sin(k)), np.sin(0.08 * np.sin(k))
        nod[1:3, 1:3] = [[c, -s], [s, c]]
        poses.append(box_room.pose(0.06 * k, turn=0.3 + 0.09 * k).astype(np.float64) @ nod)
    return poses


@cache
def view(number: int) -> formats.View:
    """What the walk's camera of this number sees."""
    pose, confidence = walk(number + 1)[-1], np.zeros((120, 160), np.uint8)
    frame = box_room.frame(number, pose, depth=True, lens=CAMERA)
    return formats.View(linear_to_srgb8(frame.image), frame.depth_m, confidence, pose, number / 10)


def written(path: Path, stored: Callable[[np.ndarray], np.ndarray], count: int = 7, **keys: object) -> Path:
    """Write the walk as a transforms.json whose world is y-up, with its poses stored in some way."""
    formats.nerfstudio(path, list(map(view, range(count))))

    def change(index: dict) -> None:
        index.update(LENS | keys)
        for frame, pose in zip(index["frames"], walk(count), strict=True):
            frame["transform_matrix"] = stored(pose).tolist()

    edit(path / "transforms.json", change)
    return path


def in_unit(per_metre: float) -> Callable[[np.ndarray], np.ndarray]:
    """Poses of which a metre is so many units."""
    return lambda pose: np.hstack([pose[:, :3], pose[:, 3:] * [[per_metre], [per_metre], [per_metre], [1]]])


def with_w_first(pose: np.ndarray) -> np.ndarray:
    """A pose whose quaternion w, x, y, z a tool took for x, y, z, w."""
    x, y, z, w = formats.quaternion(pose[:3, :3])
    return pose_from_quaternion(np.array([w, x, y, z]), pose[:3, 3])


@pytest.mark.parametrize(
    ("stored", "keys", "says"),
    [
        (lambda pose: pose, {}, None),
        (lambda pose: pose @ OPENCV_TO_OPENGL, {}, "--camera-convention opencv"),
        (np.linalg.inv, {}, "--pose-direction world-to-camera"),
        (
            lambda pose: np.linalg.inv(pose @ OPENCV_TO_OPENGL),
            {},
            "--camera-convention opencv) and pose_direction (--pose-direction world-to-camera",
        ),
        (with_w_first, {}, "move otherwise than poses and depth say"),
        (in_unit(1000), {}, "about 1000 times as large"),
        (in_unit(39.37), {}, "about 39 times as large"),
        (in_unit(0.2), {}, "about 0.2"),
        (lambda pose: pose, {"world_up": "z"}, "--world-up y"),
        (lambda pose: pose @ BODY_AXES, {}, "axes are x forward, y left, z up"),
        (lambda pose: pose, {"fl_x": 280, "fl_y": 280}, "with about half the stated focal length"),
        (lambda _: walk()[0], {}, "poses do not stand still"),
        (lambda pose: pose @ np.diag([-1.0, -1, 1, 1]), {}, "move otherwise than poses and depth say"),
    ],
)
def test_conventions_that_contradict_the_pictures_are_pointed_out(
    tmp_path: Path, stored: Callable[[np.ndarray], np.ndarray], keys: dict, says: str | None
) -> None:
    capture = open_capture(written(tmp_path / "walk", stored, **keys))
    assert len(list(capture)) == 7
    assert len(capture.notes) == (says is not None)
    assert says is None or says in str(capture.notes[0])


@pytest.mark.parametrize(("per_metre", "size"), [(39.37, r"1[678]0 times as large as"), (1000, "another size than")])
def test_poses_in_another_unit_than_estimated_depth_are_pointed_out(
    tmp_path: Path, per_metre: float, size: str
) -> None:
    """The network expects a drawn room to be a fourth as large as it is."""
    path = written(tmp_path / "walk", in_unit(per_metre))
    edit(path / "transforms.json", lambda index: [frame.pop("depth_file_path") for frame in index["frames"]])
    (note,) = [note for note in notes_of(path) if "poses make" in note or "contradicts" in note]
    assert re.search(rf"its poses make the room {size} the pictures let expect: .* \(--camera-height\)", note)


def test_quaternions_with_w_first_are_pointed_out(tmp_path: Path) -> None:
    """Where the format has quaternions."""
    path = formats.tum(tmp_path / "walk", list(map(view, range(7))))
    lines = [line.split() for line in (path / "groundtruth.txt").read_text().splitlines()[1:]]
    (path / "groundtruth.txt").write_text("\n".join(" ".join([*line[:4], line[7], *line[4:7]]) for line in lines))
    (path / "camera-intrinsics.txt").write_text("140 0 79.5\n0 140 59.5\n0 0 1")
    list(capture := open_capture(path))
    assert "write them as qx qy qz qw" in str(capture.notes[0])


def test_poses_that_freeze_after_a_while_are_pointed_out(tmp_path: Path) -> None:
    poses = iter([*walk(9), *([walk(9)[-1]] * 7)])
    list(capture := open_capture(written(tmp_path / "walk", lambda _: next(poses), 16)))
    assert any("poses do not stand still" in str(note) for note in capture.notes)


def test_stated_conventions_that_fit_are_silent(tmp_path: Path) -> None:
    path = written(tmp_path / "walk", lambda pose: np.linalg.inv(pose @ OPENCV_TO_OPENGL))
    options = CaptureOptions(camera_convention="opencv", pose_direction="world-to-camera")
    list(capture := open_capture(path, options))
    assert capture.notes == ()


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"cx": 62}, "(62, 60) of 160 x 120"),
        ({"fl_x": 1400, "fl_y": 1400}, "1400 pixels"),
        ({"fl_y": 70}, "140 and 70"),
        ({"fl_x": 45, "fl_y": 45, "camera_model": "OPENCV_FISHEYE"}, None),  # straightened, each way to 120 degrees
    ],
)
def test_intrinsics_that_hardly_a_camera_has_are_pointed_out(transforms: Path, keys: dict, says: str | None) -> None:
    for file in (*(transforms / "images").iterdir(), *(transforms / "depth").iterdir()):
        stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        assert stored is not None
        cv2.imwrite(str(file), cv2.resize(stored, (160, 120), interpolation=cv2.INTER_NEAREST))
    edit(transforms / "transforms.json", lambda index: [frame.update(LENS | keys) for frame in index["frames"]])
    list(capture := open_capture(transforms))
    said = [note.left_out for note in capture.notes if note.effect == "it is taken as stated"]
    assert len(said) == (says is not None)
    assert says is None or says in said[0]
