"""Scores of estimators on captures: per-frame values, their means over the paper's intervals, and JSON.

The JSON (schema `roomlight-evaluation-1`), numbers unscaled, in a file null for values that are not known:

    schema    "roomlight-evaluation-1"
    metrics   {key: {"title", "shown_times"}}: `shown_times` is the factor that tables show values with
    captures  [{"name", "path", "frames", "skipped", "probes", "room"}]
    summary   [{"method", "capture" (null: the mean of all), "metric",
                "intervals": [{"frames", "mean", "low", "high"}]}]
    tracks    [{"capture", "probe", "method", "frames": [index, ...], "scores": {metric: [value, ...]}}]

A track's smoothness has one value fewer than it has frames: value i compares frames i and i + 1.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.metrics import METRICS, PAPER_INTERVALS, interval_means, intervals
from roomlight_evaluation.confidence import MeanWithInterval, mean_with_interval, ratio_of_means, resampled

SCHEMA: Final = "roomlight-evaluation-1"
_Columns = Float[np.ndarray, "6"]
"""A value for each of the paper's intervals and for all frames."""


@dataclass(frozen=True)
class CaptureSummary:
    """One capture: numbers of frames scored, frames skipped as unusable, and probes with ground truth.

    Captures of one room have the same `room`; None: no other is of this one's.
    """

    name: str
    path: str
    frames: int
    skipped: int
    probes: int
    room: str | None = None


@dataclass(frozen=True)
class Track:
    """Scores of one method at one probe of one capture: for each metric key, a value per frame.

    `frames` are the indices of the frames scored.
    """

    capture: str
    probe: int
    method: str
    frames: tuple[int, ...]
    scores: Mapping[str, tuple[float, ...]]

    def means(self, metric: str) -> _Columns:
        """Return the means over the paper's five intervals and over all frames; NaN for intervals without frames."""
        values = np.array(self.scores[metric], np.float64)
        overall = values.mean() if len(values) else np.nan
        return np.append(interval_means(values, len(self.frames)), overall)


@dataclass(frozen=True)
class CaptureScores:
    """Scores of every method at every probe of every capture, and their summary."""

    captures: tuple[CaptureSummary, ...]
    tracks: tuple[Track, ...]

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods in the order in which they were given."""
        return tuple(dict.fromkeys(track.method for track in self.tracks))

    @property
    def resampled(self) -> str:
        """What intervals are over: "probes" of a single capture, "captures", or "rooms" of several captures."""
        return resampled(self._rooms)

    @property
    def _rooms(self) -> dict[str, str]:
        """The room of each capture."""
        return {capture.name: capture.room or capture.name for capture in self.captures}

    @property
    def columns(self) -> tuple[str, ...]:
        """Headings of the five intervals, by the captures' own numbers of frames from 1, and of all together."""
        lengths, walks = {capture.frames for capture in self.captures}, {track.frames for track in self.tracks}
        if lengths == {31}:
            return (*PAPER_INTERVALS, "all")
        if len(lengths) == len(walks) == 1:
            frames = walks.pop()
            return (*(_span(frames[part.start : part.stop]) for part in intervals(len(frames))), "all")
        return (*(f"part {number} of 5" for number in range(1, 6)), "all")

    def means(self, method: str, metric: str, *, capture: str | None = None) -> tuple[MeanWithInterval, ...]:
        """Return a metric's mean in each column: over a capture's probes, then over captures (or one capture only).

        The 95 % interval resamples captures with replacement, those of one room together: probes of one room are alike.
        On one capture it resamples probes; a single one has no interval (NaN).

        Raises:
            KeyError: The method or the capture was not scored.
        """
        of_captures: dict[str, list[_Columns]] = {}
        for track in self.tracks:
            if track.method == method and capture in (None, track.capture):
                of_captures.setdefault(track.capture, []).append(track.means(metric))
        if not of_captures:
            raise KeyError(f"no scores of {method!r}" + (f" on {capture!r}" if capture else ""))
        [*values] = of_captures.values()
        if len(values) == 1:
            return tuple(mean_with_interval(column) for column in np.transpose(values[0]))
        rooms = self._rooms
        rows = [np.ma.filled(np.ma.masked_invalid(probes).mean(axis=0), np.nan) for probes in values]  # of known ones
        groups = [rooms[name] for name in of_captures]
        return tuple(mean_with_interval(column, groups) for column in np.transpose(rows))

    def ratio(self, metric: str, method: str, to: str, *, capture: str | None = None) -> MeanWithInterval:
        """Return the ratio of two methods' mean errors over captures (or on one), with an interval as `means` has it.

        Raises:
            KeyError: A method or the capture was not scored.
        """
        rooms = self._rooms
        names = [capture] if capture else list(rooms)
        above, below = ([self.means(title, metric, capture=name)[-1].mean for name in names] for title in (method, to))
        return ratio_of_means(above, below, [rooms[name] for name in names])

    def to_json(self) -> dict[str, Any]:
        """Return the JSON of this module's docstring as plain dictionaries and lists."""
        scopes: list[str | None] = [None, *(capture.name for capture in self.captures)]
        return {
            "schema": SCHEMA,
            "metrics": {metric.key: {"title": metric.title, "shown_times": metric.shown_times} for metric in METRICS},
            "captures": [asdict(capture) for capture in self.captures],
            "summary": [
                {
                    "method": method,
                    "capture": scope,
                    "metric": metric.key,
                    "intervals": [
                        {"frames": column, **asdict(cell)}
                        for column, cell in zip(
                            self.columns, self.means(method, metric.key, capture=scope), strict=True
                        )
                    ],
                }
                for scope in scopes
                for method in self.methods
                for metric in METRICS
            ],
            "tracks": [asdict(track) for track in self.tracks],
        }


def _span(frames: Sequence[int]) -> str:
    """Return the first and the last number of frames, counted from 1."""
    return "none" if not frames else "-".join(str(index + 1) for index in sorted({frames[0], frames[-1]}))
