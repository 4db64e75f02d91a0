"""Contact sheets show each sequence in its row under a caption."""

import pytest

import stub_rooms
from roomlight.errors import OutputError
from roomlight.images import read_colour
from roomlight_generator.reports.preview import write_previews


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return stub_rooms.make_dataset(tmp_path_factory.mktemp("shown"), 20, shard_size=4)


def test_a_sheet_has_eight_rooms_and_rooms_are_spread(dataset, tmp_path):
    calls = []
    paths = write_previews(dataset, tmp_path, rooms=9, progress=lambda done, total: calls.append((done, total)))
    assert [path.name for path in paths] == ["preview-00.png", "preview-01.png"]
    assert calls == [(k, 9) for k in range(1, 10)]
    heights = [read_colour(path)[0].shape[0] for path in paths]
    assert heights[0] > 6 * heights[1] > 600
    assert len(write_previews(dataset, tmp_path, rooms=100)) == 2  # there are 10


def test_a_sheet_that_cannot_be_written_is_an_error(dataset, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="preview-00"):
        write_previews(dataset, tmp_path / "file", rooms=1)
