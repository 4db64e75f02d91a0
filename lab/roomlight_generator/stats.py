"""Statistics of a dataset: motion, dynamic range, exposure, coverage, and the contents of its rooms.

Luminance is Rec. 709 in units of the first frame's white; steps are from frame to frame; coverage is the share of a
probe's sphere in which some frame saw a surface. World frame: y up, metres.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import transform_points
from roomlight.conventions import direction_to_uv, panorama_solid_angles
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from roomlight.dataset.sequence_files import HALF_MAX, decode, part_sizes
from roomlight.frame import CLIPPED_SRGB8

_LUMA: Final = np.array([0.2126, 0.7152, 0.0722], np.float32)
_DARK: Final = 1e-4
"""Least median luminance: darker frames count as this, 13 stops below white, where 8 bits resolve nothing."""
_CELLS: Final = 30
"""Rows of cells, 6 degrees each, in which coverage is counted."""
_STRIDE: Final = 4
"""Step between the depth pixels that are projected.

A surface whose distance to the probe is at least a sixth of that to the camera has no gaps.
"""


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation, and 5th, 50th and 95th percentile of values; zeros without values."""

    mean: float
    deviation: float
    low: float
    median: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float] | Float[np.ndarray, " n"]) -> "Spread":
        """Summarise values."""
        array = np.asarray(values, np.float64)
        if not array.size:
            return cls(0.0, 0.0, 0.0, 0.0, 0.0)
        low, median, high = np.percentile(array, [5, 50, 95]).tolist()
        return cls(float(array.mean()), float(array.std()), low, median, high)


@dataclass(frozen=True, eq=False)
class SequenceStats:
    """One sequence's measures; lists have a value for each step, frame or probe."""

    name: str
    steps_m: list[float]
    steps_degrees: list[float]
    clipped: list[float]
    exposure_stops: float
    median_depth_m: list[float]
    unknown_depth: float
    range_stops: list[float]
    range_999_stops: list[float]
    brightest: list[float]
    coverage_first: list[float]
    coverage_all: list[float]
    at_half_limit: int
    bytes: dict[str, int]
    facts: dict[str, Any]


@dataclass(frozen=True, eq=False)
class DatasetStats:
    """`spreads` by measure over all steps, frames or probes of all sequences; `counts` by kind over rooms."""

    sequences: int
    rooms: int
    spreads: dict[str, Spread]
    counts: dict[str, dict[str, int]]
    mean_bytes: dict[str, float]
    probes_at_half_limit: int

    def to_json(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**vars(self), "spreads": {name: vars(spread) for name, spread in self.spreads.items()}}


def measure(recording: Recording, sizes: dict[str, int]) -> SequenceStats:
    """Measure one sequence; `sizes` are its bytes by part."""
    poses = recording.camera_to_world
    rotations = np.einsum("fji,fjk->fik", poses[:-1, :3, :3], poses[1:, :3, :3])
    cosines = (np.trace(rotations, axis1=1, axis2=2) - 1) / 2
    depth_m = recording.depth_mm.astype(np.float32) / 1000
    luminance = recording.probe_panoramas @ _LUMA
    medians = np.maximum(np.median(luminance, axis=(1, 2)), _DARK)
    brightest = luminance.max(axis=(1, 2))
    near_white = np.percentile(luminance, 99.9, axis=(1, 2))
    seen = [coverage(recording, position) for position in recording.probe_positions]
    return SequenceStats(
        name=recording.name,
        steps_m=np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=-1).tolist(),
        steps_degrees=np.degrees(np.arccos(np.clip(cosines, -1, 1))).tolist(),
        clipped=(recording.colour.max(axis=-1) >= CLIPPED_SRGB8).mean(axis=(1, 2)).tolist(),
        exposure_stops=float(np.log2(recording.exposure.max() / recording.exposure.min())),
        median_depth_m=[float(np.median(depth[depth > 0])) for depth in depth_m if (depth > 0).any()],
        unknown_depth=float((recording.depth_mm == 0).mean()),
        range_stops=np.log2(np.maximum(brightest, _DARK) / medians).tolist(),
        range_999_stops=np.log2(np.maximum(near_white, _DARK) / medians).tolist(),
        brightest=brightest.tolist(),
        coverage_first=[first for first, _ in seen],
        coverage_all=[whole for _, whole in seen],
        at_half_limit=int((recording.probe_panoramas >= 0.999 * HALF_MAX).any(axis=-1).sum()),
        bytes=sizes,
        facts=recording.facts,
    )


