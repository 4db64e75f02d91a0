"""The sample capture: the walk, the files, and what the package ships."""

from pathlib import Path

import numpy as np
import pytest

import roomlight
from roomlight.captures import Capture, open_capture
from roomlight.conventions import panorama_directions
from roomlight.errors import OutputError
from roomlight_model.sample_room import Quality, camera_path, generate_sample, room, textures
from roomlight_model.sample_room.render import expose, render_depth

SHIPPED = Path(roomlight.__file__).parent / "data" / "sample"


def tiny(out: Path) -> None:
    quality = Quality(frame_samples=1, probe_samples=1, gather_rays=4, bounces=3, points_per_face=1, detail_m=0.4)
    generate_sample(out, frames=3, width=48, height=36, probe_height=8, quality=quality)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_same_seed_gives_the_same_files_on_any_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny(tmp_path / "a")
    monkeypatch.setenv("ROOMLIGHT_THREADS", "1")
    tiny(tmp_path / "b")
    first, second = (files(tmp_path / name) for name in "ab")
    assert first == second
    assert len(first) == 1 + 3 + 3 + 3
    capture = open_capture(tmp_path / "a")
    frames = list(capture)
    assert [frame.image.shape for frame in frames] == [(36, 48, 3)] * 3
    with pytest.raises(OutputError, match="exists already"):
        tiny(tmp_path / "a")


def test_another_seed_is_another_walk_through_another_room() -> None:
    assert np.abs(camera_path.poses(5) - camera_path.poses(5, seed=8)).max() > 1e-3
    one, other = (textures.planks(np.random.default_rng(seed), height=88, width=400) for seed in (7, 8))
    assert np.abs(one - other).max() > 0.05


def test_the_walk_is_a_hand_held_phone_inside_the_room() -> None:
    poses = camera_path.poses(31)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    between = np.einsum("nij,nik->njk", poses[:-1, :3, :3], poses[1:, :3, :3])
    turns = np.degrees(np.arccos(np.clip((np.trace(between, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert 0.07 < steps.mean() < 0.11
    assert steps.max() < 0.15
    assert 4 < turns.mean() < 5
    assert turns.max() < 8
    heights = poses[:, 1, 3]
    assert heights.min() > 1.3
    assert heights.max() < 1.6
    gaze = -poses[:, :3, 2]
    azimuth = np.unwrap(np.arctan2(gaze[:, 2], gaze[:, 0]))
    assert 100 < np.degrees(azimuth[-1] - azimuth[0]) < 140
    np.testing.assert_array_equal(poses, camera_path.poses(31))


def test_camera_and_probes_keep_clear_of_the_furniture() -> None:
    scene = room.build_room(detail_m=0.4)
    directions = panorama_directions(90).reshape(-1, 3)
    poses = camera_path.poses(31)
    for position in (*camera_path.PROBES_M, *poses[::3, :3, 3]):
        origins = np.broadcast_to(np.asarray(position, np.float32), directions.shape)
        hits = scene.trace(origins, directions)
        assert hits.distance_m.min() > 0.25
        # Seen from inside a solid, all its faces show their backs; a few rays enter a leaf or curtain by its rim.
        assert hits.from_behind.mean() < 1e-3
    camera = camera_path.intrinsics(320, 240)
    depth = render_depth(scene, camera, poses[0])
    for probe in camera_path.PROBES_M:
        local = (np.asarray(probe) - poses[0, :3, 3]) @ poses[0, :3, :3]
        xy, z = camera.project(local[None])
        assert 20 < xy[0, 0] < 300
        assert 20 < xy[0, 1] < 220
        assert depth[int(xy[0, 1]), int(xy[0, 0])] > z[0] + 0.1


def test_exposure_clips_at_one_and_keeps_the_mean() -> None:
    image = np.full((64, 64, 3), 0.2, np.float32)
    image[:8] = 30.0
    shown = expose(image, rng=np.random.default_rng(0))
    assert (shown[:8] == 255).all()
    assert shown[8:].mean() == pytest.approx(124, abs=1)  # sRGB of 0.2 is 0.485
    assert 0.5 < shown[8:].std() < 4


@pytest.fixture(scope="module")
def shipped() -> Capture:
    return open_capture(SHIPPED)


def test_the_shipped_sample_is_small_and_whole(shipped: Capture) -> None:
    assert sum(path.stat().st_size for path in SHIPPED.rglob("*") if path.is_file()) < 6_000_000
    frames = list(shipped)
    assert len(frames) == 31
    assert all(frame.image.shape == (240, 320, 3) and frame.depth_m.shape == (240, 320) for frame in frames)
    expected = camera_path.poses(31)
    for frame, pose in zip(frames, expected, strict=True):
        np.testing.assert_allclose(frame.camera_to_world, pose, atol=1e-6)
    luminance = np.stack([frame.image @ np.array([0.2126, 0.7152, 0.0722], np.float32) for frame in frames])
    assert 0.15 < np.median(luminance) < 0.25
    assert 0.02 < np.mean([frame.clipped for frame in frames]) < 0.08
    unknown = [float((frame.depth_m == 0).mean()) for frame in frames]
    assert unknown[0] == unknown[-1] == 0
    assert max(unknown) > 0.1


def test_the_shipped_probes_are_hdr(shipped: Capture) -> None:
    probes = shipped.probes
    assert len(probes) == 3
    for probe, position in zip(probes, camera_path.PROBES_M, strict=True):
        np.testing.assert_allclose(probe.position, position)
        panorama = probe.panorama()
        assert panorama.shape == (120, 240, 3)
        assert 20 < panorama.max() < 60  # the globe
        toward = np.array(room.GLOBE) - np.array(position)
        nearest = (panorama_directions(120) @ (toward / np.linalg.norm(toward)).astype(np.float32)).argmax()
        np.testing.assert_allclose(panorama.reshape(-1, 3)[nearest], room.GLOBE_RADIANCE, rtol=0.05)
