"""The room of `formats` in the layouts of data sets and robots' tools, from these formats' own bytes."""

import json
import sqlite3
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from formats import CX, CY, FLIP, FX, FY, HEIGHT, WIDTH, Y_UP_TO_Z_UP, View, image, millimetres, quaternion, save
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def scannet_frames(path: Path, views: list[View]) -> Path:
    """As `SensReader` unpacks a .sens: 4 x 4 matrices, K with whole-number pixel centres."""
    for index, view in enumerate(views):
        save(path / f"color/{index}.jpg", image(".jpg", view.srgb8))
        save(path / f"depth/{index}.png", image(".png", millimetres(view)))
        rows = Y_UP_TO_Z_UP @ view.pose @ FLIP
        save(path / f"pose/{index}.txt", "\n".join(" ".join(map(str, row)) for row in rows).encode())
    k = f"{FX} 0 {CX - 0.5} 0\n0 {FY} {CY - 0.5} 0\n0 0 1 0\n0 0 0 1\n"
    for name in ("intrinsic_color", "intrinsic_depth"):
        save(path / f"intrinsic/{name}.txt", k.encode())
    save(path / "intrinsic/extrinsic_color.txt", b"1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    return path


def scannetpp(path: Path, views: list[View]) -> Path:
    """A scene's folder `iphone`, unpacked; ARKit's own poses are far away, in another world."""
    index = {}
    for number, view in enumerate(views):
        stem = f"frame_{10 * number:06d}"
        save(path / f"rgb/{stem}.jpg", image(".jpg", view.srgb8))
        save(path / f"depth/{stem}.png", image(".png", millimetres(view)))
        index[stem] = {
            "timestamp": view.time_s,
            "pose": (view.pose + 50.0).tolist(),
            "intrinsic": [[FX, 0, CX], [0, FY, CY], [0, 0, 1]],
            "imu": {},
            "aligned_pose": (Y_UP_TO_Z_UP @ view.pose @ FLIP).tolist(),
        }
        index[f"frame_{10 * number + 1:06d}"] = index[stem]  # not unpacked
    save(path / "pose_intrinsic_imu.json", json.dumps(index).encode())
    save(path / "exif.json", b"{}")
    return path


def packed_depth(maps: list[np.ndarray], kind: str) -> bytes:
    """ScanNet++'s `depth.bin`: one deflate stream, or a deflate stream or an LZ4 block for each map."""

    def deflated(data: bytes) -> bytes:
        packing = zlib.compressobj(wbits=-zlib.MAX_WBITS)
        return packing.compress(data) + packing.flush()

    if kind == "stream":
        return deflated(b"".join(depth_m.astype("<f4").tobytes() for depth_m in maps))
    pieces = [
        lz4_block(np.rint(depth_m * 1000).astype("<u2").tobytes())
        if kind == "lz4"
        else deflated(depth_m.astype("<f4").tobytes())
        for depth_m in maps
    ]
    return b"".join(struct.pack("<I", len(piece)) + piece for piece in pieces)


def lz4_block(data: bytes) -> bytes:
    """Runs of one 16-bit value become a literal and a copy of itself; others stay literals."""
    out, at, literals = bytearray(), 0, bytearray()

    def length(value: int) -> bytes:
        return b"" if value < 15 else b"\xff" * ((value - 15) // 255) + bytes([(value - 15) % 255])

    while at < len(data):
        value, run = data[at : at + 2], 1
        while data[at + 2 * run : at + 2 * run + 2] == value:
            run += 1
        literals += value
        run = min(run, (len(data) - 16 - at) // 2)  # a block ends in literals
        if run > 4:
            copied = 2 * (run - 1)
            out += bytes([min(len(literals), 15) << 4 | min(copied - 4, 15)]) + length(len(literals)) + literals
            out += struct.pack("<H", 2) + length(copied - 4)
            literals, at = bytearray(), at + 2 * run
        else:
            at += 2
    return bytes(out) + bytes([min(len(literals), 15) << 4]) + length(len(literals)) + bytes(literals)


def rtabmap(path: Path, views: list[View]) -> Path:
    """`rtabmap-export --images_id --poses_camera`: numbers with gaps, poses in another order."""
    lines = ["#timestamp x y z qx qy qz qw id"]
    for index, view in enumerate(views):
        number = 3 * index + 10
        save(path / f"room_rgb/{number}.jpg", image(".jpg", view.srgb8))
        save(path / f"room_depth/{number}.png", image(".png", millimetres(view)))
        save(path / f"room_calib/{number}.yaml", opencv_yaml(number).encode())
        pose = Y_UP_TO_Z_UP @ view.pose @ FLIP
        values = [view.time_s, *pose[:3, 3], *quaternion(pose[:3, :3])]
        lines.insert(1, " ".join(map(str, values)) + f" {number}")
    save(path / "room_camera_poses.txt", "\n".join(lines).encode())
    return path


def opencv_yaml(name: object, extra: str = "") -> str:
    """A camera as OpenCV's FileStorage writes it; K is the unrectified camera's, which does not count."""
    k = ", ".join(f"{value:.6e}" for value in (FX + 3, 0.0, CX, 0.0, FY + 3, CY, 0.0, 0.0, 1.0))
    values = (FX, 0.0, CX - 0.5, 0.0, 0.0, FY, CY - 0.5, 0.0, 0.0, 0.0, 1.0, 0.0)
    p = ",\n       ".join(f"{value:.16e}" for value in values)
    return (
        f'%YAML:1.0\n---\ncamera_name: "{name}"\nimage_width: {WIDTH}\nimage_height: {HEIGHT}\n'
        f"camera_matrix:\n   rows: 3\n   cols: 3\n   data: [ {k} ]\n"
        f"distortion_coefficients:\n   rows: 1\n   cols: 5\n   data: [ 0., 0., 0., 0., 0. ]\n"
        f"projection_matrix:\n   rows: 3\n   cols: 4\n   data: [ {p} ]\n{extra}"
    )


TYPES, ROS1_TYPES = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
ROS1_TYPES.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
Message = tuple[str, str, float, bytes]
"""Topic, type, time and bytes."""


def ros(kind: str, *fields: Any) -> Any:
    """Make a part of a ROS message of a type such as `geometry_msgs/msg/Point`."""
    return TYPES.types[kind](*fields)


def message(topic: str, time_s: float, kind: str, *fields: Any) -> Message:
    return topic, kind, time_s, TYPES.serialize_cdr(ros(kind, *fields), kind).tobytes()


def header(time_s: float, frame: str) -> Any:
    return ros("std_msgs/msg/Header", ros("builtin_interfaces/msg/Time", int(time_s), round(time_s % 1 * 1e9)), frame)


def image_message(
    topic: str, time_s: float, frame: str, encoding: str, pixels: np.ndarray, *, later_s: float = 0.0
) -> Message:
    """An Image that is recorded some time after the one in its header."""
    height, width = pixels.shape[:2]
    data = np.frombuffer(pixels.tobytes(), np.uint8)
    fields = header(time_s, frame), height, width, encoding, 0, pixels.strides[0], data
    return message(topic, time_s + later_s, "sensor_msgs/msg/Image", *fields)


def compressed_image(topic: str, time_s: float, kind: str, data: bytes) -> Message:
    fields = header(time_s, OPTICAL), kind, np.frombuffer(data, np.uint8)
    return message(topic, time_s, "sensor_msgs/msg/CompressedImage", *fields)


def camera(
    topic: str,
    frame: str,
    *,
    model: str = "plumb_bob",
    d: Sequence[float] = (0.0,) * 5,
    binning: int = 0,
    roi: tuple[int, int] | None = None,
) -> Message:
    """A CameraInfo of the scene's camera; `roi` is where its images lie on a sensor of twice their size."""
    bins, (x, y) = max(binning, 1), roi or (0, 0)
    k = np.array([[FX * bins, 0, CX * bins - 0.5 + x], [0, FY * bins, CY * bins - 0.5 + y], [0, 0, 1]])
    sides = HEIGHT * bins, WIDTH * bins
    whole = sides if roi is None else (2 * sides[0], 2 * sides[1])
    matrices = np.array(d, np.float64), k.ravel(), np.eye(3).ravel(), np.hstack([k, np.zeros((3, 1))]).ravel()
    part = ros("sensor_msgs/msg/RegionOfInterest", x, y, *((0, 0) if roi is None else sides), False)
    fields = header(0.0, frame), *whole, model, *matrices, binning, binning, part
    return message(topic, 5.0, "sensor_msgs/msg/CameraInfo", *fields)


def pose_of(pose: np.ndarray, kind: str = "Pose", place: str = "Point") -> Any:
    turn = ros("geometry_msgs/msg/Quaternion", *quaternion(pose[:3, :3]))
    return ros(f"geometry_msgs/msg/{kind}", ros(f"geometry_msgs/msg/{place}", *pose[:3, 3].tolist()), turn)


def transform(time_s: float, parent: str, child: str, pose: np.ndarray, *, fixed: bool = False) -> Message:
    moved = pose_of(pose, "Transform", "Vector3")
    stamped = ros("geometry_msgs/msg/TransformStamped", header(time_s, parent), child, moved)
    topic, logged_s = ("/tf_static", 5.0) if fixed else ("/tf", time_s)
    return message(topic, logged_s, "tf2_msgs/msg/TFMessage", [stamped])


def robot(view: View) -> Message:
    """The pose of the robot that carries the camera."""
    base = Y_UP_TO_Z_UP @ view.pose @ FLIP @ np.linalg.inv(MOUNT)
    return transform(view.time_s, "map", "base_link", base)


MOUNT = np.eye(4)
MOUNT[:3, :3] = cv2.Rodrigues(np.array([0.3, -0.2, 0.5]))[0]
MOUNT[:3, 3] = [0.1, 0.02, 0.3]
"""The camera's optical frame on the robot."""


OPTICAL = "camera_color_optical_frame"
COLOUR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"


def ros_messages(views: list[View], *, without: str = "\0") -> list[Message]:
    """Colour, aligned depth 4 ms later, poses of the robot, its camera's mount; none whose topic holds `without`."""
    messages = [transform(0.0, "base_link", OPTICAL, MOUNT, fixed=True), camera("/camera/color/camera_info", OPTICAL)]
    for view in views:
        bgr, depth_mm = np.ascontiguousarray(view.srgb8[..., ::-1]), millimetres(view)
        messages += [
            robot(view),
            image_message(COLOUR, view.time_s, OPTICAL, "bgr8", bgr, later_s=0.02),
            image_message(DEPTH, view.time_s + 0.004, OPTICAL, "16UC1", depth_mm, later_s=0.026),
        ]
    return [message for message in messages if without not in message[0]]


def ros_bag(path: Path, views: list[View]) -> Path:
    return ros2_bag(path, ros_messages(views))


def ros2_bag(path: Path, messages: list[Message], *, compressed: bool = False) -> Path:
    """A bag of rosbags' writer, without definitions of messages as Humble's; if `compressed`, with them, as files."""
    bag, connections = Writer(path, version=8), {}
    definitions: dict[str, Any] = {"typestore": TYPES} if compressed else {"msgdef": "", "rihs01": "-"}
    if compressed:
        bag.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with bag:
        for topic, kind, time_s, data in messages:
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, **definitions)
            bag.write(connections[topic], round(time_s * 1e9), data)
    if not compressed:  # Humble's hold no definitions of messages
        with sqlite3.connect(path / f"{path.name}.db3") as base:
            base.execute("DELETE FROM message_definitions")
        base.close()
    return path


def ros1_bag(path: Path, messages: list[Message], *others: tuple[str, str]) -> Path:
    """A bag of ROS 1; `others` are types, and their definitions, of topics that no reader knows."""
    connections: dict[str, Any] = {}
    with Ros1Writer(path) as bag:
        for kind, definition in others:
            bag.write(bag.add_connection(f"/{kind}", kind, msgdef=definition, md5sum="0" * 32), 0, bytes(9))
        for topic, kind, time_s, data in messages:
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ROS1_TYPES)
            bag.write(connections[topic], round(time_s * 1e9), bytes(TYPES.cdr_to_ros1(data, kind)))
    return path


def mcap_without_chunks(path: Path, messages: list[Message]) -> Path:
    """A file without an index."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    def record(kind: int, data: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(data)) + data

    magic, numbers = b"\x89MCAP0\r\n", dict[str, int]()
    parts = [magic, record(1, text("ros2") + text(""))]
    for topic, kind, time_s, data in messages:
        if topic not in numbers:
            number = numbers[topic] = len(numbers) + 1
            parts.append(record(3, struct.pack("<H", number) + text(kind) + text("") + text("")))
            parts.append(record(4, struct.pack("<2H", number, number) + text(topic) + text("cdr") + text("")))
        logged = round(time_s * 1e9)
        parts.append(record(5, struct.pack("<HI2Q", numbers[topic], 0, logged, logged) + data))
    save(path, b"".join([*parts, record(15, bytes(4)), record(2, bytes(20)), magic]))
    return path
