"""The rule by which a model becomes the default: on no capture worse than the classical model, and better on the mean.

A model passes if, on every capture and in every interval of frames, its log-L2 and its error at the glossy sphere are
at most `TOLERANCE` times those of the reference, and on the mean over captures (of each capture's ratio over all
frames) at most `TARGET`. Choosing on few captures picks what does not carry over: give all captures with ground truth,
and rooms of panoramas that no training has used.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.table import Table

from roomlight.captures import CaptureOptions
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import SessionOptions
from roomlight.files import write_json
from roomlight_evaluation.baselines import WarpAndFill
from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator
from roomlight_evaluation.captures.evaluation import ProgressCallback, evaluate_captures
from roomlight_evaluation.captures.scores import CaptureScores
from roomlight_evaluation.confidence import MeanWithInterval, mean_with_interval

TOLERANCE: Final = 1.05
TARGET: Final = 0.85
METRICS: Final = {"log_l2": "log-L2", "render_l2": "glossy sphere"}
_LEAST: Final = 1e-4
"""Smaller errors count as this one: the ratio of two invisible errors means nothing."""


@dataclass(frozen=True)
class Ratio:
    """A model's error as a ratio to the reference's on one capture: of each interval of frames, and of all frames.

    NaN: a short capture has no frames in this interval. Infinite: the model's error is not a number.
    """

    capture: str
    metric: str
    intervals: tuple[float, ...]
    overall: float
    to_warp: float
    """Of the last interval, as a ratio to warp-and-fill's."""

    @property
    def worst(self) -> float:
        """Greatest ratio of an interval."""
        return max(value for value in self.intervals if not math.isnan(value))

    @property
    def last(self) -> float:
        """Ratio of the last interval that has frames."""
        return [value for value in self.intervals if not math.isnan(value)][-1]


@dataclass(frozen=True)
class ShipRule:
    """Ratios of one model to the reference, and the verdict."""

    model: str
    reference: str
    ratios: tuple[Ratio, ...]
    energy: tuple[float, ...]
    """Of each capture: the model's energy at the last frame as a ratio to the truth's, mean over probes."""

    def mean(self, metric: str) -> MeanWithInterval:
        """Return the mean ratio over captures, with a 95 % interval that resamples captures."""
        return mean_with_interval([one.overall for one in self.ratios if one.metric == metric])

    def mean_to_warp(self, metric: str) -> MeanWithInterval:
        """Return the mean ratio to warp-and-fill in the last interval."""
        return mean_with_interval([one.to_warp for one in self.ratios if one.metric == metric])

    def failures(self) -> list[str]:
        """Return what breaks the rule, worst first; empty if the model passes."""
        worse = [
            (
                value,
                f"{one.capture}, interval {number} of 5: {METRICS[one.metric]} is {value:.2f} of {self.reference}'s",
            )
            for one in self.ratios
            for number, value in enumerate(one.intervals, 1)
            if value > TOLERANCE
        ]
        found = [text for _, text in sorted(worse, reverse=True)]
        for metric, title in METRICS.items():
            mean = self.mean(metric).mean
            if not mean <= TARGET:
                found.append(f"mean over captures: {title} is {mean:.3f} of {self.reference}'s, above {TARGET}")
        return found

    def to_json(self) -> dict[str, Any]:
        """Return plain values; what is NaN or infinite becomes null."""
        return {
            "model": self.model,
            "reference": self.reference,
            "tolerance": TOLERANCE,
            "target": TARGET,
            "means": {metric: _plain(vars(self.mean(metric))) for metric in METRICS},
            "ratios": [_plain(vars(one)) for one in self.ratios],
            "energy": _plain(self.energy),
            "failures": self.failures(),
        }


