"""One synthetic room in every capture format's own bytes, built without the code under test.

The room is a box with a smooth colour on its walls, seen by a 32 x 24 camera from a few poses (y-up world, OpenGL
camera); each builder turns these poses into its format's conventions with matrices written out here.
"""

import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import lzfse
import numpy as np
import OpenEXR

WIDTH, HEIGHT = 32, 24
FX, FY, CX, CY = 28.0, 27.0, 16.5, 11.75
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
# A z-up world from a y-up one: x' = x, y' = -z, z' = y.
Y_UP_TO_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class View:
    srgb8: np.ndarray  # uint8 [h, w, 3]
    depth_m: np.ndarray  # float32 [h, w]
    confidence: np.ndarray  # uint8 [h, w]
    pose: np.ndarray  # [4, 4] camera-to-world, y-up, OpenGL
    time_s: float


def rotation(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis]
    return np.array(matrix, np.float64)


def scene(count: int = 4) -> list[View]:
    views = []
    for index in range(count):
        pose = np.eye(4)
        pose[:3, :3] = rotation("y", 20.0 + 15 * index) @ rotation("x", -10.0 + 4 * index) @ rotation("z", 5.0)
        pose[:3, 3] = [0.3 + 0.1 * index, 1.4 - 0.05 * index, 0.2]
        x = (np.arange(WIDTH) + 0.5 - CX) / FX
        y = -(np.arange(HEIGHT) + 0.5 - CY) / FY
        rays = np.stack([*np.meshgrid(x, y), -np.ones((HEIGHT, WIDTH))], axis=-1) @ pose[:3, :3].T
        low, high = np.array([-2.0, 0.0, -3.0]), np.array([2.5, 2.6, 2.0])
        walls = np.where(rays > 0, high, low) - pose[:3, 3]
        with np.errstate(divide="ignore"):
            depth = (walls / rays).min(axis=-1)
        points = pose[:3, 3] + depth[..., None] * rays
        colour = 0.45 + 0.25 * np.sin(points * [0.9, 1.1, 0.7] + [0.0, 1.0, 2.0])
        confidence = np.full((HEIGHT, WIDTH), 2, np.uint8)
        confidence[:3, :4], confidence[3:6, :4] = 0, 1
        depth_mm = np.rint(depth * 1000) / 1000
        views.append(
            View((colour * 255).astype(np.uint8), depth_mm.astype(np.float32), confidence, pose, 5.0 + index / 30)
        )
    return views


def quaternion(rot: np.ndarray) -> list[float]:
    """(x, y, z, w)"""
    angle = cv2.Rodrigues(rot)[0].reshape(-1)
    turn = float(np.linalg.norm(angle))
    axis = angle / max(turn, 1e-12)
    return [*(axis * np.sin(turn / 2)), float(np.cos(turn / 2))]


