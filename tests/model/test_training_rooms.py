"""Which sequences a run trains on, while its dataset grows, and that none of those held out is ever among them."""

import pytest

import stub_rooms
from roomlight.errors import DatasetError
from roomlight_model.dataset.generate import GenerateOptions, generate
from roomlight_model.training.rooms import TrainingRooms


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


def test_other_folders_are_trained_on_whole(tmp_path):
    rooms = TrainingRooms([make(tmp_path / "first", 4), make(tmp_path / "second", 4)])
    assert (len(rooms.held_out), len(rooms.training)) == (1, 7)
    make(tmp_path / "second", 8)
    assert rooms.grow() == 4
    assert (len(rooms.held_out), len(rooms.training)) == (1, 11)


def test_what_is_no_dataset_is_named(tmp_path):
    with pytest.raises(DatasetError, match="nowhere"):
        TrainingRooms([make(tmp_path / "first", 4), tmp_path / "nowhere"])
