"""Replays as films: H.264 in MP4, which browsers and phones play, one picture a processed frame.

Each picture shows the camera's frame and, for each probe, the panorama with a mirror and a glossy sphere.
"""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Final

import av
import numpy as np
from av.container import OutputContainer
from av.video.stream import VideoStream
from jaxtyping import Float, UInt8

from roomlight.drawing import Canvas
from roomlight.errors import OutputError
from roomlight.spheres import SphereRenderer

MAX_PROBES: Final = 6
"""More rows than this make a picture that no screen shows whole; the others are in the EXR files."""

_MARGIN: Final = 16
_GAP: Final = 10
_LABEL_ROWS: Final = 20
_FRAME_ROWS: Final = 384
_PANORAMA_ROWS: Final = (108, 240)  # least and most


class VideoWriter:
    """Writes a film under a temporary name and renames it at the end: whole or not at all.

    A context manager; an exception inside leaves no file, and so does a film without a picture.
    """

    def __init__(self, path: Path, *, frames_per_second: float = 10.0, crf: int = 18) -> None:
        """`crf`: x264's constant quality, 0 to 51; 18 is where people stop seeing the difference."""
        if not 0.1 <= frames_per_second <= 240:
            raise OutputError(f"{path}: {frames_per_second} frames a second cannot be filmed; take 0.1 to 240")
        self.path = path
        self._temporary = path.with_name(f".{path.name}.part")
        self._rate = Fraction(frames_per_second).limit_denominator(1000)
        self._options = {"crf": str(crf), "preset": "medium"}
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    def __enter__(self) -> "VideoWriter":
        """Nothing is opened before the first picture, whose size is the film's."""
        return self

    def write(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """Append an sRGB picture; even sizes, the same for all."""
        height, width = picture.shape[:2]
        if height % 2 or width % 2:
            raise ValueError(f"a picture of a film has even sizes, not {width} x {height}")
        try:
            if self._container is None or self._stream is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                # the index goes first, so that a browser starts before it has everything
                self._container = av.open(str(self._temporary), "w", format="mp4", options={"movflags": "+faststart"})
                self._stream = self._container.add_stream("libx264", rate=self._rate, options=self._options)
                self._stream.width, self._stream.height = width, height
                self._stream.pix_fmt = "yuv420p"
            if (self._stream.width, self._stream.height) != (width, height):
                raise ValueError(f"the film is {self._stream.width} x {self._stream.height}, this {width} x {height}")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            self._container.mux(self._stream.encode(frame))
        except OSError as error:  # PyAV's errors of files and codecs are OSErrors too
            raise OutputError(f"{self.path}: cannot be filmed ({error})") from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Finish and rename, or clean up after an exception."""
        if self._container is None or self._stream is None:
            return
        try:
            if error is None:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            if error is None:
                self._temporary.replace(self.path)
        except OSError as problem:
            raise OutputError(f"{self.path}: cannot be filmed ({problem})") from problem
        finally:
            self._temporary.unlink(missing_ok=True)


class ReplayPicture:
    """Composes the pictures of a replay, all of one size, from frames and panoramas."""

    def __init__(
        self,
        probes: Sequence[str],
        *,
        views: Sequence[tuple[float, float, float]],
        frame_size: tuple[int, int],
        exposure_ev: float = 0.0,
    ) -> None:
        """`probes`: labels; `views`: directions their spheres are seen along; `frame_size`: columns, rows."""
        if len(views) != len(probes):
            raise ValueError(f"{len(probes)} probes need as many views, not {len(views)}")
        self._probes = list(probes)[:MAX_PROBES]
        count = max(1, len(self._probes))
        least, most = _PANORAMA_ROWS
        self._rows = min(most, max(least, (_FRAME_ROWS + _GAP) // count - _LABEL_ROWS - _GAP))
        self._rows -= self._rows % 2
        frame_columns, frame_rows = frame_size
        self._frame_size = (round(_FRAME_ROWS * frame_columns / frame_rows), _FRAME_ROWS)
        self._exposure_ev = exposure_ev
        self._spheres = [SphereRenderer(view, size=self._rows) for view in list(views)[:MAX_PROBES]]

    def compose(
        self,
        frame: Float[np.ndarray, "h w 3"],
        panoramas: Sequence[Float[np.ndarray, "..."]],
        *,
        label: str = "",
    ) -> UInt8[np.ndarray, "ph pw 3"]:
        """One picture: the linear frame on the left, a row a probe on the right (the first `MAX_PROBES`)."""
        rows, (frame_columns, frame_rows) = self._rows, self._frame_size
        left = 2 * _MARGIN + frame_columns
        width = left + 4 * rows + 2 * _GAP + _MARGIN
        probes_rows = len(self._probes) * (_LABEL_ROWS + rows + _GAP) - _GAP
        height = 2 * _MARGIN + max(_LABEL_ROWS + frame_rows, probes_rows)
        canvas = Canvas(width, height, exposure_ev=self._exposure_ev)
        canvas.text((_MARGIN, _MARGIN), label, width=frame_columns)
        canvas.picture((_MARGIN, _MARGIN + _LABEL_ROWS), frame, size=self._frame_size)
        top = _MARGIN
        for title, spheres, panorama in zip(self._probes, self._spheres, panoramas, strict=False):
            canvas.text((left, top), title, width=4 * rows)
            top += _LABEL_ROWS
            canvas.picture((left, top), panorama, size=(2 * rows, rows))
            canvas.sphere((left + 2 * rows + _GAP, top), panorama, spheres, "mirror")
            canvas.sphere((left + 3 * rows + 2 * _GAP, top), panorama, spheres, "glossy")
            top += rows + _GAP
        return canvas.image
