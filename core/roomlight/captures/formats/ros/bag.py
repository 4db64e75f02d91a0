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
import re
from collections import deque
from collections.abc import Collection, Generator, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures import fields
from roomlight.captures.capture import PoseConventions, RawFrame, RawProbe, ReadRecord
from roomlight.captures.decoding import registered
from roomlight.captures.formats.ros.images import (
    camera_of,
    decode_colour_image,
    decode_depth_image,
    is_colour,
    is_range,
    lens_of_raw,
    pose_values,
    seconds,
)
from roomlight.captures.formats.ros.transform_tree import TransformTree
from roomlight.captures.lenses import Lens, straightened, undistorted
from roomlight.captures.options import CaptureOptions
from roomlight.captures.source import MAX_FRAMES
from roomlight.captures.times import nearest
from roomlight.errors import CaptureError, FrameError, RoomLightError
from roomlight.notes import Note

_SUFFIXES: Final = (".bag", ".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
MAX_GAP_S: Final = 0.025
_IMAGES: Final = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_COLOUR: Final = ("color", "rgb", "image")
_NO_COLOUR: Final = ("depth", "infra", "fisheye", "mask", "conf")
_NO_DEPTH: Final = re.compile("conf|disparity")
_NO_RANGE: Final = re.compile(
    r"conf|disparity|infra|mask|label|therm|intens|ampli|noise|gr[ae]y|mono|signal|reflec|range_|(^|[/_])ir([/_]|$)"
)
"""Names of 16-bit and float images that are no depth, where `depth` is not in the name."""
_INFO: Final = "sensor_msgs/msg/CameraInfo"
_POSES: Final = (
    "nav_msgs/msg/Odometry",
    *(f"geometry_msgs/msg/{name}Stamped" for name in ("Pose", "PoseWithCovariance", "Transform")),
)
_RECTIFIED: Final = re.compile("(^|[/_])rect")
_TREES: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_READ: Final = re.compile(
    "/(Time|Duration|Header|Image|CompressedImage|CameraInfo|RegionOfInterest|TFMessage|Transform|TransformStamped|"
    "Odometry|PoseStamped|PoseWithCovariance(Stamped)?|Pose|TwistWithCovariance|Twist|Point|Vector3|Quaternion)$"
)
"""The types of messages that are read, and of their fields: to prepare all 150 takes ten times as long."""


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


class _Images:
    """Images of a topic; those of a bag without an index are read in the order of their recording, once in a pass.

    The latest stay, because several colours may have the same depth.
    """

    def __init__(self, bag: Any, topic: str | None) -> None:
        self._bag, self._chosen = bag, [c for c in bag.connections if c.topic == topic]
        self._indexed = _has_index(bag)
        self._latest = deque[tuple[Any, int, bytes]](maxlen=8)
        self._ahead: Iterator[tuple[Any, int, bytes]] = iter(())

    def at(self, logged: int) -> Iterator[Any]:
        """Yield the images of this time: without an index among the latest and the next ones, then by a search."""
        if not self._indexed and (not self._latest or logged <= self._latest[0][1]):
            self._latest.clear()
            self._ahead = self._bag.messages(connections=self._chosen, start=logged)
        with suppress(Exception):  # of damaged bytes on the way, which the search leaves out
            for connection, time, raw in chain([*self._latest], self._next()):
                if time == logged:
                    yield self._bag.deserialize(raw, connection.msgtype)
                if time > logged:
                    break
        self._latest.clear()
        for connection, _, raw in self._bag.messages(connections=self._chosen, start=logged, stop=logged + 1):
            yield self._bag.deserialize(raw, connection.msgtype)

    def _next(self) -> Iterator[tuple[Any, int, bytes]]:
        for message in self._ahead:
            self._latest.append(message)
            yield message


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
        self._tree = TransformTree()
        self._cameras: dict[str, Any] = {}
        self._frames: dict[str, str] = {}
        self._entries: dict[str, list[_Entry]] = {}
        self._frame_id = ""  # of colour
        with self._opened() as bag:
            topics = {connection.topic: connection.msgtype for connection in bag.connections}
            self._infos = {_space(topic) for topic, kind in topics.items() if kind == _INFO}
            firsts = {topic: _first(bag, topic) for topic, kind in topics.items() if kind in _IMAGES}
            self._colour = self._colour_topic(topics, firsts)
            self._depth = None if options.depth == "network" else self._depth_topic(firsts)
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
                text = f"has poses of {moving}, and no tf from there to {camera}; record tf_static too"
                raise CaptureError(f"{path}: {text}")
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
        with self._opened() as bag, nullcontext(bag) if _has_index(bag) else self._opened() as other:
            images = {self._depth: _Images(other, self._depth), self._colour: _Images(bag, self._colour)}
            yield lambda index: self._read(index, images)

    @contextmanager
    def _opened(self) -> Generator[Any]:
        highlevel: Any = importlib.import_module("rosbags.highlevel")
        typesys: Any = importlib.import_module("rosbags.typesys")
        humble = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE).fielddefs  # for bags that hold no definitions
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        store.fielddefs.update({name: parts for name, parts in humble.items() if _READ.search(name)})
        try:
            bag = highlevel.AnyReader([self._path], default_typestore=store)
            bag.open()
        except Exception as error:  # of the container, the index or the storage plugin
            way = "copy it again; rosbag reindex (ros2 bag reindex) repairs one that was not closed"
            if self._path.is_file() and self._path.suffix != (small := self._path.suffix.lower()):
                way = f"rename it to end in {small}"
            elif "Profile is not ros2" in str(error):
                file = [self._path, *self._path.glob("*.mcap")][-1]
                way = f"its profile is {_mcap_profile(file)!r}; record it with ROS 2, or convert it to a bag of ROS 2"
            raise CaptureError(f"{self._path}: is not a readable ROS bag ({error}); {way}") from error
        try:
            names = [name for connection in bag.connections for name in (connection.topic, connection.msgtype)]
            if not all(isinstance(name, str) for name in names):
                raise CaptureError(f"{self._path}: its topics are damaged")
            yield bag
        finally:
            bag.close()

    def _colour_topic(self, topics: dict[str, str], firsts: dict[str, Any]) -> str:
        """Return the topic of colour whose name fits best; others are noted. Raises CaptureError with what there is."""
        images = [topic for topic in firsts if _rank(topic, _COLOUR) < len(_COLOUR) and not is_range(firsts[topic])]
        images = [topic for topic in images if _rank(topic, _NO_COLOUR) == len(_NO_COLOUR)]
        if not images:
            listed = ", ".join(sorted(topics)[:12]) or "nothing"
            raise CaptureError(f"{self._path}: has no topic of colour images; its topics are {listed}")
        spaces = {topic: _space(topic, self._infos) for topic in images}

        def order(topic: str) -> tuple[bool, bool, int, bool, str]:
            guessed = _space(topic) not in self._infos
            return spaces[topic] not in self._infos, guessed, _rank(topic, _COLOUR), "compressed" in topic, topic

        images.sort(key=order)
        known = dict.fromkeys(spaces[topic] for topic in images if spaces[topic] in self._infos)
        if others := [space or "/" for space in known if space != spaces[images[0]]]:
            left = f"{self._path}: the cameras {', '.join(others[:4])}"
            self.notes.append(Note(left, f"{images[0]} alone is read", "leave it out of the bag to read another"))
        return images[0]

    def _depth_topic(self, firsts: dict[str, Any]) -> str | None:
        """Return the topic of depth of the colour's frame, or nearest to its name; None without one.

        Noted are colours that are called depth, and depth that is not.
        """
        named = sorted(topic for topic in firsts if "depth" in topic.lower() and not _NO_DEPTH.search(topic.lower()))
        depths = [topic for topic in named if firsts[topic] is None or not is_colour(firsts[topic])]
        if not depths:
            depths = [topic for topic in firsts if is_range(firsts[topic]) and not _NO_RANGE.search(topic.lower())]
            if named and not depths:
                left, text = f"{self._path}: {', '.join(named[:4])}", "holds colours, so that no depth is read"
                self.notes.append(Note(left, text, "record depth (16UC1 or 32FC1)"))
        own, frame = self._colour.split("/"), _frame_of(firsts[self._colour])

        def order(topic: str) -> tuple[bool, int, int, bool, str]:
            parts = enumerate(zip(topic.split("/"), own, strict=False))
            shared = next((at for at, (part, other) in parts if part != other), len(own))
            other = _frame_of(firsts[topic]) != frame
            return other, -shared, _rank(topic, ("aligned", "registered")), "compressed" in topic, topic

        best = min(depths, key=order, default=None)
        if best is not None and best not in named:
            text = f"{self._path}: {best}, of {firsts[best].encoding}"
            self.notes.append(Note(text, "taken for depth, which its name does not say", "leave it out if it is not"))
        return best

    def _index(self, bag: Any, topics: dict[str, str]) -> None:
        """Take the poses and cameras, and the times of the images."""
        wanted = (*_TREES, *_POSES, _INFO)
        images = {self._colour} if self._depth is None else {self._colour, self._depth}
        chosen = [c for c in bag.connections if topics[c.topic] in wanted or c.topic in images]
        loose: dict[str, list[_Pose]] = {}
        try:
            for connection, logged, raw in bag.messages(connections=chosen):
                kind, topic = connection.msgtype, connection.topic
                if topic in images:
                    self._add_image(bag, topic, kind, raw, logged)
                    continue
                message = bag.deserialize(raw, kind)
                if kind in _TREES:
                    for stamped in message.transforms:
                        self._add(stamped, fixed="static" in topic)
                elif kind == _INFO:
                    for image in images:
                        if _space(image, self._infos) == _space(topic):
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
        self._frame_id = self._frames.get(self._colour, "")
        settled = self._tree.settle()
        if loose and not self._tree.moves(self._frame_id):
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

    def _add_poses(self, topics: dict[str, list[_Pose]]) -> None:
        """Take the poses of the topic that fits best; others are noted.

        It is one whose child is the camera's, else one without a child that is called after a camera; Odometry before
        PoseStamped, then the one with most messages while images were taken.
        """
        top = self._tree.root(self._frame_id)
        times = [entry.time_s for entry in self._entries.get(self._colour, [])] or [0.0]
        start, stop = min(times) - MAX_GAP_S, max(times) + MAX_GAP_S

        def order(topic: str) -> tuple[bool, bool, bool, bool, bool, int, str]:
            first, count = topics[topic][0], sum(start <= pose.time_s <= stop for pose in topics[topic])
            other, named = first.child not in ("", top), bool(first.child)
            unlike = not named and "cam" not in topic.lower()
            return other, not count, not named, unlike, first.kind != "Odometry", -count, topic

        best, *others = sorted(topics, key=order)
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

    def _read(self, index: int, images: dict[str | None, _Images]) -> RawFrame:
        label = self.name_of(index)
        entry = self._entries[self._colour][index]
        with fields.naming(label, FrameError):
            pose = self._tree.pose(self._frame_id, entry.time_s)
            picture = decode_colour_image(self._message(images, self._colour, entry), label)
            height, width = picture.image.shape[:2]
            camera = camera_of(self._cameras[self._colour], (width, height), raw=_is_raw(self._colour))
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
        self, time_s: float, topic: str, images: dict[str | None, _Images], label: str
    ) -> Float[np.ndarray, "h w"]:
        """Return the depth image nearest in time. Raises ValueError if it is too far."""
        depths = self._entries.get(topic, [])
        if not depths:
            raise ValueError(f"{topic} has no image")
        entry = depths[nearest([depth.time_s for depth in depths], time_s)]
        if abs(entry.time_s - time_s) > MAX_GAP_S:
            raise ValueError(f"the nearest depth is {abs(entry.time_s - time_s):.3f} s away")
        return decode_depth_image(self._message(images, topic, entry), label, self._unit_m)

    def _message(self, images: dict[str | None, _Images], topic: str, entry: _Entry) -> Any:
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
            alike = _is_raw(topic) == _is_raw(self._colour) or (is_lent and not _is_raw(self._colour))
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
        camera, lens = camera_of(self._cameras[topic], (width, height), raw=_is_raw(topic)), self._lens_of(topic)
        if not lens.straight:
            (depth_m,), camera = undistorted([(depth_m, cv2.INTER_NEAREST)], camera, lens)
        return registered(depth_m, camera, colour, between)

    def _lens_of(self, topic: str) -> Lens:
        """Return the lens of a topic's camera. Raises ValueError."""
        return lens_of_raw(self._cameras[topic]) if _is_raw(topic) else Lens()


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file of its endings, or ROS 2's folder."""
    if path.is_file():
        return path.name.lower().endswith(_SUFFIXES)
    return (path / "metadata.yaml").is_file() and any(file.name.endswith(_SUFFIXES) for file in path.iterdir())


