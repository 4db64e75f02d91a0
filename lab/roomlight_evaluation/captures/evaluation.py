"""Score estimators on captures, frame by frame, as a live application would use them.

One pass over each capture: every estimator gets each frame, then gives its panorama at every ground-truth probe, which
is resized to the truth's height and compared. Spheres are seen from the first camera, along its line to the probe, for
the whole sequence: what changes in them is the light.
"""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.dataset.recording import room_of
from roomlight.dataset.sequence_files import FACTS
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError, ModelError, OptionError
from roomlight.frame import Frame
from roomlight.metrics import METRICS, SphereScorer, energy_ratio, ldr_l2, log_l2
from roomlight.spheres import SphereRenderer, resize_panorama, view_toward
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator, PredictionFolder, beside_classical
from roomlight_evaluation.captures.scores import CaptureScores, CaptureSummary, Track

ProgressCallback = Callable[[str, int, int], None]
"""Called as (capture name, frames done, frames in all) after each frame."""


def evaluate_engine(
    captures: Sequence[Path],
    session: SessionOptions,
    *,
    predictions: Path | None = None,
    options: CaptureOptions | None = None,
    progress: ProgressCallback | None = None,
) -> CaptureScores:
    """Score the engine beside the classical model and the two baselines, mean colour and warp-and-fill.

    Args:
        session: Options of the engine's sessions; each capture gets a new session.
        predictions: As in `evaluate_captures`.

    Raises:
        ModelError: The weights that `session` names are missing or do not fit.
        CaptureError: As `evaluate_captures`.
        ImageError: A prediction does not decode.
    """
    models = beside_classical(session)

    def estimators() -> list[Estimator]:
        return [MeanColour(), WarpAndFill(), *(EngineEstimator(*model) for model in models)]

    return evaluate_captures(captures, estimators, predictions=predictions, options=options, progress=progress)


def evaluate_captures(
    captures: Sequence[Path],
    estimators: Callable[[], Sequence[Estimator]],
    *,
    predictions: Path | None = None,
    options: CaptureOptions | None = None,
    progress: ProgressCallback | None = None,
) -> CaptureScores:
    """Score any estimators on captures.

    Args:
        estimators: Returns new estimators; called once for each capture.
        predictions: A folder of panoramas to score as one more method, last: `<capture name>/probe-00/...`, or
            `probe-00/...` directly if there is one capture; see `PredictionFolder`.
        options: How captures are read; predictions must have been made with its `every` and `max_frames`.

    Raises:
        CaptureError: A capture cannot be read or has no ground truth, two captures have one name, or predictions are
            missing, or a replay's that light scenes.
        OptionError: Two estimators have one name.
        ModelError: An estimator returned something else than a finite panorama without negative values.
    """
    names = capture_names(captures)
    for path in captures:
        capture_room(path)  # an error there is told before minutes of work
    tracks: list[Track] = []
    summaries: list[CaptureSummary] = []
    for name, path in zip(names, captures, strict=True):
        capture = open_capture(path, options or CaptureOptions())
        methods = list(estimators())
        if predictions is not None:
            folder = _prediction_folder(predictions, name, only_capture=len(captures) == 1)
            methods.append(PredictionFolder(folder, [probe.position for probe in capture.probes]))
        summary, scored = evaluate_capture(capture, methods, name=name, progress=progress)
        summaries.append(summary)
        tracks.extend(scored)
    return CaptureScores(tuple(summaries), tuple(tracks))


def capture_names(captures: Sequence[Path]) -> list[str]:
    """Return the names of captures in results: of their folders, or of their files without ending.

    Raises:
        CaptureError: Two have one name.
    """
    names = [path.stem if path.is_file() else path.name for path in map(Path.resolve, captures)]
    for name in names:
        if names.count(name) > 1:
            raise CaptureError(f"two captures are called {name}: their results would be mixed up; rename one")
    return names


def evaluate_capture(
    capture: Capture, estimators: Sequence[Estimator], *, name: str, progress: ProgressCallback | None = None
) -> tuple[CaptureSummary, list[Track]]:
    """Score estimators on one open capture; `name` labels the results.

    Raises:
        CaptureError: The capture has no ground truth, or its `facts.json` is not JSON.
        OptionError: Two estimators have one name.
        ModelError: An estimator returned something else than a finite panorama.
    """
    titles = [estimator.name for estimator in estimators]
    if len(set(titles)) != len(titles):
        raise OptionError(f"estimators need different names, got {titles}")
    probes = [
        (number, probe.position, probe.panorama())
        for number, probe in enumerate(capture.probes)
        if probe.panorama_path is not None
    ]
    if not probes:
        raise CaptureError(
            f"{capture.path}: there is no ground truth to compare with; an evaluation needs probes with panoramas "
            "(probes: [{position, file_path}] in transforms.json)"
        )
    room, total = capture_room(capture.path), capture.frame_count - len(capture.skipped)

    def show(done: int) -> None:
        if progress is not None:
            progress(name, done, total)

    indices, tracks = score_frames(name, capture, probes, estimators, progress=show)
    summary = CaptureSummary(
        name=name,
        path=str(capture.path),
        frames=len(indices),
        skipped=len(capture.skipped),
        probes=len(probes),
        room=room,
    )
    return summary, tracks