def coverage(recording: Recording, position: Float[np.ndarray, "3"]) -> tuple[float, float]:
    """Return the shares of the sphere around a probe (world, metres) seen by the first frame, and by all frames.

    Depth pixels are projected into cells of 6 degrees. A surface that another one hides from the probe counts too.
    """
    weights = np.broadcast_to(panorama_solid_angles(_CELLS), (_CELLS, 2 * _CELLS)) / (4 * np.pi)
    rays = recording.intrinsics.rays()[::_STRIDE, ::_STRIDE]
    mask = np.zeros((_CELLS, 2 * _CELLS), bool)
    first = 0.0
    for k, depth_mm in enumerate(recording.depth_mm):
        depth_m = depth_mm[::_STRIDE, ::_STRIDE].astype(np.float32) / 1000
        points = transform_points(recording.camera_to_world[k], (rays * depth_m[..., None])[depth_m > 0])
        offset = points - position.astype(np.float32)
        uv = direction_to_uv(offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-6))
        row = np.minimum((uv[:, 1] * _CELLS).astype(int), _CELLS - 1)
        column = np.minimum((uv[:, 0] * 2 * _CELLS).astype(int), 2 * _CELLS - 1)
        mask[row, column] = True
        if k == 0:
            first = float(weights[mask].sum())
    return first, float(weights[mask].sum())


def collect(
    dataset: Dataset,
    *,
    limit: int | None = None,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> DatasetStats:
    """Read and measure a dataset, or `limit` sequences spread evenly over it.

    Raises:
        DatasetError: if a sequence is damaged.
    """
    count = len(dataset) if limit is None else min(limit, len(dataset))
    numbers = sorted({round(k) for k in np.linspace(0, len(dataset) - 1, count).tolist()}) if count else []

    def measure_sequence(number: int) -> SequenceStats:
        files = dataset.files(number)
        sizes = part_sizes(files)
        sizes["tar"] = dataset.size_of(number) - sum(sizes.values())
        return measure(decode(files, dataset.names[number]), sizes)

    measured: list[SequenceStats] = []
    with ThreadPoolExecutor(workers) as pool:
        for stats in pool.map(measure_sequence, numbers):
            measured.append(stats)
            if progress:
                progress(len(measured), len(numbers))
    return summarise(measured)


def summarise(measured: Sequence[SequenceStats]) -> DatasetStats:
    """Combine the measures of many sequences; rooms that several sequences walk through are counted once."""
    rooms = {_room_of(stats): stats.facts for stats in measured}
    lights = [light for facts in rooms.values() if isinstance(light := facts.get("light"), dict)]
    sources = [source for light in lights for source in light.get("sources", ())]
    furniture: Counter[str] = Counter()
    for facts in rooms.values():
        furniture.update(facts.get("furniture", {}))
    parts = sorted({part for stats in measured for part in stats.bytes})
    return DatasetStats(
        sequences=len(measured),
        rooms=len(rooms),
        spreads={
            "step, m": Spread.of([x for stats in measured for x in stats.steps_m]),
            "turn, degrees": Spread.of([x for stats in measured for x in stats.steps_degrees]),
            "depth median, m": Spread.of([x for stats in measured for x in stats.median_depth_m]),
            "depth unknown": Spread.of([stats.unknown_depth for stats in measured]),
            "clipped pixels": Spread.of([x for stats in measured for x in stats.clipped]),
            "exposure change, stops": Spread.of([stats.exposure_stops for stats in measured]),
            "probe max / median, stops": Spread.of([x for stats in measured for x in stats.range_stops]),
            "probe 99.9 % / median, stops": Spread.of([x for stats in measured for x in stats.range_999_stops]),
            "probe max, times white": Spread.of([x for stats in measured for x in stats.brightest]),
            "coverage, first frame": Spread.of([x for stats in measured for x in stats.coverage_first]),
            "coverage, all frames": Spread.of([x for stats in measured for x in stats.coverage_all]),
            "colour temperature, K": Spread.of([float(s["kelvin"]) for s in sources if s.get("kelvin")]),
        },
        counts={
            "room types": _sorted(Counter(str(facts.get("room_type", "?")) for facts in rooms.values())),
            "scenarios": _sorted(Counter(str(light.get("scenario", "?")) for light in lights)),
            "light sources": _sorted(Counter(str(source.get("kind", "?")) for source in sources)),
            "furniture": _sorted(furniture),
        },
        mean_bytes={part: float(np.mean([stats.bytes.get(part, 0) for stats in measured])) for part in parts},
        probes_at_half_limit=sum(stats.at_half_limit for stats in measured),
    )


def _room_of(stats: SequenceStats) -> tuple[object, ...]:
    """Return a room's identity; a sequence whose facts do not name one is a room of its own."""
    made = stats.facts.get("made")
    return (made["split"], made["room"], made["attempt"]) if isinstance(made, dict) else (stats.name,)


def _sorted(counts: Counter[str]) -> dict[str, int]:
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))
