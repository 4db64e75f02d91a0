"""Scores of methods on a dataset: means with 95 % intervals over rooms, and ratios with their targets.

The bootstrap resamples rooms, not sequences or probes: walks through one room are not independent. Every method's
interval draws the same rooms, so that the interval of a ratio is a paired one. The JSON (schema
`roomlight-dataset-evaluation-1`) holds every sequence's scores, unscaled.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float, Int

from roomlight_evaluation.confidence import MeanWithInterval, ratio_of_means
from roomlight_evaluation.datasets.methods import BLENDED, UNBLENDED

SCHEMA: Final = "roomlight-dataset-evaluation-1"
MetricKey = Literal["log_l2", "render_l2"]
KEYS: Final[tuple[MetricKey, ...]] = ("log_l2", "render_l2")
TITLES: Final[Mapping[MetricKey, tuple[str, float]]] = {
    "log_l2": ("log-L2 (1e-1)", 1e1),
    "render_l2": ("rendering (1e-2)", 1e2),
}
"""Heading of each metric, and the factor that the paper prints it with."""
BASELINES: Final = ("mean colour", "warp and fill", "classical")
"""Methods without learning."""


@dataclass(frozen=True)
class SequenceScores:
    """One sequence's scores.

    Attributes:
        name: The sequence's name.
        room: Identifies its room within the dataset.
        room_type: The room's type, e.g. `living_room`.
        values: By method, then by kind of depth: (log-L2, rendering loss), means over the sequence's probes.
    """

    name: str
    room: str
    room_type: str
    values: Mapping[str, Mapping[str, tuple[float, float]]]


@dataclass(frozen=True)
class Ratio:
    """The ratio of two means with its 95 % interval; `limit` is the target: the largest ratio that is accepted."""

    title: str
    value: MeanWithInterval
    limit: float | None = None

    @property
    def holds(self) -> bool | None:
        """Whether the target is met; None without a target."""
        return None if self.limit is None else self.value.mean <= self.limit


@dataclass(frozen=True)
class DatasetScores:
    """Scores of every method on every sequence, and their summary."""

    dataset: str
    sequences: tuple[SequenceScores, ...]
    skipped: tuple[str, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods in the order in which they were given."""
        return tuple(self.sequences[0].values)

    @property
    def depths(self) -> tuple[str, ...]:
        """Kinds of depth that were scored."""
        return tuple(self.sequences[0].values[self.methods[0]])

    @cached_property
    def rooms(self) -> int:
        """Number of different rooms."""
        return len({sequence.room for sequence in self.sequences})

    def mean(self, method: str, depth: str, metric: MetricKey) -> MeanWithInterval:
        """Return the mean over sequences; its interval resamples rooms (NaN for a single room)."""
        sums, counts = self._by_room(method, depth, metric)
        return ratio_of_means(sums, counts)

    def ratio(self, of: tuple[str, str], to: tuple[str, str], metric: MetricKey) -> MeanWithInterval:
        """Return the mean of one (method, depth) over that of another; both resample the same rooms."""
        above, _ = self._by_room(*of, metric)
        below, _ = self._by_room(*to, metric)
        return ratio_of_means(above, below)

    def best_baseline(self, metric: MetricKey) -> str | None:
        """Return the method without learning that has the lowest mean; None if there is no such method."""
        scored = [name for name in BASELINES if name in self.methods]
        return min(scored, key=lambda name: self.mean(name, self.depths[0], metric).mean, default=None)

    def ratios(self) -> tuple[Ratio, ...]:
        """Return the comparisons that these methods allow; titles give the paper's own ratios."""
        ratios: list[Ratio] = []
        first = self.depths[0]

        def compare(title: str, method: str, other: str | None, metric: MetricKey, limit: float | None) -> None:
            if method in self.methods and other in self.methods:
                ratio = self.ratio((method, first), (other, first), metric)
                ratios.append(Ratio(f"{title}, {_title(metric)}", ratio, limit))

        compare("blended / SGLV alone (paper 0.947)", BLENDED, UNBLENDED, "log_l2", 0.93)
        compare("blended / SGLV alone (paper 0.952)", BLENDED, UNBLENDED, "render_l2", 0.93)
        compare("SGLV / RGB-alpha, both blended", BLENDED, "rgb-alpha", "log_l2", None)
        compare("SGLV / RGB-alpha, both blended (paper 0.965)", BLENDED, "rgb-alpha", "render_l2", 0.95)
        compare("with / without rendering loss", BLENDED, "no-rendering-loss", "render_l2", None)
        limits: dict[MetricKey, float | None] = {"log_l2": 0.65, "render_l2": None}
        for metric, limit in limits.items():
            best = self.best_baseline(metric)
            compare(f"{BLENDED} / {best}, the best baseline", BLENDED, best, metric, limit)
        if BLENDED in self.methods and {"exact", "arkit"} <= set(self.depths):
            for metric in KEYS:
                ratio = self.ratio((BLENDED, "arkit"), (BLENDED, "exact"), metric)
                ratios.append(Ratio(f"{BLENDED}: ARKit-like / exact depth, {_title(metric)}", ratio, 1.15))
        return tuple(ratios)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON of this module's docstring as plain dictionaries and lists."""
        return {
            "schema": SCHEMA,
            "dataset": self.dataset,
            "sequences_scored": len(self.sequences),
            "rooms": self.rooms,
            "skipped": list(self.skipped),
            "summary": [
                {"method": method, "depth": depth, "metric": metric, **_json_values(self.mean(method, depth, metric))}
                for method in self.methods
                for depth in self.depths
                for metric in KEYS
            ],
            "ratios": [
                {"title": ratio.title, "limit": ratio.limit, "holds": ratio.holds, **_json_values(ratio.value)}
                for ratio in self.ratios()
            ],
            "sequences": [
                {
                    "name": sequence.name,
                    "room": sequence.room,
                    "room_type": sequence.room_type,
                    "scores": {
                        method: {depth: dict(zip(KEYS, pair, strict=True)) for depth, pair in kinds.items()}
                        for method, kinds in sequence.values.items()
                    },
                }
                for sequence in self.sequences
            ],
        }

    @cached_property
    def _room_numbers(self) -> Int[np.ndarray, " n"]:
        """The room of each sequence, as a number from 0."""
        names = sorted({sequence.room for sequence in self.sequences})
        return np.array([names.index(sequence.room) for sequence in self.sequences])

    def _by_room(
        self, method: str, depth: str, metric: MetricKey
    ) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
        """Return each room's sum of scores and its number of sequences."""
        values = np.array([sequence.values[method][depth][KEYS.index(metric)] for sequence in self.sequences])
        counts = np.bincount(self._room_numbers, minlength=self.rooms).astype(np.float64)
        return np.bincount(self._room_numbers, values, minlength=self.rooms), counts


def _title(metric: MetricKey) -> str:
    return "log-L2" if metric == "log_l2" else "rendering loss"


def _json_values(mean: MeanWithInterval) -> dict[str, float | None]:
    return {key: value if np.isfinite(value) else None for key, value in asdict(mean).items()}
