"""Score models on walks of a dataset, frame by frame, or on their first frames alone.

`recurrent_models` are the paper's comparisons of the recurrent form, `image_models` those of single images. Each walk
is streamed to every method at once, with exact depth and again with depth as a phone measures it. The phone's depth is
seeded by the walk's name, so that every method and every run gets the same one.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.dataset.arkit_depth import arkit_like
from roomlight.dataset.loader import Dataset, DepthKind
from roomlight.dataset.recording import Recording
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import DatasetError, FrameError
from roomlight.frame import Frame
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator
from roomlight_evaluation.captures.evaluation import score_frames
from roomlight_evaluation.captures.scores import CaptureScores, CaptureSummary, Track
from roomlight_evaluation.confidence import evenly_spread

Panorama = Float[np.ndarray, "h w 3"]
LATE_FROM: Final = 25
"""Frame, counted from 1, at which the late probe is first asked for."""
NO_RNN: Final = "each frame alone"
AVERAGE: Final = "simple average"
PHONE: Final = "phone depth"
ProgressCallback = Callable[[int, int], object]
"""Called as (walks done, walks in all) after each walk."""


@dataclass(frozen=True)
class Compared:
    """What is compared; networks are loaded once and shared by all walks.

    Attributes:
        exact: Makes new estimators of every comparison on exact depth.
        phone: Likewise on depth as a phone measures it.
        frames: Frames of a walk that are scored, the first ones; None: all.
    """

    exact: Callable[[], list[Estimator]]
    phone: Callable[[], list[Estimator]] = list
    frames: int | None = None


def recurrent_models(options: SessionOptions) -> Compared:
    """Return the paper's comparisons of the recurrent form.

    Raises:
        ModelError: The weights are missing, damaged or untrained.
        OptionError: The weights are single-view only.
    """
    video, single = replace(options, model="video"), replace(options, model="single")
    graphs = choose_graphs(video)
    assert graphs is not None
    single_graphs = replace(graphs, form="single")

    def exact() -> list[Estimator]:
        alone, tracked = FrameAlone(single, single_graphs), EngineEstimator(video, graphs)
        return [
            MeanColour(),
            WarpAndFill(),
            _classical(options),
            alone,
            SimpleAverage(alone),
            EngineEstimator(single, single_graphs),
            tracked,
            LateProbe(tracked),
        ]

    return Compared(exact, lambda: _by_phone([_classical(options), EngineEstimator(video, graphs)]))


def image_models(options: SessionOptions) -> Compared:
    """Return the single-view networks and the methods without learning, on the first frame of each walk.

    Raises:
        ModelError: The weights are missing, damaged or untrained.
    """
    single = replace(options, model="single")
    graphs = choose_graphs(single)

    def exact() -> list[Estimator]:
        return [MeanColour(), WarpAndFill(), _classical(options), EngineEstimator(single, graphs)]

    return Compared(exact, lambda: _by_phone(exact()[1:]), frames=1)


def _classical(options: SessionOptions) -> EngineEstimator:
    return EngineEstimator(replace(options, model="classical", weights=None), None)


def _by_phone(estimators: Sequence[Any]) -> list[Estimator]:
    for estimator in estimators:
        estimator.name = f"{estimator.name}, {PHONE}"
    return list(estimators)


class FrameAlone:
    """The single-view networks on each frame alone: a new session for every frame (the paper's "no RNN")."""

    name = NO_RNN

    def __init__(self, options: SessionOptions, graphs: LightingGraphs) -> None:
        self._options, self._graphs = options, graphs
        self._session = Session(options, graphs=graphs)
        self._answers: dict[Position, Panorama] = {}

    def push(self, frame: Frame) -> None:
        """Forget the earlier frames and take this one."""
        self._session, self._answers = Session(self._options, graphs=self._graphs), {}
        self._session.push(frame)

    def light_at(self, position: Position) -> Panorama:
        """Return the panorama [h, 2h, 3] at a point, of the last frame alone."""
        if position not in self._answers:
            self._answers[position] = self._session.light_at(position).reflection
        return self._answers[position]


class SimpleAverage:
    """The mean of the panoramas of each frame alone, so far."""

    name = AVERAGE

    def __init__(self, alone: FrameAlone) -> None:
        """Average what `alone` answers, which gets the same frames."""
        self._alone = alone
        self._sums: dict[Position, Panorama] = {}
        self._frames = 0

    def push(self, frame: Frame) -> None:
        """Count the frame."""
        del frame
        self._frames += 1

    def light_at(self, position: Position) -> Panorama:
        """Add the frame's panorama [h, 2h, 3] at a point and return the mean; call it once at each frame."""
        radiance = self._alone.light_at(position)
        self._sums[position] = radiance + self._sums[position] if position in self._sums else radiance.copy()
        return self._sums[position] / np.float32(self._frames)


class LateProbe:
    """The recurrent networks at points that are first asked for at frame `LATE_FROM`, and tracked from then on."""

    name = "video, late probe"

    def __init__(self, video: EngineEstimator) -> None:
        """Track points of the session of `video`, which gets the same frames before this estimator."""
        self._video = video
        self._frames = 0

    def push(self, frame: Frame) -> None:
        """Count the frame."""
        del frame
        self._frames += 1

    def light_at(self, position: Position) -> Panorama | None:
        """Return the panorama [h, 2h, 3] at a point, from frame `LATE_FROM` on."""
        return self._video.late_light_at(position) if self._frames >= LATE_FROM else None


def evaluate_walks(
    datasets: Sequence[Dataset],
    models: Compared,
    *,
    limit: int | None = None,
    progress: ProgressCallback | None = None,
) -> CaptureScores:
    """Score every comparison on the walks of datasets; those without probes or a usable first frame are left out.

    So are methods without an answer on any walk: late probes need `LATE_FROM` frames.

    Args:
        datasets: Test splits: rooms that no network was trained on.
        limit: Score this many walks of each dataset, spread evenly; None scores all.
        progress: Called as (walks done, walks in all) after each walk.

    Raises:
        DatasetError: A dataset is empty or damaged, two have folders of one name, or no walk can be used.
    """
    names = [dataset.folder.name for dataset in datasets]
    for name in names:
        if names.count(name) > 1:
            raise DatasetError(f"two datasets are called {name}: their results would be mixed up; rename one")
    chosen = [(dataset, number) for dataset in datasets for number in evenly_spread(len(dataset), limit)]
    if not chosen:
        folders = ", ".join(str(dataset.folder) for dataset in datasets)
        raise DatasetError(f"{folders}: has no finished walk of this split; generate some first")
    summaries: list[CaptureSummary] = []
    tracks: list[Track] = []
    for done, (dataset, number) in enumerate(chosen, 1):
        recording = dataset[number]
        name = f"{dataset.folder.name}/{recording.name}"
        try:
            walk_tracks = score_walk(recording, models, name=name) if len(recording.probe_positions) else []
        except FrameError:
            walk_tracks = []
        if walk_tracks:
            tracks += walk_tracks
            probes = len({track.probe for track in walk_tracks})
            frames = len(walk_tracks[0].frames)
            summaries.append(CaptureSummary(name, str(dataset.folder), frames, 0, probes, recording.room))
        if progress is not None:
            progress(done, len(chosen))
    if not tracks:
        raise DatasetError(
            f"{chosen[0][0].folder}: no walk can be used: they have no probes, or their first frames no depth"
        )
    answered = {track.method for track in tracks if np.isfinite(track.scores["log_l2"]).any()}
    return CaptureScores(tuple(summaries), tuple(track for track in tracks if track.method in answered))


def score_walk(recording: Recording, models: Compared, *, name: str) -> list[Track]:
    """Score every comparison on one walk.

    Raises:
        FrameError: The first frame cannot begin a stream.
    """
    probes = [(number, *truth) for number, truth in enumerate(recording.truths())]
    sensors: list[tuple[DepthKind, list[Estimator]]] = [("exact", models.exact()), ("arkit", models.phone())]
    tracks: list[Track] = []
    for depth, estimators in sensors:
        if estimators:
            frames = islice(walk_frames(recording, depth), models.frames)
            tracks += score_frames(name, frames, probes, estimators)[1]
    return tracks


def walk_frames(recording: Recording, depth: DepthKind) -> Iterable[Frame]:
    """Return the frames of a walk as a client would send them, radiance in units of the first frame's white."""
    depth_mm = recording.depth_mm
    if depth == "arkit":
        rng = np.random.default_rng([1, *recording.name.encode()])
        depth_mm = arkit_like(depth_mm, recording.surface, recording.colour, rng)
    for number, measured in enumerate(depth_mm):
        yield recording.frame(number, measured)
