"""Score estimators on captures without ground truth: the view of a later frame is predicted from the frames before it.

Every estimator gets the frames up to some frame and gives its panorama at the camera's position `ahead` frames later.
That frame's pixels, averaged in the panorama's pixels, are the truth in the directions that it shows. Directions that
the earlier frames have shown to that position ("seen": the classical model's coverage) are scored apart from the
others ("unseen"), the same for all methods.

The error is the mean of (log(1 + estimate) - log(1 + truth))^2 by solid angle. Where the later frame is clipped its
value is a lower bound: an estimate above it has no error. Exposures that a capture does not report are taken as equal.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from jaxtyping import Bool, Float

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.conventions import Position, direction_to_uv, panorama_solid_angles
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import CaptureError, OptionError
from roomlight.files import write_json
from roomlight.frame import Frame
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator
from roomlight_evaluation.confidence import MeanWithInterval, mean_with_interval, ratio_of_means

HEIGHT: Final = 120
REFERENCE: Final = "classical"
"""The method that the others are compared with, and whose coverage says which directions were seen."""
LEAST_PIXELS: Final = 20
"""A view's directions of one kind are scored if they are at least this many pixels of the panorama."""
Region = Literal["seen", "unseen"]
REGIONS: Final[tuple[Region, ...]] = ("seen", "unseen")
ViewProgress = Callable[[str, int, int], None]
"""Called as (capture name, frames done, frames in all) after each frame."""


@dataclass(frozen=True, eq=False)
class View:
    """What a frame shows, as a part of a panorama at its camera's position.

    Attributes:
        radiance: [h, 2h, 3] mean of the frame's pixels in each direction, 0 elsewhere.
        shown: [h, 2h] directions that the frame shows.
        clipped: [h, 2h] directions in which a pixel was clipped: radiance is a lower bound there.
    """

    radiance: Float[np.ndarray, "h w 3"]
    shown: Bool[np.ndarray, "h w"]
    clipped: Bool[np.ndarray, "h w"]

    @classmethod
    def of(cls, frame: Frame, height: int = HEIGHT) -> "View":
        """Average a frame's pixels in the pixels of a panorama; those that it covers by less than half are left out."""
        rays = frame.intrinsics.rays()
        directions = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ frame.camera_to_world[:3, :3].T
        uv = direction_to_uv(directions.reshape(-1, 3))
        row = np.minimum((uv[:, 1] * height).astype(int), height - 1)
        cell = row * 2 * height + np.minimum((uv[:, 0] * 2 * height).astype(int), 2 * height - 1)
        size = 2 * height * height
        count = np.bincount(cell, minlength=size)
        image = frame.image.reshape(-1, 3)
        sums = np.stack([np.bincount(cell, image[:, c], minlength=size) for c in range(3)], axis=-1)
        full = count > 0.5 * np.median(count[count > 0])
        clipped = np.bincount(cell, frame.clipped.reshape(-1), minlength=size) > 0
        radiance = np.where(full[:, None], sums / np.maximum(count, 1)[:, None], 0).astype(np.float32)
        shape = (height, 2 * height)
        return cls(radiance.reshape(*shape, 3), full.reshape(shape), (clipped & full).reshape(shape))

    def error(self, estimate: Float[np.ndarray, "h w 3"], where: Bool[np.ndarray, "h w"]) -> float:
        """Return the mean squared difference of log(1 + radiance) in these directions, by solid angle."""
        difference = np.log1p(np.maximum(estimate, 0)) - np.log1p(self.radiance)
        difference = np.where(self.clipped[..., None], np.minimum(difference, 0), difference)
        weight = panorama_solid_angles(len(estimate)) * where
        return float((np.square(difference).mean(axis=-1) * weight).sum() / weight.sum())


@dataclass(frozen=True)
class ViewScore:
    """One method's error at one later frame, for the directions of one kind, which are `share` of the view's."""

    capture: str
    frame: int
    method: str
    region: Region
    error: float
    share: float


@dataclass(frozen=True)
class ViewScores:
    """Scores of all captures, later frames, methods and kinds of directions; `ahead` is in frames."""

    ahead: int
    scores: tuple[ViewScore, ...]

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods in the order in which they were given."""
        return tuple(dict.fromkeys(score.method for score in self.scores))

    def errors(self, method: str, region: Region) -> list[float]:
        """Return the errors of all views; views are in the same order for every method."""
        return [score.error for score in self.scores if score.method == method and score.region == region]

    def mean(self, method: str, region: Region) -> MeanWithInterval:
        """Return the mean error over views, with a 95 % interval that resamples views."""
        return mean_with_interval(self.errors(method, region))

    def ratio(self, method: str, region: Region) -> MeanWithInterval:
        """Return the mean error as a ratio to the reference's, with a 95 % interval that resamples views."""
        errors = self.errors(method, region)
        return ratio_of_means(errors, self.errors(REFERENCE, region) if errors else [])

    def share(self, region: Region) -> float:
        """Return the mean share of a view's directions that are of this kind."""
        shares = [score.share for score in self.scores if score.method == REFERENCE and score.region == region]
        views = {(score.capture, score.frame) for score in self.scores}
        return sum(shares) / len(views)

    def write(self, path: Path) -> None:
        """Write all scores and their means as JSON, atomically.

        Raises:
            OutputError: The file cannot be written.
        """
        means = [
            {"method": method, "region": region, "mean": _plain(self.mean(method, region))}
            | {"ratio": _plain(self.ratio(method, region))}
            for method in self.methods
            for region in REGIONS
        ]
        write_json(path, {"ahead": self.ahead, "summary": means, "scores": [asdict(score) for score in self.scores]})


