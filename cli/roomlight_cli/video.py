"""Replays as videos: H.264 in MP4, which browsers and phones play, one picture per frame.

Each picture shows the camera's frame and, for each probe, the panorama with a mirror sphere and a glossy sphere.
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

from roomlight.errors import OptionError, OutputError
from roomlight.imaging.drawing import LABEL_ROWS, Canvas
from roomlight.spheres import Material, SphereRenderer

MAX_PROBES: Final = 6
"""More rows would make a picture larger than screens; all probes are in the EXR files."""

_MATERIALS: Final[tuple[Material, Material]] = ("mirror", "glossy")
_MARGIN: Final = 16
_GAP: Final = 10
_FRAME_ROWS: Final = 384
_PANORAMA_ROWS: Final = (108, 240)  # least and most


class VideoWriter:
    """Writes a video under a temporary name and renames it at the end, for use in a `with` statement.

    An exception inside the statement leaves no file, and so does a video without a picture.

    Args:
        path: The MP4 file.
        frames_per_second: 0.1 to 240.
        crf: x264's constant quality, 0 to 51; from 18 down people see no difference.

    Raises:
        OptionError: `frames_per_second` is out of range.
    """

    def __init__(self, path: Path, *, frames_per_second: float = 10.0, crf: int = 18) -> None:
        if not 0.1 <= frames_per_second <= 240:
            raise OptionError(f"frames_per_second is {frames_per_second}; it must be 0.1 to 240")
        self.path = path
        self._temporary = path.with_name(f".{path.name}.part")
        self._rate = Fraction(frames_per_second).limit_denominator(1000)
        self._options = {"crf": str(crf), "preset": "medium"}
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    def __enter__(self) -> "VideoWriter":
        return self

    def write(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """Append an 8-bit sRGB picture; the first one's size is the video's.

        Raises:
            ValueError: A side is odd, or the size differs from the first picture's.
            OutputError: The file cannot be written.
        """
        height, width = picture.shape[:2]
        if height % 2 or width % 2:
            raise ValueError(f"a video's pictures have even sides, not {width} x {height}")
        try:
            if self._container is None or self._stream is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                # the index goes first, so that a browser starts to play before it has the whole file
                self._container = av.open(str(self._temporary), "w", format="mp4", options={"movflags": "+faststart"})
                self._stream = self._container.add_stream("libx264", rate=self._rate, options=self._options)
                self._stream.width, self._stream.height = width, height
                self._stream.pix_fmt = "yuv420p"
            if (self._stream.width, self._stream.height) != (width, height):
                size = f"{self._stream.width} x {self._stream.height}"
                raise ValueError(f"the video is {size}, this picture {width} x {height}")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            self._container.mux(self._stream.encode(frame))
        except OSError as error:  # PyAV's errors of files and codecs are OSErrors too
            raise OutputError(f"{self.path}: cannot be written ({error})") from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._container is None or self._stream is None:
            return
        try:
            if error is None:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            if error is None:
                self._temporary.replace(self.path)
        except OSError as problem:
            raise OutputError(f"{self.path}: cannot be written ({problem})") from problem
        finally:
            self._temporary.unlink(missing_ok=True)


class ReplayPicture:
    """Composes a video's pictures, all of one size, from frames and panoramas.

    Args:
        probes: Labels of the probes; the first `MAX_PROBES` are shown.
        views: World directions along which each probe's spheres are seen.
        frame_size: The frames' (columns, rows).
        exposure_ev: Exposure in stops.

    Raises:
        ValueError: The numbers of probes and views differ.
    """

    def __init__(
        self,
        probes: Sequence[str],
        *,
        views: Sequence[tuple[float, float, float]],
        frame_size: tuple[int, int],
        exposure_ev: float = 0.0,
    ) -> None:
        if len(views) != len(probes):
            raise ValueError(f"{len(probes)} probes need as many views, not {len(views)}")
        self._probes = list(probes)[:MAX_PROBES]
        count = max(1, len(self._probes))
        least, most = _PANORAMA_ROWS
        self._rows = min(most, max(least, (_FRAME_ROWS + _GAP) // count - LABEL_ROWS - _GAP))
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
        """Return one 8-bit sRGB picture: the linear frame on the left, a row per probe on the right."""
        rows, (frame_columns, frame_rows) = self._rows, self._frame_size
        left = 2 * _MARGIN + frame_columns
        width = left + 4 * rows + 2 * _GAP + _MARGIN
        probes_rows = len(self._probes) * (LABEL_ROWS + rows + _GAP) - _GAP
        height = 2 * _MARGIN + max(LABEL_ROWS + frame_rows, probes_rows)
        canvas = Canvas(width, height, exposure_ev=self._exposure_ev)
        canvas.text((_MARGIN, _MARGIN), label, width=frame_columns)
        canvas.picture((_MARGIN, _MARGIN + LABEL_ROWS), frame, size=self._frame_size)
        top = _MARGIN
        for title, spheres, panorama in zip(self._probes, self._spheres, panoramas, strict=False):
            canvas.text((left, top), title, width=2 * rows)
            canvas.picture((left, top + LABEL_ROWS), panorama, size=(2 * rows, rows))
            columns = (left + 2 * rows + _GAP, left + 3 * rows + 2 * _GAP)
            for column, material in zip(columns, _MATERIALS, strict=True):
                canvas.text((column, top), f"{material} sphere", width=rows)
                canvas.sphere((column, top + LABEL_ROWS), panorama, spheres, material)
            top += LABEL_ROWS + rows + _GAP
        return canvas.image
