"""Light every frame of a capture at one point and save the panoramas.

    python examples/replay_folder.py [CAPTURE] [--position X Y Z] [--frames N] [--out FOLDER]

CAPTURE is any recording that `rl.open_capture` reads (docs/captures.md), by default the sample room. The position is
in world metres, y up; by default it lies in front of the first camera. Output: one linear HDR panorama per frame,
FOLDER/light.000000.exr and so on, and one line per frame.
"""

import argparse
from pathlib import Path

import roomlight as rl


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("capture", type=Path, nargs="?", default=rl.sample_capture())
    parser.add_argument("--position", type=float, nargs=3, metavar=("X", "Y", "Z"))
    parser.add_argument("--frames", type=int, help="at most this many frames")
    parser.add_argument("--out", type=Path, default=Path("out/replay_folder"))
    args = parser.parse_args()

    session = rl.Session()
    tracked = None
    for frame in rl.open_capture(args.capture, rl.CaptureOptions(max_frames=args.frames)):
        if tracked is None:  # a point that is tracked from the first frame on is cheapest
            x, y, z = args.position or rl.point_in_view(frame)
            tracked = session.track((x, y, z))
        session.push(frame)
        light = session.light(tracked)
        path = args.out / f"light.{frame.index:06d}.exr"
        light.save(path)
        print(f"{path}: {light.coverage:.0%} of the directions observed")


if __name__ == "__main__":
    main()
