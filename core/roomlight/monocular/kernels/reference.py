"""Readable references of the kernels in NumPy: tests compare the fast ones with them. Arguments as theirs."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8, UInt32

from roomlight.monocular.kernels.sweep import MOST, REACH, UNSEEN


def census_reference(grey: UInt8[np.ndarray, "h w"], margin: int) -> UInt32[np.ndarray, "2 h w"]:
    """Compute `census_rows` of a whole picture."""
    padded = np.pad(grey.astype(int), REACH, mode="edge")
    height, width = grey.shape
    signs, bit = np.zeros((2, height, width), np.uint32), 0
    for dy in range(-3, 4):
        for dx in range(-4, 5):
            if (dx + dy) % 2 == 0 and (dx, dy) != (0, 0):
                moved = padded[REACH + dy : REACH + dy + height, REACH + dx : REACH + dx + width]
                signs[0] |= (moved - grey > margin).astype(np.uint32) << np.uint32(bit)
                signs[1] |= (grey.astype(int) - moved > margin).astype(np.uint32) << np.uint32(bit)
                bit += 1
    return signs


def sweep_reference(
    census: UInt32[np.ndarray, "2 h w"],
    others: UInt32[np.ndarray, "n 2 h w"],
    projections: Float32[np.ndarray, "n 3 4"],
    inverses: Float32[np.ndarray, " k"],
    guess: Float32[np.ndarray, "gh gw"],
    prior: float,
    step: int,
) -> tuple[Float[np.ndarray, "gh gw k"], Float[np.ndarray, "gh gw"]]:
    """Compute `sweep_rows` of a whole grid: costs and contrast."""
    height, width = census.shape[1:]
    rows, columns, tones = np.meshgrid(
        step // 2 + step * np.arange(guess.shape[0]),
        step // 2 + step * np.arange(guess.shape[1]),
        inverses,
        indexing="ij",
    )
    points = np.stack([columns + 0.5, rows + 0.5, np.ones(rows.shape), tones], axis=-1)
    all_costs: list[Float[np.ndarray, "gh gw k"]] = []
    for other, projection in zip(others, projections, strict=True):
        there = points @ projection.T.astype(np.float64)
        u, v = there[..., 0] / there[..., 2], there[..., 1] / there[..., 2]
        inside = (there[..., 2] > 1e-6) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
        x, y = np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int)
        differ = np.bitwise_count(census[:, rows, columns] ^ other[:, y, x]).sum(axis=0)
        all_costs.append(np.where(inside, differ / 31, np.inf))
    ordered = np.sort(all_costs, axis=0)
    seen = np.isfinite(ordered).sum(axis=0)
    told = np.where(seen > 2, ordered[:2].mean(axis=0), ordered[0]) if len(ordered) > 1 else ordered[0]
    contrast = np.where(seen > 0, told, 0).max(axis=-1) - np.where(seen > 0, told, 2).min(axis=-1)
    far = np.minimum(np.abs(np.log(inverses) - np.log(guess)[..., None]), 1)
    return np.minimum(np.where(seen > 0, told, UNSEEN), MOST) + prior * far, np.maximum(contrast, 0)


def aggregate_reference(
    costs: Float32[np.ndarray, "gh gw k"],
    grey: UInt8[np.ndarray, "gh gw"],
    penalties: Float32[np.ndarray, "3"],
    dy: int,
    dx: int,
) -> Float[np.ndarray, "gh gw k"]:
    """Compute what `aggregate_lines` adds for one direction: each pixel follows the one before it."""
    height, width, depths = costs.shape
    near, far, edge = penalties.astype(np.float64)
    sums = np.zeros(costs.shape)
    apart = np.abs(np.arange(depths)[:, None] - np.arange(depths))
    for row in range(height) if dy >= 0 else reversed(range(height)):
        for column in range(width) if dx >= 0 else reversed(range(width)):
            y, x = row - dy, column - dx
            sums[row, column] = costs[row, column]
            if 0 <= y < height and 0 <= x < width:
                jump = max(far * edge / (edge + abs(int(grey[row, column]) - int(grey[y, x]))), near)
                steps = np.where(apart == 0, 0, np.where(apart == 1, near, jump))
                sums[row, column] += (sums[y, x] + steps).min(axis=1) - sums[y, x].min()
    return sums


def decide_reference(
    sums: Float32[np.ndarray, "gh gw k"], tones: Float32[np.ndarray, " k"], heat: float
) -> tuple[Float[np.ndarray, "gh gw"], Float[np.ndarray, "gh gw"]]:
    """Compute `decide_rows` of a whole grid."""
    shares = np.exp((sums.min(axis=-1, keepdims=True) - sums.astype(np.float64)) / heat)
    best = sums.argmin(axis=-1)[..., None]
    near = shares * (np.abs(np.arange(len(tones)) - best) <= 2)
    shares /= shares.sum(axis=-1, keepdims=True)
    mean = (shares * tones).sum(axis=-1)
    spread = np.sqrt(np.maximum((shares * tones**2).sum(axis=-1) - mean**2, 0))
    return (near * tones).sum(axis=-1) / near.sum(axis=-1), spread


def reduced_reference(
    first: Int[np.ndarray, " k+1"],
    columns: Int[np.ndarray, "m c"],
    jacobian: Float[np.ndarray, "m 2 c"],
    coupling: Float[np.ndarray, "m c"],
    curvature: Float[np.ndarray, " k"],
    error: Float[np.ndarray, "m 2"],
    pull: Float[np.ndarray, " k"],
    size: int,
) -> tuple[Float[np.ndarray, "{size} {size}"], Float[np.ndarray, " {size}"]]:
    """Compute what `add_reduced` adds to a system of `size` unknowns."""
    wide, couplings = np.zeros((*error.shape, size)), np.zeros((len(curvature), size))
    for mark, (start, stop) in enumerate(pairwise(first)):
        for own in range(start, stop):
            np.add.at(couplings[mark], columns[own], coupling[own])
            for axis in range(2):
                np.add.at(wide[own, axis], columns[own], jacobian[own, axis])
    system = np.einsum("mai,maj->ij", wide, wide) - np.einsum("ki,kj,k->ij", couplings, couplings, 1 / curvature)
    return system, -np.einsum("mai,ma->i", wide, error) - couplings.T @ (pull / curvature)
