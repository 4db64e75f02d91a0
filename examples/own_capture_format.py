"""Make frames from arrays of a format that RoomLight does not know.

    python examples/own_capture_format.py [--frames N] [--out FOLDER]

This format stands for any other: blue-green-red images, depth in centimetres, and OpenCV poses (camera x right, y down,
z forward) in a world with z up. `frames_of` converts it to RoomLight's conventions (docs/conventions.md): linear RGB,
metres, camera x right, y up, z backward, world y up. Output: FOLDER/light.exr.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import roomlight as rl
from roomlight.conventions import linear_to_srgb8, srgb8_to_linear

CAMERA_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # flips y and z of the camera; its own inverse
Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # (x, y, z) to (x, z, -y)


def record(frames: int) -> dict[str, np.ndarray]:
    """Make a recording in that format from the sample room; yours comes from a file."""
    sample = list(rl.open_capture(rl.sample_capture(), rl.CaptureOptions(max_frames=frames)))
    k = sample[0].intrinsics
    return {
        "bgr": np.stack([linear_to_srgb8(frame.image)[..., ::-1] for frame in sample]),
        "depth_cm": np.stack([frame.depth_m * 100 for frame in sample]),
        "focal_and_centre": np.array([k.fx, k.fy, k.cx, k.cy]),
        "pose": np.stack([Y_UP_FROM_Z_UP.T @ frame.camera_to_world @ CAMERA_FROM_OPENCV for frame in sample]),
    }


def frames_of(recording: dict[str, np.ndarray]) -> Iterator[rl.Frame]:
    """Convert the recording frame by frame."""
    height, width = recording["bgr"].shape[1:3]
    fx, fy, cx, cy = recording["focal_and_centre"].tolist()
    for index, bgr in enumerate(recording["bgr"]):
        rgb = np.ascontiguousarray(bgr[..., ::-1])
        yield rl.Frame(
            index=index,
            image=srgb8_to_linear(rgb),
            clipped=rgb.max(axis=-1) >= 250,
            depth_m=recording["depth_cm"][index] / np.float32(100),
            intrinsics=rl.Intrinsics(fx, fy, cx, cy, width, height),
            camera_to_world=Y_UP_FROM_Z_UP @ recording["pose"][index] @ CAMERA_FROM_OPENCV,
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path("out/own_capture_format"))
    args = parser.parse_args()
    session = rl.Session()
    frames = list(frames_of(record(args.frames)))
    for frame in frames:
        session.push(frame)
    light = session.light_at(rl.point_in_view(frames[0]))
    light.save(args.out / "light.exr")
    print(f"{args.out / 'light.exr'}: {light.coverage:.0%} of the directions observed")


if __name__ == "__main__":
    main()
