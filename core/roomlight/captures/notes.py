"""Notes of an open capture: what its poses, lens and depth leave open."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.camera import Intrinsics
from roomlight.captures.consistency import FRAMES, DepthCheck, Disagreement, PoseCheck, looks_turned, odd_depth
from roomlight.captures.options import CameraConvention, CaptureOptions, PoseDirection
from roomlight.conventions import OPENCV_TO_OPENGL
from roomlight.frame import Frame
from roomlight.notes import Note

if TYPE_CHECKING:
    from roomlight.monocular.stream import DepthStream

_OF_QUATERNIONS: Final = ("tum", "stray-scanner", "record3d", "rtabmap", "ros-bag")
"""Formats whose poses hold quaternions as x, y, z, w."""
_MOST_BY_POSES: Final = 4.0
"""Most that poses enlarge estimated depth: 1.5 times in captures. They reduce it wrongly where their noise is large."""
_OF_ANY_TOOL: Final = ("nerfstudio", "colmap")
"""Formats whose depth and world come from any tool; those of the others are a sensor's, or have one unit and up."""
_LYING, _DEPTH = "lying camera", "scale of depth"
"""Notes after which others are not given."""
_APART: Final = "depth apart"
"""A note that is given at a pass's end, unless another one explains it: of depth that meets by the poses in no way, or
only by a turn that the pictures do not show."""
_NORMALISED: Final = ((1.0, 1.0), (0.2549, 0.2551), (64.2, 65.54))
"""Ranges of the largest depth in metres where floats, 8 or 16 bits are normalised, the integers read as millimetres."""
_CUT_OFF: Final = 0.01
"""Share of pixels with the largest depth above which depth was cut off there, and not normalised to 16 bits."""
_BLACK: Final = 0.003
"""Linear value up to which a pixel may be a black bar's: 10 of 255 in sRGB."""
_LEAST_BAR: Final = 0.02
_BLUR_PX: Final = 8
"""Width of a bar's edge, as compression leaves it."""


def lying_camera(name: str, convention: str, upward: float) -> Note:
    """Make the note for a world that is the first camera's: of a tracker that knows no gravity."""
    up = "y" if convention == "opengl" else "-y"
    return Note(
        f"{name}: the first pose is the identity, so that the camera looks straight {'up' if upward > 0 else 'down'} "
        "in the world that the format assumes",
        "the panorama may be turned by 90 degrees",
        f"state world_up (--world-up {up} if the first camera was held level)",
    )


def first_cameras_up(name: str) -> Note:
    """Make the note for a recording whose poses begin with no turn, which Record3D leaves out of them."""
    text, effect = f"{name}: the first pose is without a turn", "up is that of the first camera"
    return Note(text, effect, "state world_up (--world-up) if it was not held level")


def scaled_poses(name: str, metres: float, height_m: float) -> Note:
    """Make the note for poses that were scaled by the floor."""
    return Note(
        f"{name}: the scale of its poses, found by the floor in view",
        f"a unit of its poses is taken for {metres:.3g} m, the camera for {height_m:g} m above the floor in the mean",
        "scale the poses to metres for exact sizes, and leave out camera_height_m",
    )


def unread_depth(path: Path) -> Note | None:
    """Make the note for files or folders of depth in a recording whose format or index leads to none; else None."""
    entries = [*path.iterdir(), *path.glob("rgbd/*"), *path.glob("keyframes/*")] if path.is_dir() else []
    names = sorted(entry.relative_to(path).as_posix() for entry in entries if "depth" in entry.name.lower())
    if not names:
        return None
    listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    effect = "no frame's depth is read from there"
    return Note(
        f"{path}: {listed}", effect, "name it in the index, or as the format does, if it is these frames' depth"
    )


def removed_lens(name: str, camera: Intrinsics) -> Note:
    """Make the note for a lens whose distortion was removed."""
    pinhole = f"fx {camera.fx:.6g}, fy {camera.fy:.6g}, cx {camera.cx:.6g}, cy {camera.cy:.6g}"
    pinhole += f" of {camera.width} x {camera.height} pixels"
    text, effect = f"{name}: the distortion of its lens", f"pictures and pixels are those of a pinhole with {pinhole}"
    return Note(text, effect, "use this camera with what is written; other frames may have their own")


def wrong_scale(name: str, factor: float | None) -> Note:
    """Make the note for depth whose unit is not that of the poses; `factor` on depth, None where it is not clear."""
    scale = "at another scale" if factor is None else f"about {float(f'{factor:.2g}'):g} times as large"
    return Note(
        f"{name}: depth contradicts the poses; they agree with depth {scale}",
        "the unit of depth or of the poses, or the focal length, seems wrong",
        "state depth_unit_m, the metres for one stored unit of depth, scale the poses to metres, or check the focal "
        "length",
    )


