"""What inferred directions look like in a mirror: how coloured and how uneven they are, beside the truth.

Smears of half-seen furniture and tiles show as too much of both; a grey fog as too little.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import LUMINANCE, panorama_solid_angles

MEASURES: Final = ("saturation", "gradient energy")
"""Mean of (max - min) / max over the channels; mean squared difference of neighbours in log(1 + luminance), x 10,000.
Both of light that white cuts, as a picture shows it."""


def unseen_look(panorama: Float[np.ndarray, "h w 3"], observed: Float[np.ndarray, "h w"]) -> dict[str, float]:
    """Return each of `MEASURES` over the directions that were not observed; NaN if there are none."""
    weights = np.where(observed < 0.5, panorama_solid_angles(len(panorama)), 0)
    shown = np.clip(panorama, 0, 1)
    brightest, darkest = shown.max(axis=-1), shown.min(axis=-1)
    log = np.log1p(shown @ LUMINANCE)
    across, down = np.roll(log, -1, axis=1) - log, np.diff(log, axis=0)
    both = weights[:-1] * (weights[1:] > 0) * (np.roll(weights, -1, axis=1)[:-1] > 0)
    saturation = (brightest - darkest) / np.maximum(brightest, 0.02)
    return {
        MEASURES[0]: _mean(saturation, weights),
        MEASURES[1]: 1e4 * _mean(across[:-1] ** 2 + down**2, both),
    }


def _mean(values: Float[np.ndarray, "h w"], weights: Float[np.ndarray, "h w"]) -> float:
    total = float(weights.sum())
    return float((values * weights).sum()) / total if total > 0 else float("nan")
