"""The pictures of a replay: a video in parts while it runs, which are joined at its end, and a summary."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.captures import Capture
from roomlight.conventions import Position
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session
from roomlight.frame import Frame
from roomlight.images import write_png
from roomlight.imaging.video_writer import VideoWriter, join_videos
from roomlight.spheres import view_toward
from roomlight_cli.probe_notes import position_text
from roomlight_cli.replays.inserted_spheres import ProbeView, insert_spheres
from roomlight_cli.replays.sheet import Sheet, SheetProbe, SheetTime, compose_sheet, mean_light, sheet_times
from roomlight_cli.replays.video import MAX_PROBES, ReplayPicture

SUMMARY: Final = "summary.png"
VIDEO: Final = "replay.mp4"
_RATES: Final = (2.0, 60.0)
"""Bounds of the video's frames per second: players stumble below 2, screens do not show more than 60."""


@dataclass
class PicturesState:
    """What the pictures of a replay know after a frame.

    Attributes:
        views: World directions along which the probes' spheres are seen: from the first camera.
        frame_size: Columns and rows of a frame in the video.
        times: Of the summary.
        indices: Of the frames whose light was computed, for the plots.
        light: The panoramas' mean luminance in these frames.
        coverage: The share of the sphere seen in them.
        best: The frame that shows most probes.
        taken: Number of frames drawn.
        parts: Number of finished parts of the video.
    """

    views: list[tuple[float, float, float]]
    frame_size: tuple[int, int]
    times: list[SheetTime] = field(default_factory=list[SheetTime])
    indices: list[int] = field(default_factory=list[int])
    light: list[list[float]] = field(default_factory=list[list[float]])
    coverage: list[list[float]] = field(default_factory=list[list[float]])
    best: ProbeView | None = None
    taken: int = 0
    parts: int = 0

    @classmethod
    def of(cls, first: Frame, positions: Sequence[Position]) -> "PicturesState":
        """Begin with the first frame."""
        height, width = first.resized(*WORKING_SIZE).image.shape[:2]
        return cls([view_toward(first.camera_to_world, position) for position in positions], (width, height))


def video_rate(frames_per_second: float) -> float:
    """Return the frames per second of the video of a recording."""
    return min(max(frames_per_second, _RATES[0]), _RATES[1])


class ReplayPictures:
    """Draws each frame with its panoramas; `close` finishes video and summary, `abandon` leaves neither.

    Args:
        out: The replay's folder.
        positions: The probes, world metres.
        state: What is known so far.
        parts: Folder for the parts of the video.
        capture: The recording; measured panoramas of its probes are shown beside the estimated ones.
        subtitle: The line below the summary's title.
    """

    def __init__(
        self,
        out: Path,
        positions: Sequence[Position],
        state: PicturesState,
        *,
        parts: Path,
        capture: Capture,
        subtitle: str,
    ) -> None:
        self.state = state
        self._summary, self._whole, self._parts = out / SUMMARY, out / VIDEO, parts
        self._title, self._subtitle = capture.path.name, subtitle
        self._positions = tuple(positions)
        self._labels = [f"Probe {n} at {position_text(position)}" for n, position in enumerate(positions)]
        self._shown = f", {MAX_PROBES} of {len(positions)} probes" if len(positions) > MAX_PROBES else ""
        measured = {probe.position: probe for probe in capture.truths}
        self._truths = [measured[at].panorama() if at in measured else None for at in self._positions]
        self._wanted = sheet_times(capture.frame_count)
        self._picture = ReplayPicture(self._labels, views=state.views, frame_size=state.frame_size)
        self._rate = video_rate(capture.film_rate)
        self._video = self._next_part()

    def _next_part(self) -> VideoWriter:
        return VideoWriter(self._part(self.state.parts), frames_per_second=self._rate)

    def _part(self, number: int) -> Path:
        return self._parts / f"{number:06d}.mp4"

    def add(
        self,
        frame: Frame,
        panoramas: Sequence[Float[np.ndarray, "..."]],
        coverage: Sequence[float] = (),
        observed: Sequence[Float[np.ndarray, "..."] | None] = (),
    ) -> None:
        """Draw the next frame; `coverage` and `observed` tell how much was seen around each probe, if it is known."""
        image, state = frame.resized(*WORKING_SIZE).image, self.state
        self._video.write(self._picture.compose(image, panoramas, label=f"Frame {frame.index}{self._shown}"))
        due = len(state.times) < len(self._wanted) and state.taken >= self._wanted[len(state.times)]
        if due:
            copies = tuple(panorama.copy() for panorama in panoramas)
            seen = tuple(None if share is None else share.copy() for share in observed)
            state.times.append(SheetTime(f"Frame {frame.index}", image, copies, seen))
        if coverage:
            state.indices.append(frame.index)
            state.light.append([mean_light(panorama) for panorama in panoramas])
            state.coverage.append(list(coverage))
        view = ProbeView.of(frame, self._positions)
        # late frames are preferred: their light is known best, and so is the room's shape
        if state.best is None or view.score >= state.best.score:
            state.best = view
        state.taken += 1

    def end_part(self) -> PicturesState:
        """Finish a part of the video, and return what later frames go on from. Raises OutputError."""
        self._video.__exit__(None, None, None)
        self.state.parts += 1
        self._video = self._next_part()
        if self.state.best is not None:
            self.state.best = self.state.best.printed()
        return self.state

    def close(self, session: Session | None) -> None:
        """Finish the video and write the summary, with spheres if the session is given. Raises OutputError."""
        self._video.__exit__(None, None, None)
        parts = [self._part(number) for number in range(self.state.parts + 1)]
        join_videos([part for part in parts if part.exists()], self._whole)
        probes = [
            SheetProbe(
                label,
                view,
                truth,
                light=tuple(values[number] for values in self.state.light),
                coverage=tuple(values[number] for values in self.state.coverage),
            )
            for number, (label, view, truth) in enumerate(
                zip(self._labels, self.state.views, self._truths, strict=True)
            )
        ]
        best = self.state.best
        inserted = None if session is None or best is None else insert_spheres(session, best.printed())
        sheet = Sheet(
            self._title, self._subtitle, self.state.times, probes, indices=self.state.indices, inserted=inserted
        )
        write_png(self._summary, compose_sheet(sheet))

    def abandon(self, error: BaseException) -> None:
        """Remove the unfinished part of the video; there is no summary yet."""
        self._video.__exit__(type(error), error, error.__traceback__)
