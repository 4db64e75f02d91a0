from pathlib import Path

import numpy as np
import pytest

from roomlight.conventions import linear_to_srgb8
from roomlight.drawing import BACKGROUND, Canvas, fitted
from roomlight.errors import OutputError
from roomlight.images import read_colour
from roomlight.spheres import SphereRenderer
from roomlight_cli.sheet import SheetColumn, compose_sheet, sheet_times, write_contact_sheet

VIEW = (0.0, 0.0, -1.0)


def flat(height: int, width: int, value: float) -> np.ndarray:
    return np.full((height, width, 3), np.float32(value))


def has(image: np.ndarray, value: float) -> int:
    """How many pixels show this radiance."""
    return int((image == linear_to_srgb8(np.array([value], np.float32))[0]).all(axis=-1).sum())


def test_the_sheet_shows_every_frame_and_panorama() -> None:
    columns = [
        SheetColumn(f"frame {n}", flat(60, 80, 0.02 + 0.1 * n), (flat(30, 60, 0.07 + 0.1 * n), flat(30, 60, 0.9)))
        for n in range(4)
    ]
    columns.append(SheetColumn("truth", None, (flat(30, 60, 0.8), None)))
    sheet = compose_sheet(columns, ["probe 0", "probe 1"], views=[VIEW, VIEW], heading="a room")
    assert sheet.dtype == np.uint8
    for n in range(4):
        assert has(sheet, 0.02 + 0.1 * n) >= 240 * 180
        # the panorama, and the mirror sphere: a constant panorama makes a constant mirror
        assert has(sheet, 0.07 + 0.1 * n) > 240 * 120 + 0.7 * 114**2
    assert has(sheet, 0.8) >= 240 * 120
    assert has(sheet, 0.9) >= 4 * 240 * 120
    np.testing.assert_array_equal(sheet[0, 0], round(BACKGROUND * 255))


def test_exposure_brightens_and_clips_at_white() -> None:
    columns = [SheetColumn("frame 1", flat(60, 80, 0.1), (flat(30, 60, 0.2),))]
    sheet = compose_sheet(columns, ["p"], views=[VIEW], exposure_ev=1.0)
    assert has(sheet, 0.2) >= 240 * 180
    assert has(sheet, 0.4) >= 240 * 120
    bright = compose_sheet(columns, ["p"], views=[VIEW], exposure_ev=10.0)
    assert has(bright, 1.0) >= 240 * 300


@pytest.mark.parametrize(
    ("frames", "columns", "expected"),
    [(31, 6, [0, 6, 12, 18, 24, 30]), (3, 6, [0, 1, 2]), (1, 6, [0]), (0, 6, []), (100, 2, [0, 99])],
)
def test_times_are_spread_over_the_sequence(frames: int, columns: int, expected: list[int]) -> None:
    assert sheet_times(frames, columns) == expected


def test_the_file_is_the_picture(tmp_path: Path) -> None:
    columns = [SheetColumn("frame 1", flat(60, 80, 0.1), (flat(30, 60, 0.2),))]
    path = tmp_path / "out" / "summary.png"
    write_contact_sheet(path, columns, probes=["p"], views=[VIEW], heading="x")
    image, _ = read_colour(path)
    expected = compose_sheet(columns, ["p"], views=[VIEW], heading="x")
    np.testing.assert_array_equal(linear_to_srgb8(image), expected)
    assert [entry.name for entry in path.parent.iterdir()] == ["summary.png"]


def test_a_place_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    columns = [SheetColumn("frame 1", None, ())]
    with pytest.raises(OutputError, match=r"summary\.png"):
        write_contact_sheet(tmp_path / "file" / "summary.png", columns, probes=[], views=[])


def test_mismatched_panoramas_and_views_are_refused() -> None:
    column = SheetColumn("frame 1", None, (flat(30, 60, 0.2),))
    with pytest.raises(ValueError, match="at least one column"):
        compose_sheet([], [], views=[])
    with pytest.raises(ValueError, match="1 panoramas, not 2"):
        compose_sheet([column], ["a", "b"], views=[VIEW, VIEW])
    with pytest.raises(ValueError, match="as many views"):
        compose_sheet([column], ["a"], views=[])


def test_text_stays_within_its_width() -> None:
    canvas = Canvas(101, 51)
    assert canvas.image.shape == (52, 102, 3)
    canvas.text((4, 4), "a label much longer than its place", width=80)
    inked = np.nonzero((canvas.image != round(BACKGROUND * 255)).any(axis=(0, 2)))[0]
    assert len(inked) > 20
    assert inked.max() < 4 + 80 + 4
    canvas.text((90, 45), "falls off the canvas, with an umlaut: ü")
    canvas.text((4, 20), "")
    assert fitted("short", 1000) == "short"
    assert fitted("anything", 1) == ""


def test_a_picture_beyond_the_canvas_is_refused() -> None:
    canvas = Canvas(40, 40)
    with pytest.raises(ValueError, match="do not fit"):
        canvas.picture((30, 0), flat(10, 10, 0.5), size=(20, 20))


def test_a_lamp_does_not_whiten_its_neighbours_when_shrunk() -> None:
    image = flat(40, 40, 0.0)
    image[0, 0] = 10_000
    canvas = Canvas(20, 20)
    canvas.picture((0, 0), image, size=(10, 10))
    assert canvas.image[0, 0].max() < 100  # 1/16 of white, not white


def test_spheres_blend_into_the_background() -> None:
    canvas = Canvas(40, 40)
    canvas.sphere((4, 4), flat(16, 32, 1.0), SphereRenderer(VIEW, size=32), "mirror")
    image = canvas.image
    assert (image[20, 20] == 255).all()
    assert (image[4, 4] == round(BACKGROUND * 255)).all()
    # the rim has steps between the two, no darker halo
    assert len(np.unique(image)) > 5
    assert image.min() == round(BACKGROUND * 255)
