"""A video without poses, depth and intrinsics, as cameras write it: `.mp4`, `.mov`, `.m4v`, `.3gp`, `.mkv`, `.webm`.

A record is a frame, a fifth of a second after the last one. Poses are estimated from the pictures
(`roomlight.monocular.motion`) when the first record is read; depth is estimated as for any recording without. Frames
are upright, by the video's rotation tag.

World: that of the first camera, turned so that y is up; with `world_up`, its axes (x right, y up, z backward).
"""

import math
import re
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.camera import Intrinsics
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.options import CaptureOptions
from roomlight.captures.video import VideoFrames
from roomlight.conventions import linear_to_srgb
from roomlight.errors import CaptureError, FrameError, OptionError
from roomlight.frame import ASPECT_TOLERANCE
from roomlight.monocular.motion import SIDE, CameraMotion, CameraPath, Lost, Still
from roomlight.notes import Note
from roomlight.threads import read_ahead

RATE: Final = 5.0
"""Frames a second that are used: the share of the view that two of them have in common is what placing needs."""
MOST_FRAMES: Final = 600
"""Two minutes."""
DEFAULT_FOV_DEG: Final = 64.0
"""Field of view along the longer side without any better knowledge: of phones' main cameras, 60 to 68 degrees."""
USUAL_FOV_DEG: Final = (42.0, 90.0)
"""Along the longer side, of phones' main cameras and their videos, which may be cropped."""
_WIDEST: Final = 2.4
"""Longer side by the shorter of pictures that one view has: films' 2.39 or 2.4 are the widest that are usual."""
_BENDING: Final = re.compile(r"fish.?eye|gopro|insta360|theta", re.IGNORECASE)
"""Names of lenses that see so much that no pinhole stands for them."""
_FILM_WIDTH_MM: Final = 34.6
"""Width of a 4:3 picture of the diagonal of 36 x 24 mm film: videos have the photos' width."""
_RGBD: Final = "rangeOfEncodedDepth"
_TAIL_BYTES: Final = 65536
_UNUSED: Final = ("camera_convention", "pose_direction", "depth_unit_m", "depth_key", "min_confidence")


