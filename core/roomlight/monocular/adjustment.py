"""Bundle adjustment of a video's cameras: turns, places, focal length, and the scale of each picture's estimated depth.

A landmark is a feature of its host picture at an inverse depth, which the depth network states within some percent;
other pictures see it. So a camera that only turns stays where it is, and the network's metres give the scale.
Landmarks are eliminated (Schur complement), a host at a time; Levenberg-Marquardt with robust weights (Triggs et al.
2000).

Cameras: OpenCV axes (x right, y down, z forward), camera to world.
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Int

_CUT_PX: Final = 1.5
"""Reprojection error, in pixels of a 640-pixel picture, from which a feature's weight falls (Cauchy)."""
_DEPTH_ERROR: Final = 0.25
"""Relative error of the network's depth from place to place in a picture."""
_SCALE_ERROR: Final = 0.12
"""Relative error of the depth's scale from picture to picture."""
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
    """

    host: Int[np.ndarray, " k"]
    pixel: Float[np.ndarray, "k 2"]
    log_stated: Float[np.ndarray, " k"]
    landmark: Int[np.ndarray, " m"]
    picture: Int[np.ndarray, " m"]
    seen: Float[np.ndarray, "m 2"]
    unit: float
    focal_prior: tuple[float, float]


def adjusted(cameras: Cameras, sightings: Sightings, *, rounds: int = 40) -> Cameras:
    """Return the cameras and landmarks that fit the sightings best; the first camera stays."""
    damping, cost = 1e-4, _cost(cameras, sightings)
    for _ in range(rounds):
        system, right, eliminated = _normal_equations(cameras, sightings)
        while damping < 1e4:
            step = np.zeros(len(right))
            damped = system + np.diag(damping * np.diag(system) + 1e-9)
            step[6:] = np.linalg.solve(damped[6:, 6:], right[6:])  # the first camera is the world
            trial = _moved(cameras, step, eliminated)
            new = _cost(trial, sightings)
            if new < cost:
                break
            damping *= 10
        else:
            return cameras
        cameras, damping, fallen, cost = trial, damping / 10, 1 - new / cost, new
        if fallen < _CLOSE:
            break
    return cameras


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
    return (cameras.log_inverse + cameras.log_scale[sightings.host] - sightings.log_stated) / _DEPTH_ERROR


def _cost(cameras: Cameras, sightings: Sightings) -> float:
    pixels = reprojection_errors(cameras, sightings) / _CUT_PX
    depth = _depth_errors(cameras, sightings)
    prior, width = sightings.focal_prior
    priors = (cameras.log_scale / _SCALE_ERROR) @ (cameras.log_scale / _SCALE_ERROR)
    priors += (np.log(cameras.focal / prior) / width) ** 2
    return float(np.log1p(pixels**2).sum() * _CUT_PX**2 + 4 * np.log1p(depth**2 / 4).sum() + priors)


@dataclass(frozen=True, eq=False)
class _Host:
    """The landmarks of a picture as they were eliminated: `curvature` step = `right` - `coupling` step of `columns`."""

    landmarks: slice
    columns: Int[np.ndarray, " c"]
    coupling: Float[np.ndarray, "h c"]
    curvature: Float[np.ndarray, " h"]
    right: Float[np.ndarray, " h"]


def _normal_equations(
    cameras: Cameras, sightings: Sightings
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"], list[_Host]]:
    """Return the system of the cameras' steps: 6 numbers a camera (turn, centre), then scales, then the focal."""
    count = len(cameras.turns)
    size = 7 * count + 1
    system, right, hosts = np.zeros((size, size)), np.zeros(size), list[_Host]()
    jacobian, to_inverse, error = _jacobians(cameras, sightings)
    root = 1 / (sightings.unit * np.sqrt(1 + (np.linalg.norm(error, axis=1) / sightings.unit / _CUT_PX) ** 2))
    jacobian *= root[:, None, None]
    to_inverse, error = to_inverse * root[:, None], error * root[:, None]
    depth = _depth_errors(cameras, sightings)
    depth_root = 1 / (_DEPTH_ERROR * np.sqrt(1 + depth**2 / 4))
    edges = np.searchsorted(sightings.host, np.arange(count + 1))
    rows = np.searchsorted(sightings.landmark, edges)
    for host in range(count):
        marks, own = slice(edges[host], edges[host + 1]), slice(rows[host], rows[host + 1])
        number = edges[host + 1] - edges[host]
        if number == 0:
            continue
        others, place = np.unique(sightings.picture[own], return_inverse=True)
        blocks = np.concatenate([[host], others])
        columns = np.concatenate([(6 * blocks[:, None] + np.arange(6)).ravel(), [6 * count + host, size - 1]])
        seen = rows[host + 1] - rows[host]
        local = np.zeros((seen, 2, len(columns)))
        local[:, :, :6], local[:, :, -1] = jacobian[own, :, :6], jacobian[own, :, 12]
        at = 6 + 6 * place[:, None] + np.arange(6)
        np.put_along_axis(local, np.repeat(at[:, None], 2, axis=1), jacobian[own, :, 6:12], axis=2)
        mark = sightings.landmark[own] - edges[host]
        # the network's statement is a row of its own for each landmark
        weight = depth_root[marks]
        residual = depth[marks] * _DEPTH_ERROR * weight
        coupling, curvature, pull = np.zeros((number, len(columns))), weight**2, -weight * residual
        coupling[:, -2] = weight**2
        np.add.at(coupling, mark, np.einsum("rpc,rp->rc", local, to_inverse[own]))
        np.add.at(curvature, mark, (to_inverse[own] ** 2).sum(axis=1))
        np.add.at(pull, mark, -(to_inverse[own] * error[own]).sum(axis=1))
        flat = local.reshape(2 * seen, -1)
        block = flat.T @ flat - (coupling / curvature[:, None]).T @ coupling
        side = -flat.T @ error[own].ravel() - coupling.T @ (pull / curvature)
        block[-2, -2] += float(weight @ weight)
        side[-2] -= float(weight @ residual)
        system[np.ix_(columns, columns)] += block
        right[columns] += side
        hosts.append(_Host(marks, columns, coupling, curvature, pull))
    scales = np.arange(6 * count, 7 * count)
    system[scales, scales] += 1 / _SCALE_ERROR**2
    right[scales] -= cameras.log_scale / _SCALE_ERROR**2
    prior, width = sightings.focal_prior
    system[-1, -1] += 1 / width**2
    right[-1] -= np.log(cameras.focal / prior) / width**2
    return system, right, hosts


