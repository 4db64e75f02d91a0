"""Bags of ROS 1 and 2 (`.bag`, or a folder or file of `.db3` or `.mcap`, a folder also of `.zstd`), by `rosbags`.

A record is a colour image with the depth image nearest in time. Topics are chosen by their type and name: colour by
`color` or `rgb`, those with a CameraInfo first; depth by `depth`, else by its encoding, that of the colour's frame
first, then of its namespace, then `aligned` or `registered`. Depth of another frame is projected into the colour image
by the fixed transforms of tf; of depth and colour of one frame, where one alone is rectified, the other's lens is
removed, of depth only with a CameraInfo of its own.

Conventions: the pose is that of the colour image's frame in the root of tf; without one there, TransformStamped, or one
topic of Odometry or PoseStamped (also with covariance), carries it. Optical frames are OpenCV's, the world is z-up
(REP 103). Pixel centres are at whole numbers (`CameraInfo`), so that half a pixel is added. 16UC1 is millimetres, 32FC1
metres.
"""

import importlib
import importlib.util
from collections.abc import Generator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.decoding import registered
from roomlight.captures.formats.ros.container import (
    IMAGES,
    INFO,
    POSES,
    TREES,
    TopicImages,
    first_image,
    has_index,
    is_later_part,
    opened_bag,
    parts_of,
)
from roomlight.captures.formats.ros.images import (
    camera_of,
    decode_colour_image,
    decode_depth_image,
    lens_of_raw,
    pose_values,
    seconds,
)
from roomlight.captures.formats.ros.topics import colour_topic, depth_topic, is_raw, other_trees, space_of
from roomlight.captures.formats.ros.transform_tree import TransformTree
from roomlight.captures.lenses import Lens, straightened, undistorted
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES
from roomlight.captures.times import nearest
from roomlight.errors import CaptureError, FrameError, RoomLightError
from roomlight.notes import Note

MAX_GAP_S: Final = 0.025


@dataclass(frozen=True)
class _Entry:
    """An image: the time in its header, and where it lies in the bag."""

    time_s: float
    logged: int


@dataclass(frozen=True)
class _Pose:
    """A pose of an Odometry, or of a PoseStamped or PoseWithCovarianceStamped message, which name no `child`."""

    kind: str
    parent: str
    child: str
    values: Float[np.ndarray, "7"]
    time_s: float