class BareVideoReader:
    """Reads a video file alone."""

    format = "video"
    conventions = PoseConventions("opengl", "camera-to-world", (0.0, 1.0, 0.0))

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        for name in _UNUSED:
            if getattr(options, name) is not None:
                raise OptionError(f"{name} is for stored poses and depth; {path} is a video without")
        if options.depth == "file":
            raise OptionError(f"depth is 'file', but {path} is a video without depth; depth=auto estimates it")
        self._path, self._options = path, options
        self.probes: list[RawProbe] = []
        self.notes: list[Note] = []
        with self._opened() as video:
            self._times_s, self._focal_35mm = video.times_s, video.focal_35mm
            _refuse_rgbd(path, video.stated)
            self.notes += bending_lens(str(path), *video.stated)
        self._numbers: list[int] = []
        due = 0  # in frames of `RATE`
        for number, time_s in enumerate(self._times_s):
            if time_s >= due / RATE - 1e-3:
                self._numbers.append(number)
                due = int((time_s + 1e-3) * RATE) + 1
        wanted = min(MOST_FRAMES, options.every * (options.max_frames or MOST_FRAMES))
        if len(self._numbers) > MOST_FRAMES == wanted:
            seconds = self._times_s[self._numbers[MOST_FRAMES]]
            left = f"{path}: what follows after {seconds:.0f} s"
            self.notes.append(Note(left, "is not read", "cut the video into parts, or record its poses"))
        self._numbers = self._numbers[:wanted]
        self.count = len(self._numbers)
        self._motion: CameraPath | None = None

    def name_of(self, index: int) -> str:
        """Return the video and the frame's time."""
        return f"{self._path}: frame {self._numbers[index]}, at {self._times_s[self._numbers[index]]:.1f} s"

    def timestamps(self) -> list[float | None]:
        """Return the frames' times."""
        return [self._times_s[number] for number in self._numbers]

    def prepare(self, watch: Callable[[int, int], object]) -> None:
        """Estimate the poses of all frames, once.

        Raises:
            CaptureError: The video cannot be read.
            ModelError: The depth model cannot be used.
        """
        if self._motion is not None:
            return
        motion, unread = None, dict[int, str]()
        with self._opened() as video, closing(read_ahead(self._described(video, unread))) as described:
            for motion, still in described:
                watch(still.number, self.count)
                motion.place(still)
        if motion is None:
            raise CaptureError(f"{self._path}: none of its frames can be read; the first: {unread[0]}")
        self._motion = motion.path(level=self._options.world_up is None)
        self._motion.lost.update(unread)
        self._note(self._motion)
        watch(self.count, self.count)

    def _described(self, video: VideoFrames, unread: dict[int, str]) -> Iterator[tuple[CameraMotion, Still | Lost]]:
        """Yield what the pictures show, and what places them; `unread` takes those that do not decode, and why."""
        from roomlight.monocular.stream import metric_model  # onnxruntime takes a while to import

        model, motion, first = metric_model(self._options.depth_model), None, 0.0
        for index, number in enumerate(self._numbers):
            try:
                image = video.frame(number, longest=SIDE).image
            except FrameError as error:
                unread[index] = str(error)
                continue
            aspect = image.shape[1] / image.shape[0]
            if motion is None:
                if _has_hues_at_left(image):
                    raise _rgbd_video(self._path)
                first = aspect
                lens, known = self._lens(image.shape[1], image.shape[0])
                motion = CameraMotion(model, lens, focal_is_known=known)
            if abs(aspect - first) > ASPECT_TOLERANCE * first:
                unread[index] = f"its aspect is {aspect:.3g}, the first picture's {first:.3g}; cut the video there"
                continue
            yield motion, motion.described(index, linear_to_srgb(np.minimum(image, 1)).astype(np.float32))

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Estimate the poses in the first pass, and hold the video open."""
        self.prepare(lambda _done, _total: None)
        with self._opened() as video:
            yield lambda index: self._read(index, video)

    def _read(self, index: int, video: VideoFrames) -> RawFrame:
        assert self._motion is not None
        if (reason := self._motion.lost.get(index)) is not None:
            raise FrameError(f"{self.name_of(index)}: {reason}")
        picture = video.frame(self._numbers[index])
        height, width = picture.image.shape[:2]
        return RawFrame(
            name=self.name_of(index),
            picture=picture,
            depth_m=np.zeros((height, width), np.float32),
            depth_name=None,
            intrinsics=self._motion.intrinsics.resized(width, height),
            pose=self._motion.poses[index],
        )

    def _opened(self) -> VideoFrames:
        return VideoFrames(self._path, str(self._path), upright=True)

    def _lens(self, width: int, height: int) -> tuple[Intrinsics, bool]:
        """Return the lens for frames of this size, and whether it is stated."""
        longer = max(width, height)
        focal, known = 0.5 * longer / math.tan(math.radians(DEFAULT_FOV_DEG) / 2), False
        if self._options.fov_deg is not None:
            focal, known = 0.5 * width / math.tan(math.radians(self._options.fov_deg) / 2), True
        elif self._focal_35mm is not None:
            focal, known = self._focal_35mm * longer / _FILM_WIDTH_MM, True
        return Intrinsics(focal, focal, width / 2, height / 2, width, height), known

    def _note(self, motion: CameraPath) -> None:
        self.notes.append(
            Note(
                f"{self._path}: its camera poses are estimated from the pictures",
                "turns may be off by some degrees, and places by a good part of the walk",
                "record with an app that stores poses, such as Stray Scanner, for exact places",
            )
        )
        lens = motion.intrinsics
        size = lens.width, lens.height
        if (panorama := panorama_like(str(self._path), *size)) is not None:
            self.notes.append(panorama)
        if motion.misfits:
            first, last = (self._times_s[self._numbers[at]] for at in (motion.misfits[0], motion.misfits[-1]))
            self.notes.append(
                Note(
                    f"{self._path}: {len(motion.misfits)} of {len(motion.poses)} pictures, from {first:.1f} to "
                    f"{last:.1f} s, fit the others badly",
                    "their turns may be off, mostly by a few degrees",
                    "cut the video there, move slowly in good light, or give poses in a transforms.json",
                )
            )
        if self._options.fov_deg is None and self._focal_35mm is None:
            fov_deg, longer = (math.degrees(2 * math.atan(0.5 * side / lens.fx)) for side in (lens.width, max(size)))
            odd = (
                ""
                if USUAL_FOV_DEG[0] <= longer <= USUAL_FOV_DEG[1]
                else ", which is hardly a phone's: poses are doubtful"
            )
            is_prior = abs(lens.fx / self._lens(*size)[0].fx - 1) < 1e-3  # nothing moved that could tell
            known_by = "is assumed, as of phones' main cameras" if is_prior else f"fits the pictures best{odd}"
            self.notes.append(
                Note(
                    f"{self._path}: its focal length is not stated",
                    f"a horizontal field of view of {fov_deg:.0f} degrees {known_by}",
                    "state fov_deg (--fov) if the camera's is known",
                )
            )
        if self._options.world_up is None and not motion.upright.sure:
            self.notes.append(unsure_horizon(str(self._path)))
        times = [self._times_s[self._numbers[index]] for index in motion.poses]
        if len(motion.lost) > 0.2 * self.count:
            share = (
                f"{len(times)} of {self.count} frames, from {min(times):.1f} to {max(times):.1f} s,"
                if times
                else "none"
            )
            self.notes.append(
                Note(
                    f"{self._path}: poses were estimated for {share} alone",
                    "the others are skipped, each with its reason",
                    "cut the video to one take, move slowly in good light, or give poses in a transforms.json",
                )
            )


def _refuse_rgbd(path: Path, stated: tuple[str, ...]) -> None:
    """Raise CaptureError for Record3D's RGBD video, whose JSON is metadata or the end of the file."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _TAIL_BYTES))
        tail = file.read()
    if _RGBD.encode() in tail or any(_RGBD in value for value in stated):
        raise _rgbd_video(path)


