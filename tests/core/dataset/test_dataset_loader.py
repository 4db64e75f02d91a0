"""Reading sequences by number, and writing them as captures."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import stub_rooms
from roomlight.captures import open_capture
from roomlight.dataset.extract import extract
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import room_of
from roomlight.dataset.shards import index_path, read_index
from roomlight.errors import DatasetError, OutputError
from roomlight_generator.generate import GenerateOptions, generate


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("loaded")
    generate(
        out,
        GenerateOptions(24, seed=3, shard_size=4, sequences_per_room=2, frames=4, renderer=stub_rooms.NAME),
        workers=1,
    )
    return out


@pytest.fixture
def one_damaged(folder, tmp_path):
    """A copy whose sequence 9 has a flipped byte."""
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    tar = tmp_path / "train-00002.tar"
    damaged = bytearray(tar.read_bytes())
    damaged[read_index(tar).entries[1].offset + 5000] ^= 64
    tar.write_bytes(damaged)
    return tmp_path


def test_sequences_are_read_by_number_in_any_order(folder):
    dataset = Dataset(folder)
    assert len(dataset) == 24
    assert dataset[17].name == "train-000017"
    assert [recording.name for recording in dataset] == dataset.names
    assert dataset.number_of("train-000023") == 23
    assert [dataset.room_of(number) for number in (0, 1, 23)] == [0, 0, 11]
    np.testing.assert_array_equal(dataset[17].depth_mm, Dataset(folder)[17].depth_mm)


def test_recordings_of_one_room_state_it(folder):
    made = {"split": "train", "room_seed": 3, "room": 8}
    assert [Dataset(folder)[number].room for number in (16, 17)] == ["train-3-8"] * 2
    assert room_of({"light": {"building": "hall"}, "made": made}) == "hall"  # as of other rooms
    assert room_of({"scene": "loft.blend", "made": made}) == "loft.blend"
    assert room_of({"room": "attic"}) == "attic"
    assert [room_of(facts) for facts in ({}, [], {"room": 8.5, "light": "hall"}, {"room": 8})] == [None] * 3 + ["8"]
    assert stub_rooms.recording(np.random.default_rng(0), name="walk").room == "walk"


def test_datasets_made_before_clipped_radiance_have_none(folder):
    assert Dataset(folder).read(0, clipped=True).clipped_radiance is None


def test_what_is_not_there_is_an_error(folder, tmp_path):
    with pytest.raises(DatasetError, match="no sequence 'train-000024'; it has 24, from train-000000 to train-000023"):
        Dataset(folder).number_of("train-000024")
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(DatasetError, match="is not a dataset"):
            Dataset(path)


def test_damage_to_one_sequence_leaves_the_others_readable(one_damaged):
    dataset = Dataset(one_damaged)
    for number in range(24):
        if number != 9:
            dataset.read(number, frames=[0])
    with pytest.raises(DatasetError, match=r"train-00002\.tar: sequence train-000009 has another checksum"):
        dataset.read(9)


def test_a_tail_that_is_being_written_is_not_seen(folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    last = tmp_path / "train-00005.tar"
    lines = index_path(last).read_bytes()
    index_path(last).write_bytes(lines[:-20])
    assert len(Dataset(tmp_path)) == 23


def test_an_extracted_sequence_is_a_capture(folder, tmp_path, one_damaged):
    dataset = Dataset(folder)
    extract(dataset, "train-000006", tmp_path / "out" / "room")
    frames = list(open_capture(tmp_path / "out" / "room"))
    assert len(frames) == 4
    np.testing.assert_allclose(frames[1].depth_m * 1000, dataset[6].depth_mm[1], atol=1e-3)
    with pytest.raises(OutputError, match="exists already"):
        extract(dataset, "train-000007", tmp_path / "out" / "room")
    with pytest.raises(DatasetError, match="train-000009"):
        extract(Dataset(one_damaged), "train-000009", tmp_path / "out" / "broken")
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="cannot be written"):
        extract(dataset, "train-000007", tmp_path / "file" / "below")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["room"]


def test_a_sequence_is_extracted_into_the_empty_folder_where_one_is(folder, tmp_path, monkeypatch):
    (tmp_path / "room").mkdir()
    monkeypatch.chdir(tmp_path / "room")
    extract(Dataset(folder), "train-000006", Path())
    assert len(list(open_capture("."))) == 4
    assert [path.name for path in tmp_path.iterdir()] == ["room"]
    with pytest.raises(OutputError, match="exists already"):
        extract(Dataset(folder), "train-000006", Path())