class LaterPoint:
    """A session whose light is asked for at points that it does not track."""

    def __init__(self, options: SessionOptions, graphs: LightingGraphs | None) -> None:
        """Open a session."""
        self._inner = EngineEstimator(options, graphs, late=True)
        self.name = options.model

    def push(self, frame: Frame) -> None:
        """Take the next frame."""
        self._inner.push(frame)

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """Return the panorama [h, 2h, 3] at a point, from the keyframes and the last frame."""
        return self._inner.light_at(position)


def evaluate_views(
    captures: Sequence[Path],
    models: Sequence[SessionOptions],
    *,
    ahead: int = 10,
    spacing: int = 5,
    options: CaptureOptions | None = None,
    progress: ViewProgress | None = None,
) -> ViewScores:
    """Predict later frames of captures with mean colour, warp-and-fill, the classical model and other models.

    Args:
        captures: Captures with or without ground truth.
        models: Options of the other models' sessions; each capture gets new ones.
        ahead: How many frames after the last known one the predicted frame is.
        spacing: Predict every n-th frame.
        options: How captures are read.
        progress: Called after each frame.

    Raises:
        OptionError: `ahead` or `spacing` is less than 1, or two models have one name.
        ModelError: Weights are missing or do not fit.
        CaptureError: A capture cannot be read or is too short.
    """
    if ahead < 1 or spacing < 1:
        raise OptionError(f"ahead and spacing must be at least 1 frame, got {ahead} and {spacing}")
    names = [model.model for model in models]
    if len(set(names)) != len(names) or REFERENCE in names:
        raise OptionError(f"models need different names, and {REFERENCE} is always scored; got {names}")
    graphs = [choose_graphs(model) for model in models]
    scores: list[ViewScore] = []
    for path in captures:
        reference = Session(SessionOptions(model=REFERENCE, height=HEIGHT))
        estimators: list[Estimator] = [MeanColour(HEIGHT), WarpAndFill(HEIGHT)]
        estimators += [LaterPoint(model, graph) for model, graph in zip(models, graphs, strict=True)]
        capture = open_capture(path, options or CaptureOptions())
        capture_scores = _score_capture(capture, reference, estimators, (ahead, spacing), progress)
        if not capture_scores:
            raise CaptureError(f"{path}: predicting a view needs more than {ahead} usable frames")
        scores += capture_scores
    return ViewScores(ahead, tuple(scores))


def _score_capture(
    capture: Capture,
    reference: Session,
    estimators: Sequence[Estimator],
    steps: tuple[int, int],
    progress: ViewProgress | None,
) -> list[ViewScore]:
    ahead, spacing = steps
    name = capture.path.resolve().name
    waiting: list[Frame] = []
    scores: list[ViewScore] = []
    for count, frame in enumerate(capture, 1):
        waiting.append(frame)
        if len(waiting) > ahead:
            known = waiting.pop(0)
            reference.push(known)
            for estimator in estimators:
                estimator.push(known)
            if (count - ahead - 1) % spacing == 0:
                scores += _score_view(name, frame, reference, estimators)
        if progress is not None:
            progress(name, count, capture.frame_count - len(capture.skipped))
    return scores


def _score_view(name: str, frame: Frame, reference: Session, estimators: Sequence[Estimator]) -> list[ViewScore]:
    """Score every method at one later frame."""
    view = View.of(frame.resized(*WORKING_SIZE))
    x, y, z = (float(value) for value in frame.camera_to_world[:3, 3])
    light = reference.light_at((x, y, z))
    panoramas = {estimator.name: estimator.light_at((x, y, z)) for estimator in estimators}
    panoramas[REFERENCE] = light.reflection
    seen = light.observed >= 0.5
    scores: list[ViewScore] = []
    for region, where in zip(REGIONS, (view.shown & seen, view.shown & ~seen), strict=True):
        if where.sum() < LEAST_PIXELS:
            continue
        share = float(where.sum() / view.shown.sum())
        for method, panorama in panoramas.items():
            assert panorama is not None
            scores.append(ViewScore(name, frame.index, method, region, view.error(panorama, where), share))
    return scores


def _plain(cell: MeanWithInterval) -> dict[str, float | None]:
    return {key: None if np.isnan(value) else value for key, value in asdict(cell).items()}
