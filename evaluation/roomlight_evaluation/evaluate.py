"""Scores lighting estimates against a capture's ground-truth probes, frame by frame as they would be used
live.

One pass over each capture: every method gets each frame, then gives its panorama at every probe, which is
compared with the truth at the truth's height. Spheres are seen from the first camera, along its line to the
probe, for the whole sequence, so that what changes in them is the light.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.errors import CaptureError, ModelError
from roomlight.frame import Frame
from roomlight.images import read_panorama
from roomlight.metrics import SphereJudge, ldr_l2, log_l2, smoothness
from roomlight.spheres import SphereRenderer, resize_panorama, view_toward
from roomlight_evaluation.scores import CaptureSummary, Evaluation, Track

Progress = Callable[[str, int, int], None]
"""Called as (capture name, frames done, frames in all) after each frame."""


@runtime_checkable
class Estimator(Protocol):
    """What is evaluated: a session, a baseline, or panoramas that somebody wrote."""

    @property
    def name(self) -> str:
        """The method's name in tables."""
        ...

    def push(self, frame: Frame) -> None:
        """Take the next frame."""
        ...

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """Linear HDR panorama [h, 2h, 3] at a point (world, metres) after the frames so far."""
        ...


class Predictions:
    """Panoramas read back from files, one a probe and frame: `probe-00/000000.exr`, numbered by
    `Frame.index`.

    That is what `roomlight replay --probes-from-capture` writes, and what any other program may write to be
    scored.
    """

    name = "predictions"

    def __init__(self, folder: Path, probes: Sequence[Position]) -> None:
        """`folder` holds `probe-00`, `probe-01`, ... in the order of the capture's `probes`."""
        self._folders = {position: folder / f"probe-{number:02d}" for number, position in enumerate(probes)}
        self._file_name = ""

    def push(self, frame: Frame) -> None:
        """Turn to this frame's files; CaptureError naming the first that is missing."""
        self._file_name = f"{frame.index:06d}.exr"
        for folder in self._folders.values():
            if not (folder / self._file_name).is_file():
                raise CaptureError(
                    f"{folder / self._file_name}: this prediction is missing; every frame of the capture "
                    "needs one for each probe (use the --every and --max-frames they were made with)"
                )

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """The panorama in the current frame's file; ImageError if it does not decode."""
        return read_panorama(self._folders[position] / self._file_name)


def evaluate(
    captures: Sequence[Path],
    estimators: Callable[[], Sequence[Estimator]],
    *,
    options: CaptureOptions | None = None,
    predictions: Path | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Score fresh `estimators()` on each capture, and the panoramas in `predictions` as one more method.

    `predictions` holds `<capture name>/probe-00/...`, or `probe-00/...` directly when there is one capture.
    Raises CaptureError for a capture without ground truth, for two captures of one name, for missing
    predictions.
    """
    names = [_name(path) for path in captures]
    for name in names:
        if names.count(name) > 1:
            raise CaptureError(f"two captures are called {name}: results could not be told apart, rename one")
    tracks: list[Track] = []
    summaries: list[CaptureSummary] = []
    for name, path in zip(names, captures, strict=True):
        capture = open_capture(path, options or CaptureOptions())
        methods = list(estimators())
        if predictions is not None:
            folder = _prediction_folder(predictions, name, alone=len(captures) == 1)
            methods.append(Predictions(folder, [probe.position for probe in capture.probes]))
        summary, scored = evaluate_capture(capture, methods, name=name, progress=progress)
        summaries.append(summary)
        tracks.extend(scored)
    return Evaluation(tuple(summaries), tuple(tracks))


def evaluate_predictions(
    capture: Path,
    directory: Path,
    *,
    options: CaptureOptions | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Score only the panoramas in `directory` (see `evaluate`) against the capture's truth."""
    return evaluate([capture], lambda: [], options=options, predictions=directory, progress=progress)


def evaluate_capture(
    capture: Capture, methods: Sequence[Estimator], *, name: str, progress: Progress | None = None
) -> tuple[CaptureSummary, list[Track]]:
    """Score methods on one open capture; `name` labels the results."""
    titles = [method.name for method in methods]
    if len(set(titles)) != len(titles):
        raise ValueError(f"methods need different names to be told apart, these are {titles}")
    probes = [
        (number, probe.position, probe.panorama())
        for number, probe in enumerate(capture.probes)
        if probe.panorama_path is not None
    ]
    if not probes:
        raise CaptureError(
            f"{capture.path}: there is no ground truth to compare with; eval needs probes with panoramas "
            "(probes: [{position, file_path}] in transforms.json)"
        )
    scorers: list[_Scorer] = []
    indices: list[int] = []
    for frame in capture:
        if not scorers:
            spheres = {
                position: SphereRenderer(view_toward(frame.camera_to_world, position)) for _, position, _ in probes
            }
            scorers = [
                _Scorer(method.name, number, position, truth, SphereJudge(truth, spheres[position]))
                for number, position, truth in probes
                for method in methods
            ]
        for method in methods:
            method.push(frame)
            for scorer in scorers:
                if scorer.method == method.name:
                    scorer.score(method.light_at(scorer.position), frame)
        indices.append(frame.index)
        if progress is not None:
            progress(name, len(indices), capture.frame_count - len(capture.skipped))
    summary = CaptureSummary(
        name=name,
        path=str(capture.path),
        frames=len(indices),
        skipped=len(capture.skipped),
        probes=len(probes),
    )
    return summary, [scorer.track(name, indices) for scorer in scorers]


class _Scorer:
    """Collects the scores of one method at one probe."""

    def __init__(
        self,
        method: str,
        probe: int,
        position: Position,
        truth: Float[np.ndarray, "h w 3"],
        judge: SphereJudge,
    ) -> None:
        self.method = method
        self.position = position
        self._probe = probe
        self._truth = truth
        self._judge = judge
        self._previous: Float[np.ndarray, "h w 3"] | None = None
        self._scores: dict[str, list[float]] = {}

    def score(self, panorama: Float[np.ndarray, "h w 3"], frame: Frame) -> None:
        if panorama.shape[1] != 2 * panorama.shape[0] or not np.isfinite(panorama).all():
            raise ModelError(
                f"{self.method}: what it gave at {self.position} after frame {frame.index} is no panorama "
                f"(shape {panorama.shape}; it must be [h, 2h, 3] and finite)"
            )
        current = resize_panorama(panorama, len(self._truth))
        scores = {"log_l2": log_l2(current, self._truth), "ldr_l2": ldr_l2(current, self._truth)}
        if self._previous is not None:
            scores["smoothness"] = smoothness(current, self._previous)
        scores.update(self._judge.scores(current))
        self._previous = current
        for key, value in scores.items():
            self._scores.setdefault(key, []).append(value)

    def track(self, capture: str, indices: Sequence[int]) -> Track:
        scores = {"smoothness": (), **{key: tuple(values) for key, values in self._scores.items()}}
        return Track(capture, self._probe, self.method, tuple(indices), scores)


def _name(path: Path) -> str:
    resolved = path.resolve()
    return resolved.stem if resolved.is_file() else resolved.name


def _prediction_folder(directory: Path, name: str, *, alone: bool) -> Path:
    candidates: Iterator[Path] = iter([directory / name, *([directory] if alone else [])])
    for folder in candidates:
        if (folder / "probe-00").is_dir():
            return folder
    looked = f"{directory / name / 'probe-00'}" + (f" or {directory / 'probe-00'}" if alone else "")
    raise CaptureError(f"{directory}: no predictions for the capture {name}: there is no folder {looked}")
