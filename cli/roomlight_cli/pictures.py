"""The pictures of a replay: a video while it runs, and a contact sheet at its end."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.session import WORKING_SIZE
from roomlight.frame import Frame
from roomlight.spheres import view_toward
from roomlight_cli.probe_notes import position_text
from roomlight_cli.sheet import SheetColumn, sheet_times, write_contact_sheet
from roomlight_cli.video import MAX_PROBES, ReplayPicture, VideoWriter

SUMMARY: Final = "summary.png"
VIDEO: Final = "replay.mp4"
_DEFAULT_RATE: Final = 10.0
_RATES: Final = (2.0, 60.0)
"""Bounds of the video's frames per second: players stumble below 2, screens do not show more than 60."""


class ReplayPictures:
    """Draws each frame with its panoramas; `close` finishes video and sheet, `abandon` removes the unfinished video.

    Args:
        out: The replay's folder.
        positions: The probes, world metres.
        first: The first frame; spheres are seen from its camera.
        frame_count: Frames of the whole replay.
        frames_per_second: The recording's rate; None if unknown.
        truths: Measured panoramas of the probes where the capture has them: the sheet's last column.
        heading: The sheet's title.
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
        heading: str = "",
    ) -> None:
        self._sheet = out / SUMMARY
        self._heading = heading
        self._labels = [f"Probe {n} at {position_text(position)}" for n, position in enumerate(positions)]
        self._shown = f", {MAX_PROBES} of {len(positions)} probes" if len(positions) > MAX_PROBES else ""
        self._views = [view_toward(first.camera_to_world, position) for position in positions]
        self._truths = tuple(truths)
        self._wanted = sheet_times(frame_count)
        self._taken = 0
        self._columns: list[SheetColumn] = []
        small = first.resized(*WORKING_SIZE).image
        self._picture = ReplayPicture(self._labels, views=self._views, frame_size=(small.shape[1], small.shape[0]))
        rate = min(max(frames_per_second or _DEFAULT_RATE, _RATES[0]), _RATES[1])
        self._video = VideoWriter(out / VIDEO, frames_per_second=rate)

    def add(self, frame: Frame, panoramas: Sequence[Float[np.ndarray, "..."]], coverage: Sequence[float] = ()) -> None:
        """Draw the next frame; `coverage` is each probe's share of the sphere seen, if it is known."""
        image = frame.resized(*WORKING_SIZE).image
        self._video.write(self._picture.compose(image, panoramas, label=f"Frame {frame.index}{self._shown}"))
        due = len(self._columns) < len(self._wanted) and self._taken >= self._wanted[len(self._columns)]
        if due:
            copies = tuple(panorama.copy() for panorama in panoramas)
            self._columns.append(SheetColumn(f"Frame {frame.index}", image, copies, tuple(coverage)))
        self._taken += 1

    def close(self) -> None:
        """Finish the video and write the sheet. Raises OutputError."""
        self._video.__exit__(None, None, None)
        columns = list(self._columns)
        if any(truth is not None for truth in self._truths):
            columns.append(SheetColumn("Ground truth", None, self._truths))
        write_contact_sheet(self._sheet, columns, probes=self._labels, views=self._views, heading=self._heading)

    def abandon(self, error: BaseException) -> None:
        """Remove the unfinished video; there is no sheet yet."""
        self._video.__exit__(type(error), error, error.__traceback__)
