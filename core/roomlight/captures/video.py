"""Frames of a video by number, decoded in order with one in memory at a time (PyAV, which contains FFmpeg)."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError, InvalidDataError
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation

from roomlight.conventions import srgb8_to_linear
from roomlight.errors import CaptureError, FrameError
from roomlight.frame import clipped_pixels
from roomlight.images import MAX_PIXELS, MIN_ALPHA, ColourImage
from roomlight.imaging.colour_spaces import UNSPECIFIED, ColourSpace
from roomlight.imaging.exif import oriented
from roomlight.notes import Note, oblong_pixels

_UNSPECIFIED: Final = UNSPECIFIED[0]
_UNSTATED: Final = {"color_primaries": UNSPECIFIED, "color_trc": UNSPECIFIED, "colorspace": (_UNSPECIFIED, 3)}
"""Codes that state nothing, by tag; the matrix of code 0 is that of RGB."""
_FULL_RANGE: Final = 2
_BT2020_MATRICES: Final = (9, 10)
_BT2020: Final = 9
DEMUXERS: Final = {".mp4": "mp4", ".mov": "mp4", ".m4v": "mp4", ".3gp": "mp4", ".mkv": "matroska", ".webm": "matroska"}
"""FFmpeg's reader by the end of a file's name."""
_AREA: Final = Interpolation.AREA
_EXACT: Final = Interpolation.AREA | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND
"""How 8 bits are made: FFmpeg's quick way is 1 to 2 levels too dark. Its 16 bits are right in the quick way alone."""
_LIMITED_WHITE: Final = 65280
"""What FFmpeg makes of limited range's white in 16 bits."""
_SONY: Final = "XAVC"
_SONY_BYTES: Final = 2**22
_SONY_CURVE: Final = re.compile(rb'CaptureGammaEquation"\s+value="(s-log[^"]{0,20})"')
"""Brand of Sony's cameras; the curve stands in an XML among the last bytes of the file."""
_MATROSKA: Final = b"\x1a\x45\xdf\xa3"
_MP4_BOXES: Final = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
_FOCAL_35MM: Final = "focal_length.35mm_equivalent"
"""End of the name of QuickTime's entry that new iPhones write."""
_ORIENTATIONS: Final = {
    **{(False, False, False): 1, (False, True, False): 2, (False, True, True): 3, (False, False, True): 4},
    **{(True, False, False): 5, (True, False, True): 6, (True, True, True): 7, (True, True, False): 8},
}
"""EXIF's orientation by whether a display matrix (a, b; c, d) swaps the axes, and a (b) and d (c) are below 0."""
_MIRRORED: Final = (2, 4, 5, 7)
_RECTILINEAR: Final = 4
_TWO_VIEWS: Final = {
    1: "side by side",
    2: "one above the other",
    4: "in turn",
    5: "in turn",
    6: "in turn",
    7: "in turn",
}
"""FFmpeg's AVSphericalProjection of a pinhole camera; its AVStereo3DType of pictures that share a frame."""


