"""Scores of estimated poses: angles, panoramas of another world's axes, and which frame sees a probe."""

import cv2
import numpy as np
import pytest

from box_room import frame, pose
from roomlight.captures import CaptureOptions
from roomlight.engine.session import SessionOptions
from roomlight.errors import OptionError
from roomlight_evaluation.captures.poses import PoseScore, PoseScores, _in_view, evaluate_poses, rotation_deg, turned


def _yaw(degrees: float) -> np.ndarray:
    return cv2.Rodrigues(np.array([0.0, np.radians(degrees), 0.0]))[0]


def test_the_angle_between_two_rotations() -> None:
    assert rotation_deg(_yaw(10), _yaw(37)) == pytest.approx(27)


def test_a_panorama_turns_about_the_vertical_by_columns() -> None:
    panorama = np.random.default_rng(1).random((16, 32, 3)).astype(np.float32)
    np.testing.assert_allclose(turned(panorama, np.eye(3)), panorama, atol=1e-4)
    quarter = turned(panorama, _yaw(90))
    assert any(np.allclose(quarter, np.roll(panorama, shift, axis=1), atol=1e-3) for shift in (8, -8))


def test_a_probe_is_in_view_before_the_camera_alone() -> None:
    shot = frame(0, pose(0))
    centre, back = shot.camera_to_world[:3, 3], shot.camera_to_world[:3, 2]
    assert _in_view(centre - back, shot)
    assert not _in_view(centre + back, shot)
    assert not _in_view(centre - back + 9 * shot.camera_to_world[:3, 0], shot)


def test_the_table_has_captures_by_their_names_the_median_and_the_worst() -> None:
    near, far = (PoseScore(f"a [y{n:g}]", 9, 1.0, 0.1, n, n, n, 1.0, 0.2, (0.1,), (n, 1.0)) for n in (1.0, 3.0))
    names, *_, light = (list(column.cells) for column in PoseScores((near, far)).table().columns)
    assert names == [r"a \[y1]", r"a \[y3]", "median", "worst"]
    assert light == ["1", "3", "2", "3"]


def test_a_video_has_no_poses_to_score_against(tmp_path) -> None:
    (tmp_path / "room.mp4").write_bytes(b"never read")
    with pytest.raises(OptionError, match="a video without depth"):
        evaluate_poses([tmp_path / "room.mp4"], SessionOptions(model="classical"), CaptureOptions())
