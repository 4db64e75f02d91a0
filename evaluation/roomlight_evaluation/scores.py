"""Results of an evaluation: per-frame scores, their means over the paper's intervals, and JSON.

The JSON (schema `roomlight-evaluation-1`), numbers unscaled, null where there is none:

    schema    "roomlight-evaluation-1"
    metrics   {key: {"title", "shown_times"}}: the factor is the one tables show values with
    captures  [{"name", "path", "frames", "skipped", "probes"}]
    summary   [{"method", "capture" (null: the mean of all), "metric", "intervals": [{"frames", "mean",
    "low", "high"}]}] tracks    [{"capture", "probe", "method", "frames": [index, ...], "scores": {metric:
    [value, ...]}}]

A track's smoothness has one value fewer than it has frames: value i is that of frames i and i + 1.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.errors import CaptureError
from roomlight.files import write_json
from roomlight.metrics import METRICS, PAPER_INTERVALS, interval_means, intervals

SCHEMA: Final = "roomlight-evaluation-1"
BOOTSTRAP_SAMPLES: Final = 10_000
"""Resamples of the (capture, probe) pairs; the ends of an interval are then stable to 2 % of its width."""


@dataclass(frozen=True)
class CaptureSummary:
    """What was evaluated: frames scored, frames skipped as unusable, and probes with truth."""

    name: str
    path: str
    frames: int
    skipped: int
    probes: int


@dataclass(frozen=True)
class Track:
    """Scores of one method at one probe of one capture, a value for each frame, by metric key."""

    capture: str
    probe: int
    method: str
    frames: tuple[int, ...]
    scores: Mapping[str, tuple[float, ...]]

    def means(self, metric: str) -> Float[np.ndarray, "6"]:
        """Means over the paper's five intervals and over all frames; NaN where there is no frame."""
        values = np.array(self.scores[metric], np.float64)
        overall = values.mean() if len(values) else np.nan
        return np.append(interval_means(values, len(self.frames)), overall)


@dataclass(frozen=True)
class Cell:
    """A mean and its 95 % bootstrap interval over (capture, probe) pairs; NaN where there is none."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Evaluation:
    """All tracks of all captures, and the tables made of them."""

    captures: tuple[CaptureSummary, ...]
    tracks: tuple[Track, ...]

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods in the order in which they were given."""
        return tuple(dict.fromkeys(track.method for track in self.tracks))

    @property
    def columns(self) -> tuple[str, ...]:
        """Headings of the five intervals and of the mean over all frames; frames are numbered from 1."""
        lengths = {capture.frames for capture in self.captures}
        if lengths == {31}:
            return (*PAPER_INTERVALS, "all")
        if len(lengths) == 1:
            parts = intervals(lengths.pop())
            spans = [f"[{part.start + 1},{part.stop + 1})" if part else "none" for part in parts]
            return (*spans, "all")
        return (*(f"part {number} of 5" for number in range(1, 6)), "all")

    def cells(self, method: str, metric: str, *, capture: str | None = None) -> tuple[Cell, ...]:
        """The metric's mean in each column: over a capture's probes, then over captures (or one capture
        only).

        The interval resamples (capture, probe) pairs with replacement; a single pair has none (NaN).
        """
        chosen = [
            track for track in self.tracks if track.method == method and (capture is None or track.capture == capture)
        ]
        if not chosen:
            raise KeyError(f"no scores of {method!r}" + (f" on {capture!r}" if capture else ""))
        values = np.stack([track.means(metric) for track in chosen])  # [pair, column]
        probes = [sum(other.capture == track.capture for other in chosen) for track in chosen]
        return tuple(_cell(column, 1 / np.array(probes, np.float64)) for column in values.T)

    def to_json(self) -> dict[str, Any]:
        """The schema in this module's docstring, as plain dictionaries and lists."""
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
                        {"frames": column, **{key: _number(value) for key, value in asdict(cell).items()}}
                        for column, cell in zip(
                            self.columns, self.cells(method, metric.key, capture=scope), strict=True
                        )
                    ],
                }
                for scope in scopes
                for method in self.methods
                for metric in METRICS
            ],
            "tracks": [
                {
                    "capture": track.capture,
                    "probe": track.probe,
                    "method": track.method,
                    "frames": list(track.frames),
                    "scores": {key: [_number(value) for value in values] for key, values in track.scores.items()},
                }
                for track in self.tracks
            ],
        }

    def write(self, path: Path) -> None:
        """Write `to_json` to a file, whole or not at all; OutputError if it cannot be written."""
        write_json(path, self.to_json())

    @classmethod
    def read(cls, path: Path) -> "Evaluation":
        """Read what `write` wrote, so that runs can be compared later; CaptureError for anything else."""
        try:
            data: Any = json.loads(path.read_text())
            if data["schema"] != SCHEMA:
                raise CaptureError(f"{path}: its schema is {data['schema']!r}, not {SCHEMA!r}")
            captures = tuple(CaptureSummary(**capture) for capture in data["captures"])
            tracks = tuple(_track(track) for track in data["tracks"])
        except OSError as error:
            raise CaptureError(f"{path}: cannot be read ({error.strerror or error})") from error
        except (ValueError, TypeError, KeyError) as error:
            raise CaptureError(f"{path}: is not the JSON that `roomlight eval` writes ({error!r})") from error
        return cls(captures, tracks)


def _track(data: dict[str, Any]) -> Track:
    scores = {
        key: tuple(math.nan if value is None else float(value) for value in values)
        for key, values in data["scores"].items()
    }
    return Track(data["capture"], int(data["probe"]), data["method"], tuple(data["frames"]), scores)


def _cell(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> Cell:
    known = np.isfinite(values)
    values, weights = values[known], weights[known]
    if len(values) == 0:
        return Cell(math.nan, math.nan, math.nan)
    mean = float(np.average(values, weights=weights))
    if len(values) == 1:
        return Cell(mean, math.nan, math.nan)
    # Seeded, so that a table comes out the same twice, and the same pairs are drawn for every method.
    drawn = np.random.default_rng(0).integers(0, len(values), (BOOTSTRAP_SAMPLES, len(values)))
    means = (values * weights)[drawn].sum(axis=1) / weights[drawn].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return Cell(mean, float(low), float(high))


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