class VideoFrames:
    """The frames of the largest video stream in colour of an MP4 or Matroska file, numbered in order of presentation.

    Packets are numbered by presentation time before decoding, so that a packet that does not decode loses only its
    own frame and does not shift the numbers of later frames. Packets that an edit list cuts off, which only help to
    decode others, have no number, unless the `whole` file is read.
    """

    def __init__(self, path: Path, label: str, *, upright: bool = False, whole: bool = False) -> None:
        """Index the packets and open the decoder.

        Args:
            path: The file.
            label: Its name in messages.
            upright: Rotate frames by the video's rotation tag; otherwise they are as the sensor stored them.
            whole: Number the frames that an edit list cuts off too.

        Raises:
            CaptureError: The file is not a readable video.
        """
        self._label, self._path, self._upright = label, path, upright
        self._options = {"ignore_editlist": "1"} if whole else {}
        try:
            self._kind = _demuxer(path)
            with self._opened() as container:
                stream, self._notes = _main_stream(container, label)
                shown = (packet.pts for packet in container.demux(stream) if not packet.is_discard)
                times = sorted({pts for pts in shown if pts is not None})
                stated = {**container.metadata, **stream.metadata}
                self.focal_35mm, self.stated = _stated_focal(stated), tuple(stated.values())
                if container.metadata.get("major_brand") == _SONY:
                    self._notes += _logarithmic(path, label)
                self.times_s = [float((pts - times[0]) * (stream.time_base or 1)) for pts in times]
            self._number_of = {pts: number for number, pts in enumerate(times)}
            self._open()
        except (FFmpegError, OSError, ValueError, IndexError) as error:
            damaged = "it is cut off, was never finished, or is none; copy or export it again"
            reason = damaged if isinstance(error, InvalidDataError) else error
            raise CaptureError(f"{label}: is not a readable video ({reason})") from error

    def _opened(self) -> InputContainer:
        return av.open(str(self._path), format=self._kind, metadata_errors="replace", options=self._options)

    def _open(self) -> None:
        self._container = self._opened()
        stream, _ = _main_stream(self._container, self._label)
        # A stream whose codec FFmpeg does not know has no such attributes at all.
        width, height = int(getattr(stream, "width", 0)), int(getattr(stream, "height", 0))
        if not 0 < width * height <= MAX_PIXELS:
            self._container.close()
            raise CaptureError(f"{self._label}: declares {width} x {height} pixels of a codec that can be decoded")
        # FFmpeg's decoders of HEVC and ProRes forget what the container states
        self._tags = {name: int(getattr(stream.codec_context, name)) for name in (*_UNSTATED, "color_range")}
        stream.thread_type = "AUTO"
        self._packets = self._container.demux(stream)
        self._decoded: list[VideoFrame] = []
        self._ended = False
        self._at = -1

    def __enter__(self) -> "VideoFrames":
        return self

    def __exit__(self, *_: object) -> None:
        self._container.close()

    def frame(self, number: int, *, longest: int | None = None) -> ColourImage:
        """Decode a frame to linear RGB by the video's colour tags.

        Args:
            number: Of the frame.
            longest: Most pixels of its longer side; it is shrunk to them.

        Raises:
            FrameError: The frame does not exist or does not decode, or its colour space is not read.
        """
        if number >= (count := len(self._number_of)):
            raise FrameError(f"{self._label}: has {count} frames, so there is no frame {number}")
        if number <= self._at:
            self._container.close()
            try:
                self._open()
            except CaptureError as error:  # the file was changed meanwhile
                raise FrameError(str(error)) from error
        while (frame := self._next()) is not None:
            decoded = self._number_of.get(frame.pts, -1) if frame.pts is not None else -1
            self._at = max(self._at, decoded)
            if decoded == number:
                return self._picture(frame, number, longest)
            if decoded > number:  # the wanted frame did not decode; keep this one for a later call
                self._decoded.insert(0, frame)
                self._at = number
                break
        raise FrameError(f"{self._label}: frame {number} does not decode; the video is truncated or damaged")

    def _next(self) -> VideoFrame | None:
        while not self._decoded and not self._ended:
            try:
                packet = next(self._packets, None)
            except (FFmpegError, OSError, ValueError):  # the file cannot be read further
                packet = None
            if packet is None:
                self._ended = True
                break
            try:
                self._decoded.extend(packet.decode())  # pyright: ignore[reportArgumentType]  (a video stream's packet)
            except (FFmpegError, ValueError):
                continue  # this packet is damaged; its frame is missed by its number
        return self._decoded.pop(0) if self._decoded else None

    def _picture(self, frame: VideoFrame, number: int, longest: int | None) -> ColourImage:
        if frame.is_corrupt or frame.width * frame.height > MAX_PIXELS:
            raise FrameError(f"{self._label}: frame {number} is damaged")
        self._tag(frame)
        try:
            _check_pinhole(frame)
            space = _colour_space(frame)
        except ValueError as error:
            raise FrameError(f"{self._label}: {error}") from error
        # HLG and PQ have 10 bits, which 8 would band in the shadows.
        deep = not space.is_srgb and frame.format.components[0].bits > 8
        alpha = any(component.is_alpha for component in frame.format.components)
        layout = ("rgba64le" if alpha else "rgb48le") if deep else ("rgba" if alpha else "rgb24")
        try:
            share = min(1.0, (longest or MAX_PIXELS) / max(frame.width, frame.height))
            width, height = round(share * frame.width), round(share * frame.height)
            how = _AREA if deep else _EXACT
            small = frame.reformat(width, height, layout, src_colorspace=_matrix(frame), interpolation=how)
            pixels = small.to_ndarray(format=layout)
        except (FFmpegError, ValueError, MemoryError) as error:
            raise FrameError(f"{self._label}: frame {number} does not convert to RGB ({error})") from error
        rgb = np.ascontiguousarray(pixels[..., :3])
        if deep and not frame.format.is_rgb and frame.color_range != _FULL_RANGE:
            rgb = np.rint(np.minimum(rgb, _LIMITED_WHITE) * np.float32(65535 / _LIMITED_WHITE)).astype(np.uint16)
        clipped = clipped_pixels(rgb)
        shown = pixels[..., 3] >= MIN_ALPHA * (256**pixels.itemsize - 1) if alpha else None
        seen = None if shown is None or shown.all() else shown
        notes = (*self._notes, *_unstated_curve(frame, self._label))
        if frame.interlaced_frame:
            combed = f"{self._label}: its rows are of two moments in turn (interlaced)"
            notes = (*notes, Note(combed, "edges that move are combs", "deinterlace it (ffmpeg -i IN -vf yadif OUT)"))
        turn = _orientation(frame)
        if self._upright:
            rgb, clipped = oriented(rgb, turn), oriented(clipped, turn)
            seen = None if seen is None else oriented(seen, turn)
        elif turn != 1:
            what = "that it is shown mirrored" if turn in _MIRRORED else f"its rotation of {frame.rotation} degrees"
            rotation = Note(
                f"{self._label}: {what}",
                "frames are read as stored, which is what intrinsics and poses refer to",
                "rotate the video, and its intrinsics and poses, if they are for upright frames",
            )
            notes = (*notes, rotation)
        image = srgb8_to_linear(rgb) if space.is_srgb else space.to_linear(rgb)
        return ColourImage(image, clipped, seen, notes=notes)

    def _tag(self, frame: VideoFrame) -> None:
        """State what the frame leaves open and the container states."""
        unstated = [name for name, codes in _UNSTATED.items() if int(getattr(frame, name)) in codes]
        if len(unstated) == len(_UNSTATED) and self._tags["color_range"] == _FULL_RANGE:
            frame.color_range = _FULL_RANGE
        for name in unstated:
            code = self._tags[name]
            setattr(frame, name, _UNSPECIFIED if code in _UNSTATED[name] else code)


