"""The training sequences of a growing dataset; held-out sequences are never among them."""

from dataclasses import replace

import numpy as np
import pytest

import stub_rooms
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import DatasetError
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_model.training.subsets import TrainingRooms, surround


def make(folder, sequences):
    options = GenerateOptions(sequences, seed=3, shard_size=4, sequences_per_room=2, frames=4, renderer=stub_rooms.NAME)
    generate(folder, options, workers=1)
    return folder


def names(part):
    return [part.read(number, frames=[0]).name for number in range(len(part))]


def test_a_dataset_that_grows_keeps_its_held_out_rooms(tmp_path):
    rooms = TrainingRooms([make(tmp_path / "first", 8)])
    assert names(rooms.held_out) == ["train-000000", "train-000001"]
    assert len(rooms.training) == 6
    assert rooms.grow() == 0
    make(tmp_path / "first", 12)
    assert rooms.grow() == 4
    assert names(rooms.held_out) == ["train-000000", "train-000001"]
    assert names(rooms.training) == [f"train-{number:06d}" for number in range(2, 12)]


def test_all_of_the_other_folders_is_trained_on(tmp_path):
    rooms = TrainingRooms([make(tmp_path / "first", 4), make(tmp_path / "second", 4)])
    assert (len(rooms.held_out), len(rooms.training)) == (1, 7)
    make(tmp_path / "second", 8)
    assert rooms.grow() == 4
    assert (len(rooms.held_out), len(rooms.training)) == (1, 11)
    assert [share["sequences"] for share in rooms.described()] == [3, 8]
    assert {"seed", "frames", "sequences"} == set(rooms.described()[0])


def test_surroundings_over_the_frame_by_hand():
    recording = stub_rooms.recording(np.random.default_rng(1), frames=1)
    grey = srgb8_to_linear(np.full((1, 1, 1), 100, np.uint8)).item()
    even = replace(
        recording,
        colour=np.full_like(recording.colour, 100),
        probe_panoramas=np.full_like(recording.probe_panoramas, grey),
    )
    assert surround(even) == pytest.approx(1.0, rel=1e-3)
    lit = even.probe_panoramas.copy()
    lit[:, : lit.shape[1] // 2] = np.exp(3) - 1
    assert surround(replace(even, probe_panoramas=lit)) == pytest.approx(0.5 * 3 / np.log1p(grey) + 0.5, rel=1e-3)


def test_only_views_of_the_lit_side_are_trained_on(tmp_path):
    folder = make(tmp_path / "first", 8)
    everything = TrainingRooms([folder])
    ratios = [surround(everything.training.read(number, frames=[0])) for number in range(6)]
    most = sorted(ratios)[3]
    reported = []
    rooms = TrainingRooms([folder], surround_max=most, progress=lambda *done: reported.append(done))
    assert names(rooms.held_out) == names(everything.held_out)
    assert names(rooms.training) == [f"train-{2 + number:06d}" for number in range(6) if ratios[number] <= most]
    assert len(rooms.training) == 4
    assert reported == [(k, 6) for k in range(1, 7)]
    make(tmp_path / "first", 12)
    new = rooms.grow()
    assert len(reported) == 10  # sequences that were measured are not read again
    assert len(rooms.training) == 4 + new
    assert not set(names(rooms.training)) & set(names(rooms.held_out))


def test_if_no_sequence_is_left_the_error_states_the_least(tmp_path):
    with pytest.raises(
        DatasetError, match=r"none of 6 sequences .* at most 0.01 .*the least: [0-9.]+\); raise `surround_max`"
    ):
        TrainingRooms([make(tmp_path / "first", 8)], surround_max=0.01)


def test_a_folder_without_a_dataset_is_named(tmp_path):
    with pytest.raises(DatasetError, match="nowhere"):
        TrainingRooms([make(tmp_path / "first", 4), tmp_path / "nowhere"])
