"""Score single-image methods on a dataset's rooms: the first frame of each sequence, at its three probes.

Every method gets the frame as a client would send it (8-bit colour, raw depth with its holes). Its panoramas of 120
rows are compared with the truth by log-L2 and the paper's rendering loss. Networks run as users run them: exported, in
the engine. Depth is exact, or degraded as a phone measures it; the degradation is seeded by the sequence's name, so
that every method and every run gets the same depth.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Final, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.dataset.arkit_depth import arkit_like
from roomlight.dataset.recording import Recording
from roomlight.errors import DatasetError, FrameError, ModelError, OptionError
from roomlight.frame import Frame
from roomlight.metrics import log_l2
from roomlight.spheres import SphereRenderer, resize_panorama, view_toward
from roomlight_evaluation.datasets.methods import HEIGHT, Method, Panorama
from roomlight_evaluation.datasets.picture import PictureRow
from roomlight_evaluation.datasets.scores import DatasetScores, SequenceScores

DepthKind = Literal["exact", "arkit"]
DEPTHS: Final[tuple[DepthKind, ...]] = get_args(DepthKind)

ProgressCallback = Callable[[int, int], object]
"""Called as (sequences done, sequences in all) after each sequence."""


@runtime_checkable
class Sequences(Protocol):
    """What is read of a dataset; `roomlight.dataset.loader.Dataset` has it."""

    @property
    def folder(self) -> object:
        """The dataset's name in messages and results."""
        ...

    def __len__(self) -> int:
        """Return the number of sequences."""
        ...

    def read(self, number: int, /, *, frames: list[int]) -> Recording:
        """Read one sequence: these frames decoded, and all its probes."""
        ...


def evaluate_dataset(
    dataset: Sequences,
    methods: Sequence[Method],
    *,
    depths: Sequence[DepthKind] = DEPTHS,
    limit: int | None = None,
    picture_rows: int = 0,
    progress: ProgressCallback | None = None,
) -> tuple[DatasetScores, list[PictureRow]]:
    """Score every method on a dataset's sequences; a sequence whose frame a method refuses is skipped and named.

    Args:
        dataset: The dataset.
        methods: What to score; see `roomlight_evaluation.datasets.methods`.
        depths: Kinds of depth to score.
        limit: Score this many sequences, spread evenly; None scores all.
        picture_rows: Return this many of the scored sequences for `dataset_picture`, spread evenly.
        progress: Called after each sequence.

    Raises:
        DatasetError: The dataset is empty or damaged, or no sequence can be used.
        OptionError: Two methods have one name.
        ModelError: A method returned something else than finite panoramas of 120 rows.
    """
    names = [name for method in methods for name in method.names]
    if len(set(names)) != len(names):
        raise OptionError(f"methods need different names, got {names}")
    if len(dataset) == 0:
        raise DatasetError(f"{dataset.folder}: has no finished sequence of this split; generate some first")
    numbers = evenly_spread(len(dataset), limit)
    in_picture = {numbers[k] for k in evenly_spread(len(numbers), picture_rows)} if picture_rows else set[int]()
    scored: list[SequenceScores] = []
    skipped: list[str] = []
    rows: list[PictureRow] = []
    for done, number in enumerate(numbers):
        recording = dataset.read(number, frames=[0])
        try:
            scores, row = _score_sequence(recording, methods, depths)
            scored.append(scores)
            if number in in_picture:
                rows.append(row)
        except FrameError as error:
            skipped.append(f"{recording.name}: {error}")
        if progress is not None:
            progress(done + 1, len(numbers))
    if not scored:
        raise DatasetError(f"{dataset.folder}: no sequence can be used; the first: {skipped[0]}")
    return DatasetScores(str(dataset.folder), tuple(scored), tuple(skipped)), rows


def first_frame(recording: Recording, depth: DepthKind) -> Frame:
    """Return the first decoded frame as a client would send it."""
    depth_mm = recording.depth_mm[0]
    if depth == "arkit":
        rng = np.random.default_rng([0, *recording.name.encode()])
        measured_mm, _ = arkit_like(recording.depth_mm[:1], recording.surface[:1], recording.colour[:1], rng)
        depth_mm = measured_mm[0]
    return recording.frame(0, depth_mm)


def _score_sequence(
    recording: Recording, methods: Sequence[Method], depths: Sequence[DepthKind]
) -> tuple[SequenceScores, PictureRow]:
    """Score every method at the sequence's probes; the picture's row shows the first probe with `depths[0]`."""
    positions = [(float(x), float(y), float(z)) for x, y, z in recording.probe_positions]
    truths = list(recording.true_panoramas())
    views = [view_toward(recording.camera_to_world[0], position) for position in positions]
    renderers = [SphereRenderer(view) for view in views]
    true_spheres = [_glossy_pixels(renderer, truth) for renderer, truth in zip(renderers, truths, strict=True)]
    values: dict[str, dict[str, tuple[float, float]]] = {}
    columns: dict[str, Panorama] = {"truth": truths[0]}
    first = first_frame(recording, depths[0])
    for depth in depths:
        frame = first_frame(recording, depth)
        for name, estimates in _checked_lights(methods, frame, positions):
            panoramas = [
                resize_panorama(estimate, len(truth)) for estimate, truth in zip(estimates, truths, strict=True)
            ]
            errors = [
                (log_l2(panorama, truth), float(np.mean((_glossy_pixels(renderer, panorama) - true_sphere) ** 2)))
                for panorama, truth, renderer, true_sphere in zip(
                    panoramas, truths, renderers, true_spheres, strict=True
                )
            ]
            log_error, rendering_error = np.mean(errors, axis=0).tolist()
            values.setdefault(name, {})[depth] = (log_error, rendering_error)
            if depth == depths[0]:
                columns[name] = panoramas[0]
    facts = recording.facts
    room = f"{facts.get('split', '')}/{facts.get('seed', '')}/{facts['room']}" if "room" in facts else recording.name
    room_type = str(facts.get("room_type", "room"))
    return (
        SequenceScores(recording.name, room, room_type, values),
        PictureRow(recording.name, room_type, first.image, views[0], columns),
    )


def _glossy_pixels(renderer: SphereRenderer, panorama: Panorama) -> Float[np.ndarray, "n 3"]:
    """Render the pixels of the glossy sphere, clamped to [0, 1] as in the paper's rendering loss."""
    return np.clip(renderer.pixels(panorama, "glossy"), 0, 1)


def _checked_lights(
    methods: Sequence[Method], frame: Frame, positions: Sequence[Position]
) -> Iterator[tuple[str, Sequence[Panorama]]]:
    """Yield every method's panoramas by name. Raises ModelError for a panorama of another shape or not finite."""
    for method in methods:
        lights = method.light(frame, positions)
        for name in method.names:
            for panorama in lights[name]:
                if panorama.shape != (HEIGHT, 2 * HEIGHT, 3) or not np.isfinite(panorama).all():
                    raise ModelError(
                        f"{name}: returned an invalid panorama for {frame.source} "
                        f"(shape {panorama.shape}; it must be [{HEIGHT}, {2 * HEIGHT}, 3] and finite)"
                    )
            yield name, lights[name]


def evenly_spread(count: int, wanted: int | None) -> list[int]:
    """Return `wanted` of the numbers below `count`, evenly spread, or all."""
    if wanted is None or wanted >= count:
        return list(range(count))
    return [at * count // wanted for at in range(wanted)]