def _demuxer(path: Path) -> str:
    """Return FFmpeg's reader by the file's first bytes: recorders of browsers write WebM under any name."""
    with path.open("rb") as file:
        start = file.read(8)
    if start[:4] == _MATROSKA:
        return "matroska"
    return "mp4" if start[4:] in _MP4_BOXES else DEMUXERS.get(path.suffix.lower(), "mp4")


def _main_stream(container: Any, label: str) -> tuple[Any, tuple[Note, ...]]:
    """Return the largest video stream in colour that is no cover picture, and what is unusual about it.

    Raises ValueError for none. Depth and infrared are streams too, grey or smaller.
    """
    streams = [stream for stream in container.streams.video if not stream.disposition & Disposition.attached_pic]
    if not streams:
        raise ValueError("it holds no pictures")
    sizes = [(getattr(stream, "width", 0), getattr(stream, "height", 0)) for stream in streams]
    kinds = [getattr(stream, "pix_fmt", None) or "of an unknown codec" for stream in streams]
    best = max(range(len(streams)), key=lambda at: (not kinds[at].startswith("gray"), sizes[at][0] * sizes[at][1]))
    stream, notes = streams[best], list[Note]()
    if len(streams) > 1:
        listed = ", ".join(f"{width} x {height} {kind}" for (width, height), kind in zip(sizes, kinds, strict=True))
        text = f"{label}: {len(streams)} video streams ({listed})"
        notes.append(Note(text, f"number {best + 1} is read", "keep the one that is meant"))
    shape = getattr(stream, "sample_aspect_ratio", None)
    return stream, (*notes, *oblong_pixels(label, float(shape or 1)))


