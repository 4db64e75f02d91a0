"""Score the direction of the main light on captures, frame by frame: error, jumps, light from below.

Compared are:

- tracked: the main light of a tracked probe, as an application gets it;
- one panorama: the first of `find_lights` in the same panorama, without memory;
- cube, SH and cube, peak: a cube map of ARCore's resolution, 6 x 16 x 16 pixels, without HDR: warp-and-fill's panorama
  cut off at white. Its dominant direction is that of the first-order harmonics of luminance, or the centroid of the
  texels within 1 % of the brightest. This is not ARCore, which has a network of its own.

Directions are compared with two of the ground truth: its main light by the same extraction, and, independent of it, the
centroid of its brightest region. The brightest region is the connected one with the most light among the pixels of the
brightest 1 % of the sphere. Captures without ground truth are scored for jumps and light from below, at the point in
view of the first frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.conventions import LUMINANCE, Position, panorama_rays, panorama_solid_angles
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.files import write_json
from roomlight.light.cube import CubeMap
from roomlight.light.main_light import main_light
from roomlight.light.spherical_harmonics import project
from roomlight.placement import point_in_view
from roomlight_evaluation.baselines import WarpAndFill
from roomlight_evaluation.confidence import MeanWithInterval, mean_with_interval

METHODS: Final = ("tracked", "one panorama", "cube, SH", "cube, peak")
SETTLED_FRAME: Final = 5
"""Jumps are counted between this frame (the fifth, counted from 1) and the last one."""
JUMP_DEG: Final = 20.0
CUBE_PIXELS: Final = 16
_BRIGHT_SHARE: Final = 0.01  # of the sphere, in `brightest_region`

Direction = Float[np.ndarray, "3"]


@dataclass(frozen=True)
class DirectionTrack:
    """One method's main light at one probe of one capture.

    Attributes:
        directions: unit directions after each frame.
        truth: the truth's main light; None without ground truth.
        truth_region: the centroid of the truth's brightest region; None without ground truth.
    """

    capture: str
    probe: int
    method: str
    directions: tuple[Direction, ...]
    truth: Direction | None
    truth_region: Direction | None

    @property
    def jumps_deg(self) -> list[float]:
        """Angles between consecutive frames from `SETTLED_FRAME` on."""
        later = self.directions[SETTLED_FRAME - 1 :]
        return [angle_deg(first, second) for first, second in pairwise(later)]

    @property
    def below(self) -> float:
        """Share of the frames in which the light comes from below the horizon."""
        return float(np.mean([direction[1] < 0 for direction in self.directions]))

    def errors_deg(self, truth: Direction | None) -> list[float]:
        """Angles to a true direction, a frame each; none without ground truth."""
        return [] if truth is None else [angle_deg(direction, truth) for direction in self.directions]


@dataclass(frozen=True)
class MethodSummary:
    """One method over all tracks; errors are means over tracks, with 95 % bootstrap intervals over tracks."""

    method: str
    largest_jump_deg: float
    jumps: int
    steps: int
    below: float
    error_deg: MeanWithInterval
    last_error_deg: MeanWithInterval
    region_error_deg: MeanWithInterval


@dataclass(frozen=True)
class MainLightScores:
    """Tracks of all captures, probes and methods."""

    tracks: tuple[DirectionTrack, ...]

    def summary(self, method: str) -> MethodSummary:
        """Summarise one of `METHODS`."""
        tracks = [track for track in self.tracks if track.method == method]
        steps = [jump for track in tracks for jump in track.jumps_deg]
        errors = [track.errors_deg(track.truth) for track in tracks if track.truth is not None]
        regions = [track.errors_deg(track.truth_region) for track in tracks if track.truth_region is not None]
        return MethodSummary(
            method,
            largest_jump_deg=max(steps, default=0.0),
            jumps=sum(step > JUMP_DEG for step in steps),
            steps=len(steps),
            below=float(np.mean([direction[1] < 0 for track in tracks for direction in track.directions])),
            error_deg=mean_with_interval([float(np.mean(error)) for error in errors]),
            last_error_deg=mean_with_interval([error[-1] for error in errors]),
            region_error_deg=mean_with_interval([float(np.mean(error)) for error in regions]),
        )

    def to_json(self) -> dict[str, Any]:
        """Return every direction and score as plain JSON values."""
        return {
            "tracks": [
                {
                    "capture": track.capture,
                    "probe": track.probe,
                    "method": track.method,
                    "directions": [direction.tolist() for direction in track.directions],
                    "truth": None if track.truth is None else track.truth.tolist(),
                    "truth_region": None if track.truth_region is None else track.truth_region.tolist(),
                    "largest_jump_deg": max(track.jumps_deg, default=0.0),
                    "below": track.below,
                    "errors_deg": track.errors_deg(track.truth),
                    "region_errors_deg": track.errors_deg(track.truth_region),
                }
                for track in self.tracks
            ]
        }

    def write(self, path: Path) -> None:
        """Write `to_json` to a file atomically.

        Raises:
            OutputError: The file cannot be written.
        """
        write_json(path, self.to_json())


def evaluate_main_lights(
    captures: Sequence[Path],
    session: SessionOptions,
    *,
    options: CaptureOptions | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> MainLightScores:
    """Score the main light on captures, with or without ground truth.

    Args:
        captures: Captures of at least one frame.
        session: Options of the engine's sessions; each capture gets a new session.
        options: How captures are read.
        progress: Called as (capture name, frames done, frames in all) after each frame.

    Raises:
        ModelError: The weights that `session` names are missing or do not fit.
        CaptureError: A capture cannot be read or has no usable frame.
    """
    graphs = choose_graphs(session)
    tracks: list[DirectionTrack] = []
    for path in captures:
        capture = open_capture(path, options or CaptureOptions())
        tracks += _score_capture(capture, Session(session, graphs=graphs), progress)
    return MainLightScores(tuple(tracks))


def _score_capture(
    capture: Capture, session: Session, progress: Callable[[str, int, int], None] | None
) -> list[DirectionTrack]:
    name = capture.path.resolve().name
    probes = [probe for probe in capture.probes if probe.panorama_path is not None]
    truths = [probe.panorama() for probe in probes]
    baseline = WarpAndFill()
    positions: list[Position] = [probe.position for probe in probes]
    handles: list[int] = []
    directions_of: dict[tuple[int, str], list[Direction]] = {}
    for count, frame in enumerate(capture, 1):
        if not handles:
            positions = positions or [point_in_view(frame)]
            handles = [session.track(position) for position in positions]
        session.push(frame)
        baseline.push(frame)
        for probe, (handle, position) in enumerate(zip(handles, positions, strict=True)):
            light = session.light(handle)
            cube = CubeMap.from_panorama(np.minimum(baseline.light_at(position), 1), size=CUBE_PIXELS)
            directions = (
                light.main_light.direction,
                main_light(light.reflection).direction,
                harmonics_direction(cube),
                peak_direction(cube),
            )
            for method, direction in zip(METHODS, directions, strict=True):
                directions_of.setdefault((probe, method), []).append(direction)
        if progress is not None:
            progress(name, count, capture.frame_count - len(capture.skipped))
    targets = [(main_light(truth).direction, brightest_region(truth)) for truth in truths] or [(None, None)]
    return [
        DirectionTrack(name, probe, method, tuple(directions), *targets[probe])
        for (probe, method), directions in directions_of.items()
    ]


def brightest_region(panorama: Float[np.ndarray, "h w 3"]) -> Direction:
    """Return the centroid, by light, of the connected bright region with the most light; see the module docstring."""
    height = len(panorama)
    luminance = np.maximum(panorama @ LUMINANCE, 0).astype(np.float64)
    solid_angle = np.broadcast_to(panorama_solid_angles(height), luminance.shape)
    order = np.argsort(-luminance, axis=None)
    brighter = np.cumsum(solid_angle.reshape(-1)[order])
    threshold = luminance.reshape(-1)[order[np.searchsorted(brighter, _BRIGHT_SHARE * brighter[-1])]]
    # Twice the panorama side by side: a region across the seam is whole in the middle.
    above = luminance > threshold  # nothing, if more than that share is equally bright
    bright = np.tile(above if above.any() else luminance >= threshold, (1, 2)).astype(np.uint8)
    count, labels = cv2.connectedComponents(bright, connectivity=8)
    light = np.tile(luminance * solid_angle, (1, 2)) * (bright > 0)
    rays = np.tile(panorama_rays(height).reshape(height, 2 * height, 3), (1, 2, 1)).astype(np.float64)
    sums = np.bincount(labels.reshape(-1), light.reshape(-1), minlength=count)
    mean = ((labels == np.argmax(sums)) * light).reshape(-1) @ rays.reshape(-1, 3)
    return _unit(mean)


def harmonics_direction(cube: CubeMap) -> Direction:
    """Return the dominant direction of a cube map: that of its first-order harmonics of luminance."""
    first = project(cube.to_panorama(4 * cube.size), phase="positive").coefficients[1:4] @ LUMINANCE
    return _unit(first[[2, 0, 1]])  # the basis is y, z, x


def peak_direction(cube: CubeMap) -> Direction:
    """Return the centroid of a cube map's texels within 1 % of the brightest: in LDR, many are equally white."""
    panorama = cube.to_panorama(4 * cube.size)
    luminance = (panorama @ LUMINANCE).reshape(-1)
    weight = (luminance >= 0.99 * luminance.max()) * np.repeat(
        panorama_solid_angles(len(panorama))[:, 0], panorama.shape[1]
    )
    return _unit(weight @ panorama_rays(len(panorama)))


def angle_deg(first: Direction, second: Direction) -> float:
    """Return the angle between two unit directions."""
    return float(np.degrees(np.arccos(np.clip(first @ second, -1, 1))))


def _unit(vector: Float[np.ndarray, "3"]) -> Direction:
    length = float(np.linalg.norm(vector))
    return vector.astype(np.float64) / length if length > 1e-12 else np.array([0.0, 1.0, 0.0])
