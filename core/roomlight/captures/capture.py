"""A capture opened for reading: frames one at a time in RoomLight's conventions, bad ones skipped and
counted.

The formats' readers hand out `RawFrame`s in their own conventions; the one conversion of pose, the confidence
threshold and the checks of depth and sizes are here.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, UInt8

from roomlight.camera import Intrinsics, check_rigid, rigid_inverse
from roomlight.captures.options import CameraConvention, CaptureOptions, PoseDirection, up_vector
from roomlight.conventions import OPENCV_TO_OPENGL, rotation_to_y_up
from roomlight.errors import CaptureError, FrameError, ImageError, RoomLightError
from roomlight.frame import Frame
from roomlight.images import read_panorama

DEPTH_MEDIAN_M: Final = (0.01, 100.0)
"""The median of known depth must lie in here; rooms do, and a wrong unit (factor 1000) leaves it on either
side.
"""


@dataclass(frozen=True)
class SkippedFrame:
    """A record that gave no frame: its index in the capture, the file to look at and why."""

    index: int
    file: str
    reason: str


@dataclass(frozen=True)
class ProbeTruth:
    """A measured panorama that comes with a capture: where it was taken (our world, metres) and its file.

    The panorama is in `conventions`' mapping in a world whose up is +Y. For a z-up capture that is Blender's
    panorama as it stands: the turn that brings z up to y up is the one between the two mappings.
    """

    position: tuple[float, float, float]
    panorama_path: Path | None = None

    def panorama(self) -> Float[np.ndarray, "h w 3"]:
        """Read the panorama, linear RGB float32 [h, 2h, 3]; ImageError when there is none or it does not
        decode.
        """
        if self.panorama_path is None:
            raise ImageError(f"the probe at {self.position} has a position but no panorama file")
        return read_panorama(self.panorama_path)


@dataclass(frozen=True)
class Conventions:
    """What a format says of its poses when the user says nothing."""

    camera: CameraConvention
    pose: PoseDirection
    world_up: tuple[float, float, float]


@dataclass(frozen=True)
class RawFrame:
    """One record as stored: image decoded to linear RGB, depth in metres, pose as in the file."""

    name: str
    image: Float[np.ndarray, "h w 3"]
    clipped: Bool[np.ndarray, "h w"]
    depth_m: Float[np.ndarray, "dh dw"]
    depth_name: str
    intrinsics: Intrinsics
    pose: Float[np.ndarray, "4 4"]
    timestamp_s: float | None = None
    confidence: UInt8[np.ndarray, "ch cw"] | None = None


ReadRecord = Callable[[int], RawFrame]


RawProbe = tuple[Float[np.ndarray, "3"], Path | None]
"""A probe as stored: position in the stored world, and its panorama's file."""


@runtime_checkable  # so that a checker of annotations can look at it in the test run
class Reader(Protocol):
    """What a format provides. `records` gives a function from record index to `RawFrame`, for one pass in
    order.
    """

    format: str
    conventions: Conventions
    count: int
    probes: list[RawProbe]

    def name_of(self, index: int) -> str:
        """The file to name when record `index` fails."""
        ...

    def timestamps_s(self) -> list[float]:
        """Times of all records, for the frame rate; empty when the format has none."""
        ...

    def records(self) -> AbstractContextManager[ReadRecord]:
        """Open what a pass needs; the function given raises RoomLightError or ValueError for a bad record."""
        ...


