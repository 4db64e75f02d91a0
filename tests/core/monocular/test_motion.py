"""Cameras of a video from its pictures: turns, walks, an unknown lens, what is lost and why; and their adjustment."""

from dataclasses import replace

import numpy as np
import pytest

import box_room
from box_room import LENS, exact_depth, frame, pose
from depth_models import StatedDepth
from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.monocular import adjustment
from roomlight.monocular.adjustment import Cameras, Sightings, adjusted, in_metres, reprojection_errors
from roomlight.monocular.estimate import srgb_picture
from roomlight.monocular.features import FeatureTracker, matched
from roomlight.monocular.motion import CameraMotion, CameraPath
from roomlight.monocular.tracks import grey_picture


def _path(
    poses: list[np.ndarray],
    pictures: list[np.ndarray] | None = None,
    *,
    lens: Intrinsics = LENS,
    known: bool = True,
    breathing: float = 0.0,
    level: bool = True,
) -> CameraPath:
    """The path by pictures, by default those of the room from these poses; every depth has another error of scale."""
    model = StatedDepth("metric", lambda call: 1 / ((1 + breathing * (-1) ** call) * exact_depth(poses[call])))
    motion = CameraMotion(model, lens, focal_is_known=known)
    for number, picture in enumerate(_pictures(poses) if pictures is None else pictures):
        motion.place(motion.described(number, picture))
    assert not any(up is not None for up in model.told)  # it is told by all pictures together
    return motion.path(level=level)


def _pictures(poses: list[np.ndarray]) -> list[np.ndarray]:
    return [srgb_picture(frame(number, at)) for number, at in enumerate(poses)]


def _errors(path: CameraPath, poses: list[np.ndarray]) -> tuple[float, float]:
    """The largest error of turns (degrees) and places (metres), in the first camera's axes."""
    turns, places = [], []
    for number, estimated in path.poses.items():
        true = rigid_inverse(poses[0].astype(np.float64)) @ poses[number]
        own = rigid_inverse(path.poses[0]) @ estimated
        cosine = (np.trace(true[:3, :3].T @ own[:3, :3]) - 1) / 2
        turns.append(np.degrees(np.arccos(min(1.0, cosine))))
        places.append(np.linalg.norm(true[:3, 3] - own[:3, 3]))
    return max(turns), max(places)


@pytest.mark.slow
def test_a_camera_that_turns_on_the_spot() -> None:
    poses = [pose(0, turn=0.1 * k) for k in range(8)]
    path = _path(poses, breathing=0.1)
    assert list(path.poses) == list(range(8))
    turn, place = _errors(path, poses)
    assert turn < 1  # of 40
    assert place < 0.08


@pytest.mark.slow
def test_a_walk_has_the_network_s_metres() -> None:
    poses = [pose(0.1 * k, turn=0.02 * k) for k in range(8)]
    turn, place = _errors(_path(poses, breathing=0.05), poses)
    assert turn < 0.5
    assert place < 0.06  # of 0.7 m


@pytest.mark.slow
def test_walls_whose_features_look_alike_are_followed() -> None:
    """Each feature has the looks of many others, so that none is recognised."""
    poses = [pose(0.03 * k, turn=0.08 * k) for k in range(10)]
    pictures: list[np.ndarray] = []
    for at in poses:
        points = box_room.hit(at, LENS)[1]
        value = 0.5 + 0.3 * np.sin(6 * points).prod(axis=2) + 0.15 * np.cos(6 * points).sum(axis=2) / 3
        pictures.append(np.repeat(value[..., None], 3, axis=2).astype(np.float32))
    path = _path(poses, pictures)
    assert list(path.poses) == list(range(10))
    turn, place = _errors(path, poses)
    assert turn < 2  # of 41
    assert place < 0.15  # of 0.27 m


def test_a_picture_that_shares_too_little_is_lost() -> None:
    """The first one shows a strip alone: cameras are then those of the others, in the axes of the first of these."""
    poses = [pose(0, turn=0.05 * k) for k in range(6)]
    pictures = _pictures(poses)
    pictures[0][:, :-60] = 0.5
    path = _path(poses, pictures, level=False)
    assert list(path.poses) == [1, 2, 3, 4, 5]
    assert "shares too little" in path.lost[0]
    np.testing.assert_allclose(path.poses[1], np.eye(4), atol=1e-9)


