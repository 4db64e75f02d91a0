"""Estimated depth scored in recordings that have depth, and the light that follows from it.

Each frame's own depth is hidden from the estimate and compared with it. AbsRel is the mean of |d / d_true - 1|; "delta"
the share of pixels with max(d / d_true, d_true / d) < 1.25 (Eigen et al. 2014). Pixels without an estimate are left
out. At true panoramas, light by estimated depth is compared with light by exact depth.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float, Float32
from rich.table import Table

from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.dataset.folder import MANIFEST
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError
from roomlight.frame import Frame
from roomlight.imaging.tables import figure_table
from roomlight.monocular.stream import DepthStream, open_depth_stream
from roomlight_evaluation.captures.estimators import EngineEstimator
from roomlight_evaluation.captures.evaluation import ProgressCallback, capture_names, capture_room, score_frames
from roomlight_evaluation.captures.scores import Track
from roomlight_evaluation.confidence import (
    MeanWithInterval,
    evenly_spread,
    mean_cell,
    mean_with_interval,
    ratio_of_means,
)

CONSTANT_M: Final = 2.5
"""The answer that knows nothing."""
METHODS: Final = ("constant", "single", "stream", "scaled")
"""2.5 m everywhere, each frame alone, the stream with its poses, and that at each frame's best scale."""
LIGHT: Final = {"log_l2": "log-L2", "si_rmse_diffuse": "diffuse sphere"}
"""Scores of light that are compared, by their keys in `roomlight.metrics.METRICS`."""

_CAPTURES: Final = "captures"


@dataclass(frozen=True)
class DepthScore:
    """Scores of one recording: means over its frames.

    Attributes:
        room: The capture's name, or the walk's number.
        source: The dataset of a walk, or `captures`.
        abs_rel: By `METHODS`.
        delta: Likewise, the share within 25 %.
        light: By `LIGHT`, the errors of light by estimated depth and by exact depth; none without true panoramas.
        of_room: The same of recordings of one room; None: no other is of this one's.
    """

    room: str
    source: str
    frames: int
    abs_rel: dict[str, float]
    delta: dict[str, float]
    light: dict[str, tuple[float, float]]
    of_room: str | None = None


@dataclass(frozen=True)
class DepthScores:
    """Scores of several recordings."""

    scores: tuple[DepthScore, ...]

    def table(self) -> Table:
        """Return a row for each capture, and for the captures and each dataset the means with 95 % intervals."""
        columns = [*(f"AbsRel {method}" for method in METHODS), *(f"delta {method}" for method in METHODS[1:3])]
        note = "light: error by estimated depth over that by exact depth"
        sources = dict.fromkeys(score.source for score in self.scores)
        groups = [(score.room, [score]) for score in self.scores if score.source == _CAPTURES]
        groups += [(name, [score for score in self.scores if score.source == name]) for name in sources]
        rows: list[list[str]] = []
        for name, scores in groups:
            of_rooms = [score.of_room or score.room for score in scores]
            means = (
                *(mean_with_interval((score.abs_rel[method] for score in scores), of_rooms) for method in METHODS),
                *(mean_with_interval((score.delta[method] for score in scores), of_rooms) for method in METHODS[1:3]),
                *(_light_ratio(scores, metric) for metric in LIGHT),
            )
            title = f"{name} ({len(scores)})" if name in sources else name
            rows.append([title, *(mean_cell(mean, 2) for mean in means)])
        return figure_table("estimated depth", [*columns, *LIGHT.values()], rows, caption=note)

    def to_json(self) -> dict[str, Any]:
        """Return all scores as plain JSON values."""
        return asdict(self)


def evaluate_depth(
    sources: Sequence[Path],
    light: SessionOptions,
    reading: CaptureOptions,
    *,
    split: Split = "test",
    limit: int | None = None,
    progress: ProgressCallback | None = None,
) -> DepthScores:
    """Score the estimated depth of recordings, and its light.

    Args:
        sources: Captures with depth, and dataset folders.
        reading: How captures are read; its `depth_model` is scored, `every` and `max_frames` hold for datasets too.
        limit: Use this many walks of each dataset, evenly spread; None uses all.

    Raises:
        CaptureError: A capture cannot be read, or has no depth; two sources have one name; there is nothing to score.
        DatasetError: A dataset is damaged.
        ModelError: The depth model or the weights of `light` cannot be used.
    """
    named, graphs = zip(capture_names(sources), sources, strict=True), choose_graphs(light)
    scores: list[DepthScore] = []
    for room in (room for name, path in named for room in _rooms(name, path, reading, split, limit)):
        hidden, exact = _Hidden(light, graphs, reading.depth_model), EngineEstimator(light, graphs)

        def show(done: int, room: _Room = room) -> None:
            if progress is not None:
                progress(room.name, done, room.count)

        probes = [(number, *truth) for number, truth in enumerate(room.truths)]
        _, tracks = score_frames(room.name, room.frames, probes, [hidden, exact], progress=show)
        if not hidden.errors:
            raise CaptureError(f"{room.name}: has no frame to score")
        errors = np.nanmean(hidden.errors, axis=0).tolist()
        scores.append(
            DepthScore(
                room=room.name,
                source=room.source,
                frames=len(hidden.errors),
                abs_rel={method: error for method, (error, _) in zip(METHODS, errors, strict=True)},
                delta={method: share for method, (_, share) in zip(METHODS, errors, strict=True)},
                light={metric: (_mean(tracks, hidden, metric), _mean(tracks, exact, metric)) for metric in LIGHT}
                if probes
                else {},
                of_room=room.of_room,
            )
        )
    if not scores:
        what = f"give captures with depth, or datasets with walks of the split {split} (--split)"
        raise CaptureError(f"no recording to score: {what}")
    return DepthScores(tuple(scores))


