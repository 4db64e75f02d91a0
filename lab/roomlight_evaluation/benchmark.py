"""A benchmark that anybody can run: spheres in the light of generated test rooms, after one image and after a walk.

Rooms come from a seed (`benchmark_options`): one walk of 31 frames and three probes each, of the split that no network
was trained on. Scored are mirror, matte silver and diffuse spheres (LeGendre et al. 2019), seen from the first camera:
RMSE, scale-invariant RMSE and angular error of their pixels, in linear radiance (units of the first frame's white) and
`tone_mapped` as StyleLight and DiffusionLight score them, on data of their own: the mirror is theirs, which reflects
0.8; their silver (0.8, roughness 0.33) and diffuse sphere (0.8, with a glossy coat) are other materials than ours. A
room's figure is the mean over its probes; intervals are over rooms. Models give the mirror their reflection and the
other spheres their lighting (`roomlight.light.sources.LightUse`).
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from rich.table import Table

from roomlight.dataset.loader import Dataset, DepthKind
from roomlight.dataset.recording import Recording
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import DatasetError, FrameError
from roomlight.imaging.tables import figure_table
from roomlight.metrics import SPHERES, SphereScorer
from roomlight.spheres import Material, SphereRenderer, view_toward
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.estimators import beside_classical
from roomlight_evaluation.confidence import MeanWithInterval, mean_cell, mean_with_interval
from roomlight_evaluation.walks import walk_frames
from roomlight_generator.generate import GenerateOptions

_ERRORS: Final = {"rmse": "RMSE", "si_rmse": "scale-invariant RMSE", "angular_deg": "angular error (deg)"}
ERRORS: Final = _ERRORS | {f"toned_{key}": f"tone-mapped: {name}" for key, name in _ERRORS.items()}
"""Kinds of error and their headings."""
_GAMMA: Final = 2.4
_MEDIAN: Final = 0.5
_MIRROR: Final = 0.8
"""What the mirror of tone-mapped scores reflects."""
SINGLE_IMAGE: Final = "one image"
Panorama = Float[np.ndarray, "h w 3"]
_Sessions = Sequence[tuple[SessionOptions, LightingGraphs | None]]


@dataclass(frozen=True)
class BenchmarkScores:
    """Errors by (method, moment) and then by sphere's error (`rmse_mirror` and so on), a value for each of `rooms`."""

    rooms: tuple[str, ...]
    errors: dict[tuple[str, str], dict[str, list[float]]]

    def mean(self, method: str, moment: str, error: str) -> MeanWithInterval:
        """Return the mean over rooms, with its 95 % bootstrap interval."""
        return mean_with_interval(self.errors[method, moment][error])

    def tables(self, *, title: str) -> list[Table]:
        """Return a table for each kind of error: methods and moments as rows, spheres as columns."""
        return [
            figure_table(
                f"{name}; {title}, rooms: {len(self.rooms)}",
                SPHERES,
                (
                    [
                        f"{method}, {moment}",
                        *(mean_cell(self.mean(method, moment, f"{key}_{ball}")) for ball in SPHERES),
                    ]
                    for method, moment in self.errors
                ),
                caption="mean over rooms (95 % bootstrap interval)",
            )
            for key, name in ERRORS.items()
        ]

    def to_json(self) -> dict[str, Any]:
        """Return every room's errors as plain JSON values."""
        rows = [
            {"method": method, "moment": moment, "errors": errors} for (method, moment), errors in self.errors.items()
        ]
        return {"rooms": self.rooms, "scores": rows}


def benchmark_options(*, rooms: int, seed: int) -> GenerateOptions:
    """Return what is generated: test rooms of a seed, with a walk in each; fewer rooms are the first of more."""
    return GenerateOptions(sequences=rooms, seed=seed, split="test", shard_size=1, sequences_per_room=1)


def tone_mapped(panorama: Panorama) -> Panorama:
    """Return a panorama as the evaluation of StyleLight (ECCV 2022) and DiffusionLight (CVPR 2024) lights spheres.

    The power 1 / 2.4 of radiance, scaled to a median of 0.5 over what is not black, not clipped: estimate and truth
    each by a scale of their own.
    """
    powers = np.maximum(panorama, 0) ** (1 / _GAMMA)
    lit = powers[powers > 0]
    return powers * (_MEDIAN / np.median(lit)) if lit.size else powers


