"""What a replay shows for itself while it runs: the film, and the contact sheet at its end."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.session import WORKING_SIZE
from roomlight.frame import Frame
from roomlight.spheres import view_toward
from roomlight_cli.sheet import SheetColumn, sheet_times, write_contact_sheet
from roomlight_cli.video import MAX_PROBES, ReplayPicture, VideoWriter

SUMMARY: Final = "summary.png"
FILM: Final = "replay.mp4"
_DEFAULT_RATE: Final = 10.0
_RATES: Final = (2.0, 60.0)
"""A film slower than 2 frames a second is a slide show, faster than 60 is not shown."""


class ReplayPictures:
    """Takes each frame with its panoramas; `close` finishes film and sheet, `abandon` removes the unfinished film."""

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
        """`truths`: measured panoramas of the probes, where the capture has them, shown as the sheet's last column."""
        self._sheet = out / SUMMARY
        self._heading = heading
        self._labels = [f"probe {n:02d} at ({x:.2f}, {y:.2f}, {z:.2f}) m" for n, (x, y, z) in enumerate(positions)]
        self._shown = f", {MAX_PROBES} of {len(positions)} probes" if len(positions) > MAX_PROBES else ""
        self._views = [view_toward(first.camera_to_world, position) for position in positions]
        self._truths = tuple(truths)
        self._wanted = sheet_times(frame_count)
        self._taken = 0
        self._columns: list[SheetColumn] = []
        small = first.resized(*WORKING_SIZE).image
        self._picture = ReplayPicture(self._labels, views=self._views, frame_size=(small.shape[1], small.shape[0]))
        rate = min(max(frames_per_second or _DEFAULT_RATE, _RATES[0]), _RATES[1])
        self._film = VideoWriter(out / FILM, frames_per_second=rate)

    def add(self, frame: Frame, panoramas: Sequence[Float[np.ndarray, "..."]]) -> None:
        """One more moment, in order."""
        image = frame.resized(*WORKING_SIZE).image
        self._film.write(self._picture.compose(image, panoramas, label=f"frame {frame.index}{self._shown}"))
        due = len(self._columns) < len(self._wanted) and self._taken >= self._wanted[len(self._columns)]
        if due:
            copies = tuple(panorama.copy() for panorama in panoramas)
            self._columns.append(SheetColumn(f"frame {frame.index}", image, copies))
        self._taken += 1

    def close(self) -> None:
        """Finish the film and write the sheet."""
        self._film.__exit__(None, None, None)
        columns = list(self._columns)
        if any(truth is not None for truth in self._truths):
            columns.append(SheetColumn("ground truth", None, self._truths))
        write_contact_sheet(self._sheet, columns, probes=self._labels, views=self._views, heading=self._heading)

    def abandon(self, error: BaseException) -> None:
        """Remove the unfinished film; the sheet was not begun."""
        self._film.__exit__(type(error), error, error.__traceback__)
