"""Put a virtual object into a recording and write the pictures.

    python examples/virtual_object.py [CAPTURE] [--object sphere] [--pixel U,V] [--frames N] [--out FOLDER]

The object is a shape or a GLB, glTF, OBJ or PLY file. It stands on the surface that the pixel of the first frame shows.
Output: FOLDER/000000.jpg, ... with the object lit by the room.
"""

import argparse
from pathlib import Path

import roomlight as rl
from roomlight.compositing.picture.layer_files import encode_picture


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("capture", type=Path, nargs="?", default=rl.sample_capture())
    parser.add_argument("--object", default="chair", help="sphere, cube, plane, vase, chair, teapot, or a file")
    parser.add_argument("--pixel", default="240,195", help="column and row in the first frame")
    parser.add_argument("--frames", type=int, help="at most this many frames")
    parser.add_argument("--out", type=Path, default=Path("out/virtual_object"))
    args = parser.parse_args()

    u, v = (float(number) for number in args.pixel.split(","))
    scene = rl.scene_of_object(args.object, (u, v))
    frames = rl.open_capture(args.capture, rl.CaptureOptions(max_frames=args.frames))
    args.out.mkdir(parents=True, exist_ok=True)
    for picture in rl.composite_capture(frames, scene, quality="preview"):
        path = args.out / f"{picture.frame.index:06d}.jpg"
        path.write_bytes(encode_picture(picture, "jpeg"))
        print(f"{path}: the object covers {picture.alpha.mean():.1%} of the picture")


if __name__ == "__main__":
    main()
