"""The container of a bag: its files, the definitions of its messages, and its images by the time of their recording."""

import importlib
import re
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import Any, Final

from roomlight.errors import CaptureError

_SUFFIXES: Final = (".bag", ".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
_PART: Final = re.compile(r"(.*?)_?(?:\d{4}(?:-\d\d){5})?_(\d+)\.(?:bag|db3|mcap)")
"""Names of parts of a recording: its name, for ROS 1 the time of the part's start, and a number."""
IMAGES: Final = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO: Final = "sensor_msgs/msg/CameraInfo"
POSES: Final = (
    "nav_msgs/msg/Odometry",
    *(f"geometry_msgs/msg/{name}Stamped" for name in ("Pose", "PoseWithCovariance", "Transform")),
)
TREES: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_READ: Final = re.compile(
    "/(Time|Duration|Header|Image|CompressedImage|CameraInfo|RegionOfInterest|TFMessage|Transform|TransformStamped|"
    "Odometry|PoseStamped|PoseWithCovariance(Stamped)?|Pose|TwistWithCovariance|Twist|Point|Vector3|Quaternion)$"
)
"""The types of messages that are read, and of their fields: to prepare all 150 takes ten times as long."""


class TopicImages:
    """Images of a topic; those of a bag without an index are read in the order of their recording, once in a pass.

    The latest stay, because several colours may have the same depth.
    """

    def __init__(self, bag: Any, topic: str | None) -> None:
        self._bag, self._chosen = bag, [c for c in bag.connections if c.topic == topic]
        self._indexed = has_index(bag)
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


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file of its endings, ROS 2's folder, or one of all parts of ROS 1's."""
    if path.is_file():
        return path.name.lower().endswith(_SUFFIXES)
    has_metadata = (path / "metadata.yaml").is_file()
    return (has_metadata and any(file.name.endswith(_SUFFIXES) for file in path.iterdir())) or bool(parts_of(path))


def parts_of(folder: Path) -> list[Path]:
    """Return the parts of a split recording of ROS 1 by their number; none if a folder has other bags too."""
    files = [file for file in folder.glob("*.bag") if file.name[0] != "."]
    parts = sorted((int(name[2]), name[1], file) for file in files if (name := _PART.fullmatch(file.name)))
    numbers, names = [number for number, _, _ in parts], {name for _, name, _ in parts}
    is_whole = numbers == list(range(len(files))) and len(names) == 1 < len(parts)
    return [file for _, _, file in parts] if is_whole else []


def is_later_part(path: Path) -> bool:
    """Whether a file has the name of a part of a split recording after its first."""
    return (name := _PART.fullmatch(path.name)) is not None and int(name[2]) > 0


class _FilteredReader:
    """A reader of `rosbags` that leaves out definitions of types that are never read; a damaged one would stop it."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)

    def __enter__(self) -> Any:
        return self._reader.__enter__()

    def __exit__(self, *raised: object) -> None:
        self._reader.__exit__(*raised)

    @property
    def connections(self) -> list[Any]:
        """The connections, those of other types without a definition."""
        interfaces: Any = importlib.import_module("rosbags.interfaces")
        none = interfaces.MessageDefinition(interfaces.MessageDefinitionFormat.NONE, "")
        wanted, stated = (*IMAGES, *TREES, *POSES, INFO), self._reader.connections
        return [c if c.msgtype in wanted else c._replace(msgdef=none) for c in stated]


@contextmanager
def opened_bag(path: Path) -> Generator[Any]:
    """Open a bag for reading. Raises CaptureError, with what to do."""
    highlevel: Any = importlib.import_module("rosbags.highlevel")
    typesys: Any = importlib.import_module("rosbags.typesys")
    humble = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE).fielddefs  # for bags that hold no definitions
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.fielddefs.update({name: parts for name, parts in humble.items() if _READ.search(name)})
    try:
        bag = highlevel.AnyReader(parts_of(path) or [path], default_typestore=store)
        bag.readers = [_FilteredReader(reader) for reader in bag.readers]
        bag.open()
    except Exception as error:  # of the container, the index or the storage plugin
        raise CaptureError(f"{path}: is not a readable ROS bag ({error}); {_way_out(path, error)}") from error
    try:
        names = [name for connection in bag.connections for name in (connection.topic, connection.msgtype)]
        if not all(isinstance(name, str) for name in names):
            raise CaptureError(f"{path}: its topics are damaged")
        yield bag
    finally:
        bag.close()


def _way_out(path: Path, error: Exception) -> str:
    """Say what to do about a bag that does not open."""
    if path.is_file() and path.suffix != (small := path.suffix.lower()):
        return f"rename it to end in {small}"
    mcaps = [file for file in (path, *path.glob("*.mcap")) if file.suffix == ".mcap"]
    if mcaps and "Profile is not ros2" in str(error):
        return f"its profile is {_mcap_profile(mcaps[-1])!r}; record it with ROS 2, or convert it to a bag of ROS 2"
    if "Storage plugin ''" in str(error):  # as ros2 bag reindex writes
        return "its metadata.yaml names no storage; delete that file, or open the .db3 or .mcap itself"
    if error.args == ("unknown",):  # as rosbag2 writes for types of actions
        return (
            "the type of one of its topics has no definition; copy the others (mcap filter IN -o OUT -n "
            "'.*/_action/.*', or ros2 bag convert with exclude_regex)"
        )
    tool = "mcap recover IN -o OUT" if mcaps else "rosbag reindex (ros2 bag reindex)"
    return f"copy it again; {tool} repairs one that was not closed"


def has_index(bag: Any) -> bool:
    """Whether images are read by their place; an MCAP without chunks is read from its start by each call."""
    stores = [getattr(reader, "storage", reader) for reader in bag.readers]  # of a folder or a file
    files = [file for store in stores for file in getattr(store, "storages", [store])]
    return all(getattr(file, "chunks", True) for file in files)


def first_image(bag: Any, topic: str) -> Any:
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
