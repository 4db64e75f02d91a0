"""Scale and shift of estimated depth, fitted to known depth at some pixels.

A model's 1 / depth is q, the true one t: t = a q + b. The fit minimises relative errors, robustly (iteratively
reweighted least squares with Tukey's biweight), and prior terms hold what few samples leave open.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.monocular.estimate import DepthKind

LEAST_SAMPLES: Final = 8
_ROUNDS: Final = 12
_CUT: Final = 0.6
"""Relative errors beyond this do not count at all."""


@dataclass(frozen=True)
class Fit:
    """t = scale q + shift, and how many samples agree with it."""

    scale: float
    shift: float = 0.0
    samples: int = 0


def fit_inverse(
    estimated: Float[np.ndarray, " n"],
    true: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    *,
    kind: DepthKind,
    prior: Fit | None,
) -> Fit | None:
    """Fit scale, and for inverse depth shift; None if too few samples say anything and there is no prior.

    Args:
        estimated: q at the samples.
        true: t at the samples, per metre.
        weight: Of the samples.
        kind: Only inverse depth has a shift.
        prior: The fit of earlier frames; it weighs as much as a few samples.
    """
    if len(true) < LEAST_SAMPLES:
        return prior
    q, t = estimated.astype(np.float64), np.maximum(true.astype(np.float64), 1e-3)
    start = _start(q, t, weight, kind)
    if start is None:
        return prior
    columns, target, base = np.stack([q / t, 1 / t], axis=1), np.ones(len(t)), weight.astype(np.float64)
    rows = np.zeros((0, 2))
    aims, strength = np.zeros(0), 1.0
    if kind != "inverse":
        rows, aims = np.array([[0.0, 1e6]]), np.zeros(1)
    if prior is not None and prior.scale > 0:
        rows = np.vstack([rows, [strength / prior.scale, 0.0]])
        aims = np.append(aims, strength)
        if kind == "inverse":
            rows = np.vstack([rows, [0.0, strength / float(np.median(t))]])
            aims = np.append(aims, strength * prior.shift / float(np.median(t)))
    a, b = start
    for number in range(_ROUNDS):
        residual = columns @ (a, b) - target
        cut = max(_CUT * 0.8**number, 3 * 1.4826 * float(np.median(np.abs(residual))), 0.05)
        robust = base * np.maximum(1 - (residual / cut) ** 2, 0) ** 2
        root = np.sqrt(robust)[:, None]
        system, right = np.vstack([columns * root, rows]), np.concatenate([target * root[:, 0], aims])
        (a, b), *_ = np.linalg.lstsq(system, right, rcond=None)
    agree = np.abs(columns @ (a, b) - target) < 0.25
    if a <= 0 or int(agree.sum()) < LEAST_SAMPLES:
        return prior
    return Fit(float(a), float(b) if kind == "inverse" else 0.0, int(agree.sum()))


def _start(
    q: Float[np.ndarray, " n"], t: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"], kind: DepthKind
) -> tuple[float, float] | None:
    """Return a first fit: the weighted median ratio; with a shift, the median line through pairs of samples."""
    if kind != "inverse":
        good = q > 1e-9
        if int(good.sum()) < LEAST_SAMPLES:
            return None
        ratio, share = t[good] / q[good], weight[good]
        order = np.argsort(ratio)
        total = np.cumsum(share[order])
        return float(ratio[order][np.searchsorted(total, total[-1] / 2)]), 0.0
    order = np.argsort(q)
    half = len(q) // 2
    low, high = order[:half], order[-half:]
    rise = q[high] - q[low]
    good = rise > 0.05 * max(float(np.ptp(q)), 1e-9)
    if int(good.sum()) < LEAST_SAMPLES // 2:
        return None
    slope = float(np.median((t[high] - t[low])[good] / rise[good]))
    return (slope, float(np.median(t - slope * q))) if slope > 0 else None