def _has_hues_at_left(image: Float[np.ndarray, "h w 3"]) -> bool:
    """Whether most of a picture's left half, and little of its right one, has the purest hues, of several kinds.

    They cover up to 0.26 of a half in captures, all but what has no depth of an RGBD video's.
    """
    most = image.max(axis=2)
    pure: Bool[np.ndarray, "h w"] = (most > 0.6) & (image.min(axis=2) < 0.1 * most)
    half = image.shape[1] // 2
    shares = pure[:, :half].mean(), pure[:, half:].mean()
    return bool(shares[0] > 0.6 and shares[1] < 0.4 and np.ptp(image[:, :half].argmax(axis=2)[pure[:, :half]]) > 0)


def _rgbd_video(path: Path) -> CaptureError:
    return CaptureError(
        f"{path}: is Record3D's RGBD video, whose left half is depth as hues; export the recording as .r3d or EXR + JPG"
    )


def bending_lens(source: str, *stated: str) -> list[Note]:
    """Return the note for a camera, named in a file's metadata, whose lens bends lines; nothing for others."""
    camera = next((text.strip()[:60] for text in stated if _BENDING.search(text)), None)
    if camera is None:
        return []
    text = f"{source}: its camera is {camera}, whose lens bends lines"
    return [Note(text, "it is read as the picture of a pinhole camera", "undistort it, and state fov_deg")]


def panorama_like(source: str, width: int, height: int, *, stated: bool = False) -> Note | None:
    """Return the note for a picture that is `stated` to be a panorama, or of one's shape; None for another one."""
    aspect = max(width, height) / min(width, height)
    if width == 2 * height:
        shape = f"{source}: it is twice as wide as high, as panoramas of all directions are"
    elif stated or aspect > _WIDEST:
        shape = f"{source}: it is a panorama, by its {'EXIF' if stated else f'aspect of {aspect:.3g}'}"
    else:
        return None
    return Note(shape, "it is read as the picture of a pinhole camera", "cut views out of a panorama, or ignore this")


def unsure_horizon(source: str) -> Note:
    """Return the note for pictures whose lines do not tell which way is up."""
    return Note(
        f"{source}: no straight lines show which way is up",
        "it is guessed, as people hold a camera: hardly rolled, looking ahead or down",
        "state world_up (--world-up X,Y,Z in the first camera's axes: x right, y up, z backward; y if it was level)",
    )
