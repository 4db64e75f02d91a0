"""Errors of an estimated panorama against the true one: the paper's metrics, and those of three spheres.

Panoramas are linear HDR radiance, float32 [h, 2h, 3], world-aligned. The paper's losses (sections 3 and 4, equations of
L2, LR and Lsm) are sums; as in its tables, means over pixels and channels are reported here. They are plain pixel
means, as in the paper, which overweights the poles.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_solid_angles
from roomlight.spheres import Material, SphereRenderer

Panorama = Float[np.ndarray, "h w 3"]

PAPER_INTERVALS: Final = ("[1,8)", "[8,14)", "[14,20)", "[20,26)", "[26,31]")
"""The paper's video table: frames numbered from 1 in a sequence of 31."""
_PAPER_STARTS: Final = (1, 8, 14, 20, 26)
_PAPER_FRAMES: Final = 31

SPHERES: Final[tuple[Material, ...]] = ("mirror", "matte", "diffuse")
"""The three spheres of lighting estimation (LeGendre et al. 2019): mirror, matte silver, diffuse."""


@dataclass(frozen=True)
class Metric:
    """A column of the results: its key in JSON, its heading, the factor of the paper's tables, and the best value."""

    key: str
    title: str
    shown_times: float = 1.0
    best: float = 0.0


METRICS: Final = (
    Metric("log_l2", "log-L2 (1e-1)", 1e1),
    Metric("ldr_l2", "LDR L2 (1e-2)", 1e2),
    Metric("smoothness", "smoothness (1e-3)", 1e3),
    Metric("render_l2", "render L2 (1e-2)", 1e2),
    *(Metric(f"si_rmse_{sphere}", f"si-RMSE {sphere}") for sphere in SPHERES),
    *(Metric(f"angular_deg_{sphere}", f"angular {sphere} (deg)") for sphere in SPHERES),
    Metric("energy", "energy (1 is right)", best=1.0),
)
"""All metrics, in the order of the tables. Energy is a ratio; of all others lower is better."""


def log_l2(prediction: Panorama, truth: Panorama) -> float:
    """Mean of (log(1 + L) - log(1 + Lgt))^2: the paper's HDR environment map error and its training loss L2.

    Radiance below 0 counts as 0. Zero exactly when the two are equal.
    """
    difference = np.log1p(np.maximum(prediction, 0)) - np.log1p(np.maximum(truth, 0))
    return _mean_square(difference)


def ldr_l2(prediction: Panorama, truth: Panorama) -> float:
    """Mean squared difference after clamping both to [0, 1]: the paper's LDR environment map error."""
    return _mean_square(np.clip(prediction, 0, 1) - np.clip(truth, 0, 1))


def energy_ratio(prediction: Panorama, truth: Panorama) -> float:
    """Radiance summed over the sphere and the channels, as a ratio to the truth's: 1 is right; NaN for black truth."""
    weights = panorama_solid_angles(len(truth))[..., None]
    total = float((truth * weights).sum(dtype=np.float64))
    return float((prediction * weights).sum(dtype=np.float64)) / total if total > 0 else float("nan")


def rmse(prediction: Float[np.ndarray, "n 3"], truth: Float[np.ndarray, "n 3"]) -> float:
    """RMSE of sphere pixels, in the truth's unit of radiance."""
    return float(np.sqrt(np.mean((prediction.astype(np.float64) - truth) ** 2)))


def si_rmse(prediction: Float[np.ndarray, "n 3"], truth: Float[np.ndarray, "n 3"]) -> float:
    """Scale-invariant RMSE of sphere pixels: after multiplying the prediction by the best factor (>= 0).

    In the truth's unit of radiance. A black prediction has no factor: its error is the truth's RMS.
    """
    pixels, reference = prediction.astype(np.float64), truth.astype(np.float64)
    energy = (pixels * pixels).sum()
    factor = max(0.0, (pixels * reference).sum() / energy) if energy > 0 else 0.0
    return float(np.sqrt(np.mean((factor * pixels - reference) ** 2)))


