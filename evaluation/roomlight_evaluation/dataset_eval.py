"""Scores ways of lighting from a single image on a dataset's rooms: first frames only, each with its three probes.

Every method gets a frame as a client would send it (8-bit colour, raw depth with its holes) and gives panoramas of 120
rows, which are held against the truth: log-L2 and the paper's rendering loss. Networks run as users run them, exported,
in the engine. Depth is exact, or such as a phone measures; a sequence's phone is drawn by its name, so that every
method and every run meets the same.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.baselines import MeanColour, WarpAndFill
from roomlight.conventions import Position, srgb8_to_linear
from roomlight.dataset.arkit_depth import arkit_like
from roomlight.dataset.recording import Recording
from roomlight.engine.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.engine.sglv import render_panorama
from roomlight.errors import DatasetError, FrameError, ModelError
from roomlight.frame import CLIPPED_SRGB8, Frame
from roomlight.metrics import log_l2
from roomlight.spheres import SphereRenderer, resize_panorama, view_toward
from roomlight_evaluation.dataset_scores import DatasetScores, SequenceScores

DepthKind = Literal["exact", "arkit"]
DEPTHS: Final[tuple[DepthKind, ...]] = get_args(DepthKind)
HEIGHT: Final = 120
ALONE: Final = "SGLV alone"
FULL: Final = "full"

Panorama = Float[np.ndarray, "h w 3"]


@runtime_checkable
class Sequences(Protocol):
    """A dataset, or what looks like one."""

    @property
    def folder(self) -> object:
        """What messages and results call it."""
        ...

    def __len__(self) -> int:
        """How many sequences."""
        ...

    def read(self, number: int, /, *, frames: list[int]) -> Recording:
        """One, with these frames decoded and all its probes."""
        ...


@runtime_checkable
class Method(Protocol):
    """One way of lighting, or several that share their work."""

    @property
    def names(self) -> tuple[str, ...]:
        """What its panoramas are called in tables."""
        ...

    def light(self, frame: Frame, positions: Sequence[Position]) -> Mapping[str, Sequence[Panorama]]:
        """Panoramas at the positions by name, from this frame alone. FrameError where it cannot be used."""
        ...


@dataclass(frozen=True)
class Baseline:
    """Mean colour or warp-and-fill."""

    make: type[MeanColour] | type[WarpAndFill]

    @property
    def names(self) -> tuple[str, ...]:
        """Its own."""
        return (self.make.name,)

    def light(self, frame: Frame, positions: Sequence[Position]) -> Mapping[str, Sequence[Panorama]]:
        """From this frame alone."""
        method = self.make(HEIGHT)
        method.push(frame)
        return {method.name: [method.light_at(position) for position in positions]}


@dataclass(frozen=True)
class Engine:
    """A session on its own graphs, or the classical one; `alone` also gives the volume before blending."""

    name: str
    options: SessionOptions
    graphs: LightingGraphs | None
    alone: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The unblended volume's first."""
        return (self.name,) if self.alone is None else (self.alone, self.name)

    def light(self, frame: Frame, positions: Sequence[Position]) -> Mapping[str, Sequence[Panorama]]:
        """From this frame alone, in a session of its own."""
        session = Session(self.options, graphs=self.graphs)
        session.push(frame)
        lights = {self.name: [session.light_at(position).panorama for position in positions]}
        if self.alone is not None:
            assert session.sglv is not None
            lights[self.alone] = [render_panorama(session.sglv, at, height=HEIGHT)[0] for at in positions]
        return lights


@dataclass(frozen=True)
class Shown:
    """One sequence's first probe under every method, for the picture."""

    name: str
    room_type: str
    image: Float[np.ndarray, "ih iw 3"]
    view: tuple[float, float, float]
    panoramas: Mapping[str, Panorama]
    """By column: truth first, then the methods."""