def another_size(name: str, ratio: float | None) -> Note:
    """Make the note for poses that contradict estimated depth; `ratio` of the sizes, None where it is not clear."""
    size = "another size than" if ratio is None else f"{float(f'{ratio:.2g}'):g} times as large as"
    return Note(
        f"{name}: its poses make the room {size} the pictures let expect",
        "their unit is taken for a metre",
        "scale the poses to metres, or state camera_height_m (--camera-height), the camera's height above the floor",
    )


def unlikely_depth(name: str, frames: Sequence[Frame]) -> Note | None:
    """Make the note for depth that the picture contradicts; else None."""
    instead = "or none (of a recording: --depth network): it is then estimated"
    largest = [float(frame.depth_m.max()) for frame in frames]
    shares = [float((frame.depth_m == frame.depth_m.max()).mean()) for frame in frames]
    ranges = _NORMALISED[:-1] if min(shares, default=0) > _CUT_OFF else _NORMALISED
    if largest and any(low <= min(largest) and max(largest) <= high for low, high in ranges):
        text = f"{name}: its largest depth is {largest[0]:.4g}, as where depth is normalised"
        return Note(text, "it is read as metres", f"give depth in metres, {instead}")
    if (odd := odd_depth(frames)) is None:
        return None
    falls, ratio = odd
    if falls:
        text = f"{name}: depth is small where the picture shows what is far, as 1 / depth (disparity) is"
        return Note(text, "it is read as depth", f"give depth in metres, {instead}")
    text = f"{name}: depth is {ratio:.2g} times what the picture lets expect"
    return Note(
        text, "its unit seems wrong, or it is relative", f"state depth_unit_m, or give depth in metres, {instead}"
    )


def wrong_poses(name: str, wrong: Disagreement, convention: CameraConvention, direction: PoseDirection) -> Note:
    """Make the note for poses that do not fit the pictures, or a world that lies on its side."""
    if wrong.axis is not None:
        return Note(
            f"{name}: the cameras are level about the {wrong.axis[-1]} axis of the stored world, not the assumed up",
            "the panorama may be turned by 90 degrees",
            f"state world_up (--world-up {wrong.axis}, unless they hung upside down)",
        )
    if wrong.up is not None:
        return Note(
            f"{name}: the cameras hang upside down in the world that is assumed",
            "the panorama is upside down, unless they did",
            f"state world_up (--world-up {wrong.up})",
        )
    if wrong.length != 1:
        return wrong_scale(name, None if wrong.length is None else 1 / wrong.length)
    if wrong.w_first:
        text = f"{name}: features of the pictures move as quaternions would that have w first"
        return Note(text, "light comes from wrong directions", "write them as qx qy qz qw")
    if wrong.body_axes:
        text = f"{name}: features of the pictures move as for cameras whose axes are x forward, y left, z up"
        instead = "give poses of the optical frame: x right, y down, z forward (--camera-convention opencv)"
        return Note(text, "light comes from wrong directions", instead)
    if wrong.focal != 1:
        times = "half" if wrong.focal < 1 else "twice"
        text = f"{name}: features of the pictures move as with about {times} the stated focal length"
        return Note(text, "places and directions are wrong", "state the intrinsics of pictures of this size")
    if not wrong.known:
        return Note(
            f"{name}: features of the pictures move otherwise than poses and depth say",
            "light comes from wrong places",
            "check that pictures, poses and depth are in one order, none of them turned or mirrored, and that poses do "
            "not stand still or jump",
        )
    options: list[str] = []
    if wrong.other_axes:
        options.append(f"camera_convention (--camera-convention {'opengl' if convention == 'opencv' else 'opencv'})")
    if wrong.inverse:
        other = "camera-to-world" if direction == "world-to-camera" else "world-to-camera"
        options.append(f"pose_direction (--pose-direction {other})")
    return Note(
        f"{name}: features of the pictures do not move as {direction} poses with the camera axes of {convention} say",
        "light comes from wrong directions",
        f"state {' and '.join(options)}, with which they do",
    )


def odd_camera(name: str, camera: Intrinsics, *, oblong: bool = False) -> Note | None:
    """Make the note for intrinsics that hardly a camera has, and another size or unit explains; else None.

    `oblong`: the picture states pixels as wide and high as the focal lengths have them.
    """
    x, y = camera.cx / camera.width, camera.cy / camera.height
    if not (min(x, y) >= 0.4 and max(x, y) <= 0.6):
        what = f"a principal point at ({camera.cx:g}, {camera.cy:g}) of {camera.width} x {camera.height}"
    elif not 0.25 <= camera.width / camera.fx <= 8:
        what = f"a focal length of {camera.fx:g} pixels for {camera.width} pixels"
    elif not oblong and not 0.8 <= camera.fx / camera.fy <= 1.25:
        what = f"focal lengths of {camera.fx:g} and {camera.fy:g} pixels"
    else:
        return None
    return Note(f"{name}: {what}", "it is taken as stated", "check that the intrinsics are those of this picture")