def angular_error_deg(prediction: Float[np.ndarray, "n 3"], truth: Float[np.ndarray, "n 3"]) -> float:
    """Mean angle between the RGB vectors of corresponding sphere pixels, in degrees: colour without brightness.

    Two black pixels count 0, a black pixel against one with colour 90, the most.
    """
    pixels, reference = prediction.astype(np.float64), truth.astype(np.float64)
    # atan2 of cross and dot: arccos of the dot product loses angles below 0.02 degrees to rounding
    sine = np.linalg.norm(np.cross(pixels, reference), axis=-1)
    cosine = (pixels * reference).sum(axis=-1)
    angle = np.degrees(np.arctan2(sine, cosine))
    black, reference_black = (~image.any(axis=-1) for image in (pixels, reference))
    angle[black != reference_black] = 90.0
    return float(angle.mean())


class SphereScorer:
    """Compares spheres lit by a prediction with spheres lit by the truth, whose pictures are rendered once.

    `si_rmse_*` and `angular_deg_*` of mirror, matte silver and diffuse spheres (linear radiance, pixels of
    the sphere only), and `render_l2`, the paper's rendering loss: its glossy sphere, clamped to [0, 1], mean
    squared difference.
    """

    def __init__(self, truth: Panorama, spheres: SphereRenderer) -> None:
        """`spheres` determines the view of the spheres; scorers may share a renderer."""
        self._spheres = spheres
        self._truth = {sphere: spheres.pixels(truth, sphere) for sphere in SPHERES}
        self._glossy = np.clip(spheres.pixels(truth, "glossy"), 0, 1)

    def scores(self, prediction: Panorama) -> dict[str, float]:
        """Return the seven sphere metrics by their keys in `METRICS`."""
        glossy = np.clip(self._spheres.pixels(prediction, "glossy"), 0, 1)
        scores = {"render_l2": float(np.mean((glossy - self._glossy) ** 2, dtype=np.float64))}
        for sphere in SPHERES:
            errors = self.errors(prediction, sphere)
            scores |= {f"{key}_{sphere}": errors[key] for key in ("si_rmse", "angular_deg")}
        return scores

    def errors(self, prediction: Panorama, sphere: Material) -> dict[str, float]:
        """Return `rmse`, `si_rmse` and `angular_deg` of a sphere of `SPHERES`."""
        pixels, truth = self._spheres.pixels(prediction, sphere), self._truth[sphere]
        return {
            "rmse": rmse(pixels, truth),
            "si_rmse": si_rmse(pixels, truth),
            "angular_deg": angular_error_deg(pixels, truth),
        }


def intervals(frames: int) -> tuple[range, ...]:
    """Return the paper's five intervals as ranges of frame indices (from 0) in a sequence of `frames`.

    For 31 frames these are the paper's [1,8) [8,14) [14,20) [20,26) [26,31], counted from 0. For other lengths the
    borders keep their share of the sequence; with fewer than five frames some intervals are empty. The smoothness at
    index i is that of frames i and i + 1, so its last interval, [26,30], ends one earlier: use `intervals(frames)` and
    cut at `frames - 1`.

    Raises:
        ValueError: `frames` is negative.
    """
    if frames < 0:
        raise ValueError(f"a sequence has 0 frames or more, not {frames}")
    borders = [round((start - 1) / _PAPER_FRAMES * frames) for start in _PAPER_STARTS] + [frames]
    return tuple(range(start, stop) for start, stop in pairwise(borders))


def interval_means(values: Float[np.ndarray, " n"], frames: int) -> Float[np.ndarray, "5"]:
    """Mean of per-frame values in each interval of a sequence of `frames`; NaN where an interval is empty.

    `values` has `frames` entries, or `frames - 1` for the smoothness.

    Raises:
        ValueError: `values` has another length.
    """
    if len(values) not in (frames, max(0, frames - 1)):
        raise ValueError(f"{len(values)} values do not belong to a sequence of {frames} frames")
    parts = (values[part.start : part.stop] for part in intervals(frames))
    return np.array([part.mean() if len(part) else np.nan for part in parts])


def _mean_square(difference: Panorama) -> float:
    return float(np.mean(difference.astype(np.float64) ** 2, axis=(1, 2)).mean())
