"""What an evaluation on a dataset found: means with 95 % intervals over rooms, and ratios held to targets.

Rooms are drawn, not sequences or probes: walks through one room are not independent. The same rooms are drawn for every
method, so that a ratio's interval is that of the pairs. The JSON (schema `roomlight-dataset-evaluation-1`) holds every
sequence's scores, unscaled.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float, Int

from roomlight_evaluation.scores import BOOTSTRAP_SAMPLES, Cell

SCHEMA: Final = "roomlight-dataset-evaluation-1"
MetricKey = Literal["log_l2", "render_l2"]
KEYS: Final[tuple[MetricKey, ...]] = ("log_l2", "render_l2")
TITLES: Final[Mapping[MetricKey, tuple[str, float]]] = {
    "log_l2": ("log-L2 (1e-1)", 1e1),
    "render_l2": ("rendering (1e-2)", 1e2),
}
"""Headings, and the factor the paper prints them with."""
BASELINES: Final = ("mean colour", "warp and fill", "classical")


@dataclass(frozen=True)
class SequenceScores:
    """One sequence: means over its probes of (log-L2, rendering loss), by method and kind of depth."""

    name: str
    room: str
    room_type: str
    values: Mapping[str, Mapping[str, tuple[float, float]]]


@dataclass(frozen=True)
class Ratio:
    """Mean over mean with its 95 % interval; `limit` is the target it should stay under, where there is one."""

    title: str
    value: Cell
    limit: float | None = None

    @property
    def holds(self) -> bool | None:
        """Whether the target holds; None without one."""
        return None if self.limit is None else self.value.mean <= self.limit


@dataclass(frozen=True)
class DatasetScores:
    """All sequences' scores, and what is concluded from them."""

    dataset: str
    sequences: tuple[SequenceScores, ...]
    skipped: tuple[str, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """In the order in which they were given."""
        return tuple(self.sequences[0].values)

    @property
    def depths(self) -> tuple[str, ...]:
        """Kinds of depth scored."""
        return tuple(self.sequences[0].values[self.methods[0]])

    @cached_property
    def rooms(self) -> int:
        """How many different rooms."""
        return len({sequence.room for sequence in self.sequences})

    def cell(self, method: str, depth: str, metric: MetricKey) -> Cell:
        """The mean over sequences; its interval draws rooms with replacement (NaN for a single room)."""
        sums, counts = self._by_room(method, depth, metric)
        mean = float(sums.sum() / counts.sum())
        if len(sums) < 2:
            return Cell(mean, np.nan, np.nan)
        low, high = np.percentile(sums[self._drawn].sum(1) / counts[self._drawn].sum(1), [2.5, 97.5])
        return Cell(mean, float(low), float(high))

    def ratio(self, of: tuple[str, str], to: tuple[str, str], metric: MetricKey) -> Cell:
        """Mean of one (method, depth) over that of another, on the same drawn rooms."""
        above, _ = self._by_room(*of, metric)
        below, _ = self._by_room(*to, metric)
        mean = float(above.sum() / below.sum())
        if len(above) < 2:
            return Cell(mean, np.nan, np.nan)
        low, high = np.percentile(above[self._drawn].sum(1) / below[self._drawn].sum(1), [2.5, 97.5])
        return Cell(mean, float(low), float(high))

    def best_baseline(self, metric: MetricKey) -> str | None:
        """The lowest mean of those without learning."""
        there = [name for name in BASELINES if name in self.methods]
        return min(there, key=lambda name: self.cell(name, self.depths[0], metric).mean, default=None)

    def ratios(self) -> tuple[Ratio, ...]:
        """The comparisons that these methods allow: targets first, the paper's own ratios in the titles."""
        found: list[Ratio] = []
        first = self.depths[0]

        def compare(title: str, one: str, other: str | None, metric: MetricKey, limit: float | None) -> None:
            if one in self.methods and other in self.methods:
                cell = self.ratio((one, first), (other, first), metric)
                found.append(Ratio(f"{title}, {_named(metric)}", cell, limit))

        compare("blended / SGLV alone (paper 0.947)", "full", "SGLV alone", "log_l2", 0.93)
        compare("blended / SGLV alone (paper 0.952)", "full", "SGLV alone", "render_l2", 0.93)
        compare("SGLV / RGB-alpha, both blended", "full", "rgb-alpha", "log_l2", None)
        compare("SGLV / RGB-alpha, both blended (paper 0.965)", "full", "rgb-alpha", "render_l2", 0.95)
        compare("with / without rendering loss", "full", "no-rendering-loss", "render_l2", None)
        limits: dict[MetricKey, float | None] = {"log_l2": 0.65, "render_l2": None}
        for metric, limit in limits.items():
            best = self.best_baseline(metric)
            compare(f"full / {best}, the best baseline", "full", best, metric, limit)
        if "full" in self.methods and {"exact", "arkit"} <= set(self.depths):
            for metric in KEYS:
                cell = self.ratio(("full", "arkit"), ("full", "exact"), metric)
                found.append(Ratio(f"full: ARKit-like / exact depth, {_named(metric)}", cell, 1.15))
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """The schema in this module's docstring."""
        return {
            "schema": SCHEMA,
            "dataset": self.dataset,
            "sequences_scored": len(self.sequences),
            "rooms": self.rooms,
            "skipped": list(self.skipped),
            "summary": [
                {"method": method, "depth": depth, "metric": metric, **_plain(self.cell(method, depth, metric))}
                for method in self.methods
                for depth in self.depths
                for metric in KEYS
            ],
            "ratios": [
                {"title": ratio.title, "limit": ratio.limit, "holds": ratio.holds, **_plain(ratio.value)}
                for ratio in self.ratios()
            ],
            "sequences": [
                {
                    "name": one.name,
                    "room": one.room,
                    "room_type": one.room_type,
                    "scores": {
                        method: {depth: dict(zip(KEYS, pair, strict=True)) for depth, pair in kinds.items()}
                        for method, kinds in one.values.items()
                    },
                }
                for one in self.sequences
            ],
        }

    @cached_property
    def _room_of(self) -> Int[np.ndarray, " n"]:
        names = sorted({sequence.room for sequence in self.sequences})
        return np.array([names.index(sequence.room) for sequence in self.sequences])

    @cached_property
    def _drawn(self) -> Int[np.ndarray, "b r"]:
        return np.random.default_rng(0).integers(0, self.rooms, (BOOTSTRAP_SAMPLES, self.rooms))

    def _by_room(
        self, method: str, depth: str, metric: MetricKey
    ) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
        values = np.array([one.values[method][depth][KEYS.index(metric)] for one in self.sequences])
        counts = np.bincount(self._room_of, minlength=self.rooms).astype(np.float64)
        return np.bincount(self._room_of, values, minlength=self.rooms), counts


def _named(metric: MetricKey) -> str:
    return "log-L2" if metric == "log_l2" else "rendering loss"


def _plain(cell: Cell) -> dict[str, float | None]:
    return {key: value if np.isfinite(value) else None for key, value in asdict(cell).items()}
