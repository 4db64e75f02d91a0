"""Folders with files of several programs: the recording is found, whatever lies beside it."""

import json
from pathlib import Path

import formats
import numpy as np
import pytest
from builders import BUILDERS, FORMAT_OF

from roomlight.captures import open_capture
from roomlight.errors import CaptureError

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


def test_record3ds_files_without_poses_are_named(tmp_path: Path) -> None:
    path = formats.record3d_export(tmp_path / "capture", VIEWS[:1])
    (path / "metadata.json").write_text('{"w": 32, "h": 24}')
    with pytest.raises(CaptureError, match=r"metadata\.json: poses is missing"):
        open_capture(path)


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
