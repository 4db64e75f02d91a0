"""The pictures of a replay: a video while it runs, and a summary at its end."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session
from roomlight.frame import Frame
from roomlight.imaging.video_writer import VideoWriter
from roomlight.spheres import view_toward
from roomlight_cli.probe_notes import position_text
from roomlight_cli.replays.inserted_spheres import ProbeView, insert_spheres
from roomlight_cli.replays.sheet import Sheet, SheetProbe, SheetTime, mean_light, sheet_times, write_sheet
from roomlight_cli.replays.video import MAX_PROBES, ReplayPicture

SUMMARY: Final = "summary.png"
VIDEO: Final = "replay.mp4"
_DEFAULT_RATE: Final = 10.0
_RATES: Final = (2.0, 60.0)
"""Bounds of the video's frames per second: players stumble below 2, screens do not show more than 60."""


@dataclass(frozen=True)
class Titles:
    """The summary's title and the line below it."""

    title: str = ""
    subtitle: str = ""


@dataclass
class _History:
    """Numbers of every frame whose light was computed, for the plots."""

    indices: list[int] = field(default_factory=list[int])
    light: list[list[float]] = field(default_factory=list[list[float]])
    coverage: list[list[float]] = field(default_factory=list[list[float]])


class ReplayPictures:
    """Draws each frame with its panoramas; `close` finishes video and summary, `abandon` removes the unfinished video.

    Args:
        out: The replay's folder.
        positions: The probes, world metres.
        first: The first frame; spheres are seen from its camera.
        frame_count: Frames of the whole replay.
        frames_per_second: The recording's rate; None if unknown.
        truths: Measured panoramas of the probes where the capture has them.
        titles: The summary's.
    """

    def __init__(
        self,
        out: Path,
        positions: Sequence[Position],
        first: Frame,
        *,
        frame_count: int,
        frames_per_second: float | None,
        truths: Sequence[Float[np.ndarray, "th tw 3"] | None] = (),
        titles: Titles = Titles(),
    ) -> None:
        self._summary = out / SUMMARY
        self._titles = titles
        self._positions = tuple(positions)
        self._labels = [f"Probe {n} at {position_text(position)}" for n, position in enumerate(positions)]
        self._shown = f", {MAX_PROBES} of {len(positions)} probes" if len(positions) > MAX_PROBES else ""
        self._views = [view_toward(first.camera_to_world, position) for position in positions]
        self._truths = tuple(truths) or (None,) * len(positions)
        self._wanted = sheet_times(frame_count)
        self._taken = 0
        self._times: list[SheetTime] = []
        self._history = _History()
        self._best: ProbeView | None = None
        small = first.resized(*WORKING_SIZE).image
        self._picture = ReplayPicture(self._labels, views=self._views, frame_size=(small.shape[1], small.shape[0]))
        rate = min(max(frames_per_second or _DEFAULT_RATE, _RATES[0]), _RATES[1])
        self._video = VideoWriter(out / VIDEO, frames_per_second=rate)

    def add(
        self,
        frame: Frame,
        panoramas: Sequence[Float[np.ndarray, "..."]],
        coverage: Sequence[float] = (),
        observed: Sequence[Float[np.ndarray, "..."] | None] = (),
    ) -> None:
        """Draw the next frame; `coverage` and `observed` tell how much was seen around each probe, if it is known."""
        image = frame.resized(*WORKING_SIZE).image
        self._video.write(self._picture.compose(image, panoramas, label=f"Frame {frame.index}{self._shown}"))
        due = len(self._times) < len(self._wanted) and self._taken >= self._wanted[len(self._times)]
        if due:
            copies = tuple(panorama.copy() for panorama in panoramas)
            seen = tuple(None if share is None else share.copy() for share in observed)
            self._times.append(SheetTime(f"Frame {frame.index}", image, copies, seen))
        if coverage:
            self._history.indices.append(frame.index)
            self._history.light.append([mean_light(panorama) for panorama in panoramas])
            self._history.coverage.append(list(coverage))
        view = ProbeView.of(frame, self._positions)
        # late frames are preferred: their light is known best, and so is the room's shape
        if self._best is None or view.score >= self._best.score:
            self._best = view
        self._taken += 1

    def close(self, session: Session | None = None) -> None:
        """Finish the video and write the summary, with spheres if the session is given. Raises OutputError."""
        self._video.__exit__(None, None, None)
        probes = [
            SheetProbe(
                label,
                view,
                truth,
                light=tuple(values[number] for values in self._history.light),
                coverage=tuple(values[number] for values in self._history.coverage),
            )
            for number, (label, view, truth) in enumerate(zip(self._labels, self._views, self._truths, strict=True))
        ]
        inserted = None if session is None or self._best is None else insert_spheres(session, self._best)
        sheet = Sheet(
            self._titles.title,
            self._titles.subtitle,
            self._times,
            probes,
            indices=self._history.indices,
            inserted=inserted,
        )
        write_sheet(self._summary, sheet)

    def abandon(self, error: BaseException) -> None:
        """Remove the unfinished video; there is no summary yet."""
        self._video.__exit__(type(error), error, error.__traceback__)
