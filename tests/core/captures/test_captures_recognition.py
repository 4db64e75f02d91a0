"""Folders with files of several programs: the recording is found, whatever lies beside it."""

import json
import re
import shutil
from pathlib import Path

import formats
import numpy as np
import pytest
from builders import BUILDERS, FORMAT_OF
from capture_checks import refused

from roomlight.captures import CaptureOptions, open_capture
from roomlight.errors import UnknownFormatError

VIEWS = formats.scene()


@pytest.mark.parametrize("kind", ["tum", "seven-scenes", "colmap", "polycam", "record3d-export"])
def test_metadata_of_another_program_is_not_record3ds(tmp_path: Path, kind: str) -> None:
    path = BUILDERS[kind](tmp_path / "capture", VIEWS[:2])
    formats.save(path / "metadata/info.txt", b"x")
    if kind != "record3d-export":
        formats.save(path / "metadata.json", b'{"name": "room"}')
    frames = list(capture := open_capture(path))
    assert capture.format == FORMAT_OF[kind]
    poses = [view.pose for view in VIEWS[:2]]
    np.testing.assert_allclose([frame.camera_to_world for frame in frames], poses, atol=1e-6)
    formats.save(tmp_path / "outer/metadata.json", b"{}")
    path.rename(tmp_path / "outer/capture")
    assert open_capture(tmp_path / "outer").path == tmp_path / "outer/capture"


@pytest.mark.parametrize("data", [b"", b" " * (1 << 21)])
def test_cameras_of_another_program_are_not_polycams(tmp_path: Path, data: bytes) -> None:
    path = formats.colmap(tmp_path / "capture", VIEWS[:2])
    formats.save(path / "cameras/cameras.json", data)
    assert open_capture(path).format == "colmap"


def test_record3ds_files_without_poses_are_named(tmp_path: Path) -> None:
    path = formats.record3d_export(tmp_path / "capture", VIEWS[:1])
    (path / "metadata.json").write_text('{"w": 32, "h": 24, "K": []}')
    refused(path, r"metadata\.json: poses is missing.*record with LiDAR.*roomlight light")


def test_images_beside_metadata_without_record3ds_keys_are_not_record3ds(tmp_path: Path) -> None:
    path = formats.record3d_export(tmp_path / "capture", VIEWS[:1])
    (path / "metadata.json").write_text('{"frameCount": 1}')
    refused(path, r"rgb/0\.jpg without focal lengths", error=UnknownFormatError)
    members = {name: (path / name).read_bytes() for name in ("metadata.json", "rgb/0.jpg")}
    refused(formats.zipped(tmp_path / "a.zip", members), r"holds rgb/0\.jpg without", error=UnknownFormatError)


@pytest.mark.parametrize("kind", ["record3d", "polycam"])
def test_a_trainers_index_does_not_hide_the_recording_with_depth(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "capture"
    if kind == "polycam":
        formats.polycam(path, VIEWS[:2])
    else:
        for name, data in formats.record3d_members(VIEWS[:2]).items():
            formats.save(path / name, data)
    picture = next(file for file in path.rglob("*.jpg")).relative_to(path).as_posix()
    frame = {"file_path": picture, "transform_matrix": np.eye(4).tolist()}
    index = {"fl_x": formats.FX, "w": formats.WIDTH, "h": formats.HEIGHT, "frames": [frame]}
    formats.save(path / "transforms.json", json.dumps(index).encode())
    capture = open_capture(path)
    assert (capture.format, capture.frame_count) == (kind, 2)
    (note,) = capture.notes
    assert "transforms.json: it leads to no depth" in note.left_out
    named = open_capture(path / "transforms.json")
    assert (named.format, len(list(named))) == ("nerfstudio", 1)
    assert any("depth" in note.left_out and "is read from there" in note.effect for note in named.notes)
    frame["depth_file_path"] = "depth/0.png"
    formats.save(path / "transforms.json", json.dumps(index).encode())
    assert open_capture(path).format == "nerfstudio"


@pytest.mark.parametrize("kind", ["record3d", "scannet"])
def test_a_folder_or_zip_with_one_recorded_file(tmp_path: Path, kind: str) -> None:
    recorded = BUILDERS[kind](tmp_path / "scans/scene0000_00/scene0000_00", VIEWS[:2])
    formats.save(recorded.with_name("scene0000_00.txt"), b"axisAlignment = 1")
    capture, zipped = open_capture(tmp_path / "scans"), tmp_path / "a.ZIP"
    assert (capture.format, capture.path, len(list(capture))) == (kind, recorded, 2)
    formats.zipped(zipped, {f"scan/{recorded.name}": recorded.read_bytes()})
    assert len(list(open_capture(zipped))) == 2
    shutil.copy(recorded, recorded.with_stem("b"))
    formats.zipped(tmp_path / "b.zip", {"scan/a.zip": zipped.read_bytes()})
    refused(tmp_path / "b.zip", r"b\.zip: holds the archive scan/a\.zip; unpack it", error=UnknownFormatError)
    refused(
        recorded.parent, r"holds 2 captures \(b\.\w+, scene0000_00\.\w+\); open one of them", error=UnknownFormatError
    )


def test_a_folder_with_nothing_but_a_video(tmp_path: Path) -> None:
    formats.video(tmp_path / "walk/IMG_1.MOV", [view.srgb8 for view in VIEWS])
    for name in (".DS_Store", "IMG_1.AAE", "IMG_1.THM"):
        formats.save(tmp_path / "walk" / name, b"x")
    assert open_capture(tmp_path / "walk").format == "video"
    formats.save(tmp_path / "walk/depth/000000.png", b"x")  # a part of something else
    refused(tmp_path / "walk", "no capture format recognised", error=UnknownFormatError)


@pytest.mark.parametrize("folder", ["images", "input", "results"])
@pytest.mark.parametrize(
    "name",
    [
        *("sfm_data.json", "bundle.out", "shot.chan", "shot.abc", "shot.fbx", "shot.usda", "reconstruction.json"),
        *("poses_bounds.npy", "cameras_sphere.npz", "traj.txt", "trajectory.log"),
    ],
)
def test_cameras_of_other_programs_are_named(tmp_path: Path, folder: str, name: str) -> None:
    formats.save(tmp_path / folder / "000000.png", formats.image(".png", VIEWS[0].srgb8))
    formats.save(tmp_path / name, b"x")
    refused(tmp_path, rf"the cameras in {re.escape(name)} are not read; write them into transforms\.json")


def test_a_part_of_a_recording_leads_to_the_whole(tmp_path: Path) -> None:
    stray, tum = formats.stray_scanner(tmp_path / "stray", VIEWS[:2]), formats.tum(tmp_path / "tum", VIEWS[:2])
    opened = open_capture(stray / "rgb.mp4")
    assert (opened.format, opened.path) == ("stray-scanner", stray)
    assert open_capture(stray / "rgb.mp4", CaptureOptions(format="video")).format == "video"
    for part in (stray / "depth", stray / "odometry.csv", tum / "rgb", tum / "rgb.txt"):
        whole = part.parent
        refused(part, rf"is part of the [\w-]+ recording {whole}; open that$", error=UnknownFormatError)


def test_errors_of_a_zip_name_the_zip(tmp_path: Path) -> None:
    formats.zipped(tmp_path / "a.zip", {"scene.sens": b"no recording"})
    refused(tmp_path / "a.zip", f"^{re.escape(str(tmp_path))}/a.zip/scene.sens: is ")
