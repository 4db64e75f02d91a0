"""The wrapper of Embree against the intersection of each ray with each triangle."""

import numpy as np
import pytest

from roomlight.rays import BLOCK_RAYS, RayTree


def triangles(count: int = 40, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(0, 0.3, (count, 3, 3))).astype(np.float32)


def rays(count: int, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-2, 2, (count, 3)).astype(np.float32)
    toward = rng.uniform(-1, 1, (count, 3)) - origins
    return origins, (toward / np.linalg.norm(toward, axis=1, keepdims=True)).astype(np.float32)


def brute_force(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances and barycentrics of all pairs [n, f], inf where they miss (Moeller, Trumbore 1997)."""
    a, e, g = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(directions[:, None], g)
    scale = 1 / (p * e).sum(-1)
    s = origins[:, None] - a
    q = np.cross(s, e)
    u, v = (s * p).sum(-1) * scale, (directions[:, None] * q).sum(-1) * scale
    distance = (g * q).sum(-1) * scale
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0), distance, np.inf), np.stack([u, v], -1)


def tree_of(corners: np.ndarray, *, robust: bool = True) -> RayTree:
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return RayTree(corners.reshape(-1, 3), faces, robust=robust)


@pytest.mark.parametrize("robust", [True, False])
def test_nearest_triangles_are_those_of_brute_force(robust: bool) -> None:
    corners, (origins, directions) = triangles(), rays(2000)
    expected, barycentrics = brute_force(corners, *(part.astype(np.float64) for part in (origins, directions)))
    found = tree_of(corners, robust=robust).trace(origins, directions)
    nearest, least = expected.argmin(axis=1), expected.min(axis=1)
    same = np.where(np.isfinite(least), nearest, -1) == found.face
    assert same.mean() > 0.999  # rays through edges may differ by rounding
    hit = same & (found.face >= 0)
    assert 200 < hit.sum() < 1900
    np.testing.assert_allclose(found.distance_m[hit], least[hit], rtol=1e-4)
    weights = barycentrics[np.arange(2000), nearest][hit]
    np.testing.assert_allclose(np.stack([found.u, found.v], 1)[hit], weights, atol=2e-3)
    assert np.isinf(found.distance_m[found.face < 0]).all()


def test_blocked_rays_end_at_their_reach_and_reach_is_kept() -> None:
    corners, (origins, directions) = triangles(), rays(500)
    tree = tree_of(corners)
    distance_m = tree.trace(origins, directions).distance_m
    hit = np.isfinite(distance_m)
    assert (tree.blocked(origins, directions) == hit).all()
    short, long = np.where(hit, 0.99 * distance_m, 5.0), np.where(hit, 1.01 * distance_m, 5.0)
    kept = short.copy()
    assert not tree.blocked(origins, directions, short).any()
    assert (short == kept).all()
    assert (tree.blocked(origins, directions, long) == hit).all()


def test_blocks_and_no_rays_give_the_same() -> None:
    corners, (origins, directions) = triangles(), rays(BLOCK_RAYS + 7)
    tree = tree_of(corners)
    whole = tree.trace(origins, directions)
    for column, part in zip(whole, tree.trace_here(origins, directions), strict=True):
        np.testing.assert_array_equal(column, part)
    assert len(tree.trace(origins[:0], directions[:0]).face) == len(tree.blocked(origins[:0], directions[:0])) == 0
