"""Videos: H.264 in MP4, which browsers and phones play."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import av
import numpy as np
from av.container import OutputContainer
from av.video.stream import VideoStream
from jaxtyping import UInt8

from roomlight.errors import OptionError, OutputError
from roomlight.files import temporary_beside
from roomlight.imaging.rates import exact_rate

_BT709: Final = 1
_SRGB: Final = 13
_LIMITED: Final = 1
"""H.273's codes of primaries and matrix, and of the transfer curve; FFmpeg's of the range 16 to 235."""

MOST_ROWS: Final = 0.1
"""Most rows, of a picture's, that it may have more or less than the video."""


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
        self._temporary = temporary_beside(path)
        self._rate = exact_rate(frames_per_second)
        self._options = {"crf": str(crf), "preset": "medium"}
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    def __enter__(self) -> "VideoWriter":
        return self

    def write(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """Append an 8-bit sRGB picture; the first one's size is the video's, without the last pixel of odd sides.

        A picture with a few rows more or less, whose own lens was removed, is cropped, or goes on at its borders.

        Raises:
            ValueError: The size differs from the first picture's.
            OutputError: The file cannot be written.
        """
        if self._stream is not None and 0 < abs(more := len(picture) - self._stream.height) <= MOST_ROWS * len(picture):
            above = (np.arange(self._stream.height) + more // 2).clip(0, len(picture) - 1)
            picture = picture[above]
        height, width = (side - side % 2 for side in picture.shape[:2])
        try:
            if self._container is None or self._stream is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                # the index goes first, so that a browser starts to play before it has the whole file
                self._container = av.open(str(self._temporary), "w", format="mp4", options={"movflags": "+faststart"})
                self._stream = self._container.add_stream("libx264", rate=self._rate, options=self._options)
                self._stream.width, self._stream.height = width, height
                self._stream.pix_fmt = "yuv420p"
                codec = self._stream.codec_context
                codec.colorspace, codec.color_primaries = _BT709, _BT709
                codec.color_trc, codec.color_range = _SRGB, _LIMITED
            if (self._stream.width, self._stream.height) != (width, height):
                size = f"{self._stream.width} x {self._stream.height}"
                raise ValueError(f"the video is {size}, this picture {width} x {height}")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
            encoded = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
            self._container.mux(self._stream.encode(encoded))
        except OSError as error:  # PyAV's errors of files and codecs are OSErrors too
            raise OutputError(f"{self.path}: cannot be written ({error})") from error

    def __exit__(self, _: object, error: BaseException | None, __: object, /) -> None:
        container, self._container = self._container, None  # closed once: a second time its file is gone
        if container is None or self._stream is None:
            return
        try:
            if error is None:
                container.mux(self._stream.encode(None))
            container.close()
            if error is None:
                self._temporary.replace(self.path)
        except OSError as problem:
            if error is None:  # else that is the cause
                raise OutputError(f"{self.path}: cannot be written ({problem})") from problem
        finally:
            with contextlib.suppress(OSError):  # the file may not exist, or its name be refused
                self._temporary.unlink()


def join_videos(parts: Sequence[Path], path: Path) -> None:
    """Join the videos of `VideoWriter`s of the same picture size and rate to one, without encoding them again.

    Raises:
        OutputError: A part cannot be read, or the file cannot be written.
    """
    temporary = temporary_beside(path)
    try:
        with av.open(str(temporary), "w", format="mp4", options={"movflags": "+faststart"}) as whole:
            joined: VideoStream | None = None
            start, before = 0, -(1 << 62)
            for part in parts:
                with av.open(str(part), format="mp4") as container:
                    stream = container.streams.video[0]
                    joined = joined or whole.add_stream_from_template(stream)
                    for packet in container.demux(stream):
                        if packet.dts is None or packet.pts is None:  # the end
                            continue
                        # pictures that are stored out of order begin before a part: more than a short one lasts
                        before = max(packet.dts + start, before + 1)
                        packet.dts, packet.pts, packet.stream = before, packet.pts + start, joined
                        whole.mux(packet)
                    start += stream.duration or 0
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error})") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
