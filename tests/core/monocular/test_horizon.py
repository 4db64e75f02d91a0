"""Which way is up in pictures: by lines of a room, by drawn edges, and what is said where there are none."""

import cv2
import numpy as np
import pytest

from roomlight.camera import Intrinsics
from roomlight.monocular.horizon import Lines, lines_of, upright

LENS = Intrinsics(300.0, 300.0, 160.0, 120.0, 320, 240)


def _turn(pitch_deg: float, roll_deg: float) -> np.ndarray:
    """Camera to world of a camera that looks up by `pitch_deg`, then is rolled."""
    pitch, roll = np.radians([pitch_deg, roll_deg])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    about_z = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    return about_x @ about_z


def _lines(directions: np.ndarray, turn: np.ndarray, rng: np.random.Generator) -> Lines:
    """Lines of these world directions through points before the camera, half a degree off."""
    points = np.stack(
        [rng.uniform(-1, 1, len(directions)), rng.uniform(-0.8, 0.8, len(directions)), -np.ones(len(directions))], 1
    )
    normals = np.cross(points, directions @ turn) + rng.normal(size=points.shape) * 0.005
    return Lines(normals / np.linalg.norm(normals, axis=1, keepdims=True), np.full(len(points), 0.15))


def _off_deg(up: tuple[float, float, float], turn: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, float(np.array(up) @ turn[1])))))


@pytest.mark.parametrize(("pitch", "roll"), [(0, 0), (-15, 3), (18, -5)])
def test_the_lines_of_a_room(pitch: float, roll: float) -> None:
    rng, turn = np.random.default_rng(2), _turn(pitch, roll)
    yaw = np.radians(35)
    axes = np.array([[0, 1, 0], [np.cos(yaw), 0, np.sin(yaw)], [-np.sin(yaw), 0, np.cos(yaw)]])
    clutter = rng.normal(size=(12, 3))
    directions = np.concatenate([np.repeat(axes, 10, axis=0), clutter])
    estimate = upright([_lines(directions, turn, rng)], [np.eye(3)])
    assert estimate.sure
    assert _off_deg(estimate.up, turn) < 1


@pytest.mark.parametrize("pitch", [-24, -45])
def test_a_camera_that_looks_far_down(pitch: float) -> None:
    rng, turn = np.random.default_rng(2), _turn(pitch, 0)
    estimate = upright([_lines(np.repeat(np.eye(3), 10, axis=0), turn, rng)], [np.eye(3)])
    assert estimate.sure
    assert _off_deg(estimate.up, turn) < 1


def test_pictures_agree_on_one_direction() -> None:
    rng = np.random.default_rng(6)
    turns = [_turn(-20, 2), _turn(-10, -4), _turn(5, 1)]
    first = turns[0]
    pictures = [_lines(np.repeat([[0.0, 1, 0]], 4, axis=0), turn, rng) for turn in turns]
    estimate = upright(pictures, [first.T @ turn for turn in turns])
    assert _off_deg(estimate.up, first) < 1


def test_without_lines_the_camera_counts_as_held_in_a_hand_and_unsure() -> None:
    estimate = upright([lines_of(np.full((240, 320), 90, np.uint8), LENS)], [np.eye(3)])
    assert not estimate.sure
    assert _off_deg(estimate.up, _turn(-12, 0)) < 3


def test_edges_of_a_picture_become_planes_through_the_camera() -> None:
    grey = np.full((240, 320), 60, np.uint8)
    cv2.rectangle(grey, (200, 40), (260, 200), 200, -1)
    lines = lines_of(grey, LENS)
    upward = np.abs(lines.normals[:, 1]) < 0.02
    assert int(upward.sum()) >= 2  # the two vertical edges: their planes hold the camera's y axis
    assert lines.lengths[upward].max() == pytest.approx(160 / 400, abs=0.03)


def test_another_focal_length_turns_the_planes() -> None:
    grey = np.full((240, 320), 60, np.uint8)
    cv2.line(grey, (40, 30), (280, 210), 220, 3)
    wide, narrow = LENS, Intrinsics(450.0, 450.0, 160.0, 120.0, 320, 240)
    expected = lines_of(grey, narrow).normals
    np.testing.assert_allclose(lines_of(grey, wide).refocused(1.5).normals, expected, atol=1e-9)


def test_a_tiny_picture_has_no_lines() -> None:
    assert len(lines_of(np.eye(64, dtype=np.uint8) * 255, LENS.resized(64, 64)).lengths) == 0
