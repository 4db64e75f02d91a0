"""The room of `formats` in the layouts of data sets and robots' tools, from these formats' own bytes."""

import json
import sqlite3
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from formats import (
    CX,
    CY,
    FLIP,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    Y_UP_TO_Z_UP,
    View,
    image,
    millimetres,
    quaternion_of_any,
    save,
)


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
        values = [view.time_s, *pose[:3, 3], *quaternion_of_any(pose[:3, :3])]
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


Message = tuple[str, str, float, bytes]
"""Topic, type, time and bytes."""


class Cdr:
    """Little-endian CDR, the encoding of ROS 2's messages."""

    def __init__(self) -> None:
        self.data = bytearray()

    def put(self, kind: str, *values: float) -> "Cdr":
        size = struct.calcsize(kind)
        for value in values:
            self.data += bytes(-len(self.data) % size) + struct.pack(f"<{kind}", value)
        return self

    def text(self, text: str) -> "Cdr":
        self.put("I", len(text) + 1)
        self.data += text.encode() + b"\0"
        return self

    def raw(self, data: bytes) -> "Cdr":
        self.put("I", len(data))
        self.data += data
        return self

    def header(self, time_s: float, frame: str) -> "Cdr":
        return self.put("i", int(time_s)).put("I", round(time_s % 1 * 1e9)).text(frame)

    def bytes(self) -> bytes:
        return b"\x00\x01\x00\x00" + bytes(self.data)


def image_message(time_s: float, frame: str, encoding: str, pixels: np.ndarray) -> bytes:
    height, width = pixels.shape[:2]
    cdr = Cdr().header(time_s, frame).put("I", height, width).text(encoding).put("B", 0)
    return cdr.put("I", pixels.strides[0]).raw(pixels.tobytes()).bytes()


def camera_message(
    frame: str,
    *,
    shift: float = 0.0,
    model: str = "plumb_bob",
    d: Sequence[float] = (0.0,) * 5,
    binning: int = 0,
    roi: tuple[int, int] | None = None,
) -> bytes:
    """A CameraInfo of the scene's camera; `roi` is where its images lie on a sensor of twice their size."""
    bins, (x, y) = max(binning, 1), roi or (0, 0)
    k = (FX * bins, 0, CX * bins - 0.5 + x + shift, 0, FY * bins, CY * bins - 0.5 + y, 0, 0, 1)
    sides = HEIGHT * bins, WIDTH * bins
    whole = sides if roi is None else (2 * sides[0], 2 * sides[1])
    cdr = Cdr().header(0.0, frame).put("I", *whole).text(model).put("I", len(d)).put("d", *d)
    p = np.hstack([np.reshape(k, (3, 3)), np.zeros((3, 1))])
    cdr.put("d", *k).put("d", *np.eye(3).reshape(-1)).put("d", *p.reshape(-1))
    return cdr.put("I", binning, binning, x, y, *((0, 0) if roi is None else sides)).put("B", 0).bytes()


def transform(time_s: float, parent: str, child: str, pose: np.ndarray, *, fixed: bool = False) -> Message:
    cdr = Cdr().put("I", 1).header(time_s, parent).text(child)
    data = cdr.put("d", *pose[:3, 3], *quaternion_of_any(pose[:3, :3])).bytes()
    return "/tf_static" if fixed else "/tf", "tf2_msgs/msg/TFMessage", 5.0 if fixed else time_s, data


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


def camera(topic: str, data: bytes) -> Message:
    return topic, "sensor_msgs/msg/CameraInfo", 5.0, data


def ros_messages(views: list[View], *, without: str = "\0") -> list[Message]:
    """Colour, aligned depth 4 ms later, poses of the robot, its camera's mount; none whose topic holds `without`."""
    messages = [
        transform(0.0, "base_link", OPTICAL, MOUNT, fixed=True),
        camera("/camera/color/camera_info", camera_message(OPTICAL)),
    ]
    for view in views:
        bgr = np.ascontiguousarray(view.srgb8[..., ::-1])
        depth = image_message(view.time_s + 0.004, OPTICAL, "16UC1", millimetres(view))
        colour = image_message(view.time_s, OPTICAL, "bgr8", bgr)
        messages += [
            robot(view),
            (COLOUR, "sensor_msgs/msg/Image", view.time_s + 0.02, colour),
            (DEPTH, "sensor_msgs/msg/Image", view.time_s + 0.03, depth),
        ]
    return [message for message in messages if without not in message[0]]


def ros_bag(path: Path, views: list[View]) -> Path:
    return ros2_bag(path, ros_messages(views))


def ros2_bag(path: Path, messages: list[Message]) -> Path:
    """`metadata.yaml` and an SQLite file, as `ros2 bag record` writes them."""
    path.mkdir(parents=True, exist_ok=True)
    topics = list(dict.fromkeys((topic, kind) for topic, kind, _, _ in messages))
    with sqlite3.connect(path / "bag_0.db3") as base:
        base.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
            "data BLOB NOT NULL)"
        )
        for number, (topic, kind) in enumerate(topics, 1):
            base.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, topic, kind))
        for topic, kind, time_s, data in messages:
            row = (topics.index((topic, kind)) + 1, round(time_s * 1e9), data)
            base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    base.close()
    counts = [
        {
            "topic_metadata": {"name": name, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": ""},
            "message_count": sum(message[0] == name for message in messages),
        }
        for name, kind in topics
    ]
    information = {
        "version": 5,
        "storage_identifier": "sqlite3",
        "relative_file_paths": ["bag_0.db3"],
        "duration": {"nanoseconds": 200_000_000},
        "starting_time": {"nanoseconds_since_epoch": 5_000_000_000},
        "message_count": len(messages),
        "topics_with_message_count": counts,
        "compression_format": "",
        "compression_mode": "",
        "files": [],
    }
    # JSON is YAML
    save(path / "metadata.yaml", json.dumps({"rosbag2_bagfile_information": information}).encode())
    return path