def capture_room(path: Path) -> str | None:
    """Return the room that a capture's `facts.json` states, as those of datasets do; None without one.

    Raises:
        CaptureError: The file is not JSON.
    """
    facts = path / FACTS
    try:
        return room_of(json.loads(facts.read_bytes()))
    except OSError:
        return None
    except ValueError as error:
        raise CaptureError(f'{facts}: is not JSON ({error}); it states the room: {{"room": "attic"}}') from error


def score_frames(
    name: str,
    frames: Iterable[Frame],
    probes: Sequence[tuple[int, Position, Float[np.ndarray, "h w 3"]]],
    estimators: Sequence[Estimator],
    *,
    progress: Callable[[int], None] | None = None,
) -> tuple[list[int], list[Track]]:
    """Give each frame to every estimator, then score its light at every probe (number, world position, truth).

    Returns:
        The indices of the frames, and the tracks, which are labelled with `name`.

    Raises:
        ModelError: An estimator returned something else than a finite panorama.
    """
    scorers: list[_ProbeScorer] = []
    indices: list[int] = []
    for frame in frames:
        if not scorers:
            spheres = {
                position: SphereRenderer(view_toward(frame.camera_to_world, position)) for _, position, _ in probes
            }
            scorers = [
                _ProbeScorer(estimator.name, number, position, truth, SphereScorer(truth, spheres[position]))
                for number, position, truth in probes
                for estimator in estimators
            ]
        for estimator in estimators:
            estimator.push(frame)
            for scorer in scorers:
                if scorer.method == estimator.name:
                    scorer.add(estimator.light_at(scorer.position), frame)
        indices.append(frame.index)
        if progress is not None:
            progress(len(indices))
    return indices, [scorer.track(name, indices) for scorer in scorers]


class _ProbeScorer:
    """Collects the scores of one method at one probe."""

    def __init__(
        self,
        method: str,
        probe: int,
        position: Position,
        truth: Float[np.ndarray, "h w 3"],
        judge: SphereScorer,
    ) -> None:
        self.method = method
        self.position = position
        self._probe = probe
        self._truth = truth
        self._judge = judge
        self._previous: Float[np.ndarray, "h w 3"] | None = None
        self._scores: dict[str, list[float]] = {metric.key: [] for metric in METRICS}

    def add(self, panorama: Float[np.ndarray, "h w 3"] | None, frame: Frame) -> None:
        """Score the panorama after one frame; None scores NaN. Raises ModelError if it is not a panorama."""
        current, scores = None, dict[str, float]()
        if panorama is not None:
            height, least = len(panorama), np.min(panorama, initial=math.inf)
            fits = panorama.shape == (height, 2 * height, 3) and 0 <= least < math.inf
            if not fits or not np.isfinite(panorama).all():
                raise ModelError(
                    f"{self.method}: returned an invalid panorama at {self.position} after frame {frame.index} (shape "
                    f"{panorama.shape}, least value {least:.4g}; it must be [h, 2h, 3], finite and not negative)"
                )
            current = resize_panorama(panorama, len(self._truth))
            scores = {"log_l2": log_l2(current, self._truth), "ldr_l2": ldr_l2(current, self._truth)}
            if self._previous is not None:
                scores["smoothness"] = log_l2(current, self._previous)  # the paper's Lsm
            scores.update(self._judge.scores(current))
            scores["energy"] = energy_ratio(current, self._truth)
        self._previous = current
        for key, values in self._scores.items():
            values.append(scores.get(key, math.nan))

    def track(self, capture: str, indices: Sequence[int]) -> Track:
        """Return all scores; `indices` are those of the frames scored."""
        scores = {key: tuple(values) for key, values in self._scores.items()}
        scores["smoothness"] = scores["smoothness"][1:]  # none is before the first frame
        return Track(capture, self._probe, self.method, tuple(indices), scores)


def _prediction_folder(folder: Path, name: str, *, only_capture: bool) -> Path:
    """Find the predictions of one capture. Raises CaptureError."""
    candidates = [folder / name, *([folder] if only_capture else [])]
    for candidate in candidates:
        if (candidate / "probe-00").is_dir():
            _check_use(candidate / "replay.json")
            return candidate
    expected = " or ".join(str(candidate / "probe-00") for candidate in candidates)
    raise CaptureError(f"{folder}: no predictions for the capture {name}: there is no folder {expected}")


def _check_use(intent: Path) -> None:
    """Refuse a replay's panoramas that light scenes: their sums are right, their single directions are not."""
    try:
        use = json.loads(intent.read_text())["options"]["use"]
    except (OSError, ValueError, LookupError, TypeError):
        return  # not a replay's, but those of another program
    if use != "reflection":
        raise CaptureError(
            f"{intent.parent}: its panoramas have the use `lighting`, but scores are of single directions; replay with "
            "--use reflection"
        )