class Capture:
    """Frames of a recording. Iterating decodes them one by one; nothing is decoded before.

    path, format:       where, and which reader.
    frame_count:        records selected by `every` and `max_frames`, good or bad.
    frames_per_second:  of the selected records, from their timestamps; None when there are none.
    probes:             ground truth that came along.
    skipped:            what the latest iteration left out so far, each with its file and reason.
    """

    def __init__(self, path: Path, reader: Reader, options: CaptureOptions) -> None:
        """Made by `open_capture`; CaptureError if the reader found no record."""
        self.path = path
        self.format = reader.format
        self.skipped: list[SkippedFrame] = []
        self._reader = reader
        self._options = options
        conventions = reader.conventions
        self._camera_convention = options.camera_convention or conventions.camera
        self._pose_direction = options.pose_direction or conventions.pose
        up = up_vector(options.world_up) if options.world_up is not None else conventions.world_up
        self._to_y_up = rotation_to_y_up(np.array(up, np.float64))
        self._min_confidence = 1 if options.min_confidence is None else options.min_confidence
        if reader.count == 0:
            raise CaptureError(f"{path}: holds no frame at all")
        selected = range(0, reader.count, options.every)
        self._indices = selected if options.max_frames is None else selected[: options.max_frames]
        self.probes = tuple(
            ProbeTruth(position=_tuple3(self._to_y_up[:3, :3] @ position), panorama_path=panorama)
            for position, panorama in reader.probes
        )

    @property
    def frame_count(self) -> int:
        """How many records are selected; iterating gives that many frames less the skipped ones."""
        return len(self._indices)

    @property
    def frames_per_second(self) -> float | None:
        """Rate of the selected records by the median step between timestamps, or None."""
        times = np.array(self._reader.timestamps_s(), np.float64)
        steps = np.diff(times[np.isfinite(times)])
        step = float(np.median(steps)) if steps.size else 0.0
        return 1.0 / (step * self._options.every) if step > 1e-6 else None

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order; `Frame.index` counts the capture's records, so that every = 10 gives 0, 10, 20,
        ...

        A bad record is put on `skipped` and passed over. CaptureError at the end if not one was good.
        """
        self.skipped = skipped = list[SkippedFrame]()
        good = 0
        with self._reader.records() as read:
            for index in self._indices:
                try:
                    frame = self._frame(index, read)
                except FrameError as error:
                    skipped.append(SkippedFrame(index, self._reader.name_of(index), str(error)))
                    continue
                good += 1
                yield frame
        if good == 0:
            first = skipped[0]
            raise CaptureError(
                f"{self.path}: none of its {self.frame_count} frames can be used; "
                f"the first, {first.file}: {first.reason}"
            )

    def frame_at(self, index: int) -> Frame:
        """The frame of one record, by its `Frame.index`; FrameError if it is bad or there is none.

        A video has to be decoded up to there; every other format reads just this frame.
        """
        if not 0 <= index < self._reader.count:
            raise FrameError(f"{self.path}: there is no frame {index}; frames are 0 to {self._reader.count - 1}")
        with self._reader.records() as read:
            return self._frame(index, read)

    def _frame(self, index: int, read: ReadRecord) -> Frame:
        name = self._reader.name_of(index)
        try:
            raw = read(index)
            return Frame(
                index=index,
                image=raw.image,
                clipped=raw.clipped,
                depth_m=self._checked_depth(raw),
                intrinsics=raw.intrinsics,
                camera_to_world=self._converted(raw.pose),
                timestamp_s=raw.timestamp_s,
                source=raw.name,
            )
        except FrameError:
            raise
        except RoomLightError as error:
            raise FrameError(str(error)) from error
        except (ValueError, OverflowError) as error:
            raise FrameError(f"{name}: {error}") from error

    def _converted(self, pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """The stored pose as camera-to-world with OpenGL camera axes in a y-up world."""
        rigid = check_rigid(pose)
        if self._pose_direction == "world-to-camera":
            rigid = rigid_inverse(rigid)
        if self._camera_convention == "opencv":
            rigid = rigid @ OPENCV_TO_OPENGL
        return self._to_y_up @ rigid

    def _checked_depth(self, raw: RawFrame) -> Float[np.ndarray, "dh dw"]:
        """Depth without what confidence rejects; FrameError when nothing is left or its unit looks wrong."""
        depth_m = raw.depth_m
        known = depth_m > 0
        if not known.any():
            raise FrameError(f"{raw.depth_name}: no pixel has a known depth")
        median_m = float(np.median(depth_m[known]))
        low, high = DEPTH_MEDIAN_M
        if not low <= median_m <= high:
            raise FrameError(
                f"{raw.depth_name}: the median depth would be {median_m:.4g} m: the depth unit looks wrong; "
                "state it (depth_unit_m, on the command line --depth-unit: metres for one stored unit, "
                "0.001 for millimetres)"
            )
        if raw.confidence is None:
            return depth_m
        if raw.confidence.shape != depth_m.shape:
            raise FrameError(
                f"{raw.depth_name}: depth is {depth_m.shape[1]} x {depth_m.shape[0]} "
                f"but its confidence is {raw.confidence.shape[1]} x {raw.confidence.shape[0]}"
            )
        trusted = np.where(raw.confidence >= self._min_confidence, depth_m, np.float32(0))
        if not trusted.any():
            raise FrameError(
                f"{raw.depth_name}: no pixel with depth has a confidence of {self._min_confidence} or more "
                "(min_confidence, on the command line --min-confidence, sets the threshold)"
            )
        return trusted


def _tuple3(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
