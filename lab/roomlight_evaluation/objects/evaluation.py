"""Score the light of objects after a few frames, at the ground-truth probes of many rooms, against simpler lights.

A room is a walk of a dataset or a capture with ground truth. All methods see the same frames. Errors are those of
`lit_objects`, as means over a room's probes; ratios to `HARMONICS` have 95 % bootstrap intervals over rooms.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.dataset.folder import MANIFEST
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import CaptureError, FrameError
from roomlight.frame import Frame
from roomlight.spheres import resize_panorama, view_toward
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.estimators import beside_classical
from roomlight_evaluation.captures.evaluation import capture_names, capture_room
from roomlight_evaluation.composites.methods import HARMONICS, WARPED, harmonics_and_directional
from roomlight_evaluation.confidence import MeanWithInterval, evenly_spread, mean_with_interval, ratio_of_means
from roomlight_evaluation.objects.lit_objects import LOOKS, MEASURES, SHADOW, LitObjects, unseen_look

COMPOSITED: Final = "as composited"
"""Appended to a model's name: in the light that the compositor gives to objects, mirrors and shadows."""

TRUTH: Final = "truth"

Panorama = Float[np.ndarray, "h w 3"]
Truth = tuple[Position, Panorama]


@dataclass(frozen=True)
class RoomObjects:
    """One capture's or walk's errors and its unseen directions, by method: means over its probes.

    Recordings of one room have the same `of_room`; None: no other is of this one's.
    """

    room: str
    probes: int
    errors: Mapping[str, Mapping[str, float]]
    unseen: Mapping[str, Mapping[str, float]]
    of_room: str | None = None


@dataclass(frozen=True)
class ObjectScores:
    """All rooms of an evaluation."""

    rooms: tuple[RoomObjects, ...]

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods, in the order of tables."""
        return tuple(self.rooms[0].errors)

    def mean(self, method: str, look: str) -> MeanWithInterval:
        """Return the mean error over rooms."""
        return mean_with_interval((room.errors[method][look] for room in self.rooms), self._groups)

    def ratio(self, method: str, look: str) -> MeanWithInterval:
        """Return the mean error relative to that of `HARMONICS`."""
        above, below = ([room.errors[name][look] for room in self.rooms] for name in (method, HARMONICS))
        return ratio_of_means(above, below, self._groups)

    def unseen(self, method: str, measure: str) -> MeanWithInterval:
        """Return the mean of a measure of unseen directions over rooms; `method` may be `TRUTH`."""
        return mean_with_interval((room.unseen[method][measure] for room in self.rooms), self._groups)

    def worst(self, method: str, look: str) -> float:
        """Return the greatest of the rooms' errors relative to that of `HARMONICS`."""
        return max(room.errors[method][look] / room.errors[HARMONICS][look] for room in self.rooms)

    @property
    def _groups(self) -> list[str]:
        return [room.of_room or room.room for room in self.rooms]

    def to_json(self) -> list[dict[str, Any]]:
        """Return every room's errors as plain JSON values."""
        return [asdict(room) for room in self.rooms]


