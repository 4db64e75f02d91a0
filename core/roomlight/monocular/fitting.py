"""Scale and shift of estimated depth, and its errors over the picture, fitted to known depth at some pixels.

A model's 1 / depth is q, the true one t: t = a q + b. The fit minimises relative errors, robustly (iteratively
reweighted least squares with Tukey's biweight), and prior terms hold what few samples leave open.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int

from roomlight.monocular.estimate import DepthKind

LEAST_SAMPLES: Final = 8
_ROUNDS: Final = 12
_CUT: Final = 0.6
"""Relative errors beyond this do not count at all."""
_NODES: Final = (6, 5, 3)
"""Of the field of errors: across, down, and from far to near."""
_SMOOTH, _SMALL = 2.5, 1.0
"""Weight of differences between neighbouring nodes, and of the nodes, where a sample's is 1."""
_FIELD_ROUNDS: Final = 4
_FIELD_CUT: Final = 0.5


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
    aims = np.zeros(0)
    if kind != "inverse":
        rows, aims = np.array([[0.0, 1e6]]), np.zeros(1)
    if prior is not None and prior.scale > 0:
        rows = np.vstack([rows, [1 / prior.scale, 0.0]])
        aims = np.append(aims, 1.0)
        if kind == "inverse":
            rows = np.vstack([rows, [0.0, 1 / float(np.median(t))]])
            aims = np.append(aims, prior.shift / float(np.median(t)))
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
        return median_of(t[good] / q[good], weight[good]), 0.0
    order = np.argsort(q)
    half = len(q) // 2
    low, high = order[:half], order[-half:]
    rise = q[high] - q[low]
    good = rise > 0.05 * max(float(np.ptp(q)), 1e-9)
    if int(good.sum()) < LEAST_SAMPLES // 2:
        return None
    slope = float(np.median((t[high] - t[low])[good] / rise[good]))
    return (slope, float(np.median(t - slope * q))) if slope > 0 else None


def median_of(values: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    """Return the weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def error_field(
    inverse: Float32[np.ndarray, "h w"],
    pixels: Float[np.ndarray, "n 2"],
    log_ratio: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
) -> Float32[np.ndarray, "h w"]:
    """Return a smooth log correction of inverse depth, which follows the picture and depth itself.

    A network's error varies slowly over the picture, and with depth: the field is a bilateral grid (Chen et al. 2007)
    over both, fitted by least squares with Tukey's weights; nodes without samples tend to their neighbours and to 0.

    Args:
        inverse: Estimated 1 / depth, above 0.
        pixels: (column, row) of the samples.
        log_ratio: log(true / estimated) of 1 / depth there.
    """
    height, width = inverse.shape
    tone = np.log(inverse)
    low, high = np.percentile(tone[::8, ::8], (5, 95))
    tone = np.clip((tone - low) / max(float(high - low), 0.3), 0, 1) * (_NODES[2] - 1)
    columns, rows = np.floor(pixels).astype(int).T.clip(0, [[width - 1], [height - 1]])
    places = (
        np.clip(pixels[:, 0] / width * _NODES[0] - 0.5, 0, _NODES[0] - 1),
        np.clip(pixels[:, 1] / height * _NODES[1] - 0.5, 0, _NODES[1] - 1),
        tone[rows, columns],
    )
    shares, nodes = _hats(places)
    pairs = (nodes[:, :, None] * len(_FIELD_PRIOR) + nodes[:, None]).ravel()
    products = shares[:, :, None] * shares[:, None]
    values = np.zeros(len(_FIELD_PRIOR))
    for _ in range(_FIELD_ROUNDS):
        error = (shares * values[nodes]).sum(axis=1) - log_ratio
        robust = weight * np.maximum(1 - (error / _FIELD_CUT) ** 2, 0) ** 2
        system = np.bincount(pairs, (products * robust[:, None, None]).ravel(), _FIELD_PRIOR.size)
        right = np.bincount(nodes.ravel(), (shares * (robust * log_ratio)[:, None]).ravel(), len(values))
        values = np.linalg.solve(system.reshape(_FIELD_PRIOR.shape) + _FIELD_PRIOR, right)
    field = np.zeros(inverse.shape, np.float32)
    for layer, nodes in enumerate(values.reshape(_NODES[::-1]).astype(np.float32)):
        share = np.maximum(1 - np.abs(tone - layer), 0).astype(np.float32)
        field += share * cv2.resize(nodes, (width, height), interpolation=cv2.INTER_LINEAR)
    return field


def _hats(
    places: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
) -> tuple[Float[np.ndarray, "n 8"], Int[np.ndarray, "n 8"]]:
    """Return the shares of the eight nodes around each place in linear interpolation, and their numbers."""
    shares, nodes = np.ones((len(places[0]), 1)), np.zeros((len(places[0]), 1), np.int64)
    for place, count in zip(reversed(places), reversed(_NODES), strict=True):
        low = np.minimum(place.astype(int), count - 2)[:, None]
        high = place[:, None] - low
        shares = np.concatenate([shares * (1 - high), shares * high], axis=1)
        nodes = np.concatenate([nodes * count + low, nodes * count + low + 1], axis=1)
    return shares, nodes


def _field_prior() -> Float[np.ndarray, "k k"]:
    """Return the precision of the field's nodes without samples."""
    total = _SMALL * np.eye(int(np.prod(_NODES)))
    for axis, count in enumerate(_NODES[::-1]):
        step = np.diff(np.eye(count), axis=0)
        parts = [np.eye(other) for other in _NODES[::-1]]
        parts[axis] = step.T @ step
        total += _SMOOTH * np.kron(np.kron(parts[0], parts[1]), parts[2])
    return total


_FIELD_PRIOR: Final = _field_prior()
