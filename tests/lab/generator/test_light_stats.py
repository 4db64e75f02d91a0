"""Light measures of frames and panoramas made by hand have the expected values."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stub_rooms
from roomlight.conventions import linear_to_srgb8, panorama_directions
from roomlight.dataset.loader import Dataset
from roomlight.errors import DatasetError
from roomlight.images import encode_exr
from roomlight_generator import light_stats
from roomlight_generator.light_stats import (
    LightRow,
    compare_light,
    compare_measures,
    measure_light,
    panorama_light,
    recording_light,
)

NOTHING = np.zeros((0, 3), np.float32)


def even(value, height=60):
    return np.full((height, 2 * height, 3), value, np.float32)


def test_an_even_room_has_no_contrast():
    measured = measure_light(even(0.25), NOTHING, even(0.5))
    assert measured["frame's mean"] == pytest.approx(0.25)
    assert measured["mean / frame's mean"] == pytest.approx(2)
    assert measured["ceiling / floor"] == pytest.approx(1)
    assert measured["floor / walls"] == pytest.approx(1)
    assert measured["sphere above white"] == 0
    assert np.isnan(measured["clipped pixels' radiance"])


def test_a_bright_hemisphere_is_half_of_the_sphere():
    panorama = even(0.1)
    panorama[:30] = 1.9
    measured = measure_light(even(0.5), NOTHING, panorama)
    assert measured["sphere above white"] == pytest.approx(0.5, abs=1e-3)
    assert measured["energy above white"] == pytest.approx(0.95, abs=1e-3)
    assert measured["panorama's mean"] == pytest.approx(1, abs=1e-3)
    assert measured["sphere above 3 x frame"] == pytest.approx(0.5, abs=1e-3)
    assert measured["ceiling / floor"] == pytest.approx(19, rel=1e-3)
    assert measured["ceiling / walls"] == pytest.approx(1.9, rel=1e-3)


def test_clipped_pixels_have_their_true_radiance():
    frame = even(0.2)
    frame[:6] = 1
    clipped = np.concatenate([np.full((60, 3), 4.0), np.tile([9.0, 2.0, 1.0], (61, 1))]).astype(np.float32)
    measured = measure_light(frame, clipped, even(0.2))
    assert measured["clipped pixels' radiance"] == pytest.approx(9)
    assert measured["frame's clipped share"] == pytest.approx(0.1)


def test_views_are_exposed_by_their_80th_percentile():
    rng = np.random.default_rng(1)
    panorama = 7 * rng.random((120, 240, 3)).astype(np.float32)
    views = panorama_light(panorama, rng, views=5)
    assert len(views) == 5
    for measured in views:
        assert measured["frame's 80th percentile"] == pytest.approx(0.43, rel=1e-3)
        assert measured["panorama's mean"] < 0.43


def test_views_look_about_the_horizon():
    """Light from above 60 degrees is outside of every view: half of 55 degrees, plus 6, is less."""
    panorama = even(1.0, 120)
    panorama[panorama_directions(120)[..., 1] > np.sin(np.radians(60))] = 100
    for measured in panorama_light(panorama, np.random.default_rng(2)):
        assert measured["frame's mean"] == pytest.approx(0.43, rel=1e-3)
        assert measured["panorama's mean"] > 2


def test_stored_radiance_is_that_of_clipped_pixels():
    """The right half of a frame is clipped."""
    colour = linear_to_srgb8(np.full((1, 24, 32, 3), 0.2, np.float32))
    clipped = np.zeros((1, 24, 32, 3), np.float16)
    colour[:, :, 16:], clipped[:, :, 16:] = 255, 40
    made = stub_rooms.recording(np.random.default_rng(0), name="lit", frames=1, probes=1)
    recording = replace(made, colour=colour, clipped_radiance=clipped)
    (measured,) = recording_light(recording)
    assert measured["clipped pixels' radiance"] == pytest.approx(40)
    assert measured["frame's clipped share"] == pytest.approx(0.5)
    (alone,) = recording_light(
        replace(recording, probe_panoramas=recording.probe_panoramas[:0], probe_positions=np.zeros((0, 3)))
    )
    assert alone == {name: value for name, value in measured.items() if name in alone}
    assert len(alone) == 5
    with pytest.raises(DatasetError, match="lit: lacks the radiance of clipped pixels"):
        recording_light(replace(recording, clipped_radiance=None))


def test_rows_are_alike_within_a_quarter():
    assert LightRow("m", (1.2, 2.0, 3.0), (1.0, 2.0, 3.9)).alike
    assert not LightRow("m", (1.3, 2.0, 3.0), (1.0, 2.0, 3.0)).alike
    assert not LightRow("m", (np.nan, np.nan, np.nan), (1.0, 2.0, 3.0)).alike
    assert LightRow("m", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)).alike


def test_quartiles_leave_out_missing_values():
    (row,) = compare_measures([{"m": 1.0}, {"m": np.nan}, {"m": 3.0}], [{"m": 2.0, "of no generated frame": 1.0}])
    assert (row.generated, row.real) == ((1.5, 2.0, 2.5), (2.0, 2.0, 2.0))


def write_panoramas(folder: Path, count: int) -> Path:
    folder.mkdir()
    rng = np.random.default_rng(3)
    for k in range(count):
        (folder / f"{k}.exr").write_bytes(encode_exr(rng.random((64, 128, 3)).astype(np.float32)))
    return folder


@pytest.mark.slow
def test_a_dataset_is_compared_with_a_folder(tmp_path):
    dataset, calls = stub_rooms.make_dataset(tmp_path / "data", 4), []
    folder = write_panoramas(tmp_path / "real", 3)
    light = compare_light(dataset, folder, limit=3, progress=lambda *done: calls.append(done))
    assert calls == [(k, 6) for k in range(1, 7)]
    assert (light.sequences, light.panoramas) == (3, 3)
    written = json.loads(json.dumps(light.to_json()))
    assert written["rows"]["frame's 80th percentile"]["real"][1] == pytest.approx(light_stats.WHITE_SHARE, rel=1e-3)
    assert compare_light(dataset, folder, limit=3).rows == light.rows


def test_an_empty_dataset_or_folder_is_named(tmp_path):
    dataset = stub_rooms.make_dataset(tmp_path / "data", 2)
    with pytest.raises(DatasetError, match="holds no panorama"):
        compare_light(dataset, tmp_path)
    with pytest.raises(DatasetError, match="has no sequence to compare"):
        compare_light(Dataset(tmp_path / "data", "test"), write_panoramas(tmp_path / "real", 1))