def save(path: Path, data: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def zipped(archive: Path, members: Mapping[str, bytes]) -> Path:
    archive.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in members.items():
            packed.writestr(name, data)
    return archive


def image(suffix: str, pixels: np.ndarray) -> bytes:
    ordered = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    parameters = [cv2.IMWRITE_JPEG_QUALITY, 98] if suffix == ".jpg" else []
    ok, data = cv2.imencode(suffix, np.ascontiguousarray(ordered), parameters)
    assert ok
    return data.tobytes()


def millimetres(view: View, unit_m: float = 0.001) -> np.ndarray:
    return np.rint(view.depth_m.astype(np.float64) / unit_m).astype(np.uint16)


def exr(path: Path, channels: dict[str, np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))


def nerfstudio(path: Path, views: list[View]) -> Path:
    frames = []
    for index, view in enumerate(views):
        save(path / f"images/frame_{index + 1:05d}.png", image(".png", view.srgb8))
        save(path / f"depth/frame_{index + 1:05d}.png", image(".png", millimetres(view)))
        frames.append(
            {
                "file_path": f"images/frame_{index + 1:05d}.png",
                "depth_file_path": f"depth/frame_{index + 1:05d}.png",
                "transform_matrix": (Y_UP_TO_Z_UP @ view.pose).tolist(),
            }
        )
    exr(path / "probes/00.exr", {"RGB": np.full((4, 8, 3), 0.5, np.float16)})
    shared = {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT, "camera_model": "OPENCV"}
    probes = [{"position": [0.1, -0.3, 0.2], "file_path": "probes/00.exr"}]
    save(path / "transforms.json", json.dumps({**shared, "probes": probes, "frames": frames}).encode())
    return path


def nerfcapture(path: Path, views: list[View]) -> Path:
    """As NeRFCapture and its script write it: y-up, per-frame K, colour without suffix, depth in 10 m / 65535."""
    frames = []
    for index, view in enumerate(views):
        save(path / f"images/{index}.png", image(".png", view.srgb8))
        save(path / f"images/{index}.depth.png", image(".png", millimetres(view, 10 / 65535)))
        frames.append(
            {
                "file_path": f"images/{index}",
                "depth_path": f"images/{index}.depth.png",
                "transform_matrix": view.pose.tolist(),
                "timestamp": view.time_s,
                **{"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT},
            }
        )
    index = {"integer_depth_scale": 10 / 65535, "fl_x": 1.0, "cx": 320, "cy": 240, "frames": frames[::-1]}
    save(path / "transforms.json", json.dumps(index).encode())
    return path


def seven_scenes(path: Path, views: list[View]) -> Path:
    """World rotated by 25 degrees about x, as gravity-direction.txt states."""
    rotated = np.eye(4)
    rotated[:3, :3] = rotation("x", 25.0)
    for index, view in enumerate(views):
        stem = f"frame-{index * 4:06d}"
        save(path / f"{stem}.color.jpg", image(".jpg", view.srgb8))
        save(path / f"{stem}.depth.png", image(".png", millimetres(view)))
        rows = rotated @ view.pose @ FLIP
        save(path / f"{stem}.pose.txt", "\n".join("\t ".join(f"{v:.10e}" for v in row) for row in rows).encode())
    save(path / "camera-intrinsics.txt", f"{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n".encode())
    gravity = rotated[:3, :3] @ [0, -1, 0]
    save(path / "gravity-direction.txt", "\n".join(str(value) for value in gravity).encode())
    return path


def video(
    path: Path,
    pictures: list[np.ndarray],
    *,
    rate: int = 30,
    codec: str = "libx264",
    options: dict[str, str] | None = None,
    stored: str = "yuv420p",
    file: dict[str, Any] | None = None,
    metadata: dict[str, str] | None = None,
    tags: dict[str, int] | None = None,
) -> Path:
    """Encode pictures, RGB or RGBA; `file` are options of the container, `tags` the codec's fields of colour."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width, channels = pictures[0].shape
    with av.open(str(path), "w", **{"format": "mp4", **(file or {})}) as container:
        container.metadata.update(metadata or {})
        stream: Any = container.add_stream(codec, rate=rate, options=options or {"crf": "4", "g": "2"})
        stream.width, stream.height, stream.pix_fmt = width, height, stored
        for name, value in (tags or {}).items():
            setattr(stream.codec_context, name, value)
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(picture, format="rgba" if channels == 4 else "rgb24")
            container.mux(stream.encode(frame.reformat(format=stored, dst_colorspace="ITU601")))
        container.mux(stream.encode())
    return path


def remuxed(path: Path, target: Path, change: Callable[[Any], object], *, later_s: float = 0.0) -> Path:
    """Copy a video's packets into another file after a change of its stream; `later_s` is where it is to begin."""
    with av.open(str(path)) as source, av.open(str(target), "w") as container:
        old = source.streams.video[0]
        stream = container.add_stream_from_template(old)
        change(stream)
        for packet in source.demux(old):
            if packet.pts is not None and packet.dts is not None and packet.time_base is not None:
                packet.pts -= int(later_s / packet.time_base)
                packet.dts -= int(later_s / packet.time_base)
                packet.stream = stream
                container.mux(packet)
    return target


def stray_scanner(path: Path, views: list[View]) -> Path:
    scale = 1920 / WIDTH
    video(path / "rgb.mp4", [view.srgb8 for view in views])
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for index, view in enumerate(views):
        save(path / f"depth/{index:06d}.png", image(".png", millimetres(view)))
        save(path / f"confidence/{index:06d}.png", image(".png", view.confidence))
        pose = view.pose @ FLIP
        values = [*pose[:3, 3], *quaternion(pose[:3, :3])]
        rows.append(f"{view.time_s}, {index:06d}, " + ", ".join(str(value) for value in values))
    save(path / "odometry.csv", ("\n".join(rows) + "\n").encode())
    k = f"{FX * scale}, 0.0, {CX * scale}\n0.0, {FY * scale}, {CY * scale}\n0.0, 0.0, 1.0"
    save(path / "camera_matrix.csv", k.encode())
    return path


def record3d_metadata(views: list[View]) -> bytes:
    poses = [[*quaternion(view.pose[:3, :3]), *view.pose[:3, 3].tolist()] for view in views]
    metadata = {"w": WIDTH, "h": HEIGHT, "dw": WIDTH, "dh": HEIGHT, "fps": 30, "K": [FX, 0, 0, 0, FY, 0, CX, CY, 1]}
    return json.dumps(
        {**metadata, "poses": poses, "frameTimestamps": [view.time_s for view in views], "cameraType": 1}
    ).encode()


def record3d_members(views: list[View]) -> dict[str, bytes]:
    members = {"metadata": record3d_metadata(views)}
    for index, view in enumerate(views):
        members[f"rgbd/{index}.jpg"] = image(".jpg", view.srgb8)
        members[f"rgbd/{index}.depth"] = lzfse.compress(view.depth_m.astype("<f4").tobytes())
        members[f"rgbd/{index}.conf"] = lzfse.compress(view.confidence.tobytes())
    return members


def record3d(path: Path, views: list[View]) -> Path:
    return zipped(path.with_suffix(".r3d"), record3d_members(views))


def record3d_export(path: Path, views: list[View]) -> Path:
    save(path / "metadata.json", record3d_metadata(views))
    for index, view in enumerate(views):
        save(path / f"rgb/{index}.jpg", image(".jpg", view.srgb8))
        exr(path / f"depth/{index}.exr", {"R": view.depth_m.astype(np.float16)})
    return path


def tum(path: Path, views: list[View]) -> Path:
    """Depth 4 ms after colour, poses at 100 Hz around them; the world z-up, K with whole-number pixel centres."""
    rgb, depth, poses = ["# color images"], ["# depth maps"], ["# timestamp tx ty tz qx qy qz qw"]
    for view in views:
        name = f"{view.time_s:.6f}.png"
        save(path / "rgb" / name, image(".png", view.srgb8))
        save(path / "depth" / name, image(".png", millimetres(view, 1 / 5000)))
        rgb.append(f"{view.time_s:.6f} rgb/{name}")
        depth.append(f"{view.time_s + 0.004:.6f} depth/{name}")
        pose = Y_UP_TO_Z_UP @ view.pose @ FLIP
        values = " ".join(str(value) for value in [*pose[:3, 3], *quaternion(pose[:3, :3])])
        poses.append(f"{view.time_s + 0.003:.6f} {values}")
        poses.append(f"{view.time_s + 0.013:.6f} 9 9 9 0 0 0 1")
    for name, lines in (("rgb.txt", rgb), ("depth.txt", depth), ("groundtruth.txt", poses)):
        save(path / name, "\n".join(lines).encode())
    save(path / "camera-intrinsics.txt", f"{FX} 0 {CX - 0.5}\n0 {FY} {CY - 0.5}\n0 0 1\n".encode())
    return path


def roomlight(path: Path, views: list[View]) -> Path:
    frames = []
    for index, view in enumerate(views):
        save(path / f"colour/{index:06d}.jpg", image(".jpg", view.srgb8))
        save(path / f"depth/{index:06d}.png", image(".png", millimetres(view)))
        save(path / f"confidence/{index:06d}.png", image(".png", view.confidence))
        frames.append(
            {
                "colour": f"colour/{index:06d}.jpg",
                "depth": f"depth/{index:06d}.png",
                "confidence": f"confidence/{index:06d}.png",
                "intrinsics": {"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": WIDTH, "height": HEIGHT},
                "camera_to_world": view.pose.tolist(),
                "timestamp_s": view.time_s,
            }
        )
    exr(path / "probes/00.exr", {"RGB": np.full((4, 8, 3), 0.5, np.float16)})
    probes = [{"position": [0.1, 0.2, 0.3], "panorama": "probes/00.exr"}]
    index = {"format": "roomlight-capture", "version": 1, "frames": frames, "probes": probes}
    save(path / "capture.json", json.dumps(index).encode())
    return path


def polycam(path: Path, views: list[View]) -> Path:
    """A raw export with closed loops: the uncorrected images are there too, and would be read wrongly."""
    for index, view in enumerate(views):
        stem = f"{round(view.time_s * 1e6)}"
        root = path / "keyframes"
        save(root / f"corrected_images/{stem}.jpg", image(".jpg", view.srgb8))
        save(root / f"images/{stem}.jpg", image(".jpg", 255 - view.srgb8))
        save(root / f"depth/{stem}.png", image(".png", millimetres(view)))
        save(root / f"confidence/{stem}.png", image(".png", (view.confidence.astype(int) * 255 // 2).astype(np.uint8)))
        camera = {"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": WIDTH, "height": HEIGHT, "blur_score": 90.0 + index}
        camera |= {f"t_{row}{column}": view.pose[row, column] for row in range(3) for column in range(4)}
        save(root / f"corrected_cameras/{stem}.json", json.dumps(camera).encode())
        save(root / f"cameras/{stem}.json", json.dumps(camera | {"t_03": 99.0}).encode())
    return path


def scanner_app(path: Path, views: list[View]) -> Path:
    """Images of every fourth pose."""
    for index, view in enumerate(views):
        number = f"{4 * index:05d}"
        save(path / f"frame_{number}.jpg", image(".jpg", view.srgb8))
        save(path / f"depth_{number}.png", image(".png", millimetres(view)))
        save(path / f"conf_{number}.png", image(".png", view.confidence))
        stated = {
            "cameraPoseARFrame": view.pose.reshape(-1).tolist(),
            "intrinsics": [FX, 0, CX, 0, FY, CY, 0, 0, 1],
            "time": view.time_s,
        }
        save(path / f"frame_{number}.json", json.dumps(stated).encode())
        save(path / f"frame_{4 * index + 1:05d}.json", json.dumps(stated).encode())
    save(path / "info.json", b"{}")
    return path


def arkit_scenes(path: Path, views: list[View]) -> Path:
    lines = []
    for view in views:
        stem = f"41069021_{view.time_s:.6f}"
        save(path / f"lowres_wide/{stem}.png", image(".png", view.srgb8))
        save(path / f"lowres_depth/{stem}.png", image(".png", millimetres(view)))
        save(path / f"confidence/{stem}.png", image(".png", view.confidence))
        pincam = f"{WIDTH} {HEIGHT} {FX} {FY} {CX} {CY}"
        save(path / f"lowres_wide_intrinsics/41069021_{view.time_s + 0.001:.3f}.pincam", pincam.encode())
        inverse = np.linalg.inv(Y_UP_TO_Z_UP @ view.pose @ FLIP)
        angle = cv2.Rodrigues(inverse[:3, :3])[0].reshape(-1)
        lines.append(" ".join(str(value) for value in [view.time_s, *angle, *inverse[:3, 3]]))
    save(path / "lowres_wide.traj", "\n".join(lines).encode())
    return path


def scannet(path: Path, views: list[View]) -> Path:
    """Depth compressed by zlib, in millimetres; K with whole-number pixel centres."""
    k = np.eye(4, dtype="<f4")
    k[:2, :3] = [[FX, 0, CX - 0.5], [0, FY, CY - 0.5]]
    same = np.eye(4, dtype="<f4").tobytes()
    head = struct.pack("<IQ", 4, 15) + b"StructureSensor" + k.tobytes() + same + k.tobytes() + same
    head += struct.pack("<2i4IfQ", 2, 1, WIDTH, HEIGHT, WIDTH, HEIGHT, 1000.0, len(views))
    body = b""
    for view in views:
        colour, depth = image(".jpg", view.srgb8), zlib.compress(millimetres(view).tobytes())
        pose = (Y_UP_TO_Z_UP @ view.pose @ FLIP).astype("<f4").tobytes()
        time_us = round(view.time_s * 1e6)
        body += pose + struct.pack("<4Q", time_us, time_us, len(colour), len(depth)) + colour + depth
    path = path.with_suffix(".sens")
    save(path, head + body)
    return path


COLMAP_UP = np.diag([1.0, -1.0, -1.0, 1.0])
"""COLMAP's world as a camera that is held level sees it: y down."""


def colmap_files(path: Path, views: list[View]) -> tuple[list[str], list[list[float]]]:
    names, poses = [], []
    for index, view in enumerate(views):
        names.append(f"frame_{index + 1:05d}.png")
        save(path / "images" / names[-1], image(".png", view.srgb8))
        save(path / "depth" / names[-1], image(".png", millimetres(view)))
        inverse = np.linalg.inv(COLMAP_UP @ view.pose @ FLIP)
        x, y, z, w = quaternion(inverse[:3, :3])
        poses.append([w, x, y, z, *inverse[:3, 3]])
    return names, poses


def colmap(path: Path, views: list[View]) -> Path:
    names, poses = colmap_files(path, views)
    save(path / "sparse/0/cameras.bin", struct.pack("<QiiQQ4d", 1, 1, 1, WIDTH, HEIGHT, FX, FY, CX, CY))
    data = struct.pack("<Q", len(names))
    for index, (name, pose) in enumerate(zip(names, poses, strict=True)):
        data += struct.pack("<i7di", index + 1, *pose, 1) + name.encode() + b"\0"
        data += struct.pack("<Q", 1) + struct.pack("<ddq", 1.0, 2.0, -1)
    save(path / "sparse/0/images.bin", data)
    return path


def colmap_text(path: Path, views: list[View]) -> Path:
    names, poses = colmap_files(path, views)
    save(path / "sparse/cameras.txt", f"# cameras\n7 PINHOLE {WIDTH} {HEIGHT} {FX} {FY} {CX} {CY}\n".encode())
    lines = ["# images"]
    for index, (name, pose) in reversed(list(enumerate(zip(names, poses, strict=True)))):
        lines += [f"{index + 1} " + " ".join(map(str, pose)) + f" 7 {name}", "1.0 2.0 -1"]
    save(path / "sparse/images.txt", "\n".join(lines).encode())
    return path


def png_with_size(data: bytes, width: int, height: int) -> bytes:
    """A PNG whose header declares another size, its checksum made to fit."""
    header = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]
