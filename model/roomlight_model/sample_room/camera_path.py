"""The hand-held walk through the sample room: poses, and where its probes are.

Frames: world, y up, metres; camera x right, y up, z backward; azimuth in the panorama's sense (0 looks along +x, 90
along +z).
"""

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics

FRAME_INTERVAL_S = 1 / 3
"""Frames a third of a second apart: every tenth of a 30 Hz recording."""

PROBES_M = ((-0.36, 0.90, 0.54), (-1.35, 1.0, 0.55), (0.16, 0.55, 0.55))
"""Over the coffee table, over the sofa's seat, and lower before the table: all in the first frame's view."""

_STATIONS = np.array([
    [1.60, 1.50, 1.12],
    [1.28, 1.45, 1.28],
    [0.78, 1.42, 1.44],
    [0.15, 1.44, 1.46],
    [-0.45, 1.50, 1.36],
    [-1.00, 1.48, 1.10],
])  # fmt: skip


def intrinsics(width: int, height: int) -> Intrinsics:
    """A phone's wide camera, 58 degrees across: 289 px at 320 x 240."""
    focal = 289.0 * width / 320
    return Intrinsics(focal, focal, width / 2, height / 2, width, height)


def poses(frames: int, *, seed: int = 7) -> Float[np.ndarray, "{frames} 4 4"]:
    """Camera-to-world poses from the sofa over the window to the shelf, with the sway of a hand."""
    t = np.linspace(0, 1, frames)
    phase = np.random.default_rng([seed, 3]).uniform(0, 2 * np.pi, 6)
    at = _curve(_STATIONS, t)
    sway = 2 * np.pi * t[:, None] * np.array([3.1, 4.3, 2.7, 3.7, 5.1, 2.3])
    wobble = np.sin(sway + phase)
    at += wobble[:, :3] * np.array([0.012, 0.014, 0.012])
    azimuth = np.radians(207.0 + 136.0 * t + 1.6 * wobble[:, 3])
    pitch = np.radians(-14.5 + 12.5 * np.sin(np.pi * t) ** 1.5 + 1.2 * wobble[:, 4])
    roll = np.radians(0.9 * wobble[:, 5])
    return np.stack([_look(*row) for row in zip(at, azimuth, pitch, roll, strict=True)])


def _look(position_m: Float[np.ndarray, "3"], azimuth: float, pitch: float, roll: float) -> Float[np.ndarray, "4 4"]:
    forward = np.array([np.cos(pitch) * np.cos(azimuth), np.sin(pitch), np.cos(pitch) * np.sin(azimuth)])
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    pose = np.eye(4)
    pose[:3, 0] = np.cos(roll) * right + np.sin(roll) * up
    pose[:3, 1] = np.cos(roll) * up - np.sin(roll) * right
    pose[:3, 2] = -forward
    pose[:3, 3] = position_m
    return pose


def _curve(stations: Float[np.ndarray, "k 3"], t: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Catmull-Rom through the stations, by arc length: the walk neither stops nor jumps."""
    ends = np.concatenate([2 * stations[:1] - stations[1:2], stations, 2 * stations[-1:] - stations[-2:-1]])

    def point(s: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
        scaled = s * (len(stations) - 1)
        index = np.minimum(scaled.astype(np.int64), len(stations) - 2)
        x = (scaled - index)[:, None]
        p0, p1, p2, p3 = (ends[index + k] for k in range(4))
        cubic = (3 * p1 - 3 * p2 + p3 - p0) * x**3 + (2 * p0 - 5 * p1 + 4 * p2 - p3) * x**2
        return 0.5 * (2 * p1 + (p2 - p0) * x + cubic)

    fine = np.linspace(0, 1, 400)
    run = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(point(fine), axis=0), axis=1))])
    return point(np.interp(t * run[-1], run, fine))
