"""Contact sheets show each sequence in its row under a caption."""

import numpy as np
import pytest

import stub_rooms
from roomlight.dataset.loader import Dataset
from roomlight.errors import OutputError
from roomlight.images import read_colour
from roomlight.imaging.drawing import BACKGROUND
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_generator.reports.preview import caption, compose_preview, write_previews


def one(seed, **options):
    return stub_rooms.recording(np.random.default_rng(seed), **options)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shown")
    options = GenerateOptions(20, seed=1, shard_size=4, sequences_per_room=2, frames=4, renderer=stub_rooms.NAME)
    generate(folder, options, workers=1)
    return Dataset(folder)


def test_a_sheet_has_eight_rooms_and_rooms_are_spread(dataset, tmp_path):
    calls = []
    paths = write_previews(dataset, tmp_path, rooms=9, progress=lambda done, total: calls.append((done, total)))
    assert [path.name for path in paths] == ["preview-00.png", "preview-01.png"]
    assert calls == [(k, 9) for k in range(1, 10)]
    heights = [read_colour(path)[0].shape[0] for path in paths]
    assert heights[0] > 6 * heights[1] > 600
    assert len(write_previews(dataset, tmp_path, rooms=100)) == 2  # there are 10


def test_a_sheet_is_full_and_depends_on_its_sequences():
    sheet = compose_preview([one(1), one(2, frames=2, probes=3)])
    background = round(255 * BACKGROUND)
    assert sheet.dtype == np.uint8
    used = (np.abs(sheet.astype(int) - background).max(axis=-1) > 8).mean()
    assert used > 0.55
    assert (sheet[:10] == background).all()
    assert (compose_preview([one(1)]) == compose_preview([one(1)])).all()
    assert (compose_preview([one(1)]) != compose_preview([one(3)])).any()


def test_a_caption_states_the_known_facts():
    made = {"seed": 7, "room": 3, "attempt": 1, "split": "train"}
    facts = {"room_type": "kitchen", "made": made, "light": {"scenario": "dusk"}, "white_kcd_m2": 0.25}
    text = caption(one(1, name="train-000006", facts=facts), under_ev=-8.6)
    for part in ("train-000006", "kitchen", "seed 7 room 3 retry 1", "dusk", "white 250 cd/m2", "stops", "-8.6 EV"):
        assert part in text
    assert "unknown room" in caption(one(1), under_ev=-1.0)


def test_a_sheet_that_cannot_be_written_is_an_error(dataset, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="preview-00"):
        write_previews(dataset, tmp_path / "file", rooms=1)
