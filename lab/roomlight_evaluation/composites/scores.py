"""Errors of composites against the picture with the real object: inside it, in its shadow and elsewhere.

The regions are those of `composites.regions`. Linear light is clipped at white, as a camera clips it. Metrics: root of
the mean squared error in linear light and in sRGB, and the mean absolute difference of logarithms.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.conventions import LUMINANCE, linear_to_srgb
from roomlight.errors import OutputError
from roomlight.files import json_text, write_atomic
from roomlight_evaluation.composites.methods import HARMONICS
from roomlight_evaluation.confidence import MeanWithInterval, mean_with_interval, ratio_of_means

METRICS: Final = ("rmse", "srgb", "log")

_LOG_FLOOR: Final = 0.01
"""Added before the logarithm: a hundredth of white."""


@dataclass(frozen=True)
class SceneScore:
    """One scene's errors.

    Attributes:
        room, shape, material: as in `CompositeScene`.
        pixels: in each region.
        errors: by method, region and metric.
        darkening: mean log change of luminance in the shadow region where the real object darkens it, by method; and
            `truth`.
        shift_m: by which the compositor's place is above the real surface.
        settings: of the run, as `settings_of` gives them.
    """

    number: int
    room: str
    shape: str
    material: str
    pixels: Mapping[str, int]
    errors: Mapping[str, Mapping[str, Mapping[str, float]]]
    darkening: Mapping[str, float]
    shift_m: float
    settings: str = ""


def errors_of(
    picture: Float[np.ndarray, "h w 3"], truth: Float[np.ndarray, "h w 3"], masks: Mapping[str, Bool[np.ndarray, "h w"]]
) -> dict[str, dict[str, float]]:
    """Return each metric in each region; NaN in a region without pixels."""
    picture, wanted = np.clip(picture, 0, 1).astype(np.float32), np.clip(truth, 0, 1).astype(np.float32)
    squared = ((picture - wanted) ** 2).mean(axis=-1)
    encoded = ((linear_to_srgb(picture) - linear_to_srgb(wanted)) ** 2).mean(axis=-1)
    logs = np.abs(np.log((picture + _LOG_FLOOR) / (wanted + _LOG_FLOOR))).mean(axis=-1)
    return {
        region: {
            "rmse": float(np.sqrt(squared[mask].mean())),
            "srgb": float(np.sqrt(encoded[mask].mean())),
            "log": float(logs[mask].mean()),
        }
        if mask.any()
        else dict.fromkeys(METRICS, float("nan"))
        for region, mask in masks.items()
    }


def darkening_of(
    picture: Float[np.ndarray, "h w 3"],
    before: Float[np.ndarray, "h w 3"],
    darker: Bool[np.ndarray, "h w"],
) -> float:
    """Return log(light in the picture / light before) over some pixels: negative is a shadow; NaN without pixels."""
    if not darker.any():
        return float("nan")
    return float(np.log((picture[darker] @ LUMINANCE).mean() / max(float((before[darker] @ LUMINANCE).mean()), 1e-9)))


@dataclass(frozen=True)
class CompositeScores:
    """Scores of all scenes."""

    scenes: tuple[SceneScore, ...]

    def mean(self, method: str, region: str, metric: str, material: str | None = None) -> MeanWithInterval:
        """Return the mean over scenes, of one material or all, with its interval."""
        return mean_with_interval(self._values(method, region, metric, material))

    def ratio(
        self, method: str, region: str, metric: str, material: str | None = None, *, to: str = HARMONICS
    ) -> MeanWithInterval:
        """Return the method's mean over another's, with the interval over the same resampled scenes."""
        return ratio_of_means(
            self._values(method, region, metric, material), self._values(to, region, metric, material)
        )

    def darkening(self, method: str) -> MeanWithInterval:
        """Return the mean log change in shadows over scenes: `truth`, or a method's."""
        return mean_with_interval(scene.darkening[method] for scene in self.scenes)

    def _values(self, method: str, region: str, metric: str, material: str | None) -> list[float]:
        chosen = [scene for scene in self.scenes if material in (None, scene.material)]
        return [float(scene.errors[method][region][metric]) for scene in chosen]


def write_lines(path: Path, scores: Sequence[SceneScore]) -> None:
    """Write the scores of scenes as a file of JSON lines."""
    write_atomic(path, "".join(json_text(asdict(score)) + "\n" for score in scores).encode())


def read_lines(path: Path) -> list[SceneScore]:
    """Read the scores of a file of JSON lines; none if the file does not exist.

    Raises:
        OutputError: A line is damaged.
    """
    if not path.is_file():
        return []
    scores: list[SceneScore] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        if not line.strip():
            continue
        try:
            scores.append(SceneScore(**json.loads(line, object_hook=_with_nan)))
        except (TypeError, ValueError) as error:
            raise OutputError(f"{path}, line {number}: is no scene's scores ({error}); remove the line") from error
    return scores


def _with_nan(values: dict[str, Any]) -> dict[str, Any]:
    return {key: math.nan if value is None else value for key, value in values.items()}
