"""Rooms lit by panoramas: their light, geometry, exposure and files."""

import cv2
import numpy as np
import pytest
from panorama_files import folder_of, panorama

from fixture_rooms import plain_catalogue
from roomlight.camera import Intrinsics, transform_points
from roomlight.conventions import LUMINANCE, direction_to_uv, panorama_directions, panorama_solid_angles
from roomlight.dataset.folder import read_manifest
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import GLASS, LIGHT, ORDINARY
from roomlight.errors import DatasetError, OptionError
from roomlight.frame import CLIPPED_SRGB8
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_generator.panoramas import render
from roomlight_generator.panoramas.library import split_of
from roomlight_generator.panoramas.room import PanoramaRoom, classify_surfaces, percentile
from roomlight_generator.panoramas.shell import draw_shell
from roomlight_generator.room_request import RoomRequest
from stub_rooms import without_workers


def shells():
    """One shell of each shape."""
    by_shape = {}
    for seed in range(60):
        shell = draw_shell(np.random.default_rng(seed))
        by_shape.setdefault((shell.facts["shape"], shell.facts["hall"]), shell)
    assert {shape for shape, _ in by_shape} == {"box", "corner", "slope", "gable"}
    return list(by_shape.values())


SHELLS = shells()


def room_of(shell, image):
    return PanoramaRoom(shell, image, np.zeros(image.shape[:2], np.uint8))


def energy(image):
    return (image * panorama_solid_angles(len(image))[..., None]).sum(axis=(0, 1))