def evaluate_objects(
    sources: Sequence[Path],
    options: SessionOptions,
    *,
    reading: CaptureOptions | None = None,
    frames: int = 6,
    split: Split = "test",
    limit: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> ObjectScores:
    """Score objects in the light of `options.model` and of the classical one beside simpler lights.

    Args:
        sources: Captures with ground truth, and dataset folders.
        reading: How captures are read.
        frames: How many of a recording's frames are shown, evenly spread.
        limit: Use this many walks of each dataset, evenly spread; None uses all.
        progress: Called as (room, rooms done, rooms in all) before each room.

    Raises:
        CaptureError: A capture has no ground truth, no frame can be used, or no walk has a probe; two sources have one
            name.
        DatasetError: A dataset is damaged.
        ModelError: The weights are missing, damaged or untrained.
    """
    sessions = beside_classical(options)
    named = zip(capture_names(sources), sources, strict=True)
    rooms = [room for name, source in named for room in _rooms(name, source, reading, split, frames, limit)]
    scored: list[RoomObjects] = []
    for done, (name, read) in enumerate(rooms):
        if progress is not None:
            progress(name, done, len(rooms))
        room_frames, truths, of_room = read()
        if not truths:  # single views, made for depth
            continue
        try:
            scored.append(replace(_score(name, room_frames, truths, sessions), of_room=of_room))
        except FrameError as error:
            raise CaptureError(f"{name}: its first frame cannot begin a stream: {error}") from error
    if not scored:
        what = f"give captures with ground truth, or datasets with probes in walks of the split {split} (--split)"
        raise CaptureError(f"no room to score: {what}")
    return ObjectScores(tuple(scored))


_Shown = tuple[list[Frame], list[Truth], str | None]
_Read = Callable[[], _Shown]


def _rooms(
    name: str, source: Path, reading: CaptureOptions | None, split: Split, frames: int, limit: int | None
) -> Iterable[tuple[str, _Read]]:
    if (source / MANIFEST).is_file():
        dataset = Dataset(source, split)
        for number in evenly_spread(len(dataset), limit):
            yield f"{name} {number}", lambda number=number: _of_walk(dataset, number, frames)
    else:
        yield name, lambda: _of_capture(source, frames, reading)


def _of_walk(dataset: Dataset, number: int, frames: int) -> _Shown:
    recording = dataset[number]
    chosen = _spread(len(recording.colour), frames)
    pictures = [recording.frame(number, recording.depth_mm[number]) for number in chosen]
    return pictures, recording.truths(), recording.room


def _of_capture(path: Path, frames: int, reading: CaptureOptions | None = None) -> _Shown:
    capture = open_capture(path, reading or CaptureOptions())
    truths = [(probe.position, probe.panorama()) for probe in capture.truths]
    if not truths:
        raise CaptureError(f"{path}: has no ground-truth probes; give captures that have them")
    room = capture_room(capture.path)

    def shown(readable: int) -> list[Frame]:
        chosen = set(_spread(readable, frames))
        return [frame for number, frame in enumerate(capture) if number in chosen]

    pictures = shown(capture.frame_count)
    if capture.skipped:
        pictures = shown(capture.frame_count - len(capture.skipped))
    return pictures, truths, room


def _spread(count: int, frames: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, frames).astype(int)).tolist()


def _score(
    name: str,
    frames: list[Frame],
    truths: list[Truth],
    sessions: Sequence[tuple[SessionOptions, LightingGraphs | None]],
) -> RoomObjects:
    mean, warped = MeanColour(), WarpAndFill()
    models = [Session(options, graphs=graphs) for options, graphs in sessions]
    handles = [[model.track(position) for position, _ in truths] for model in models]
    for frame in frames:
        for estimator in (mean, warped, *models):
            estimator.push(frame)
    errors: dict[str, list[dict[str, float]]] = {}
    unseen: dict[str, list[dict[str, float]]] = {}
    for number, (position, truth) in enumerate(truths):
        objects = LitObjects(truth, view_toward(frames[-1].camera_to_world, position))
        fill = warped.light_at(position)
        observed = models[0].light(handles[0][number]).observed
        lights = {
            mean.name: mean.light_at(position),
            HARMONICS: harmonics_and_directional(np.minimum(fill, 1)),
            WARPED: fill,
        }
        of_probe = {method: objects.errors(panorama) for method, panorama in lights.items()}
        for model, own in zip(models, handles, strict=True):
            light = model.light(own[number])
            lit, mirrored = objects.errors(light.panorama), objects.errors(light.reflection)
            of_probe[model.model] = mirrored
            lights[model.model] = light.reflection
            of_probe[f"{model.model}, {COMPOSITED}"] = {**lit, "mirror": mirrored["mirror"], SHADOW: mirrored[SHADOW]}
        for method, looks in of_probe.items():
            errors.setdefault(method, []).append(looks)
        for method, panorama in {**lights, TRUTH: resize_panorama(truth, len(observed))}.items():
            unseen.setdefault(method, []).append(unseen_look(panorama, observed))
    return RoomObjects(name, len(truths), _means(errors, LOOKS), _means(unseen, MEASURES))


def _means(values: Mapping[str, Sequence[Mapping[str, float]]], names: Sequence[str]) -> dict[str, dict[str, float]]:
    def mean(of_probes: Sequence[Mapping[str, float]], name: str) -> float:
        known = [probe[name] for probe in of_probes if not np.isnan(probe[name])]
        return float(np.mean(known)) if known else float("nan")

    return {method: {name: mean(of_probes, name) for name in names} for method, of_probes in values.items()}
