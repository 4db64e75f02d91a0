"""Which sequences a run trains on; held-out ones are never among them."""

from dataclasses import replace

import numpy as np
import pytest

import stub_rooms
from recordings import BoxRecordings
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import DatasetError
from roomlight_model.training.subsets import describe, surround, test_split, train_val_split

setattr(test_split, "__test__", False)  # noqa: B010  (a function of the package, no test)


def names(subset):
    return [subset.read(number, frames=[0]).name for number in range(len(subset))]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return stub_rooms.make_dataset(tmp_path_factory.mktemp("data") / "rooms", 8, shard_size=4)


def test_every_twelfth_room_is_trained_on_in_no_stage():
    """Walks 0, 1, 24 and 25 are of the rooms 0 and 12, in whichever dataset; a dataset listed twice counts twice."""
    first, second = BoxRecordings(30), BoxRecordings(4)
    training, held_out = train_val_split([second, first, second], 48)
    assert names(held_out) == ["box-0", "box-1"]
    kept = [f"box-{number}" for number in range(30) if number not in (0, 1, 24, 25)]
    assert names(training) == ["box-2", "box-3", *kept, "box-2", "box-3"]
    assert names(train_val_split([first, second], 3)[1]) == ["box-0", "box-1", "box-24"]
    held_out = names(train_val_split([second, first, second])[1])
    assert held_out == [f"box-{number}" for number in (0, 1, 0, 1, 24, 25)]
    with pytest.raises(DatasetError, match=r"the 2 sequences are all of held-out rooms, .*; generate more rooms"):
        train_val_split([BoxRecordings(2)], 48)


def test_datasets_are_described(dataset):
    described = describe([dataset])[0]
    assert (described["seed"], described["frames"], described["sequences"]) == (3, 2, 8)
    assert {"renderer", "generator", "panoramas", "furniture_share"} <= set(described)


@pytest.mark.slow
def test_test_splits_are_found_where_there_are_any(dataset, tmp_path):
    stub_rooms.make_dataset(tmp_path / "both", 4, split="test")
    both = stub_rooms.make_dataset(tmp_path / "both", 4)
    splits = test_split([dataset, both, both])
    assert [split.folder for split in splits] == [tmp_path / "both"]
    assert len(splits[0]) == 4


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


def test_only_views_of_the_lit_side_are_trained_on(dataset):
    training, _ = train_val_split([dataset], 48)
    ratios = [surround(training.read(number, frames=[0])) for number in range(6)]
    most, reported = sorted(ratios)[3], []
    lit = training.without_bright_surroundings(most, lambda *done: reported.append(done))
    assert names(lit) == [name for name, ratio in zip(names(training), ratios, strict=True) if ratio <= most]
    assert len(lit) == 4
    assert reported == [(k, 6) for k in range(1, 7)]


def test_if_no_sequence_is_left_the_error_states_the_least(dataset):
    training, _ = train_val_split([dataset], 48)
    with pytest.raises(
        DatasetError, match=r"none of 6 sequences .* at most 0.01 .*the least: [0-9.]+\); raise `surround_max`"
    ):
        training.without_bright_surroundings(0.01)
