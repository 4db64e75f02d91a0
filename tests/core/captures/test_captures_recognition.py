"""Folders with files of several programs: the recording is found, whatever lies beside it."""

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
