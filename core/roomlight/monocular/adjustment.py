"""Bundle adjustment of a video's cameras: turns, places, focal length, and the scale of each picture's estimated depth.

A landmark is a feature of its host picture at an inverse depth, which the depth network states within some percent;
other pictures see it. So a camera that only turns stays where it is, and the network's metres give the scale.
Landmarks are eliminated (Schur complement); Levenberg-Marquardt with robust weights (Triggs et al.
2000).

Cameras: OpenCV axes (x right, y down, z forward), camera to world.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int

from roomlight.monocular.kernels.adjustment import add_reduced

_CUT_PX: Final = 1.5
"""Reprojection error, in pixels of a 640-pixel picture, from which a feature's weight falls (Cauchy)."""
_SCALE_ERROR: Final = 0.12
"""Relative error of the depth's scale from picture to picture."""
_PARALLAX: Final = 4.0
"""Squared pixels by which a landmark moves when its depth changes e-fold, from which its depth is known."""
_LEAST: Final = 20
"""Landmarks with parallax that tell the scale."""
_CLOSE: Final = 1e-3
"""Relative fall of the cost below which the adjustment ends."""


@dataclass(frozen=True, eq=False)
class Cameras:
    """What is adjusted. World: that of the first camera.

    Attributes:
        turns: Camera-to-world rotations.
        centres: In metres.
        log_scale: Logarithm of the factor on each picture's estimated depth.
        log_inverse: Logarithm of each landmark's inverse depth in its host.
        focal: In pixels.
    """

    turns: Float[np.ndarray, "n 3 3"]
    centres: Float[np.ndarray, "n 3"]
    log_scale: Float[np.ndarray, " n"]
    log_inverse: Float[np.ndarray, " k"]
    focal: float


@dataclass(frozen=True, eq=False)
class Sightings:
    """What was seen. Pixels are relative to the principal point.

    Attributes:
        host: Picture of each landmark, ascending.
        pixel: Of each landmark in its host.
        log_stated: Logarithm of the network's inverse depth.
        landmark: Of each sighting, ascending.
        picture: Of each sighting; never its landmark's host.
        seen: Pixel of each sighting.
        unit: Pixels that are one pixel of a 640-pixel picture.
        focal_prior: (focal length in pixels, its relative error).
        depth_error: Relative error of the network's depth from place to place in a picture.
    """

    host: Int[np.ndarray, " k"]
    pixel: Float[np.ndarray, "k 2"]
    log_stated: Float[np.ndarray, " k"]
    landmark: Int[np.ndarray, " m"]
    picture: Int[np.ndarray, " m"]
    seen: Float[np.ndarray, "m 2"]
    unit: float
    focal_prior: tuple[float, float]
    depth_error: float


def adjusted(cameras: Cameras, sightings: Sightings, *, rounds: int = 40) -> Cameras:
    """Return the cameras and landmarks that fit the sightings best; the first camera stays."""
    damping, cost = 1e-4, _cost(cameras, sightings)
    for _ in range(rounds):
        system, right, landmarks = _normal_equations(cameras, sightings)
        easing = 3.0  # Levenberg and Marquardt's factor for less damping; none after steps that failed
        while damping < 1e4:
            step = np.zeros(len(right))
            damped = system + np.diag(damping * np.diag(system) + 1e-9)
            step[6:] = np.linalg.solve(damped[6:, 6:], right[6:])  # the first camera is the world
            trial = _moved(cameras, step, _eased(landmarks, sightings.landmark, step))
            new = _cost(trial, sightings)
            if new < cost:
                break
            damping, easing = damping * 10, 1.0
        else:
            return cameras
        cameras, damping, fallen, cost = trial, damping / easing, 1 - new / cost, new
        if fallen < _CLOSE:
            break
    return cameras