@pytest.mark.parametrize("shell", SHELLS)
def test_a_probe_at_the_centre_sees_the_panorama(shell):
    image = panorama(height=256)
    seen = room_of(shell, image).panorama(shell.centre, height=64, seed=0)
    expected = cv2.resize(image, (128, 64), interpolation=cv2.INTER_AREA)
    weight = panorama_solid_angles(64)[..., None]
    assert (np.abs(seen - expected) * weight).sum() < 0.01 * (expected * weight).sum()
    np.testing.assert_allclose(energy(seen), energy(image), rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("shell", SHELLS[:3])
def test_small_lamps_keep_their_energy(shell):
    """A lamp of a pixel of the panorama, many times smaller than the probe's pixels."""
    image = np.full((512, 1024, 3), 1e-6, np.float32)
    rng = np.random.default_rng(5)
    rows, columns = rng.integers(60, 450, 30), rng.integers(0, 1024, 30)
    columns[0] = 0  # on the seam
    image[rows, columns] = 1000
    room = room_of(shell, image)
    seen = room.panorama(shell.centre, height=60, seed=0)
    np.testing.assert_allclose(energy(seen), energy(image), rtol=0.01)
    position = shell.centre + np.array([0.4, -0.3, -0.3])
    coarse, fine = (room.panorama(position, height=height, seed=0) for height in (60, 480))
    np.testing.assert_allclose(energy(coarse), energy(fine), rtol=0.03)


@pytest.mark.parametrize("shell", SHELLS)
def test_every_ray_from_inside_meets_the_shell(shell):
    rng = np.random.default_rng(3)
    origins = shell.centre + rng.uniform(-0.4, 0.4, (4000, 3))
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = shell.distances(origins, directions)
    assert reach.min() > 0.1
    assert reach.max() < 25
    met = origins + reach[:, None] * directions
    assert met[:, 1].min() > -1e-3  # the floor is at 0
    assert met[:, 1].max() < shell.facts["size_m"][1] + 0.01


@pytest.mark.parametrize("shell", SHELLS)
def test_the_centre_sees_all_of_the_shell(shell):
    """So every point has one place in the panorama."""
    triangles = shell.arrays
    middles = triangles.corner + triangles.edge.sum(axis=1) / 3
    away = middles - shell.centre
    far = np.linalg.norm(away, axis=1)
    reach = shell.distances(np.tile(shell.centre, (len(away), 1)), away / far[:, None])
    np.testing.assert_allclose(reach, far, rtol=1e-5)


@pytest.mark.parametrize("shell", SHELLS)
def test_a_frame_shows_what_the_shell_carries(shell):
    """Depth and colour agree: the surface behind each pixel has the colour of its direction from the centre."""
    image = panorama(height=256)
    room = room_of(shell, image)
    lens = Intrinsics(60.0, 60.0, 31.0, 25.0, 64, 48)
    pose = np.eye(4)
    pose[:3, 3] = shell.centre + np.array([0.2, -0.1, 0.3])
    view = room.frame(lens, pose, seed=0)
    np.testing.assert_allclose(view.depth_m, room.depth(lens, pose), rtol=1e-5)
    points = transform_points(pose, lens.rays() * view.depth_m[..., None]) - shell.centre
    directions = points / np.linalg.norm(points, axis=-1, keepdims=True)
    columns, rows = np.moveaxis((direction_to_uv(directions) * (512, 256)).astype(int), -1, 0)
    expected = image[rows, columns]
    off = np.abs(view.radiance - expected).max(axis=-1) / expected.max(axis=-1)
    assert np.median(off) < 0.01
    assert (off < 0.1).mean() > 0.95  # the rest: edges of the window


def test_bright_areas_are_lights_windows_glass_floors_ordinary():
    image = np.full((64, 128, 3), 1.0, np.float32)
    image[26:38, 10:40] = 50  # a window
    image[5:7, 60:62] = 50  # a lamp
    image[55:60, 80:120] = 50  # sun on the floor
    kinds_by_seed = [classify_surfaces(image, np.random.default_rng(seed)) for seed in range(40)]
    assert {int(kinds[30, 20]) for kinds in kinds_by_seed} == {GLASS, LIGHT}
    for kinds in kinds_by_seed:
        assert (kinds[26:38, 10:40] == kinds[30, 20]).all()
        assert kinds[5, 60] == LIGHT
        assert kinds[57, 100] == kinds[0, 0] == ORDINARY


def test_percentiles_are_over_the_sphere():
    luminance = panorama_directions(64)[..., 1].copy()  # uniform in -1 to 1 on the sphere
    assert percentile(luminance, 50.0) == pytest.approx(0, abs=0.05)
    assert percentile(luminance, 80.0) == pytest.approx(0.6, abs=0.05)


def test_the_first_frames_80th_percentile_is_aimed_at():
    rng = np.random.default_rng(2)
    for _ in range(20):
        radiance = rng.lognormal(0, 1, (2, 24, 32, 3)).astype(np.float32)
        exposure = render.expose(radiance, rng)
        shown = (radiance[0] * exposure.gains * exposure.multiplier[0]) @ LUMINANCE
        assert 0.3 <= np.percentile(shown, 80) <= 0.6
        assert exposure.gains @ LUMINANCE == pytest.approx(1)


def test_each_panorama_is_used_once_before_any_again(tmp_path):
    files = [tmp_path / f"{k}.exr" for k in range(7)]
    for turn in range(3):
        assert sorted(render._choose(files, 7 * turn + k, 5) for k in range(7)) == files
    assert [render._choose(files, k, 5) for k in range(7)] != [render._choose(files, k, 6) for k in range(7)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return folder_of(tmp_path_factory.mktemp("panoramas"))


def options(folder, sequences=4, **changes):
    given = {"seed": 3, "shard_size": 2, "sequences_per_room": 1, "frames": 2, "furniture_share": 0.0}
    return GenerateOptions(sequences, panoramas=folder, **{**given, **changes})


@pytest.fixture(scope="module")
def dataset(folder, tmp_path_factory):
    """Sequences of both splits."""
    out = tmp_path_factory.mktemp("dataset")
    with without_workers():
        generate(out, options(folder, 2))
        generate(out, options(folder, 1, split="test"))
    return out


@pytest.mark.slow
def test_a_dataset_of_panorama_rooms_is_like_any_other(dataset, folder):
    manifest = read_manifest(dataset)
    assert manifest.settings.renderer == "roomlight_generator.panoramas.render:render_room"
    assert manifest.sequences == {"test": 1, "train": 2}
    for recording in Dataset(dataset):
        assert recording.colour.shape == (2, 240, 320, 3)
        assert recording.probe_panoramas.shape == (3, 120, 240, 3)
        assert recording.facts["room_type"] == "panorama"
        assert (folder / recording.facts["panorama"]).is_file()


@pytest.mark.slow
def test_panoramas_of_the_other_split_are_not_used(dataset, folder):
    for split in ("train", "test"):
        for recording in Dataset(dataset, split):
            assert split_of(folder / recording.facts["panorama"]) == split


@pytest.mark.slow
def test_clipped_pixels_have_their_true_radiance(dataset):
    data = Dataset(dataset)
    bright = 0
    for number in range(len(data)):
        assert data.read(number).clipped_radiance is None  # not requested
        recording = data.read(number, clipped=True)
        assert recording.clipped_radiance is not None
        stored = recording.clipped_radiance.max(axis=-1)
        shown = recording.colour.max(axis=-1)
        assert (shown[stored > 0] >= CLIPPED_SRGB8 - 12).all()  # JPEG moves some below the limit
        assert (stored[shown == 255] > 0).mean() > 0.95 if (shown == 255).sum() > 50 else True
        assert np.median(stored[stored > 0]) > 0.9 if (stored > 0).any() else True
        bright += int((stored > 3).sum())
    assert bright > 5


@pytest.mark.slow
@pytest.mark.usefixtures("small_views")
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_same_room_gives_the_same_recording(folder, share, monkeypatch):
    monkeypatch.setattr(render, "catalogue_for", lambda _: plain_catalogue())
    request = RoomRequest(0, 1, "train", count=1, frames=2, panoramas=folder, furniture_share=share)
    first, second = (next(render.render_room(request)) for _ in range(2))
    for name in ("colour", "depth_mm", "surface", "probe_panoramas", "clipped_radiance"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.facts == second.facts
    assert (len(first.facts["furniture"]) > 0) == (share > 0)


@pytest.mark.slow
def test_a_dataset_continues_with_the_same_panoramas_only(dataset, folder, tmp_path):
    with pytest.raises(DatasetError, match=r"panoramas [0-9a-f]{64}, not none"):
        generate(dataset, options(None, furniture_share=0.7), workers=1)
    changed = folder_of(tmp_path / "changed", ("attic_01", "barn", "loft"))
    with pytest.raises(DatasetError, match=r"was generated with panoramas [0-9a-f]{64}, not [0-9a-f]{64}"):
        generate(dataset, options(changed), workers=1)
    assert generate(dataset, options(folder, 2), workers=1).made == 0


def test_a_missing_folder_makes_no_dataset(tmp_path):
    with pytest.raises(DatasetError, match="name a folder of panoramas"):
        generate(tmp_path / "out", options(tmp_path / "missing"), workers=1)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("share", [-0.1, 1.5])
def test_a_share_outside_0_to_1_is_an_error(share):
    with pytest.raises(OptionError, match="`furniture_share` is of rooms that `panoramas` light"):
        GenerateOptions(1, shard_size=1, sequences_per_room=1, furniture_share=0.5)
    with pytest.raises(OptionError, match=r"furniture_share is .*; it must be 0 to 1"):
        GenerateOptions(1, shard_size=1, sequences_per_room=1, furniture_share=share)