def _has_index(bag: Any) -> bool:
    """Whether images are read by their place; an MCAP without chunks is read from its start by each call."""
    stores = [getattr(reader, "storage", reader) for reader in bag.readers]  # of a folder or a file
    files = [file for store in stores for file in getattr(store, "storages", [store])]
    return all(getattr(file, "chunks", True) for file in files)


def _first(bag: Any, topic: str) -> Any:
    """Return the first image of a topic; None for an empty or a damaged one, which is found when it is read."""
    try:
        connection, _, raw = next(bag.messages(connections=[c for c in bag.connections if c.topic == topic]))
        return bag.deserialize(raw, connection.msgtype)
    except Exception:  # rosbags raises whatever the damaged bytes lead to
        return None


def _mcap_profile(path: Path) -> str:
    """Return the profile that an MCAP's header states first."""
    with path.open("rb") as file:
        head = file.read(100)
    return head[21 : 21 + int.from_bytes(head[17:21], "little")].decode(errors="replace")


def _frame_of(message: Any) -> str | None:
    """Return the frame of an image; None without one."""
    return None if message is None else message.header.frame_id.lstrip("/")


def _is_raw(topic: str) -> bool:
    """Whether images are as the lens shows them."""
    return _RECTIFIED.search(topic) is None


def _rank(topic: str, words: tuple[str, ...]) -> int:
    """Return the place of the first of these words that a topic has; their number without one."""
    return next((at for at, word in enumerate(words) if word in topic.lower()), len(words))


def _space(topic: str, infos: Collection[str] = ()) -> str:
    """Return the namespace of a camera: of `camera/color/image_raw/compressed` it is `camera/color`.

    Of `sim/rgb` it is `sim` where `sim/rgb` is not among the namespaces that have a CameraInfo (Isaac Sim).
    """
    parts = topic.split("/")
    for end in ("image", "info", "camera_info"):
        for at, part in enumerate(parts):
            if at and (part == end or part.startswith("image")):
                return "/".join(parts[:at])
    own = re.sub("/compressed(Depth)?$", "", topic)
    return own.rpartition("/")[0] if infos and own not in infos else own
