"""A capture opened for reading: an iterator over frames in RoomLight's conventions.

Frames are decoded one at a time; bad frames are skipped and recorded. The readers of the formats return `RawFrame`s
in the format's own conventions; this module converts the pose, applies the confidence threshold and checks depth
and sizes.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.camera import Intrinsics, check_rigid, rigid_inverse
from roomlight.captures.consistency import FRAMES
from roomlight.captures.lenses import fitted
from roomlight.captures.notes import PassChecks, odd_camera, removed_lens, scaled_poses, unread_depth
from roomlight.captures.options import CameraConvention, CaptureOptions, PoseDirection, up_vector
from roomlight.captures.times import timeline
from roomlight.conventions import OPENCV_TO_OPENGL, rotation_to_y_up
from roomlight.depth import DEPTH_MEDIAN_M, MAX_DEPTH_M, without_unseen
from roomlight.errors import CaptureError, FrameError, ImageError, ModelError, RoomLightError
from roomlight.frame import Frame, hidden
from roomlight.images import ColourImage, read_panorama
from roomlight.imaging.rates import DEFAULT_RATE
from roomlight.monocular.stream_state import StreamState
from roomlight.notes import Note, states_aspect

if TYPE_CHECKING:
    from roomlight.monocular.stream import DepthStream

_AHEAD: Final = 12
"""Records after the first without depth, every other of which shows it from elsewhere."""


@dataclass(frozen=True)
class SkippedFrame:
    """A record that could not be used: its index in the capture, the file at fault and the reason."""

    index: int
    file: str
    reason: str


@dataclass(frozen=True)
class ProbeTruth:
    """A measured panorama that comes with a capture: its position (y-up world, metres) and its file.

    The panorama uses the mapping of `roomlight.conventions` in a y-up world. For a z-up capture this is Blender's
    panorama unchanged: the rotation from z up to y up equals the rotation between the two mappings.
    """

    position: tuple[float, float, float]
    panorama_path: Path | None = None

    def panorama(self) -> Float[np.ndarray, "h w 3"]:
        """Read the panorama: linear RGB float32 [h, 2h, 3].

        Raises:
            ImageError: The probe has no panorama file, or the file does not decode.
        """
        if self.panorama_path is None:
            raise ImageError(f"the probe at {self.position} has a position but no panorama file")
        return read_panorama(self.panorama_path)


@dataclass(frozen=True)
class PassState:
    """Where a pass over a capture is, for another to go on from.

    Attributes:
        last: Index of its last record.
        good: Number of frames so far.
        skipped: As in `Capture`.
        notes: As in `Capture`.
        noted: Kinds of notes that are not repeated.
        depth: What the stream of estimated depth knows; None where depth is measured.
    """

    last: int
    good: int
    skipped: list[SkippedFrame]
    notes: list[Note]
    noted: list[str]
    depth: StreamState | None


@dataclass(frozen=True)
class PoseConventions:
    """A format's default pose conventions, used unless `CaptureOptions` overrides them."""

    camera: CameraConvention
    pose: PoseDirection
    world_up: tuple[float, float, float]


@dataclass(frozen=True)
class RawFrame:
    """One record as stored: picture decoded to linear RGB, depth in metres, pose in the file's conventions.

    A record of a capture without depth has no `depth_name`. `stated` is the camera whose lens was removed, if one was.
    `auto_exposed` and `exposure` are as in `Frame`.
    """

    name: str
    picture: ColourImage
    depth_m: Float[np.ndarray, "dh dw"]
    depth_name: str | None
    intrinsics: Intrinsics
    pose: Float[np.ndarray, "4 4"]
    confidence: UInt8[np.ndarray, "ch cw"] | None = None
    stated: Intrinsics | None = None
    auto_exposed: bool = True
    exposure: float = 1.0


ReadRecord = Callable[[int], RawFrame]
"""Reads the record of a given index."""

RawProbe = tuple[Float[np.ndarray, "3"], Path | None]
"""A probe as stored: position in the stored world, and its panorama's file."""


