from dataclasses import replace

import numpy as np
import pytest

from roomlight.conventions import linear_to_srgb8
from roomlight.imaging.drawing import BACKGROUND, Canvas, fitted
from roomlight_cli.replays.sheet import (
    InsertedObjects,
    Sheet,
    SheetProbe,
    SheetTime,
    compose_sheet,
    mean_light,
    sheet_times,
)

pytestmark = pytest.mark.usefixtures("small_pictures")
VIEW = (0.0, 0.0, -1.0)
WIDE = 192
"""Columns of a probe's panorama."""


def flat(height: int, width: int, value: float) -> np.ndarray:
    return np.full((height, width, 3), np.float32(value))


def has(image: np.ndarray, value: float) -> int:
    """How many pixels show this radiance."""
    return int((image == linear_to_srgb8(np.array([value], np.float32))[0]).all(axis=-1).sum())


def a_sheet(times: int, *, truth: np.ndarray | None = None, probes: int = 1, unseen: float = 0.0) -> Sheet:
    """A sheet of grey frames and panoramas: 0.02 + 0.1 n and 0.07 + 0.1 n at time n."""
    observed = np.full((30, 60), np.float32(1 - unseen))
    return Sheet(
        "a room",
        "a subtitle",
        [
            SheetTime(
                f"Frame {n}",
                flat(60, 80, 0.02 + 0.1 * n),
                (flat(30, 60, 0.07 + 0.1 * n),) * probes,
                (observed,) * probes,
            )
            for n in range(times)
        ],
        [SheetProbe(f"Probe {n}", VIEW, truth, (0.1,) * times, (0.5,) * times) for n in range(probes)],
        indices=list(range(times)),
    )


def test_the_sheet_shows_every_frame_and_panorama() -> None:
    sheet = compose_sheet(a_sheet(4, truth=flat(30, 60, 0.8)))
    assert sheet.dtype == np.uint8
    assert sheet.shape[1] > 2 * WIDE
    for n in range(4):
        assert has(sheet, 0.02 + 0.1 * n) >= 56 * 42
        # the panorama, and the mirror sphere: a constant panorama makes a constant mirror
        assert has(sheet, 0.07 + 0.1 * n) > 22 * 11 + 0.7 * 8**2
    assert has(sheet, 0.37) > WIDE * WIDE // 2
    assert has(sheet, 0.8) > WIDE * WIDE // 2
    np.testing.assert_array_equal(sheet[0, 0], round(BACKGROUND * 255))


def test_unseen_directions_are_tinted() -> None:
    seen, unseen = (compose_sheet(a_sheet(1, unseen=share)) for share in (0.0, 1.0))
    # without a truth, the panorama is shown once as it is and once tinted where nothing was seen
    assert has(seen, 0.07) - has(unseen, 0.07) >= WIDE * WIDE // 2
    assert has(unseen, 0.07) >= WIDE * WIDE // 2


def test_inserted_objects_replace_the_last_frame() -> None:
    image = np.full((48, 64, 3), 200, np.uint8)
    plain = a_sheet(1)
    sheet = compose_sheet(replace(plain, inserted=InsertedObjects(image, "with spheres", ((0.5, 0.5), None))))
    shown = int((sheet == 200).all(axis=-1).sum())
    assert WIDE * 144 - 3 * 20**2 < shown < WIDE * 144 - 400  # one badge covers a part of it


def test_mean_light_weighs_directions_by_solid_angle() -> None:
    panorama = flat(64, 128, 0.0)
    panorama[:32] = 1.0
    assert mean_light(panorama) == pytest.approx(0.5, abs=1e-6)
    panorama[16:48] = 0.0
    assert mean_light(panorama) == pytest.approx((1 - np.cos(np.pi / 4)) / 2, abs=1e-3)


@pytest.mark.parametrize(
    ("frames", "expected"),
    [(31, [0, 6, 12, 18, 24, 30]), (100, [0, 20, 40, 59, 79, 99]), (3, [0, 1, 2]), (1, [0]), (0, [])],
)
def test_times_are_spread_over_the_sequence(frames: int, expected: list[int]) -> None:
    assert sheet_times(frames) == expected


def test_mismatched_panoramas_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one time"):
        compose_sheet(a_sheet(0))
    with pytest.raises(ValueError, match="1 panoramas, not 2"):
        compose_sheet(replace(a_sheet(1), probes=a_sheet(1, probes=2).probes))


def test_text_stays_within_its_width() -> None:
    canvas = Canvas(101, 51)
    assert canvas.image.shape == (52, 102, 3)
    canvas.text((4, 4), "a label much longer than its place", width=80)
    inked = np.nonzero((canvas.image != round(BACKGROUND * 255)).any(axis=(0, 2)))[0]
    assert len(inked) > 20
    assert inked.max() < 4 + 80 + 4
    canvas.text((90, 45), "falls off the canvas, with an umlaut: ü")
    whole, cut = Canvas(101, 51), Canvas(101, 51)
    whole.text((20, 5), "cut")
    cut.text((-3, -6), "cut")
    np.testing.assert_array_equal(cut.image[:20, :40], whole.image[11:31, 23:63])
    canvas.text((4, 20), "")
    assert fitted("short", 1000) == "short"
    assert fitted("anything", 1) == ""


def test_a_picture_beyond_the_canvas_is_refused() -> None:
    canvas = Canvas(40, 40)
    with pytest.raises(ValueError, match="do not fit"):
        canvas.picture((30, 0), flat(10, 10, 0.5), size=(20, 20))
