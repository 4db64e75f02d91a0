"""Scale from the floor: of exact, tilted, relative and noisy depth, past tables, and where no floor is seen."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from box_room import LENS, exact_depth, frame, pose
from roomlight.errors import CaptureError
from roomlight.frame import Frame
from roomlight.monocular.floor import FloorFit, camera_height, floor_scale
from roomlight.monocular.pose_scale import metres_per_unit


def _tilted(pitch: float, roll: float = 0.0) -> np.ndarray:
    """Return a camera at 1.4 m that looks down by `pitch` and is rolled."""
    c, s, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    at = pose(0.3).astype(np.float64)
    at[:3, :3] = np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) @ np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return at


@pytest.mark.parametrize("unit", [1.0, 0.2, 7.0])
@pytest.mark.parametrize("at", [_tilted(0.15), _tilted(0.4), _tilted(0.9, 0.3)], ids=["far", "down", "steep"])
def test_the_floor_gives_the_camera_s_height_in_the_unit_of_depth(at: np.ndarray, unit: float) -> None:
    fit = camera_height(unit * exact_depth(at), LENS, at[1, :3])
    assert fit is not None
    assert fit.height == pytest.approx(1.4 * unit, rel=0.02)
    assert 0.05 < fit.share <= 1


@pytest.mark.parametrize(("deviation", "width_px"), [(0.02, 0), (0.1, 20)], ids=["noise", "waves"])
def test_noise_waves_and_holes_of_depth_are_withstood(deviation: float, width_px: float) -> None:
    at, rng = _tilted(0.3), np.random.default_rng(3)
    depth = exact_depth(at)
    error = rng.normal(size=depth.shape)
    error = cv2.GaussianBlur(error, (0, 0), width_px) if width_px else error
    depth = depth * np.exp(error * deviation / error.std()).astype(np.float32)
    depth[:, 100:140] = 0
    fit = camera_height(depth, LENS, at[1, :3])
    assert fit is not None
    assert fit.height == pytest.approx(1.4, rel=0.05)


def test_a_table_in_front_is_not_the_floor() -> None:
    """A level top 0.6 m below the camera, which fills an eighth of the picture, hides a half of the floor."""
    at = _tilted(0.3)
    rays = LENS.rays().astype(np.float64)
    rise = rays @ at[1, :3]
    table = np.where((rise < -0.5) & (np.abs(rays[..., 0]) < 0.35), 0.6 / np.maximum(-rise, 1e-6), np.inf)
    depth = np.minimum(exact_depth(at), table).astype(np.float32)
    assert (depth < exact_depth(at)).mean() > 0.12
    fit = camera_height(depth, LENS, at[1, :3])
    assert fit is not None
    assert fit.height == pytest.approx(1.4, rel=0.03)


def test_no_floor_in_view_gives_nothing() -> None:
    up = _tilted(-0.9)
    assert camera_height(exact_depth(up), LENS, up[1, :3]) is None
    wall = np.full((240, 320), 2.0, np.float32)
    assert camera_height(wall, LENS, np.array([0.0, 1.0, 0.0])) is None
    assert camera_height(np.zeros((240, 320), np.float32), LENS, np.array([0.0, 1.0, 0.0])) is None


def test_frames_vote_for_the_scale_by_how_much_floor_they_show() -> None:
    fits = [FloorFit(0.5, 0.2), None, FloorFit(0.48, 0.2), FloorFit(2.0, 0.05), FloorFit(0.5, 0.1)]
    assert floor_scale(fits, height_m=1.0) == pytest.approx(2.0)
    assert floor_scale([None, None], 1.5) is None
    assert floor_scale([], 1.5) is None


def _walk(unit: float, *, depth: bool, pitch: float = 0.5, step: float = 0.12) -> list[Frame]:
    """Return frames of a walk whose poses have another unit."""
    frames: list[Frame] = []
    for k in range(4):
        at = _tilted(pitch)
        at[:3, 3] = (step * k, 1.4, 0)
        whole = frame(k, at, depth=True).scaled(1 / unit)
        frames.append(whole if depth else replace(whole, depth_m=np.zeros_like(whole.depth_m)))
    return frames


def test_depth_in_the_unit_of_the_poses_shows_its_metres() -> None:
    assert metres_per_unit(_walk(5.0, depth=True), 1.4) == pytest.approx(5.0, rel=0.02)
    assert metres_per_unit(_walk(5.0, depth=True), 2.8) == pytest.approx(10.0, rel=0.02)


@pytest.mark.slow
def test_motion_shows_the_metres_of_poses_without_depth_in_any_unit() -> None:
    scales = [metres_per_unit(_walk(unit, depth=False), 1.4) for unit in (0.05, 1.0, 40.0)]
    assert scales == pytest.approx([0.05 * scales[1], scales[1], 40.0 * scales[1]], rel=0.01)
    assert scales[1] == pytest.approx(1.0, rel=0.2)


def test_what_shows_no_scale_is_told() -> None:
    with pytest.raises(CaptureError, match=r"shows no floor.*camera_height_m=1\.4"):
        metres_per_unit(_walk(1.0, depth=True, pitch=-0.9), 1.4)
    with pytest.raises(CaptureError, match="no frame moved enough"):
        metres_per_unit(_walk(1.0, depth=False, step=0.0), 1.4)
