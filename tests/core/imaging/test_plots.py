import numpy as np
import pytest

from roomlight.imaging.drawing import BACKGROUND, Canvas
from roomlight.imaging.plots import Plot, Series, draw_plot, round_up

RED = (1.0, 0.0, 0.0)
GREEN = (0.0, 1.0, 0.0)


def drawn(plot: Plot) -> np.ndarray:
    canvas = Canvas(300, 200)
    draw_plot(canvas, (0, 0), (300, 200), plot)
    return canvas.image.astype(int)


def rows_of(image: np.ndarray, channel: int) -> np.ndarray:
    """Rows that hold pixels of a strong colour."""
    others = image.sum(axis=-1) - image[..., channel]
    return np.nonzero(((image[..., channel] > 150) & (others < 120)).any(axis=1))[0]


def test_a_larger_value_is_drawn_higher_and_within_the_plot() -> None:
    image = drawn(Plot("a plot", [0, 10], [Series((0.9, 0.9), RED), Series((0.1,), GREEN)], top=1.0))
    assert rows_of(image, 0).max() < rows_of(image, 1).min()
    image = drawn(Plot("a plot", [0, 10], [Series((0.5, 7.0), RED)], top=1.0))
    assert rows_of(image, 0).min() >= 26  # above the axis
    image = drawn(Plot("", [3], [Series((0.5,), RED)], top=1.0))
    assert (image[..., 0] > 150).sum() > 200  # one time is a level
    image = drawn(Plot("", [0, 9], [Series((1.0,), RED, filled=True)], top=1.0))
    assert image[100, 150, 0] > image[100, 150, 1] + 20  # below a filled line


def test_a_dashed_line_has_gaps() -> None:
    whole, dashed = (
        int((drawn(Plot("", [0, 9], [Series((0.5,), RED, dashed=dash)], top=1.0))[..., 0] > 150).sum())
        for dash in (False, True)
    )
    assert 0.4 * whole < dashed < 0.8 * whole


def test_a_series_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="2 values does not fit 3 times"):
        drawn(Plot("", [0, 1, 2], [Series((1.0, 2.0), RED)]))
    assert (Canvas(4, 4).image == round(BACKGROUND * 255)).all()


@pytest.mark.parametrize(
    ("value", "expected"), [(0.0, 1.0), (0.3, 0.5), (0.5, 0.5), (0.51, 1.0), (1.7, 2.0), (12.0, 20.0), (600.0, 1000.0)]
)
def test_axes_end_at_round_values(value: float, expected: float) -> None:
    assert round_up(value) == pytest.approx(expected)