def test_a_feature_keeps_its_track_while_it_is_followed() -> None:
    tracker = FeatureTracker()
    poses = [pose(0, turn=0.05 * k) for k in range(3)]
    first, _, third = (tracker.features(grey_picture(srgb_picture(frame(k, at)))) for k, at in enumerate(poses))
    same = np.intersect1d(first.tracks, third.tracks, return_indices=True)[1:]
    assert len(same[0]) > 50
    rays = np.concatenate([(first.pixels[same[0]] - [LENS.cx, LENS.cy]) / LENS.fx, np.ones((len(same[0]), 1))], axis=1)
    across = np.arctan2(rays[:, 0], 1) + 0.1  # the camera turned to the left, about the vertical
    ahead = np.hypot(rays[:, 0], 1)
    expected = np.stack(
        [LENS.cx + LENS.fx * np.tan(across), LENS.cy + LENS.fy * rays[:, 1] / ahead / np.cos(across)], 1
    )
    assert np.median(np.linalg.norm(third.pixels[same[1]] - expected, axis=1)) < 0.3
    pairs = matched(first, third)
    assert len(np.unique(pairs[:, 0])) == len(pairs) > len(same[0]) / 2


@pytest.mark.slow
def test_the_focal_length_follows_from_the_motion() -> None:
    poses = [pose(0, turn=0.12 * k) for k in range(8)]
    path = _path(poses, lens=replace(LENS, fx=0.88 * LENS.fx, fy=0.88 * LENS.fy), known=False)
    assert path.intrinsics.fx == pytest.approx(LENS.fx, rel=0.02)
    assert _errors(path, poses)[0] < 1.5  # of 48


@pytest.mark.slow
def test_what_is_lost_says_why() -> None:
    poses, behind = [pose(0, turn=0.05 * k) for k in range(6)], pose(0, turn=3.0)
    unusable = [np.full((240, 320, 3), grey, np.float32) for grey in (0.02, 0.6)]
    path = _path([*poses, behind], [*_pictures(poses), *unusable, srgb_picture(frame(8, behind))])
    assert list(path.poses) == list(range(6))
    for number, reason in ((6, "too dark"), (7, "bare wall"), (8, "a cut")):
        assert reason in path.lost[number]


def test_nothing_placed_is_no_error_of_the_path() -> None:
    path = _path([], [np.zeros((240, 320, 3), np.float32)])
    assert path.poses == {}
    assert "too dark" in path.lost[0]


# The adjustment


@pytest.fixture
def problem() -> tuple[Cameras, Sightings]:
    """Four cameras that see 60 landmarks of two hosts, a little off."""
    rng = np.random.default_rng(3)
    host = np.repeat([0, 1], 30)
    pixel = rng.uniform(-140, 140, (60, 2))
    landmark = np.repeat(np.arange(60), 2)
    picture = np.array([[(other + 1) % 4, (other + 2) % 4] for other in host]).ravel()
    turns = np.stack([adjustment.cv2.Rodrigues(rng.normal(size=3) * 0.1)[0] for _ in range(4)])
    turns[0] = np.eye(3)
    centres = rng.normal(size=(4, 3)) * 0.2
    centres[0] = 0
    stated = np.log(1 / rng.uniform(1, 4, 60))
    cameras = Cameras(turns, centres, np.zeros(4), stated, 280.0)
    blank = Sightings(host, pixel, stated, landmark, picture, np.zeros((120, 2)), 0.5, (280.0, 0.1), 0.25)
    seen = adjustment._projected(cameras, blank)[0]
    return cameras, replace(blank, seen=seen)


def _off(cameras: Cameras, step: np.ndarray) -> Cameras:
    return adjustment._moved(cameras, step, np.zeros(60))


