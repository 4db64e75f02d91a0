"""The rule by which a model becomes the default: better than the classical model in the mean over all captures.

The ratio of the mean errors, model to classical, has a 95 % interval that resamples captures. Its upper end must lie
below `BELOW` for each metric, and on no capture may log-L2 be above `WORST` times the classical model's. Of the models
that pass, the one with the least mean log-L2 is the default. Choosing on few captures picks what does not carry over:
give all captures with ground truth, and rooms of panoramas that no training has used.
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
from roomlight.imaging.tables import figure_table
from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator
from roomlight_evaluation.captures.evaluation import ProgressCallback, evaluate_captures
from roomlight_evaluation.captures.scores import CaptureScores
from roomlight_evaluation.confidence import MeanWithInterval, ratio_of_means

BELOW: Final = {"log_l2": 1.0, "render_l2": 0.9}
WORST: Final = 1.6
TITLES: Final = {"log_l2": "log-L2", "render_l2": "glossy sphere"}
_LEAST: Final = 1e-4
"""Smaller errors count as this one: the ratio of two invisible errors means nothing."""


@dataclass(frozen=True)
class CaptureErrors:
    """Errors on one capture, means over its probes and frames, by the keys of `BELOW`.

    Attributes:
        capture: Its name.
        model: The candidate's errors; infinite if one is not a number.
        reference: The classical model's.
        energy: The candidate's at the last frame as a ratio to the truth's, mean over probes; NaN if the truth is
            black.
    """

    capture: str
    model: dict[str, float]
    reference: dict[str, float]
    energy: float

    def ratio(self, metric: str) -> float:
        """Return the candidate's error as a ratio to the reference's."""
        return self.model[metric] / self.reference[metric]


@dataclass(frozen=True)
class ShipRule:
    """Errors of one model and of the reference on each capture, and the verdict."""

    model: str
    reference: str
    captures: tuple[CaptureErrors, ...]

    def ratio(self, metric: str) -> MeanWithInterval:
        """Return the ratio of the mean errors over captures, with a 95 % interval that resamples captures."""
        return ratio_of_means(
            [errors.model[metric] for errors in self.captures], [errors.reference[metric] for errors in self.captures]
        )

    def failures(self) -> list[str]:
        """Return what breaks the rule, worst capture first; empty if the model passes."""
        ratios = sorted(((errors.ratio("log_l2"), errors.capture) for errors in self.captures), reverse=True)
        worse = [
            f"{name}: log-L2 is {ratio:.2f} of {self.reference}'s, above {WORST}"
            for ratio, name in ratios
            if not ratio <= WORST
        ]
        for metric, limit in BELOW.items():
            ratio = self.ratio(metric)
            if not ratio.high < limit:
                interval = f"{ratio.mean:.3f} ({ratio.low:.3f}-{ratio.high:.3f})"
                worse.append(f"all captures: {TITLES[metric]} is {interval} of {self.reference}'s, not below {limit}")
        return worse

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "model": self.model,
            "reference": self.reference,
            "below": BELOW,
            "worst": WORST,
            "ratios": {metric: vars(self.ratio(metric)) for metric in BELOW},
            "captures": [vars(errors) for errors in self.captures],
            "failures": self.failures(),
        }


def apply_ship_rule(
    captures: Sequence[Path],
    candidate: SessionOptions,
    *,
    options: CaptureOptions | None = None,
    progress: ProgressCallback | None = None,
) -> tuple[ShipRule, CaptureScores]:
    """Score a candidate beside the classical model.

    Raises:
        ModelError: Weights are missing.
        CaptureError: A capture cannot be read or has no ground truth.
    """
    known = SessionOptions(model="classical")
    graphs = [choose_graphs(session) for session in (candidate, known)]

    def estimators() -> list[Estimator]:
        engines = [EngineEstimator(session, graph) for session, graph in zip((candidate, known), graphs, strict=True)]
        for engine, name in zip(engines, ("candidate", "reference"), strict=True):
            engine.name = name
        return list(engines)

    scores = evaluate_captures(captures, estimators, options=options, progress=progress)
    return rule_of(scores, candidate.model, known.model), scores


def rule_of(scores: CaptureScores, model: str, reference: str) -> ShipRule:
    """Take the errors from scores of the methods `candidate` and `reference`."""

    def errors(method: str, capture: str) -> dict[str, float]:
        means = {metric: scores.means(method, metric, capture=capture)[-1].mean for metric in BELOW}
        return {metric: max(value, _LEAST) if math.isfinite(value) else math.inf for metric, value in means.items()}

    return ShipRule(
        model,
        reference,
        tuple(
            CaptureErrors(
                capture.name,
                errors("candidate", capture.name),
                errors("reference", capture.name),
                _last_energy(scores, capture.name),
            )
            for capture in scores.captures
        ),
    )


def ship_rule_table(rule: ShipRule) -> Table:
    """Return the ratios by capture, with those of the means over captures at the end."""
    limits = ", ".join(f"{TITLES[metric]} below {limit}" for metric, limit in BELOW.items())
    title = f"{rule.model} to {rule.reference}: {limits}; no capture's log-L2 above {WORST}"
    table = figure_table(title, (*TITLES.values(), "energy, last"))
    for errors in rule.captures:
        table.add_row(errors.capture, *(f"{errors.ratio(metric):.2f}" for metric in BELOW), f"{errors.energy:.2f}")
    means = [rule.ratio(metric) for metric in BELOW]
    table.add_row(
        "all, 95 %",
        *(f"{ratio.mean:.3f} ({ratio.low:.3f}-{ratio.high:.3f})" for ratio in means),
        f"{np.nanmedian([errors.energy for errors in rule.captures]):.2f}",
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