def evaluate_dataset(
    dataset: Sequences,
    methods: Sequence[Method],
    *,
    depths: Sequence[DepthKind] = DEPTHS,
    limit: int | None = None,
    show: int = 0,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[DatasetScores, list[Shown]]:
    """Scores of every method on all of a dataset's sequences or `limit` of them, and `show` of those to draw.

    DatasetError for a dataset without sequences or a damaged one; ValueError for two methods of one name.
    """
    names = [name for method in methods for name in method.names]
    if len(set(names)) != len(names):
        raise ValueError(f"methods need different names to be told apart, these are {names}")
    if len(dataset) == 0:
        raise DatasetError(f"{dataset.folder}: has no finished sequence of this split; generate some first")
    numbers = _spread(len(dataset), limit)
    drawn = {numbers[k] for k in _spread(len(numbers), show)} if show else set[int]()
    scored: list[SequenceScores] = []
    skipped: list[str] = []
    pictures: list[Shown] = []
    for done, number in enumerate(numbers):
        recording = dataset.read(number, frames=[0])
        try:
            scores, shown = _score(recording, methods, depths, draw=number in drawn)
            scored.append(scores)
            pictures += shown
        except FrameError as error:
            skipped.append(f"{recording.name}: {error}")
        if progress is not None:
            progress(done + 1, len(numbers))
    if not scored:
        raise DatasetError(f"{dataset.folder}: no sequence could be used; the first: {skipped[0]}")
    return DatasetScores(str(dataset.folder), tuple(scored), tuple(skipped)), pictures


def first_frame(recording: Recording, depth: DepthKind) -> Frame:
    """The first decoded frame as a client would send it."""
    colour, depth_mm = recording.colour[0], recording.depth_mm[0]
    if depth == "arkit":
        rng = np.random.default_rng([0, *recording.name.encode()])
        told, _ = arkit_like(recording.depth_mm[:1], recording.surface[:1], recording.colour[:1], rng)
        depth_mm = told[0]
    return Frame(
        index=0,
        image=srgb8_to_linear(colour),
        clipped=(colour >= CLIPPED_SRGB8).any(-1),
        depth_m=depth_mm.astype(np.float32) / np.float32(1000),
        intrinsics=recording.intrinsics,
        camera_to_world=recording.camera_to_world[0],
        source=recording.name,
    )


def _score(
    recording: Recording, methods: Sequence[Method], depths: Sequence[DepthKind], *, draw: bool
) -> tuple[SequenceScores, list[Shown]]:
    positions = [(float(x), float(y), float(z)) for x, y, z in recording.probe_positions]
    truths = list(recording.probe_panoramas.astype(np.float32) * np.float32(recording.exposure[0]))
    views = [view_toward(recording.camera_to_world[0], position) for position in positions]
    renderers = [SphereRenderer(view) for view in views]
    true_spheres = [np.clip(of.pixels(truth, "glossy"), 0, 1) for of, truth in zip(renderers, truths, strict=True)]
    values: dict[str, dict[str, tuple[float, float]]] = {}
    columns: dict[str, Panorama] = {"truth": truths[0]}
    first = first_frame(recording, depths[0])
    for depth in depths:
        frame = first_frame(recording, depth)
        for name, given in _lights(methods, frame, positions):
            panoramas = [resize_panorama(panorama, len(truth)) for panorama, truth in zip(given, truths, strict=True)]
            errors = [
                (
                    log_l2(panorama, truth),
                    float(np.mean((np.clip(renderer.pixels(panorama, "glossy"), 0, 1) - true_sphere) ** 2)),
                )
                for panorama, truth, renderer, true_sphere in zip(
                    panoramas, truths, renderers, true_spheres, strict=True
                )
            ]
            log, rendering = np.mean(errors, axis=0).tolist()
            values.setdefault(name, {})[depth] = (log, rendering)
            if depth == depths[0]:
                columns[name] = panoramas[0]
    facts = recording.facts
    room = f"{facts.get('split', '')}/{facts.get('seed', '')}/{facts['room']}" if "room" in facts else recording.name
    kind = str(facts.get("room_type", "room"))
    shown = [Shown(recording.name, kind, first.image, views[0], columns)] if draw else []
    return SequenceScores(recording.name, room, kind, values), shown


def _lights(
    methods: Sequence[Method], frame: Frame, positions: Sequence[Position]
) -> Iterator[tuple[str, Sequence[Panorama]]]:
    for method in methods:
        lights = method.light(frame, positions)
        for name in method.names:
            for panorama in lights[name]:
                if panorama.shape != (HEIGHT, 2 * HEIGHT, 3) or not np.isfinite(panorama).all():
                    raise ModelError(f"{name}: what it gave for {frame.source} is no panorama of finite radiance")
            yield name, lights[name]


def _spread(count: int, wanted: int | None) -> list[int]:
    """`wanted` of `count` places, evenly, or all."""
    if wanted is None or wanted >= count:
        return list(range(count))
    return [at * count // wanted for at in range(wanted)]