def depth_errors(depth_m: Float[np.ndarray, "h w"], true_m: Float[np.ndarray, "th tw"]) -> Float[np.ndarray, "2"]:
    """Return AbsRel and delta, at the estimate's size; NaN where nothing is known."""
    truth = cv2.resize(true_m, depth_m.shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    both = (truth > 0) & (depth_m > 0)
    if not both.any():
        return np.full(2, np.nan)
    ratio = depth_m[both] / truth[both]
    return np.array([np.abs(ratio - 1).mean(), (np.maximum(ratio, 1 / ratio) < 1.25).mean()])


@dataclass(frozen=True)
class _Room:
    """A recording: its frames, how many there are at most, and its true panoramas."""

    name: str
    source: str
    frames: Iterable[Frame]
    count: int
    truths: list[tuple[Position, Float[np.ndarray, "h w 3"]]]
    of_room: str | None = None


class _Hidden(EngineEstimator):
    """A session of the engine whose frames' depth is hidden, estimated and scored."""

    def __init__(self, options: SessionOptions, graphs: LightingGraphs | None, model: Path | None) -> None:
        super().__init__(options, graphs)
        self.name = "estimated depth"
        self._stream, self._reference = open_depth_stream(model), open_depth_stream().model
        self.errors: list[Float[np.ndarray, "4 2"]] = []

    def push(self, frame: Frame) -> None:
        true_m = frame.depth_m
        bare = replace(frame, depth_m=np.zeros_like(true_m))
        stream_m = self._stream.estimate(bare)
        answers = (
            np.full_like(true_m, CONSTANT_M),
            DepthStream(self._stream.model, self._reference).estimate(bare),
            stream_m,
            _best_scaled(stream_m, true_m),
        )
        self.errors.append(np.stack([depth_errors(depth_m, true_m) for depth_m in answers]))
        super().push(replace(bare, depth_m=stream_m))


def _rooms(name: str, path: Path, reading: CaptureOptions, split: Split, limit: int | None) -> Iterator[_Room]:
    """Read a capture, or the walks of a dataset."""
    if not (path / MANIFEST).is_file():
        capture = open_capture(path, replace(reading, depth="file", depth_model=None))
        truths = [(probe.position, probe.panorama()) for probe in capture.truths]
        yield _Room(name, _CAPTURES, capture, capture.frame_count, truths, capture_room(capture.path))
        return
    dataset = Dataset(path, split)
    for number in evenly_spread(len(dataset), limit):
        recording = dataset[number]
        chosen = range(0, len(recording.colour), reading.every)[: reading.max_frames]
        frames = [recording.frame(k, recording.depth_mm[k]) for k in chosen]
        yield _Room(recording.name, name, frames, len(frames), recording.truths(), recording.room)


def _best_scaled(depth_m: Float32[np.ndarray, "h w"], true_m: Float32[np.ndarray, "th tw"]) -> Float[np.ndarray, "h w"]:
    """Return estimated depth at the scale of its median ratio to the truth."""
    truth = cv2.resize(true_m, depth_m.shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    both = (truth > 0) & (depth_m > 0)
    return depth_m * np.median(truth[both] / depth_m[both]) if both.any() else depth_m


def _mean(tracks: Sequence[Track], method: EngineEstimator, metric: str) -> float:
    return float(np.mean([track.scores[metric] for track in tracks if track.method == method.name]))


def _light_ratio(scores: Sequence[DepthScore], metric: str) -> MeanWithInterval:
    lit = [score for score in scores if score.light]
    above, below = ([score.light[metric][side] for score in lit] for side in (0, 1))
    return ratio_of_means(above, below, [score.of_room or score.room for score in lit])
