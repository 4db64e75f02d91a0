"""Line plots on a canvas: a few series over the frames of a replay, with two ticks and no frame around them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight.imaging.drawing import HEADING, Canvas, Colour, text_width

_TITLE_ROWS: Final = 26
_TICK_ROWS: Final = 24
_TICK_COLUMNS: Final = 44
_TICK_SIZE: Final = 12
_GRID: Final = 0.22
_DASH: Final = (7.0, 5.0)


@dataclass(frozen=True)
class Series:
    """One line of a plot.

    Attributes:
        values: A value for each time; a single value is drawn as a level across the plot.
        colour: Of the line, sRGB-encoded.
        dashed: Draw a dashed line.
        filled: Tint the area below the line.
    """

    values: Sequence[float]
    colour: Colour
    dashed: bool = False
    filled: bool = False


@dataclass(frozen=True)
class Plot:
    """A plot of series over the same times.

    Attributes:
        title: The plot's heading.
        times: What the horizontal axis shows, increasing: frame indices.
        series: The lines, the last one on top.
        top: The value at the top of the vertical axis, whose bottom is 0; None: round the largest value up.
        percent: Write the ticks as percent.
    """

    title: str
    times: Sequence[int]
    series: Sequence[Series]
    top: float | None = None
    percent: bool = False


def draw_plot(canvas: Canvas, at: tuple[int, int], size: tuple[int, int], plot: Plot) -> None:
    """Draw a plot into the rectangle of `size` (columns, rows) at `at`.

    Raises:
        ValueError: There is no time, or a series has neither one value nor one for each time.
    """
    for series in plot.series:
        if len(series.values) not in (1, len(plot.times)) or not plot.times:
            raise ValueError(f"a series of {len(series.values)} values does not fit {len(plot.times)} times")
    (left, top), (width, height) = at, size
    canvas.text(at, plot.title, grey=HEADING, width=width, weight="semibold")
    x0, x1 = float(left + _TICK_COLUMNS), float(left + width - 4)
    y1, y0 = float(top + _TITLE_ROWS + 8), float(top + height - _TICK_ROWS)
    highest = plot.top or round_up(max((max(series.values) for series in plot.series), default=1.0))
    for share in (0.0, 0.5, 1.0):
        y = y0 + share * (y1 - y0)
        canvas.line([(x0, y), (x1, y)], _GRID)
        tick = f"{100 * share * highest:.0f} %" if plot.percent else f"{share * highest:.3g}"
        tick_left = round(x0) - 8 - text_width(tick, size=_TICK_SIZE)
        canvas.text((tick_left, round(y) - 8), tick, size=_TICK_SIZE)
    first, last = f"frame {plot.times[0]}", str(plot.times[-1])
    canvas.text((round(x0), round(y0) + 6), first, size=_TICK_SIZE)
    if len(plot.times) > 1:
        canvas.text((round(x1) - text_width(last, size=_TICK_SIZE), round(y0) + 6), last, size=_TICK_SIZE)
    span = max(plot.times[-1] - plot.times[0], 1)
    for series in plot.series:
        values = list(series.values) if len(series.values) > 1 else [*series.values] * len(plot.times)
        points = [
            (x0 + (x1 - x0) * (time - plot.times[0]) / span, y0 + (y1 - y0) * min(value / highest, 1.0))
            for time, value in zip(plot.times, values, strict=True)
        ]
        if len(points) == 1:  # one frame: a level across the plot
            points = [(x0, points[0][1]), (x1, points[0][1])]
        _draw_series(canvas, points, y0, series)


def round_up(value: float) -> float:
    """Return the next of 1, 2 or 5 times a power of ten, at least `value`; 1 if `value` is not positive."""
    if not value > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1 - 1e-9)))


def _draw_series(canvas: Canvas, points: list[tuple[float, float]], bottom: float, series: Series) -> None:
    if series.filled:
        canvas.area([(points[0][0], bottom), *points, (points[-1][0], bottom)], series.colour, opacity=0.22)
    if not series.dashed:
        canvas.line(points, series.colour, width=2)
        return
    for dash in _dashes(points):
        canvas.line(dash, series.colour, width=2)


def _dashes(points: list[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """Cut a polyline into dashes of `_DASH[0]` pixels with gaps of `_DASH[1]`."""
    corners = np.asarray(points, np.float64)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    starts = np.arange(0.0, along[-1], sum(_DASH))
    ends = np.minimum(starts + _DASH[0], along[-1])
    cuts = [np.stack([np.interp(edge, along, corners[:, k]) for k in (0, 1)], -1).tolist() for edge in (starts, ends)]
    return [[(a[0], a[1]), (b[0], b[1])] for a, b in zip(*cuts, strict=True)]