def _stated_focal(metadata: Mapping[str, str]) -> float | None:
    """Return the focal length in millimetres, equivalent on 35 mm film; None if the video does not state it."""
    for name, value in metadata.items():
        if name.endswith(_FOCAL_35MM):
            try:
                focal = float(value)
            except ValueError:
                return None
            return focal if 5 <= focal <= 500 else None
    return None


def _side_data(frame: VideoFrame, kind: str) -> list[int]:
    """Return the numbers of a frame's side data, as FFmpeg's structures begin with; none without it."""
    data: Any = frame.side_data.get(kind)
    return [] if data is None else np.frombuffer(bytes(data)[:20], np.int32).tolist()


def _check_pinhole(frame: VideoFrame) -> None:
    """Raise ValueError where the file's spherical or stereo metadata says that the frame is no pinhole picture."""
    projection, packing = _side_data(frame, "SPHERICAL"), _side_data(frame, "STEREO3D")
    if projection and projection[0] != _RECTILINEAR:
        raise ValueError("is a 360-degree video, not the pictures of a pinhole camera; cut a view out of it")
    if packing and packing[0] in _TWO_VIEWS:
        raise ValueError(f"shows two cameras' pictures {_TWO_VIEWS[packing[0]]} in each frame; keep one of them")


def _orientation(frame: VideoFrame) -> int:
    """Return what the display matrix does to the frame, as EXIF's orientation: 1 is upright, as without a matrix."""
    matrix = _side_data(frame, "DISPLAYMATRIX")
    if not matrix:
        return 1
    a, b, _, c, d = map(float, matrix)
    turned = abs(b) + abs(c) > abs(a) + abs(d)
    return _ORIENTATIONS[turned, (b if turned else a) < 0, (c if turned else d) < 0]


def _matrix(frame: VideoFrame) -> str | None:
    """Return the matrix of a frame that states none, as mpv guesses it by the frame's size; None where it does."""
    if int(frame.colorspace) != _UNSPECIFIED and (int(frame.colorspace) != 0 or frame.format.is_rgb):
        return None
    if int(frame.color_primaries) == _BT2020:
        return "BT2020"
    return "ITU709" if frame.width >= 1280 or frame.height > 576 else "ITU601"


def _logarithmic(path: Path, label: str) -> tuple[Note, ...]:
    """Note the logarithmic curve that a Sony camera's XML states and no tag of the video does."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _SONY_BYTES))
        stated = _SONY_CURVE.search(file.read())
    if stated is None:
        return ()
    text = f"{label}: its camera states the logarithmic curve {stated[1].decode(errors='replace')}"
    return (Note(text, "it is read as an ordinary video's", "convert it to BT.709 or HLG"),)


def _unstated_curve(frame: VideoFrame, label: str) -> list[Note]:
    """Note wide colours without a transfer curve, as cameras tag logarithmic pictures (Apple Log)."""
    wide = int(frame.color_primaries) == _BT2020 or int(frame.colorspace) in _BT2020_MATRICES
    if not wide or int(frame.color_trc) != _UNSPECIFIED:
        return []
    text = f"{label}: its colours are BT.2020's, and its transfer curve is not stated"
    return [
        Note(text, "it is read as an ordinary video's, which a logarithmic one is not", "convert it to BT.709 or HLG")
    ]


def _colour_space(frame: VideoFrame) -> ColourSpace:
    """Return the colour space of a frame's tags. Raises ValueError for one that is not read."""
    primaries = int(frame.color_primaries)
    if primaries == _UNSPECIFIED and int(frame.colorspace) in _BT2020_MATRICES:
        primaries = _BT2020
    return ColourSpace.of_codes(primaries, int(frame.color_trc))
