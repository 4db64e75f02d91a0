"""The committed sequences: undamaged, readable by all that reads datasets, and plausible as light."""

import shutil

import numpy as np
import pytest

from fixture_rooms import FOLDER, FRAMES, ROOMS
from roomlight.conventions import srgb8_to_linear
from roomlight.dataset.loader import Dataset
from roomlight.dataset.verify import verify
from roomlight_generator.rooms.colour import LUMINANCE


@pytest.fixture(scope="module", params=list(ROOMS))
def dataset(request):
    return Dataset(FOLDER, request.param)


def test_the_fixture_is_undamaged(tmp_path):
    copy = shutil.copytree(FOLDER, tmp_path / "rooms")
    report = verify(copy)
    assert report.whole == sum(ROOMS.values())
    assert not report.damaged


def test_each_sequence_has_the_formats_arrays(dataset):
    assert len(dataset) == ROOMS["train" if dataset.names[0].startswith("train") else "test"]
    for recording in dataset:
        assert recording.colour.shape == (FRAMES, 240, 320, 3)
        assert recording.depth_mm.shape == recording.surface.shape == (FRAMES, 240, 320)
        assert recording.probe_panoramas.shape == (3, 120, 240, 3)
        assert (recording.depth_mm > 0).mean() > 0.9


def test_frames_and_panoramas_are_in_the_same_units(dataset):
    """The first frame's median luminance lies within the range of the probes' panoramas."""
    for recording in dataset:
        seen = np.median(srgb8_to_linear(recording.colour[0]) @ LUMINANCE)
        around = recording.probe_panoramas @ LUMINANCE
        assert np.percentile(around, 2) < seen < np.percentile(around, 99.9)
        assert around.max() > 1  # something in the room is brighter than white
