"""Estimated depth scored on captures that have depth, and the light that follows from it.

Each frame's own depth is hidden from the estimate and compared with it. AbsRel is the mean of |d / d_true - 1|; "within
25 %" the share of pixels with max(d / d_true, d_true / d) < 1.25 (Eigen et al. 2014). Pixels without an estimate are
left out. Where a capture has true panoramas, light by estimated depth is compared with light by its own.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float
from rich.table import Table

from roomlight.captures import CaptureOptions, open_capture
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError
from roomlight.files import write_json
from roomlight.imaging.tables import figure_table
from roomlight.monocular.stream import DepthStream, open_depth_stream
from roomlight_evaluation.captures.evaluation import ProgressCallback, evaluate_engine
from roomlight_evaluation.confidence import MeanWithInterval, mean_with_interval, ratio_of_means

CONSTANT_M: Final = 2.5
"""The answer that knows nothing."""
LIGHT: Final = {"log_l2": "log-L2", "si_rmse_diffuse": "diffuse"}
"""Scores of light that are compared, by their keys in `roomlight.metrics.METRICS`."""
_ENGINE: Final = 2
"""Place of the engine among the methods of `evaluate_engine`, after two baselines."""


@dataclass(frozen=True)
class DepthScore:
    """Scores of one capture: means over its frames.

    Attributes:
        abs_rel: By method: constant, single (each frame alone), stream (by poses).
        within_25: Likewise.
        light: By `LIGHT`, the errors of light by estimated depth and by the capture's own; none without true panoramas.
    """

    capture: str
    frames: int
    abs_rel: dict[str, float]
    within_25: dict[str, float]
    light: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class DepthScores:
    """Scores of several captures."""

    scores: tuple[DepthScore, ...]

    def table(self) -> Table:
        """Return a row for each capture, and the means over captures with 95 % intervals."""
        methods = list(self.scores[0].abs_rel)
        columns = [f"{kind}{method}" for kind in ("AbsRel ", "<25% ") for method in methods]
        note = "light: error by estimated depth over that by exact depth"
        table = figure_table("estimated depth", [*columns, *LIGHT.values()], caption=note)
        for name, scores in (*((score.capture, [score]) for score in self.scores), ("all", self.scores)):
            means = [
                *(mean_with_interval(score.abs_rel[method] for score in scores) for method in methods),
                *(mean_with_interval(score.within_25[method] for score in scores) for method in methods),
                *(ratio_of_means(*zip(*pairs, strict=True)) if pairs else None for pairs in _light_pairs(scores)),
            ]
            table.add_row(name, *("-" if mean is None else _shown(mean) for mean in means))
        return table

    def write(self, path: Path) -> None:
        """Write all scores as JSON. Raises OutputError."""
        values: list[dict[str, Any]] = [asdict(score) for score in self.scores]
        write_json(path, {"scores": values})


def evaluate_depth(
    captures: Sequence[Path],
    light: SessionOptions,
    reading: CaptureOptions,
    *,
    progress: ProgressCallback | None = None,
) -> DepthScores:
    """Score the estimated depth of captures, and its light.

    Args:
        captures: Captures with depth.
        light: How light is estimated.
        reading: How captures are read; its `depth_model` is scored.
        progress: Called after each frame.

    Raises:
        CaptureError: A capture cannot be read, or has no depth.
        ModelError: The depth model cannot be used.
    """
    scores: list[DepthScore] = []
    for path in captures:
        own = replace(reading, depth="file", depth_model=None)
        capture = open_capture(path, own)
        stream, errors = open_depth_stream(reading.depth_model), dict[str, list[Float[np.ndarray, "2"]]]()
        for done, frame in enumerate(capture, 1):
            bare = replace(frame, depth_m=np.zeros_like(frame.depth_m))
            answers = {
                "constant": np.full_like(frame.depth_m, CONSTANT_M),
                "single": DepthStream(stream.model, open_depth_stream().model).estimate(bare),
                "stream": stream.estimate(bare),
            }
            for method, depth_m in answers.items():
                errors.setdefault(method, []).append(depth_errors(depth_m, frame.depth_m))
            if progress is not None:
                progress(path.name, done, capture.frame_count)
        means = {method: np.nanmean(values, axis=0) for method, values in errors.items()}
        lit = dict[str, tuple[float, float]]()
        if any(probe.panorama_path is not None for probe in capture.probes):
            both = [_light(path, light, options) for options in (replace(reading, depth="network"), own)]
            lit = {metric: (both[0][metric], both[1][metric]) for metric in LIGHT}
        scores.append(
            DepthScore(
                capture=path.name,
                frames=len(errors["single"]),
                abs_rel={method: float(mean[0]) for method, mean in means.items()},
                within_25={method: float(mean[1]) for method, mean in means.items()},
                light=lit,
            )
        )
    if not scores:
        raise CaptureError("no capture is given to score")
    return DepthScores(tuple(scores))


def depth_errors(depth_m: Float[np.ndarray, "h w"], true_m: Float[np.ndarray, "th tw"]) -> Float[np.ndarray, "2"]:
    """Return AbsRel and the share within 25 %, at the estimate's size; NaN where nothing is known."""
    truth = cv2.resize(true_m, depth_m.shape[::-1], interpolation=cv2.INTER_NEAREST)
    both = (truth > 0) & (depth_m > 0)
    if not both.any():
        return np.full(2, np.nan)
    ratio = depth_m[both] / truth[both]
    return np.array([np.abs(ratio - 1).mean(), (np.maximum(ratio, 1 / ratio) < 1.25).mean()])


def _light(path: Path, light: SessionOptions, reading: CaptureOptions) -> dict[str, float]:
    scores = evaluate_engine([path], light, options=reading)
    return {metric: scores.means(scores.methods[_ENGINE], metric)[-1].mean for metric in LIGHT}


def _light_pairs(scores: Sequence[DepthScore]) -> list[list[tuple[float, float]]]:
    return [[score.light[metric] for score in scores if score.light] for metric in LIGHT]


def _shown(mean: MeanWithInterval) -> str:
    interval = "" if np.isnan(mean.low) else f" ({mean.low:.2f}-{mean.high:.2f})"
    return f"{mean.mean:.3f}{interval}"
