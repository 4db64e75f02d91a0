"""Write a recording in RoomLight's own capture format.

    python examples/write_capture.py [--frames N] [--out FOLDER]

`CaptureWriter` takes arrays: 8-bit sRGB colour, z-depth in metres, intrinsics and a camera-to-world pose in RoomLight's
conventions (docs/conventions.md). Output: a capture in FOLDER, which must be new (capture.json, colour/, depth/), that
`rl.open_capture` and `roomlight replay FOLDER --out light` read. The arrays here come from the sample room; yours come
from a camera.
"""

import argparse
from pathlib import Path

import roomlight as rl
from roomlight.captures import CaptureWriter
from roomlight.conventions import linear_to_srgb8


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, help="at most this many frames")
    parser.add_argument("--out", type=Path, default=Path("out/write_capture"))
    args = parser.parse_args()

    camera = rl.open_capture(rl.sample_capture(), rl.CaptureOptions(max_frames=args.frames))
    with CaptureWriter(args.out) as writer:  # the folder appears when the block ends, complete or not at all
        for frame in camera:
            writer.add(
                srgb8=linear_to_srgb8(frame.image),
                depth_m=frame.depth_m,
                intrinsics=frame.intrinsics,
                camera_to_world=frame.camera_to_world,
                timestamp_s=frame.timestamp_s,
            )
        probe = camera.probes[0]  # optional ground truth, for `roomlight eval captures`
        writer.add_probe(probe.position, probe.panorama())

    written = rl.open_capture(args.out)
    print(f"{args.out}: {written.frame_count} frames, {len(written.probes)} probe")


if __name__ == "__main__":
    main()