def test_derivatives_are_those_of_differences(problem: tuple[Cameras, Sightings]) -> None:
    cameras, sightings = problem
    jacobian, to_inverse, _ = adjustment._jacobians(cameras, sightings)
    size, small = 7 * 4 + 1, 1e-6
    for column in range(size):
        if 24 <= column < 28:
            continue  # scales do not move pixels
        step = np.zeros(size)
        step[column] = small
        ahead, behind = (adjustment._projected(_off(cameras, sign * step), sightings)[0] for sign in (1, -1))
        expected = np.zeros((120, 2))
        host, picture = sightings.host[sightings.landmark], sightings.picture
        if column == size - 1:
            expected = jacobian[:, :, 13]
        else:
            camera, part = divmod(column, 6)
            expected[host == camera] += jacobian[host == camera, :, part]
            expected[picture == camera] += jacobian[picture == camera, :, 6 + part]
        np.testing.assert_allclose((ahead - behind) / (2 * small), expected, atol=1e-3)
    nearer, farther = (
        adjustment._projected(replace(cameras, log_inverse=cameras.log_inverse + sign * small), sightings)[0]
        for sign in (1, -1)
    )
    np.testing.assert_allclose((nearer - farther) / (2 * small), to_inverse, atol=1e-3)


def test_the_adjustment_finds_cameras_that_are_off(problem: tuple[Cameras, Sightings]) -> None:
    cameras, sightings = problem
    step = np.random.default_rng(4).normal(size=29) * 0.02
    step[:6] = step[24:] = 0
    start = _off(cameras, step)
    assert np.median(reprojection_errors(start, sightings)) > 3
    fitted = adjusted(start, sightings)
    assert reprojection_errors(fitted, sightings).max() < 0.05
    np.testing.assert_allclose(fitted.centres, cameras.centres, atol=2e-3)
    assert fitted.focal == pytest.approx(cameras.focal, rel=2e-3)


def test_parallax_outweighs_depth_whose_errors_are_alike(problem: tuple[Cameras, Sightings]) -> None:
    """The network takes the left of each picture for nearer than it is and the right for farther, by up to a third."""
    cameras, sightings = problem
    slanted = sightings.log_stated - 0.3 * sightings.pixel[:, 0] / 140
    wrong = replace(sightings, log_stated=slanted)
    tight, loose = (
        adjusted(replace(cameras, log_inverse=slanted), replace(wrong, depth_error=error)) for error in (0.25, 2.0)
    )
    bent = [np.abs(fitted.turns - cameras.turns).max() for fitted in (tight, loose)]
    assert bent[1] < 0.2 * bent[0]


def test_the_scale_is_the_network_s_where_parallax_tells_depth(problem: tuple[Cameras, Sightings]) -> None:
    cameras, sightings = problem
    half = replace(cameras, centres=cameras.centres / 2, log_inverse=cameras.log_inverse + np.log(2))
    assert reprojection_errors(half, sightings).max() < 1e-6
    scaled = in_metres(half, sightings)
    np.testing.assert_allclose(scaled.centres, cameras.centres, rtol=1e-6)
    turned = replace(half, centres=np.zeros((4, 3)))  # nothing tells depth
    assert in_metres(turned, sightings) is turned


def test_the_scale_of_a_picture_s_depth_is_found(problem: tuple[Cameras, Sightings]) -> None:
    """The network takes everything in the second host for a tenth nearer than in the first."""
    cameras, sightings = problem
    nearer = sightings.log_stated + 0.1 * (sightings.host == 1)
    fitted = adjusted(cameras, replace(sightings, log_stated=nearer))
    apart = fitted.log_scale[1] - fitted.log_scale[0]
    assert 0.05 < apart < 0.11
    assert reprojection_errors(fitted, sightings).max() < 0.3


def test_a_wrong_sighting_weighs_little(problem: tuple[Cameras, Sightings]) -> None:
    cameras, sightings = problem
    seen = sightings.seen.copy()
    seen[::15] += 60
    fitted = adjusted(cameras, replace(sightings, seen=seen))
    good = np.arange(120) % 15 != 0
    assert np.median(reprojection_errors(fitted, replace(sightings, seen=seen))[good]) < 0.3
