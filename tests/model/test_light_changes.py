"""Sequences whose light changes: a lamp that is switched, all light that gets brighter or dimmer."""

from dataclasses import replace

import numpy as np
import pytest

from roomlight.conventions import panorama_directions
from roomlight_model.training import light_changes
from roomlight_model.training.light_changes import LightChanges, SphereLamp
from roomlight_model.training.sequences import revisit
from rooms import BoxRoom, camera_at
from tiny_stages import box_walk

LAMP = SphereLamp(np.array([0.2, 1.5, -1.2]), 0.2, np.array([8.0, 7.0, 6.0], np.float32))


def frame_at(yaw_deg: float = 0.0):
    return BoxRoom().frame(camera_at((0.2, 1.4, 1.2), yaw_deg), width=80, height=60)


def test_a_lamp_is_drawn_where_its_centre_projects():
    frame = frame_at(12.0)
    shown = LAMP.shown_in(frame)
    covered = (shown.image != frame.image).any(-1)
    rows, columns = np.nonzero(covered)
    rotation, eye = frame.camera_to_world[:3, :3], frame.camera_to_world[:3, 3]
    (xy,), (depth,) = frame.intrinsics.project((LAMP.centre - eye)[None] @ rotation)
    assert abs(columns.mean() + 0.5 - xy[0]) < 1
    assert abs(rows.mean() + 0.5 - xy[1]) < 1
    assert (shown.image[covered] == LAMP.radiance).all()
    changed = shown.depth_m != frame.depth_m
    assert shown.depth_m[changed].min() == pytest.approx(float(depth) - LAMP.radius_m, abs=0.02)


def test_a_lamp_behind_a_surface_is_not_shown():
    frame = frame_at()
    behind = replace(LAMP, centre=np.array([0.2, 1.5, -40.0]))
    shown = behind.shown_in(frame)
    np.testing.assert_array_equal(shown.image, frame.image)
    np.testing.assert_array_equal(shown.depth_m, frame.depth_m)


def test_a_lamp_fills_its_solid_angle_in_the_truth():
    position = np.array([0.2, 1.1, 0.3])
    lit = LAMP.added_to(np.zeros((1, 60, 120, 3), np.float32), position[None], frame_at())[0]
    towards = LAMP.centre - position
    angles = np.degrees(np.arccos(panorama_directions(60) @ (towards / np.linalg.norm(towards))))
    radius_deg = np.degrees(np.arcsin(LAMP.radius_m / np.linalg.norm(towards)))
    np.testing.assert_array_equal(
        lit[angles < radius_deg - 0.01], np.broadcast_to(LAMP.radiance, lit.shape)[angles < radius_deg - 0.01]
    )
    assert not lit[angles > radius_deg + 0.01].any()


def test_a_surface_between_hides_a_lamp_from_a_probe():
    frame = frame_at()
    wall = replace(frame, depth_m=np.where(np.arange(80) < 40, 0.8, frame.depth_m).astype(np.float32))
    left, right = np.array([0.0, 1.45, -0.9]), np.array([0.35, 1.45, -0.9])
    assert LAMP.reaches(left, frame)
    assert not LAMP.reaches(left, wall)
    assert LAMP.reaches(right, wall)


@pytest.mark.parametrize("lamp_share", [0.0, 1.0])
def test_images_and_truth_change_at_the_same_frame(lamp_share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_changes, "LAMP_SHARE", lamp_share)
    monkeypatch.setattr(light_changes, "_NEAREST_LAMP_M", 0.3)
    brighter, lamps = set(), 0
    for seed in range(8):
        plain, walk = (
            box_walk(np.random.default_rng(seed), length=5, change_light=change) for change in (None, LightChanges(1.0))
        )
        at = int(walk.light_of.argmax())
        assert walk.light_of.tolist() == [0] * at + [1] * (5 - at)
        assert at >= 1
        assert all(frame.image.max() <= white for frame, white in zip(walk.frames, walk.example.whites, strict=True))
        changed = [bool((a.image != b.image).any()) for a, b in zip(plain.frames, walk.frames, strict=True)]
        assert not any(changed[:at]) or not any(changed[at:])
        before, after = walk.lights.mean(axis=(1, 2, 3, 4))
        dim = walk.lights[0 if after > before else 1]
        np.testing.assert_array_equal(dim, plain.lights[0])
        brighter.add(bool(after > before))
        gain = walk.lights.max(axis=0) / np.maximum(plain.lights[0], 1e-6)
        lamps += bool(gain.max() > 1.5 * np.median(gain))
    assert brighter == {True, False}
    assert lamps == 0 if lamp_share == 0 else lamps >= 2


def test_all_sequences_have_two_lights_and_a_share_changes():
    changed = [box_walk(np.random.default_rng(seed), length=5, change_light=LightChanges(0.5)) for seed in range(16)]
    assert all(len(walk.lights) == 2 for walk in changed)
    assert 4 <= sum(bool(walk.light_of.any()) for walk in changed) <= 12


def test_revisits_stay_or_return_the_same_way():
    rng = np.random.default_rng(0)
    stayed = returned = 0
    for _ in range(200):
        numbers = revisit([4, 6, 8, 10, 12, 14], rng)
        assert len(numbers) == 6
        assert numbers[0] == 4
        steps = np.abs(np.diff(numbers))
        assert set(steps.tolist()) <= {0, 2}
        assert len(set(numbers)) < 6
        stayed += numbers[-1] == numbers[-2]
        returned += bool((np.diff(numbers) < 0).any())
    assert stayed > 50
    assert returned > 50