def in_metres(cameras: Cameras, sightings: Sightings) -> Cameras:
    """Scale the world until landmarks whose depth follows from parallax have the network's depth, in the median.

    The scale is the direction in which the cost hardly changes, so that the adjustment ends early in it.
    """
    _, to_inverse, _ = _jacobians(cameras, sightings)
    known = np.bincount(sightings.landmark, (to_inverse**2).sum(axis=1), len(sightings.host)) / sightings.unit**2
    by_parallax = known > _PARALLAX
    if by_parallax.sum() < _LEAST:
        return cameras
    apart = cameras.log_inverse - sightings.log_stated
    change = float(np.median(apart[by_parallax]))
    inverse = np.where(by_parallax, cameras.log_inverse - change, cameras.log_inverse)
    return replace(cameras, centres=cameras.centres * np.exp(change), log_inverse=inverse)


def reprojection_errors(cameras: Cameras, sightings: Sightings) -> Float[np.ndarray, " m"]:
    """Return the distance of each sighting from where it should be, in pixels of a 640-pixel picture."""
    error = _projected(cameras, sightings)[0] - sightings.seen
    return np.linalg.norm(error, axis=1) / sightings.unit


def _projected(
    cameras: Cameras, sightings: Sightings
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Return pixels, the landmarks' directions from the host in the world, and points in the seeing camera."""
    k, j = sightings.landmark, sightings.picture
    i = sightings.host[k]
    rays = np.concatenate([sightings.pixel[k] / cameras.focal, np.ones((len(k), 1))], axis=1)
    ahead = np.einsum("mab,mb->ma", cameras.turns[i], rays)
    inverse = np.exp(cameras.log_inverse[k])[:, None]
    points = ahead + inverse * (cameras.centres[i] - cameras.centres[j])
    local = np.einsum("mba,mb->ma", cameras.turns[j], points)
    depth = np.maximum(local[:, 2:], 1e-3)
    return cameras.focal * local[:, :2] / depth, ahead, np.concatenate([local[:, :2], depth], axis=1)


def _depth_errors(cameras: Cameras, sightings: Sightings) -> Float[np.ndarray, " k"]:
    return (cameras.log_inverse + cameras.log_scale[sightings.host] - sightings.log_stated) / sightings.depth_error


def _cost(cameras: Cameras, sightings: Sightings) -> float:
    pixels = reprojection_errors(cameras, sightings) / _CUT_PX
    depth = _depth_errors(cameras, sightings)
    prior, width = sightings.focal_prior
    priors = (cameras.log_scale / _SCALE_ERROR) @ (cameras.log_scale / _SCALE_ERROR)
    priors += (np.log(cameras.focal / prior) / width) ** 2
    return float(np.log1p(pixels**2).sum() * _CUT_PX**2 + 4 * np.log1p(depth**2 / 4).sum() + priors)


class _Landmarks(NamedTuple):
    """What follows for the landmarks: `curvature` step = `pull` - sum of `coupling` steps of `columns`."""

    columns: Int[np.ndarray, "m c"]
    coupling: Float[np.ndarray, "m c"]
    curvature: Float[np.ndarray, " k"]
    pull: Float[np.ndarray, " k"]


def _normal_equations(
    cameras: Cameras, sightings: Sightings
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"], _Landmarks]:
    """Return the system of the cameras' steps: 6 numbers a camera (turn, centre), then scales, then the focal."""
    count, (mark, picture) = len(cameras.turns), (sightings.landmark, sightings.picture)
    host, marks, last = sightings.host[mark], len(sightings.host), 7 * count
    jacobian, to_inverse, error = _jacobians(cameras, sightings)
    root = 1 / (sightings.unit * np.sqrt(1 + (np.linalg.norm(error, axis=1) / sightings.unit / _CUT_PX) ** 2))
    jacobian *= root[:, None, None]
    to_inverse, error = to_inverse * root[:, None], error * root[:, None]
    # the network's statement of a landmark's depth is a row of its own
    depth = _depth_errors(cameras, sightings)
    stated = 1 / (sightings.depth_error**2 * (1 + depth**2 / 4))
    residual = depth * sightings.depth_error * stated
    curvature = stated + np.bincount(mark, (to_inverse**2).sum(axis=1), marks)
    pull = -residual - np.bincount(mark, (to_inverse * error).sum(axis=1), marks)
    first = np.searchsorted(mark, np.arange(marks + 1))
    seen = first[1:] > first[:-1]
    coupling = np.einsum("mrc,mr->mc", jacobian, to_inverse)
    coupling[first[:-1][seen], 12] = stated[seen]
    blocks = [6 * host[:, None] + np.arange(6), 6 * picture[:, None] + np.arange(6), 6 * count + host[:, None]]
    columns = np.concatenate([*blocks, np.full((len(mark), 1), last)], axis=1)

    system, right = np.zeros((last + 1, last + 1)), np.zeros(last + 1)
    add_reduced(first, columns, jacobian, coupling, curvature, error, pull, system, right)
    scales = np.arange(6 * count, last)
    system[scales, scales] += np.bincount(sightings.host[seen], stated[seen], count) + 1 / _SCALE_ERROR**2
    right[scales] -= np.bincount(sightings.host[seen], residual[seen], count) + cameras.log_scale / _SCALE_ERROR**2
    prior, width = sightings.focal_prior
    system[-1, -1] += 1 / width**2
    right[-1] -= np.log(cameras.focal / prior) / width**2
    return system, right, _Landmarks(columns, coupling, curvature, pull)


def _jacobians(
    cameras: Cameras, sightings: Sightings
) -> tuple[Float[np.ndarray, "m 2 14"], Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2"]]:
    """Return derivatives of pixels by host (turn, centre), picture, scale and focal; by log inverse depth; errors."""
    k, j = sightings.landmark, sightings.picture
    i = sightings.host[k]
    pixels, ahead, local = _projected(cameras, sightings)
    inverse = np.exp(cameras.log_inverse[k])[:, None, None]
    back = np.swapaxes(cameras.turns[j], 1, 2)  # world to camera
    project = np.zeros((len(k), 2, 3))
    project[:, 0, 0] = project[:, 1, 1] = cameras.focal / local[:, 2]
    project[:, :, 2] = -pixels / local[:, 2:]
    to_world = project @ back  # by the point in the world
    apart = cameras.centres[i] - cameras.centres[j]
    result = np.zeros((len(k), 2, 14))
    result[:, :, :3] = -to_world @ _cross(ahead)
    result[:, :, 3:6] = inverse * to_world
    result[:, :, 6:9] = to_world @ _cross(ahead + inverse[:, :, 0] * apart)
    result[:, :, 9:12] = -inverse * to_world
    rays = np.concatenate([-sightings.pixel[k] / cameras.focal, np.zeros((len(k), 1))], axis=1)
    result[:, :, 13] = pixels + np.einsum("mab,mbc,mc->ma", to_world, cameras.turns[i], rays)
    to_inverse = inverse[:, :, 0] * np.einsum("mab,mb->ma", to_world, apart)
    return result, to_inverse, pixels - sightings.seen


def _eased(
    landmarks: _Landmarks, mark: Int[np.ndarray, " m"], step: Float[np.ndarray, " p"]
) -> Float[np.ndarray, " k"]:
    """Return the steps of the landmarks that follow from the cameras'; `mark` is each sighting's landmark."""
    explained = (landmarks.coupling * step[landmarks.columns]).sum(axis=1)
    return (landmarks.pull - np.bincount(mark, explained, len(landmarks.pull))) / landmarks.curvature


def _moved(cameras: Cameras, step: Float[np.ndarray, " p"], nearer: Float[np.ndarray, " k"]) -> Cameras:
    """Return the cameras and landmarks after their steps."""
    count = len(cameras.turns)
    moves = step[: 6 * count].reshape(count, 6)
    turns = np.stack([cv2.Rodrigues(move[:3])[0] @ turn for move, turn in zip(moves, cameras.turns, strict=True)])
    return replace(
        cameras,
        turns=turns,
        centres=cameras.centres + moves[:, 3:],
        log_scale=cameras.log_scale + step[6 * count : 7 * count],
        log_inverse=np.clip(cameras.log_inverse + np.clip(nearer, -1, 1), -4, 3),
        focal=cameras.focal * float(np.exp(np.clip(step[-1], -0.2, 0.2))),
    )


def _cross(vectors: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3 3"]:
    """Return the matrices whose product with a vector is the cross product."""
    matrix = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -z, y, -x
    return matrix - np.swapaxes(matrix, 1, 2)