class RosBagReader:
    """Reads a bag."""

    format = "ros-bag"
    conventions = PoseConventions("opencv", "camera-to-world", (0.0, 0.0, 1.0))

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        if importlib.util.find_spec("rosbags") is None:
            raise CaptureError(f"{path}: is a ROS bag, which needs pip install 'roomlight[rosbag]'")
        if path.suffix.lower() == ".zstd":
            raise CaptureError(f"{path}: is a compressed part of a bag; open its folder, with metadata.yaml")
        self._path, self._unit_m = path, options.depth_unit_m
        self.probes: list[RawProbe] = []
        self.notes: list[Note] = []
        if parts := [file.name for file in parts_of(path)]:
            left = f"{path}: {len(parts)} bags, {', '.join(parts[:4])}"
            self.notes.append(Note(left, "read as parts of one recording", "open one of them to read it alone"))
        self._tree = TransformTree()
        self._cameras: dict[str, Any] = {}
        self._frames: dict[str, str] = {}
        self._entries: dict[str, list[_Entry]] = {}
        self._depth: str | None = None
        self._frame_id = ""  # of colour
        with opened_bag(path) as bag:
            topics = {connection.topic: connection.msgtype for connection in bag.connections}
            self._infos = {space_of(topic) for topic, kind in topics.items() if kind == INFO}
            firsts = {topic: first_image(bag, topic) for topic, kind in topics.items() if kind in IMAGES}
            self._colour = colour_topic(path, topics, firsts, self._infos, self.notes)
            if options.depth != "network":
                self._depth = depth_topic(path, self._colour, firsts, self.notes)
            self._index(bag, topics)
        self.count = len(self._entries.get(self._colour, []))
        if self.count > MAX_FRAMES:
            raise CaptureError(f"{path}: has {self.count} frames; up to {MAX_FRAMES} are read")
        if self._colour not in self._cameras:
            raise CaptureError(f"{path}: has no CameraInfo beside {self._colour}; record its camera_info too")
        with fields.naming(f"{path}: the CameraInfo beside {self._colour}", CaptureError):
            self._lens = self._lens_of(self._colour)
        if self.count and not self._tree.moves(self._frame_id):
            camera = self._frame_id or "the camera"
            if moving := ", ".join(self._tree.moving()[:4]):
                later = "it may be in an earlier part: open the folder of all, or "
                text = f"has poses of {moving}, and no tf from there to {camera}; "
                raise CaptureError(f"{path}: {text}{later if is_later_part(path) else ''}record tf_static too")
            raise CaptureError(
                f"{path}: has no poses of {camera} (tf, Odometry, PoseStamped); recordings of RealSense alone hold "
                "none: run a SLAM such as RTAB-Map on it, and export that"
            )

    def name_of(self, index: int) -> str:
        """Return the bag, the topic and the image's number."""
        return f"{self._path}: {self._colour} {index}"

    def timestamps(self) -> list[float | None]:
        """Return the times in the images' headers."""
        return [entry.time_s for entry in self._entries[self._colour]]

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Hold the bag open for one pass; without an index for each topic, because depth may be recorded later."""
        with opened_bag(self._path) as bag, nullcontext(bag) if has_index(bag) else opened_bag(self._path) as other:
            images = {self._depth: TopicImages(other, self._depth), self._colour: TopicImages(bag, self._colour)}
            yield lambda index: self._read(index, images)

    def _index(self, bag: Any, topics: dict[str, str]) -> None:
        """Take the poses and cameras, and the times of the images."""
        others = other_trees([topic for topic, kind in topics.items() if kind in TREES], self._colour)
        wanted = {topic for topic, kind in topics.items() if kind in (*TREES, *POSES, INFO)}.difference(others)
        images = {self._colour} if self._depth is None else {self._colour, self._depth}
        chosen = [c for c in bag.connections if c.topic in wanted | images]
        loose: dict[str, list[_Pose]] = {}
        try:
            for connection, logged, raw in bag.messages(connections=chosen):
                kind, topic = connection.msgtype, connection.topic
                if topic in images:
                    self._add_image(bag, topic, kind, raw, logged)
                    continue
                message = bag.deserialize(raw, kind)
                if kind in TREES:
                    for stamped in message.transforms:
                        self._add(stamped, fixed="static" in topic)
                elif kind == INFO:
                    for image in images:
                        if space_of(image, self._infos) == space_of(topic):
                            self._cameras.setdefault(image, message)
                elif kind.endswith("TransformStamped"):
                    self._add(message, fixed=False)
                else:
                    pose = getattr(message.pose, "pose", message.pose)
                    values, time_s = pose_values(pose.position, pose.orientation), seconds(message.header)
                    parent, child = message.header.frame_id, getattr(message, "child_frame_id", "").lstrip("/")
                    loose.setdefault(topic, []).append(_Pose(kind.split("/")[-1], parent, child, values, time_s))
        except RoomLightError:
            raise
        except Exception as error:  # rosbags raises whatever the damaged bytes lead to
            if "not in timestamp order" in str(error):
                text = "its messages are not in the order of their time, and it has no index; run mcap sort on it"
                raise CaptureError(f"{self._path}: {text}") from error
            raise CaptureError(f"{self._path}: is damaged ({error})") from error
        self._depths = sorted(self._entries.get(self._depth or "", []), key=lambda entry: entry.time_s)
        self._depth_times = [entry.time_s for entry in self._depths]
        self._frame_id = self._frames.get(self._colour, "")
        settled = self._tree.settle()
        root = self._tree.root(self._frame_id)
        carried = any(self._carries(root, poses[0]) for poses in loose.values())  # as a head that moves on tf
        if carried or (loose and not self._tree.moves(self._frame_id)):
            self._add_poses(loose)
        stands = not self._tree.moves(self._frame_id) and not (loose and self._tree.moving())
        if settled and stands:  # nothing says that it moved
            self._tree.unsettle(settled)
            left = f"{self._path}: poses that never change"
            self.notes.append(Note(left, "the camera is read as one that stands", "record its poses if it moved"))
        for child, kept, other in self._tree.conflicts(self._frame_id):
            left = f"{self._path}: poses of {child} in {other} beside those in {kept}"
            self.notes.append(
                Note(left, f"those in {kept}, which come first, are read", "record one of them to be sure")
            )

    def _carries(self, root: str, pose: _Pose) -> bool:
        """Whether a pose is that of a root, or of a frame fixed to it, in a frame that is not fixed to it."""
        return self._tree.between(root, pose.child) is not None and self._tree.between(root, pose.parent) is None

    def _add_poses(self, topics: dict[str, list[_Pose]]) -> None:
        """Take the poses of the topic that fits best; others are noted.

        It is one whose child is the root of the camera's frame, or fixed to it, else one without a child that is called
        after a camera; Odometry before PoseStamped, then the one with most messages while images were taken.
        """
        top = self._tree.root(self._frame_id)
        times = [entry.time_s for entry in self._entries.get(self._colour, [])] or [0.0]
        start, stop = min(times) - MAX_GAP_S, max(times) + MAX_GAP_S

        def order(topic: str) -> tuple[bool, bool, bool, bool, bool, bool, int, str]:
            first, count = topics[topic][0], sum(start <= pose.time_s <= stop for pose in topics[topic])
            named, below = bool(first.child), first.child != top
            other = named and not self._carries(top, first)
            unlike = not named and "cam" not in topic.lower()
            return other, not count, not named, below, unlike, first.kind != "Odometry", -count, topic

        best, *others = sorted(topics, key=order)
        if self._carries(top, topics[best][0]):
            self._tree.turn_above(topics[best][0].child)
        for pose in topics[best]:
            self._tree.add(pose.parent or "world", pose.child or top, pose.values, time_s=pose.time_s)
        if others:
            left = f"{self._path}: the poses of {', '.join(others[:4])}"
            self.notes.append(Note(left, f"those of {best} are read", f"leave {best} out of the bag to read others"))
        if not topics[best][0].child and topics[best][0].parent.lstrip("/") != top:  # else they say nothing of it
            text = f"taken for the poses of {top or 'the camera'}"
            left = f"{self._path}: the {topics[best][0].kind} messages of {best}"
            way = f", or leave tf_static out if they are those of {self._frame_id}" if top != self._frame_id else ""
            self.notes.append(Note(left, text, f"record tf to be sure{way}"))

    def _add_image(self, bag: Any, topic: str, kind: str, raw: Any, logged: int) -> None:
        """Keep where an image lies; a damaged one is found when it is read."""
        time_s = logged * 1e-9
        try:
            header = bag.deserialize(raw, kind).header
            time_s = seconds(header)
            self._frames.setdefault(topic, header.frame_id)
        except Exception:  # as below
            pass
        self._entries.setdefault(topic, []).append(_Entry(time_s, logged))

    def _add(self, stamped: Any, *, fixed: bool) -> None:
        transform = stamped.transform
        values = pose_values(transform.translation, transform.rotation)
        self._tree.add(
            stamped.header.frame_id, stamped.child_frame_id, values, time_s=seconds(stamped.header), fixed=fixed
        )

    def _read(self, index: int, images: dict[str | None, TopicImages]) -> RawFrame:
        label = self.name_of(index)
        entry = self._entries[self._colour][index]
        with fields.naming(label, FrameError):
            pose = self._tree.pose(self._frame_id, entry.time_s)
            picture = decode_colour_image(self._message(images, self._colour, entry), label)
            height, width = picture.image.shape[:2]
            camera = camera_of(self._cameras[self._colour], (width, height), raw=is_raw(self._colour))
            depth_m, between = np.zeros((height, width), np.float32), None
            if self._depth is not None:
                depth_m = self._depth_near(entry.time_s, self._depth, images, label)
                between = self._between(self._depth)
            picture, straight_m, camera, stated = straightened(picture, depth_m, camera, self._lens, label)
            if self._depth is not None and between is not None:
                straight_m = self._in_colour(depth_m, self._depth, camera, between)
        depth_name = None if self._depth is None else f"{self._path}: {self._depth}"
        return RawFrame(label, picture, straight_m, depth_name, camera, pose, stated=stated)

    def _depth_near(
        self, time_s: float, topic: str, images: dict[str | None, TopicImages], label: str
    ) -> Float[np.ndarray, "h w"]:
        """Return the depth image nearest in time. Raises ValueError if it is too far."""
        if not self._depths:
            raise ValueError(f"{topic} has no image")
        entry = self._depths[nearest(self._depth_times, time_s)]
        if abs(entry.time_s - time_s) > MAX_GAP_S:
            raise ValueError(f"the nearest depth is {abs(entry.time_s - time_s):.3f} s away")
        return decode_depth_image(self._message(images, topic, entry), label, self._unit_m)

    def _message(self, images: dict[str | None, TopicImages], topic: str, entry: _Entry) -> Any:
        """Read an image again, by the time at which it was recorded."""
        try:
            for message in images[topic].at(entry.logged):
                if seconds(message.header) == entry.time_s:
                    return message
        except Exception as error:  # as above
            raise FrameError(f"{self._path}: {topic} does not decode ({error})") from error
        raise FrameError(f"{self._path}: {topic} has no message of {entry.time_s:.3f} s")

    def _between(self, topic: str) -> Float[np.ndarray, "4 4"] | None:
        """Return the transform from depth of another camera, or without a lens; None for the colour's, or taken so."""
        frame, own = self._frames.get(topic, ""), self._cameras[self._colour]
        if frame.lstrip("/") == self._frame_id.lstrip("/"):
            is_lent = self._cameras.setdefault(topic, own) is own
            alike = is_raw(topic) == is_raw(self._colour) or (is_lent and not is_raw(self._colour))
            if alike or (self._lens.straight and self._lens_of(topic).straight):
                return None
            return np.eye(4)
        between = self._tree.between(self._frame_id, frame)
        if between is not None and self._cameras.get(topic, own) is not own:
            return between
        lacking = "no fixed transform from" if between is None else "no CameraInfo of"
        text = "taken for depth of the colour camera"
        way = "record tf_static and camera_info, or aligned depth"
        note = Note(f"{self._path}: {lacking} {frame!r}", text, way)
        if note not in self.notes:
            self.notes.append(note)
        return None

    def _in_colour(
        self, depth_m: Float[np.ndarray, "h w"], topic: str, colour: Intrinsics, between: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "dh dw"]:
        """Project depth of another camera into the colour image, without the distortion of either."""
        height, width = depth_m.shape
        camera, lens = camera_of(self._cameras[topic], (width, height), raw=is_raw(topic)), self._lens_of(topic)
        if not lens.straight:
            (depth_m,), camera = undistorted([(depth_m, cv2.INTER_NEAREST)], camera, lens)
        return registered(depth_m, camera, colour, between)

    def _lens_of(self, topic: str) -> Lens:
        """Return the lens of a topic's camera. Raises ValueError."""
        return lens_of_raw(self._cameras[topic]) if is_raw(topic) else Lens()
