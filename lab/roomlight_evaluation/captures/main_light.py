"""Score the direction of the main light on captures, frame by frame: error, jumps, light from below.

Compared are:

- tracked: the main light of a tracked probe, as an application gets it;
- one panorama: the first of `find_lights` in the same panorama, without memory.

Directions are compared with the ground truth's main light by the same extraction. Captures without ground truth are
scored for jumps and light from below, at the point in view of the first frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from rich.table import Table

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.imaging.tables import figure_table
from roomlight.light.main_light import main_light
from roomlight.placement import point_in_view
from roomlight_evaluation.captures.evaluation import capture_names, capture_room
from roomlight_evaluation.confidence import MeanWithInterval, mean_cell, mean_with_interval, resampled

METHODS: Final = ("tracked", "one panorama")
SETTLED_FRAME: Final = 5
"""Jumps are counted between this frame (the fifth, counted from 1) and the last one."""
JUMP_DEG: Final = 20.0

Direction = Float[np.ndarray, "3"]


@dataclass(frozen=True)
class DirectionTrack:
    """One method's main light at one probe of one capture.

    Attributes:
        directions: unit directions after each frame.
        truth: the truth's main light; None without ground truth.
        room: the same of captures of one room; None: no other is of this one's.
    """

    capture: str
    probe: int
    method: str
    directions: tuple[Direction, ...]
    truth: Direction | None
    room: str | None = None

    @property
    def jumps_deg(self) -> list[float]:
        """Angles between consecutive frames from `SETTLED_FRAME` on."""
        later = self.directions[SETTLED_FRAME - 1 :]
        return [angle_deg(first, second) for first, second in pairwise(later)]

    @property
    def below(self) -> float:
        """Share of the frames in which the light comes from below the horizon."""
        return float(np.mean([direction[1] < 0 for direction in self.directions]))

    @property
    def errors_deg(self) -> list[float]:
        """Angles to the true direction, a frame each; none without ground truth."""
        return [] if self.truth is None else [angle_deg(direction, self.truth) for direction in self.directions]


@dataclass(frozen=True)
class MethodSummary:
    """One method over all tracks; errors are means over tracks, with 95 % bootstrap intervals over rooms, or over
    the tracks of a single capture."""

    method: str
    largest_jump_deg: float
    jumps: int
    steps: int
    below: float
    error_deg: MeanWithInterval
    last_error_deg: MeanWithInterval


@dataclass(frozen=True)
class MainLightScores:
    """Tracks of all captures, probes and methods."""

    tracks: tuple[DirectionTrack, ...]

    @property
    def rooms(self) -> dict[str, str]:
        """The room of each capture with ground truth."""
        return {track.capture: track.room or track.capture for track in self.tracks if track.truth is not None}

    def summary(self, method: str) -> MethodSummary:
        """Summarise one of `METHODS`."""
        tracks = [track for track in self.tracks if track.method == method]
        steps = [jump for track in tracks for jump in track.jumps_deg]
        known = [track for track in tracks if track.truth is not None]
        errors, rooms = [track.errors_deg for track in known], self.rooms
        groups = [rooms[track.capture] for track in known] if len(rooms) > 1 else None
        return MethodSummary(
            method,
            largest_jump_deg=max(steps, default=0.0),
            jumps=sum(step > JUMP_DEG for step in steps),
            steps=len(steps),
            below=float(np.mean([direction[1] < 0 for track in tracks for direction in track.directions])),
            error_deg=mean_with_interval([float(np.mean(error)) for error in errors], groups),
            last_error_deg=mean_with_interval([error[-1] for error in errors], groups),
        )

    def to_json(self) -> dict[str, Any]:
        """Return every direction and score as JSON values and arrays."""

        def scored(track: DirectionTrack) -> dict[str, Any]:
            scores = {"largest_jump_deg": max(track.jumps_deg, default=0.0), "below": track.below}
            return asdict(track) | scores | {"errors_deg": track.errors_deg}

        return {"tracks": [scored(track) for track in self.tracks]}


def evaluate_main_lights(
    captures: Sequence[Path],
    session: SessionOptions,
    *,
    options: CaptureOptions | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> MainLightScores:
    """Score the main light on captures, with or without ground truth.

    Args:
        session: Options of the engine's sessions; each capture gets a new session.
        progress: Called as (capture name, frames done, frames in all) after each frame.

    Raises:
        ModelError: The weights that `session` names are missing or do not fit.
        CaptureError: A capture cannot be read or has no usable frame, or two captures have one name.
    """
    names, graphs = capture_names(captures), choose_graphs(session)
    tracks: list[DirectionTrack] = []
    for name, path in zip(names, captures, strict=True):
        capture = open_capture(path, options or CaptureOptions())
        tracks += _score_capture(capture, name, Session(session, graphs=graphs), progress)
    return MainLightScores(tuple(tracks))


def _score_capture(
    capture: Capture, name: str, session: Session, progress: Callable[[str, int, int], None] | None
) -> list[DirectionTrack]:
    room = capture_room(capture.path)
    truths = [main_light(probe.panorama()).direction for probe in capture.truths] or [None]
    positions: list[Position] = [probe.position for probe in capture.truths]
    handles: list[int] = []
    directions_of: dict[tuple[int, str], list[Direction]] = {}
    for count, frame in enumerate(capture, 1):
        if not handles:
            positions = positions or [point_in_view(frame)]
            handles = [session.track(position) for position in positions]
        session.push(frame)
        for probe, handle in enumerate(handles):
            light = session.light(handle)
            directions = light.main_light.direction, main_light(light.reflection).direction
            for method, direction in zip(METHODS, directions, strict=True):
                directions_of.setdefault((probe, method), []).append(direction)
        if progress is not None:
            progress(name, count, capture.frame_count - len(capture.skipped))
    return [
        DirectionTrack(name, probe, method, tuple(directions), truths[probe], room)
        for (probe, method), directions in directions_of.items()
    ]


def angle_deg(first: Direction, second: Direction) -> float:
    """Return the angle between two unit directions."""
    return float(np.degrees(np.arccos(np.clip(first @ second, -1, 1))))


def main_light_table(scores: MainLightScores) -> Table:
    """Return the table: jumps after the fifth frame, share from below, mean errors with 95 % intervals."""
    sequences = len({(track.capture, track.probe) for track in scores.tracks})
    known = {(track.capture, track.probe) for track in scores.tracks if track.truth is not None}
    table = figure_table(
        f"Main light, probes: {sequences}",
        ("largest\njump", f"over {JUMP_DEG:g}", "below", "error", "last\nframe"),
        caption=(
            f"degrees; jumps: angle between frames after frame {SETTLED_FRAME}; below: share of the frames; errors: of "
            f"probes with ground truth ({len(known)}), 95 % intervals over {resampled(scores.rooms)}"
        ),
    )
    for method in METHODS:
        row = scores.summary(method)
        table.add_row(
            method,
            f"{row.largest_jump_deg:.0f}",
            f"{row.jumps} of {row.steps}",
            f"{100 * row.below:.1f} %",
            *(mean_cell(cell, 0) for cell in (row.error_deg, row.last_error_deg)),
        )
    return table