def rooms_digest(folder: Path, rooms: int) -> str:
    """Return the SHA-256 of the files of a dataset's first rooms: equal where the benchmark is the same."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.tar"))[:rooms]:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def evaluate_benchmark(
    walks: Dataset,
    options: SessionOptions,
    *,
    rooms: int,
    depth: DepthKind = "exact",
    progress: Callable[[int, int], object] | None = None,
) -> BenchmarkScores:
    """Score the model of `options`, the classical one and two baselines.

    Args:
        walks: One of each room.
        rooms: Score so many, the first ones.
        depth: As it is, or as a phone measures it.
        progress: Called as (rooms done, rooms in all) after each room.

    Raises:
        DatasetError: A walk cannot be used, or there are too few.
        ModelError: The weights are missing, damaged or untrained.
    """
    if len(walks) < rooms:
        raise DatasetError(f"{walks.folder}: has {len(walks)} walks, not {rooms}; generate more")
    sessions = beside_classical(options)
    names: list[str] = []
    errors: dict[tuple[str, str], dict[str, list[float]]] = {}
    for number in range(rooms):
        recording = walks[number]
        names.append(recording.name)
        try:
            scored = _score(recording, sessions, depth)
        except FrameError as error:
            raise DatasetError(f"{walks.folder} {recording.name}: cannot begin a stream: {error}") from error
        for key, values in scored.items():
            for name, value in values.items():
                errors.setdefault(key, {}).setdefault(name, []).append(value)
        if progress is not None:
            progress(number + 1, rooms)
    return BenchmarkScores(tuple(names), errors)


def _score(recording: Recording, sessions: _Sessions, depth: DepthKind) -> dict[tuple[str, str], dict[str, float]]:
    """Return the errors of each method and moment, as means over the probes."""
    truths = recording.truths()
    positions = [position for position, _ in truths]
    baselines, models = (MeanColour(), WarpAndFill()), [Session(model, graphs=graphs) for model, graphs in sessions]
    for model in models:
        for position in positions:
            model.track(position)
    judges: list[_Judge] = []
    scored: dict[tuple[str, str], dict[str, float]] = {}
    count = len(recording.colour)
    for number, frame in enumerate(walk_frames(recording, depth), 1):
        if not judges:
            views = [SphereRenderer(view_toward(frame.camera_to_world, position)) for position in positions]
            judges = [_Judge(truth, view) for (_, truth), view in zip(truths, views, strict=True)]
        for estimator in (*baselines, *models):
            estimator.push(frame)
        if number not in (1, count):
            continue
        moment = SINGLE_IMAGE if number == 1 else f"{count} frames"
        for baseline in baselines:
            lights = [baseline.light_at(position) for position in positions]
            scored[baseline.name, moment] = _errors(judges, lights, lights)
        for model in models:
            lights = model.lights()
            scored[model.model, moment] = _errors(
                judges, [light.panorama for light in lights], [light.reflection for light in lights]
            )
    return scored


class _Judge:
    """Errors of a probe's spheres, in linear and in tone-mapped light."""

    def __init__(self, truth: Panorama, view: SphereRenderer) -> None:
        self._linear, self._toned = SphereScorer(truth, view), SphereScorer(tone_mapped(truth), view)

    def errors(self, prediction: Panorama, sphere: Material) -> dict[str, float]:
        errors, toned = self._linear.errors(prediction, sphere), self._toned.errors(tone_mapped(prediction), sphere)
        # theirs sums squares over the channels and divides by the pixels
        error = np.sqrt(3.0) * (_MIRROR if sphere == "mirror" else 1.0)
        scale = {"rmse": error, "si_rmse": error, "angular_deg": 1.0}
        return errors | {f"toned_{key}": value * scale[key] for key, value in toned.items()}


def _errors(judges: Sequence[_Judge], lit: Iterable[Panorama], mirrored: Iterable[Panorama]) -> dict[str, float]:
    of_probes = [
        {
            f"{key}_{sphere}": value
            for sphere in SPHERES
            for key, value in judge.errors(reflection if sphere == "mirror" else lighting, sphere).items()
        }
        for judge, lighting, reflection in zip(judges, lit, mirrored, strict=True)
    ]
    return {key: float(np.mean([errors[key] for errors in of_probes])) for key in of_probes[0]}