def within_bars(image: Float[np.ndarray, "h w 3"]) -> tuple[int, int, int, int] | None:
    """Return the picture between black bars: left, top, width and height in pixels; None without bars.

    Bars are at opposite sides, about equally wide, black all along, and end at a sharp edge.
    """
    spans: list[tuple[int, int]] = []
    for picture in (image, image.transpose(1, 0, 2)):
        size, ends = picture.shape[1], (0, 0)
        if picture[:, [0, -1]].max() <= _BLACK and picture.max() > 20 * _BLACK:
            lit = (picture.max(axis=2) > _BLACK).mean(axis=0)
            ends = _bar(lit), _bar(lit[::-1])
        barred = min(ends) >= _LEAST_BAR * size and abs(ends[0] - ends[1]) <= _LEAST_BAR * size
        spans.append((ends[0], size - sum(ends)) if barred else (0, size))
    (left, width), (top, height) = spans
    return (left, top, width, height) if left or top else None


def _bar(lit: Float[np.ndarray, " n"]) -> int:
    """Return the lines before the first one of which half is lit; 0 unless they are black.

    In the outer half of them there may be some text, such as a clock's.
    """
    lines = int(np.argmax(lit > 0.5))
    dark: Bool[np.ndarray, " m"] = lit[: max(lines - _BLUR_PX, 0)] < 0.01
    return lines if dark[len(dark) // 2 :].all() and dark.sum() >= 0.75 * len(dark) else 0


def black_bars(name: str, within: Sequence[tuple[int, int, int, int] | None]) -> Note | None:
    """Make the note for the same bars (`within_bars`) in most of some pictures; else None."""
    known = [span for span in within if span is not None]
    if 2 * len(known) <= len(within) or np.ptp(known, axis=0).max() > _BLUR_PX:
        return None
    left, top, width, height = np.median(known, axis=0).astype(int).tolist()
    sides = " and ".join(text for text, wide in (("left and right", left), ("top and bottom", top)) if wide)
    return Note(
        f"{name}: black bars at {sides}",
        "they are read as black walls, and the field of view or intrinsics as those of all the picture",
        f"crop them (ffmpeg -i IN -vf crop={width}:{height}:{left}:{top} OUT)",
    )


def round_picture(name: str, image: Float[np.ndarray, "h w 3"]) -> Note | None:
    """Make the note for a disc in black corners, as a circular fisheye's picture is; else None."""
    lit: Bool[np.ndarray, "h w"] = image.max(axis=2) > _BLACK
    if not 0.2 < lit.mean() < 0.9:
        return None
    rows, columns = (np.flatnonzero(lit.mean(axis=axis) > _LEAST_BAR) for axis in (1, 0))
    centre = (rows[0] + rows[-1]) / 2, (columns[0] + columns[-1]) / 2
    y, x = np.ogrid[: lit.shape[0], : lit.shape[1]]
    distance = np.hypot(y - centre[0], x - centre[1]) / (max(np.ptp(rows), np.ptp(columns), 1) / 2)
    rim, outside = lit[(distance > 0.85) & (distance < 0.95)], lit[distance > 1.05]
    off_centre = np.abs(np.divide(centre, lit.shape) - 0.5).max() > 0.1
    if off_centre or rim.mean() < 0.9 or outside.size < 0.1 * lit.size or outside.mean() > _LEAST_BAR:
        return None
    text = f"{name}: it shows a disc within black, as a circular fisheye does"
    return Note(text, "it is read as the picture of a pinhole camera", "undistort it, and state fov_deg (--fov)")


class PassChecks:
    """Compares the frames of a pass with each other, and with what is assumed about them."""

    def __init__(
        self,
        name: str,
        format: str,
        conventions: tuple[CameraConvention, PoseDirection],
        to_y_up: Float[np.ndarray, "4 4"],
        options: CaptureOptions,
        *,
        passed: int,
        noted: set[str],
    ) -> None:
        """Begin after the first `passed` frames. What options state, or pictures estimate, is not checked.

        `noted` is what a pass that goes on must know of the notes so far; it is added to.
        """
        self._name, self._format, self._conventions = name, format, conventions
        self._up_is_assumed, self._unit_is_assumed = options.world_up is None, options.depth_unit_m is None
        self._scale_is_assumed = options.camera_height_m is None
        self._count, self._poses_are_done = passed, format == "video"
        self._measured, self._set_is_whole, self._noted = True, False, noted
        self._unturned = to_y_up @ (OPENCV_TO_OPENGL if conventions[0] == "opencv" else np.eye(4))
        self._depths, self._within = DepthCheck(), list[tuple[int, int, int, int] | None]()
        self._poses = PoseCheck(to_y_up, opencv=conventions[0] == "opencv", quaternions=format in _OF_QUATERNIONS)

    def add(self, frame: Frame, depth: "DepthStream | None") -> Iterator[Note]:
        """Take a frame, and what estimated its depth; yields what contradicts."""
        self._count += 1
        self._measured = depth is None
        if self._count == 1 and self._up_is_assumed:
            turn, upward = frame.camera_to_world[:3, :3], float(-frame.camera_to_world[1, 2])
            if abs(upward) > 0.99 and np.abs(turn - self._unturned[:3, :3]).max() < 0.02:
                self._noted.add(_LYING)
                yield lying_camera(frame.source, self._conventions[0], upward)
            elif self._format == "record3d" and np.abs(turn - self._unturned[:3, :3]).max() < 1e-4:
                yield first_cameras_up(frame.source)
        if self._count <= FRAMES:
            self._within.append(within_bars(frame.image))
            if depth is None and self._unit_is_assumed:
                self._depths.add(frame)
        if not self._poses_are_done and self._poses.add(frame):
            self._set_is_whole = True
        if self._count == FRAMES:
            yield from self._notes_of_first()
            if depth is not None and not self._poses_are_done and self._scale_is_assumed:
                ratio = 1 / depth.state.per_metre
                if depth.model.kind == "metric" and ratio > _MOST_BY_POSES:
                    self._noted.add(_DEPTH)
                    yield another_size(self._name, ratio)
        elif self._count > FRAMES and self._set_is_whole:
            yield from self._notes_of_poses()

    def end(self) -> Iterator[Note]:
        """Yield what contradicts in a pass that ends here."""
        if self._count < FRAMES:
            yield from self._notes_of_first()
        if not self._poses_are_done:
            yield from self._notes_of_poses()
        if _APART in self._noted:
            text = f"{self._name}: depth of different frames does not meet by the poses"
            advice = "check that depth is in the order of the pictures, and that neither of them is turned or mirrored"
            yield Note(text, "light comes from wrong places", advice)

    def _notes_of_first(self) -> Iterator[Note]:
        """Yield notes of depth that contradicts the poses, or, where any tool wrote it, the pictures; and of bars.

        Turned maps come first: features contradict them too. Features tell a scale better than maps.
        """
        mismatch, odd = self._depths.mismatch(), None
        if mismatch is not None and mismatch.turn and looks_turned(self._depths.samples, mismatch.turn):
            self._noted.add(_DEPTH)
            text = f"{self._name}: depth agrees with the poses if its maps are {mismatch.turn}"
            advice = "store them in the rows and columns of their pictures"
            yield Note(text, "light comes from wrong places", advice)
        if self._set_is_whole:
            yield from self._notes_of_poses()
        if mismatch is not None and mismatch.factor is not None and _DEPTH not in self._noted:
            self._noted.add(_DEPTH)
            yield wrong_scale(self._name, mismatch.factor)
        of_any_tool = self._format in _OF_ANY_TOOL and _DEPTH not in self._noted
        if of_any_tool and (odd := unlikely_depth(self._name, self._depths.samples)) is not None:
            yield odd
        elif mismatch is not None and _DEPTH not in self._noted and not self._poses_are_done:
            self._noted.add(_APART)
        if (barred := black_bars(self._name, self._within)) is not None:
            yield barred

    def _notes_of_poses(self) -> Iterator[Note]:
        """Yield a note of what contradicts the pictures in the assumed conventions, once in a pass."""
        self._set_is_whole = False
        wrong = self._poses.disagreement(measured=self._measured)
        if wrong is None or (wrong.up is not None and self._format not in _OF_ANY_TOOL):  # a phone may be held so
            return
        if wrong.axis is not None and _LYING in self._noted:  # the note of the first pose names the axis
            return
        if self._up_is_assumed or (wrong.axis is None and wrong.up is None):
            self._poses_are_done = True
            self._noted.discard(_APART)
            if wrong.length != 1:
                if _DEPTH in self._noted or not (self._measured or self._scale_is_assumed):
                    return
                self._noted.add(_DEPTH)
                if not self._measured:
                    yield another_size(self._name, None if wrong.length is None else 1 / wrong.length)
                    return
            note = wrong_poses(self._name, wrong, *self._conventions)
            if self._format == "rtabmap" and not wrong.known:  # format 1 looks the same, with other axes
                note = replace(note, advice=f"export poses with --poses_format 11; {note.advice}")
            yield note
