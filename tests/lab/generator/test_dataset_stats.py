"""Measures of recordings made by hand have the expected values."""

import json
from dataclasses import replace

import numpy as np
import pytest

import stub_rooms
from roomlight.conventions import linear_to_srgb8
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_generator.stats import Spread, collect, coverage, measure, summarise
from rooms import BoxRoom, camera_at, pinhole


def room_recording(yaws, *, probe=(0.0, 1.5, 0.0), position=(0.0, 1.5, 0.0), fov=90.0):
    """A camera that turns in a box room, with exact depth, and one probe."""
    room = BoxRoom(size_m=(4.0, 3.0, 4.0))
    poses = [camera_at(position, yaw) for yaw in yaws]
    k = pinhole(160, 120, fov)
    shots = [room.frame(pose, width=160, height=120, fov_degrees=fov) for pose in poses]
    depth_mm = np.stack([np.rint(shot.depth_m * 1000).astype(np.uint16) for shot in shots])
    return Recording(
        name="box",
        colour=np.stack([linear_to_srgb8(shot.image) for shot in shots]),
        depth_mm=depth_mm,
        surface=np.zeros(depth_mm.shape, np.uint8),
        intrinsics=k,
        camera_to_world=np.stack(poses),
        exposure=np.ones(len(yaws)),
        timestamp_s=np.arange(len(yaws)) / 3,
        probe_positions=np.array([probe]),
        probe_panoramas=np.full((1, 16, 32, 3), 0.5, np.float32),
        facts={},
    )


def test_motion_is_metres_and_degrees_a_step():
    recording = room_recording([0, 5, 15, 15])
    recording.camera_to_world[2:, 0, 3] += 0.3
    stats = measure(recording, {})
    np.testing.assert_allclose(stats.steps_degrees, [5, 10, 0], atol=1e-4)
    np.testing.assert_allclose(stats.steps_m, [0, 0.3, 0], atol=1e-9)


def test_range_is_in_stops_over_the_median():
    recording = room_recording([0])
    recording.probe_panoramas[0, 4, 4] = 64.0
    stats = measure(recording, {})
    np.testing.assert_allclose(stats.range_stops, [7])
    assert stats.range_999_stops[0] < 7  # one pixel of 512 is 0.2 %, partly interpolated away
    np.testing.assert_allclose(stats.brightest, [64])
    assert stats.at_half_limit == 0
    recording.probe_panoramas[0, 5, 5] = 65504
    assert measure(recording, {}).at_half_limit == 1


def test_clipping_exposure_and_depth_are_measured():
    recording = room_recording([0, 90])
    recording.colour[:] = 100
    recording.colour[0, :60] = (255, 10, 10)
    recording.depth_mm[0, :, :40] = 0
    stats = measure(replace(recording, exposure=np.array([1.0, 4.0])), {"colour": 10})
    np.testing.assert_allclose(stats.clipped, [0.5, 0])
    assert stats.exposure_stops == 2
    np.testing.assert_allclose(stats.unknown_depth, 0.125)
    np.testing.assert_allclose(stats.median_depth_m, [2, 2], rtol=0.01)


def test_coverage_of_a_camera_at_the_probe_is_its_field_of_view():
    """90 x 73.7 degrees: solid angle 4 asin(sin(45) sin(36.9)) = 1.75 sr, 14 % of the sphere; cells of 6 degrees."""
    first, whole = coverage(room_recording([0.0]), np.array([0, 1.5, 0]))
    assert first == whole == pytest.approx(0.14, abs=0.025)
    first, whole = coverage(room_recording([0, 90, 180, 270]), np.array([0, 1.5, 0]))
    assert first == pytest.approx(0.14, abs=0.025)
    assert whole == pytest.approx(4 * 0.14, abs=0.08)


def test_a_spread_of_no_values_is_zero():
    assert Spread.of([]) == Spread(0.0, 0.0, 0.0, 0.0, 0.0)
    assert Spread.of([1.0, 2.0, 3.0]).median == 2
    assert summarise([]).spreads["step, m"].mean == 0


def test_a_dataset_is_measured_room_by_room(tmp_path):
    options = GenerateOptions(12, seed=1, shard_size=4, sequences_per_room=2, frames=4, renderer=stub_rooms.NAME)
    generate(tmp_path, options, workers=1)
    dataset = Dataset(tmp_path)
    calls = []
    stats = collect(dataset, progress=lambda done, of: calls.append((done, of)))
    assert calls == [(k, 12) for k in range(1, 13)]
    assert (stats.sequences, stats.rooms) == (12, 6)
    assert stats.counts["room types"] == {"hall": 2, "kitchen": 2, "study": 2}
    assert stats.counts["furniture"] == {"chair": 12, "lamp": 6}
    assert stats.counts["light sources"] == {"table_lamp": 6}
    assert stats.spreads["colour temperature, K"].median == 2950
    total = sum(dataset.size_of(number) for number in range(12)) / 12
    assert sum(stats.mean_bytes.values()) == pytest.approx(total)
    assert json.loads(json.dumps(stats.to_json()))["rooms"] == 6
    assert collect(dataset, limit=5).sequences == 5