def apply_ship_rule(
    captures: Sequence[Path],
    candidate: SessionOptions,
    *,
    reference: SessionOptions | None = None,
    options: CaptureOptions | None = None,
    progress: ProgressCallback | None = None,
) -> tuple[ShipRule, CaptureScores]:
    """Score a candidate beside the reference (default: the classical model) and warp-and-fill.

    Raises:
        ModelError: Weights are missing.
        CaptureError: A capture cannot be read or has no ground truth.
    """
    known = reference or SessionOptions(model="classical")
    graphs = [choose_graphs(one) for one in (candidate, known)]

    def estimators() -> list[Estimator]:
        engines = [EngineEstimator(one, graph) for one, graph in zip((candidate, known), graphs, strict=True)]
        for engine, name in zip(engines, ("candidate", "reference"), strict=True):
            engine.name = name
        return [WarpAndFill(), *engines]

    scores = evaluate_captures(captures, estimators, options=options, progress=progress)
    return rule_of(scores, candidate.model, known.model), scores


def rule_of(scores: CaptureScores, model: str, reference: str) -> ShipRule:
    """Compute the ratios from scores of the methods `candidate`, `reference` and `warp and fill`."""
    ratios = list[Ratio]()
    for capture in scores.captures:
        for metric in METRICS:
            ours, known, warp = (
                np.maximum([cell.mean for cell in scores.means(method, metric, capture=capture.name)], _LEAST)
                for method in ("candidate", "reference", "warp and fill")
            )
            ratio = np.where(np.isfinite(known) & ~np.isfinite(ours), np.inf, ours / known)
            last = int(np.flatnonzero(~np.isnan(ratio[:-1]))[-1])
            intervals = tuple(float(value) for value in ratio[:-1])
            ratios.append(
                Ratio(capture.name, metric, intervals, float(ratio[-1]), float(ratio[last] * known[last] / warp[last]))
            )
    energy = tuple(_last_energy(scores, capture.name) for capture in scores.captures)
    return ShipRule(model, reference, tuple(ratios), energy)


def ship_rule_table(rule: ShipRule) -> Table:
    """Return the ratios by capture, with the means over captures at the end."""
    table = Table(title=f"{rule.model} against {rule.reference}: errors as ratios (at most {TOLERANCE}, mean {TARGET})")
    for heading in ("capture", "metric", "worst interval", "last interval", "all frames", "last, to warp-and-fill"):
        table.add_column(heading, justify="left" if heading in ("capture", "metric") else "right")
    table.add_column("energy, last", justify="right")
    energies = dict(zip(dict.fromkeys(one.capture for one in rule.ratios), rule.energy, strict=True))
    for one in rule.ratios:
        figures = (one.worst, one.last, one.overall, one.to_warp)
        table.add_row(
            one.capture,
            METRICS[one.metric],
            *(f"{value:.2f}" for value in figures),
            f"{energies[one.capture]:.2f}" if one.metric == "log_l2" else "",
        )
    for metric, title in METRICS.items():
        mean, warp = rule.mean(metric), rule.mean_to_warp(metric)
        table.add_row(
            "mean",
            title,
            "",
            "",
            f"{mean.mean:.3f} [{mean.low:.3f}, {mean.high:.3f}]",
            f"{warp.mean:.3f} [{warp.low:.3f}, {warp.high:.3f}]",
            f"{np.nanmedian(rule.energy):.2f}" if metric == "log_l2" else "",
        )
    return table


def write_rule(path: Path, rule: ShipRule, scores: CaptureScores) -> None:
    """Write the scores as JSON (`CaptureScores.write`), with the rule as `ship_rule`, atomically.

    Raises:
        OutputError: The file cannot be written.
    """
    write_json(path, scores.to_json() | {"ship_rule": rule.to_json()})


def _last_energy(scores: CaptureScores, capture: str) -> float:
    """Return the mean of the candidate's last energies over a capture's probes; those with a black truth are NaN."""
    tracks = [track for track in scores.tracks if track.capture == capture and track.method == "candidate"]
    known = [value for value in (track.scores["energy"][-1] for track in tracks) if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


def _plain(values: Any) -> Any:
    if isinstance(values, dict):
        return {key: _plain(value) for key, value in values.items()}
    if isinstance(values, (tuple, list)):
        return [_plain(value) for value in values]
    return None if isinstance(values, float) and not math.isfinite(values) else values