@runtime_checkable  # the test run checks annotations with isinstance
class Reader(Protocol):
    """The interface of a format's reader. A pass reads records in order, by index.

    It is made of the capture's path and the options, and reads and checks the index, but no image.

    Raises:
        CaptureError: The index is missing or damaged, or lists no frame or too many.
        OptionError: An option is for what the format does not have.
    """

    format: str
    conventions: PoseConventions
    count: int
    probes: list[RawProbe]

    @property
    def notes(self) -> list[Note]:
        """What was left out, guessed or changed so far."""
        ...

    def name_of(self, index: int) -> str:
        """Return the file to name when record `index` fails."""
        ...

    def timestamps(self) -> list[float | None]:
        """Return the time of each record as stored, None where it has none; empty when the format stores none."""
        ...

    def records(self) -> AbstractContextManager[ReadRecord]:
        """Open the files of one pass and return a function from record index to `RawFrame`.

        The function raises RoomLightError or ValueError for a bad record.
        """
        ...


@runtime_checkable
class Preparing(Protocol):
    """A reader that looks at the whole recording before its first record, such as a video's."""

    def prepare(self, watch: Callable[[int, int], object]) -> None:
        """Look at it, once; `watch` is called with steps done and steps in all."""
        ...


@dataclass
class _Place:
    good: int = 0
    last: int = -1