def _jacobians(
    cameras: Cameras, sightings: Sightings
) -> tuple[Float[np.ndarray, "m 2 13"], Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2"]]:
    """Return derivatives of pixels by host (turn, centre), picture and log focal; by log inverse depth; and errors."""
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
    result = np.empty((len(k), 2, 13))
    result[:, :, :3] = -to_world @ _cross(ahead)
    result[:, :, 3:6] = inverse * to_world
    result[:, :, 6:9] = to_world @ _cross(ahead + inverse[:, :, 0] * apart)
    result[:, :, 9:12] = -inverse * to_world
    rays = np.concatenate([-sightings.pixel[k] / cameras.focal, np.zeros((len(k), 1))], axis=1)
    result[:, :, 12] = pixels + np.einsum("mab,mbc,mc->ma", to_world, cameras.turns[i], rays)
    to_inverse = inverse[:, :, 0] * np.einsum("mab,mb->ma", to_world, apart)
    return result, to_inverse, pixels - sightings.seen


def _moved(cameras: Cameras, step: Float[np.ndarray, " p"], hosts: list[_Host]) -> Cameras:
    """Return the cameras after a step, and the landmarks that follow from it."""
    count = len(cameras.turns)
    moves = step[: 6 * count].reshape(count, 6)
    turns = np.stack([cv2.Rodrigues(move[:3])[0] @ turn for move, turn in zip(moves, cameras.turns, strict=True)])
    log_inverse = cameras.log_inverse.copy()
    for host in hosts:
        change = (host.right - host.coupling @ step[host.columns]) / host.curvature
        log_inverse[host.landmarks] += np.clip(change, -1, 1)
    return replace(
        cameras,
        turns=turns,
        centres=cameras.centres + moves[:, 3:],
        log_scale=cameras.log_scale + step[6 * count : 7 * count],
        log_inverse=np.clip(log_inverse, -4, 3),
        focal=cameras.focal * float(np.exp(np.clip(step[-1], -0.2, 0.2))),
    )


def _cross(vectors: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3 3"]:
    """Return the matrices whose product with a vector is the cross product."""
    matrix = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -z, y, -x
    return matrix - np.swapaxes(matrix, 1, 2)