class Capture:
    """Frames of a recording. Iterating decodes them one by one; opening decodes nothing.

    Attributes:
        path: The capture's folder or file.
        format: The name of its format, one of `FORMATS`.
        skipped: Records that the latest iteration has skipped so far, each with its file and reason.

    Examples:
        capture = open_capture("my-recording")
        frames = list(capture)
        print(*capture.notes, *capture.skipped, sep="\n")
    """

    def __init__(self, path: Path, reader: Reader, options: CaptureOptions) -> None:
        """Wrap a reader; use `open_capture` instead.

        Raises:
            CaptureError: The reader found no record.
        """
        self.path = path
        self.format = reader.format
        self.skipped: list[SkippedFrame] = []
        self._reader = reader
        self._options = options
        conventions = reader.conventions
        self._camera_convention: CameraConvention = options.camera_convention or conventions.camera
        self._pose_direction: PoseDirection = options.pose_direction or conventions.pose
        up = up_vector(options.world_up) if options.world_up is not None else conventions.world_up
        self._to_y_up = rotation_to_y_up(np.array(up, np.float64))
        self._noted = set[str]()
        self._min_confidence = 1 if options.min_confidence is None else options.min_confidence
        if reader.count == 0:
            raise CaptureError(f"{path}: has no frames")
        selected = range(0, reader.count, options.every)
        self._indices = selected if options.max_frames is None else selected[: options.max_frames]
        stored = reader.timestamps()
        # The container of a video states the unit.
        self._timeline = timeline(stored or [None] * reader.count, str(path), seconds=reader.format == "video")
        self._depth_stream: DepthStream | None = None
        self._at = _Place()
        self._notes = dict.fromkeys(self._timeline.notes)
        self._metres = 1.0 if options.camera_height_m is None else None

    @property
    def probes(self) -> tuple[ProbeTruth, ...]:
        """Ground-truth panoramas that come with the capture. Raises CaptureError as iterating does."""
        turn = self._to_y_up[:3, :3] * (self._metres_per_unit() if self._reader.probes else 1.0)
        placed = ((turn @ position, panorama) for position, panorama in self._reader.probes)
        return tuple(ProbeTruth((float(x), float(y), float(z)), panorama) for (x, y, z), panorama in placed)

    @property
    def truths(self) -> tuple[ProbeTruth, ...]:
        """Those of `probes` that have panoramas."""
        return tuple(probe for probe in self.probes if probe.panorama_path is not None)

    @property
    def frame_count(self) -> int:
        """Number of records selected by `every` and `max_frames`; iterating yields this many minus the skipped ones."""
        return len(self._indices)

    @property
    def frames_per_second(self) -> float | None:
        """Rate of the selected records by the step between timestamps; None without timestamps."""
        step_s = self._timeline.step_s
        return None if step_s is None else 1.0 / (step_s * self._options.every)

    @property
    def film_rate(self) -> float:
        """`frames_per_second`; without timestamps as if records were `DEFAULT_RATE` a second."""
        return self.frames_per_second or DEFAULT_RATE / self._options.every

    def pace_note(self, frames: int, first: int, last: int, *, rate: float | None = None) -> Note | None:
        """Make the note for so many frames, of index `first` to `last`, whose steps of time are not those of the rate.

        None where a film at `rate`, by default `frames_per_second`, runs as long as the recording, within 1 %.
        """
        own, start_s, end_s = self.frames_per_second, self._timeline.times_s[first], self._timeline.times_s[last]
        if own is None or start_s is None or end_s is None:
            return None
        film_s, recorded_s = (frames - 1) / (rate or own), end_s - start_s
        if abs(film_s - recorded_s) <= 0.01 * recorded_s:
            return None
        text = f"{self.path}: frames that are skipped or have uneven timestamps, or a rate that films do not have"
        effect = f"the film runs {film_s:.3g} s, the recording {recorded_s:.3g} s"
        return Note(text, effect, "place its pictures by the timestamps if the pace matters")

    def pixel_notes(self) -> list[Note]:
        """Make the note for a pixel of the first frame that is used, after it is read; none if it is the first frame.

        What that one shows may be another part of the room.
        """
        skipped = {record.index for record in self.skipped}
        first = next((index for index in self._indices if index not in skipped), None)
        if first in (None, self._indices[0]):
            return []
        text = f"the pixel is of {self._reader.name_of(first)}"
        return [Note(text, "the frames before it are skipped", "give a pixel of that frame")]

    @property
    def notes(self) -> tuple[Note, ...]:
        """What the files state and was left out, guessed or changed, as far as they have been read."""
        return tuple(dict.fromkeys([*self._reader.notes, *self._notes]))

    def prepare(self, watch: Callable[[str, int, int], object]) -> None:
        """Do what takes a while before the first frame, with progress; without this call, iterating does it.

        Args:
            watch: Called with what is done, steps done and steps in all.

        Raises:
            CaptureError: The recording cannot be read.
            ModelError: The depth model cannot be used.
        """
        if isinstance(self._reader, Preparing):
            self._reader.prepare(lambda done, total: watch("estimating camera poses", done, total))

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames in order. `Frame.index` is the record's index: every = 10 yields 0, 10, 20, ...

        A bad record is added to `skipped`.

        Raises:
            CaptureError: After the last record, if no frame was usable; before the first, if poses are to be scaled and
                no floor is seen.
            ModelError: The capture has no depth, and the model that is to estimate it cannot be used.
        """
        return self.frames()

    def frames(self, after: PassState | None = None) -> Iterator[Frame]:
        """Yield frames as iterating does, the same ones after an earlier pass (`passed`) if that is given."""
        self.skipped = skipped = [] if after is None else list(after.skipped)
        self._metres_per_unit()
        at = self._at = _Place()
        self._depth_stream = None
        if after is not None:
            at.good, at.last = after.good, after.last
            self._noted.update(after.noted)
            self._notes |= dict.fromkeys(after.notes)
            if after.depth is not None:
                self._depth_stream = self._opened_stream()
                self._depth_stream.state = after.depth
        checks = PassChecks(
            str(self.path),
            self.format,
            (self._camera_convention, self._pose_direction),
            self._to_y_up,
            self._options,
            passed=at.good,
            noted=self._noted,
        )
        with self._reader.records() as read:
            for index in self._indices:
                if index <= at.last:
                    continue
                at.last = index
                try:
                    frame = self._frame(index, read)
                    if at.good == 0 and frame.is_black:
                        raise FrameError(
                            f"{frame.source}: its image is black, as cameras begin and films fade in; "
                            "or it is in another unit than 1 = white"
                        )
                except FrameError as error:
                    skipped.append(SkippedFrame(index, self._reader.name_of(index), str(error)))
                    continue
                at.good += 1
                self._notes |= dict.fromkeys(checks.add(frame, self._depth_stream))
                yield frame
        self._notes |= dict.fromkeys(checks.end())
        if at.good == 0:
            first = skipped[0]
            reason = first.reason if first.reason.startswith(first.file) else f"{first.file}: {first.reason}"
            raise CaptureError(f"{self.path}: none of its {self.frame_count} frames can be used; the first is {reason}")

    def passed(self) -> PassState | None:
        """Return where the latest pass is now; None among its first frames, which are compared with each other."""
        if self._at.good < FRAMES:
            return None
        depth = None if self._depth_stream is None else replace(self._depth_stream.state)
        return PassState(self._at.last, self._at.good, list(self.skipped), list(self.notes), sorted(self._noted), depth)

    def frame_at(self, index: int) -> Frame:
        """Read one frame by its `Frame.index`. A video is decoded up to it; other formats read this frame only.

        Raises:
            FrameError: The record is bad, or there is no record of this index.
            CaptureError: Poses are to be scaled, and no floor is seen.
        """
        if not 0 <= index < self._reader.count:
            raise FrameError(f"{self.path}: there is no frame {index}; frames are 0 to {self._reader.count - 1}")
        self._metres_per_unit()
        self._depth_stream = None
        with self._reader.records() as read:
            return self._frame(index, read)

    def _metres_per_unit(self) -> float:
        """Return the metres of the stored unit, by the floor if its scale is to be found; reads frames once."""
        if self._metres is not None:
            return self._metres
        from roomlight.monocular.pose_scale import metres_per_unit  # onnxruntime takes a while to import

        last, height_m = len(self._indices) - 1, self._options.camera_height_m
        assert height_m is not None
        chosen = sorted({min(last, run * last // 4 + step) for run in range(5) for step in (0, 1, 2, 4, 8)})
        frames: list[Frame] = []
        with self._reader.records() as read:
            for number in chosen:
                with suppress(FrameError):  # a bad record is told when its turn comes
                    frames.append(self._frame(self._indices[number], read, stored=True))
        if not frames:
            raise CaptureError(f"{self.path}: none of {len(chosen)} frames can be used to find the scale of its poses")
        self._metres = metres_per_unit(frames, height_m)
        self._notes[scaled_poses(str(self.path), self._metres, height_m)] = None
        return self._metres

    def _frame(self, index: int, read: ReadRecord, *, stored: bool = False) -> Frame:
        """Read a frame in metres, with depth; `stored`: in the stored unit, and without depth where the file has none.

        Raises FrameError and ModelError.
        """
        name = self._reader.name_of(index)
        try:
            raw = read(index)
            measured = raw.depth_name is not None and self._options.depth != "network"
            if not measured and self._options.depth == "file":
                raise FrameError(f"{raw.name}: has no depth; depth=auto estimates it")
            picture, intrinsics = fitted(raw.picture, raw.intrinsics, raw.name)
            depth_m = self._checked_depth(raw) if measured else np.zeros(picture.image.shape[:2], np.float32)
            image = picture.image
            if picture.seen is not None:
                image, depth_m = hidden(image, depth_m, picture.seen)
                if measured and not depth_m.any():
                    raise FrameError(f"{raw.name}: no pixel that is seen has a known depth")
            frame = Frame(
                index=index,
                image=image,
                clipped=picture.clipped,
                depth_m=depth_m,
                intrinsics=intrinsics,
                camera_to_world=self._to_conventions(check_rigid(raw.pose)),
                timestamp_s=self._timeline.times_s[index],
                source=raw.name,
                seen=picture.seen,
                auto_exposed=raw.auto_exposed,
                exposure=raw.exposure,
            )
            self._take_notes(replace(raw, picture=picture), frame)
            if stored:
                return frame
            frame = self._in_metres(frame)
            return frame if measured else self._with_depth(frame)
        except (FrameError, ModelError):
            raise
        except RoomLightError as error:
            raise FrameError(str(error)) from error
        except (ValueError, OverflowError) as error:
            raise FrameError(f"{name}: {error}") from error

    def _in_metres(self, frame: Frame) -> Frame:
        return frame if self._metres in (None, 1.0) else frame.scaled(self._metres)

    def _with_depth(self, frame: Frame) -> Frame:
        """Estimate the depth of the next frame of this pass. Raises ModelError and FrameError."""
        if self._depth_stream is None:
            self._depth_stream = self._opened_stream()
            self._notes[self._depth_stream.note(str(self.path))] = None
            if self._options.depth == "auto" and (note := unread_depth(self.path)) is not None:
                self._notes[note] = None
            self._look_ahead(self._depth_stream, frame.index)
        estimated = self._depth_stream.complete(frame)
        return replace(estimated, depth_m=without_unseen(estimated.depth_m, frame.seen))

    def _look_ahead(self, stream: "DepthStream", index: int) -> None:
        """Show a new stream what follows a frame, so that its depth has parallax too. Raises ModelError."""
        later = [other for other in self._indices if other > index][:_AHEAD:2]
        with self._reader.records() as read:
            for other in later:
                with suppress(FrameError):  # a bad record is told when its turn comes
                    stream.complete(self._in_metres(self._frame(other, read, stored=True)))

    def _opened_stream(self) -> "DepthStream":
        from roomlight.monocular.stream import open_depth_stream  # onnxruntime takes a while to import

        return open_depth_stream(self._options.depth_model, height_m=self._options.camera_height_m)

    def _take_notes(self, raw: RawFrame, frame: Frame) -> None:
        """Keep the notes of a frame, one for all frames of a kind: the first frame's file stands for the others."""
        camera = raw.stated or frame.intrinsics
        oblong = {note for note in raw.picture.notes if states_aspect(note, camera.fy / camera.fx)}
        for note in raw.picture.notes:
            if note in oblong:  # the intrinsics are of such pixels
                continue
            kind = note.left_out.replace(raw.name, "")
            if kind not in self._noted:
                self._noted.add(kind)
                self._notes[note] = None
        if raw.stated not in (None, raw.intrinsics) and "lens" not in self._noted:
            self._noted.add("lens")
            self._notes[removed_lens(frame.source, frame.intrinsics)] = None
        if "camera" not in self._noted:
            odd = odd_camera(frame.source, camera, oblong=bool(oblong))
            if odd is not None:
                self._noted.add("camera")
                self._notes[odd] = None

    def _to_conventions(self, pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        rigid = pose
        if self._pose_direction == "world-to-camera":
            rigid = rigid_inverse(rigid)
        if self._camera_convention == "opencv":
            rigid = rigid @ OPENCV_TO_OPENGL
        return self._to_y_up @ rigid

    def _checked_depth(self, raw: RawFrame) -> Float[np.ndarray, "dh dw"]:
        """Remove depth of low confidence. Raises FrameError when none is left or the unit looks wrong."""
        depth_m = raw.depth_m
        assert raw.depth_name is not None
        known = depth_m > 0
        if not known.any():
            raise FrameError(
                f"{raw.depth_name}: no pixel has a known depth, above 0 and up to {MAX_DEPTH_M:g} m; unless the file "
                "is empty, the depth unit looks wrong; set depth_unit_m, the metres for one stored unit "
                "(0.001 for millimetres)"
            )
        median_m = float(np.median(depth_m[known]))
        low, high = DEPTH_MEDIAN_M
        if not low <= median_m <= high:
            raise FrameError(
                f"{raw.depth_name}: the median depth would be {median_m:.4g} m: the depth unit looks wrong; "
                "set depth_unit_m, the metres for one stored unit (0.001 for millimetres)"
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
                f"{raw.depth_name}: no pixel with depth has a confidence of {self._min_confidence} or more; "
                "min_confidence sets the threshold"
            )
        return trusted
