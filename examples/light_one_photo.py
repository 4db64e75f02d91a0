"""Light a point of a single photograph with depth.

    python examples/light_one_photo.py [PHOTO DEPTH] [--fov DEGREES] [--pixel U V] [--out FOLDER]

PHOTO is an 8-bit image, DEPTH a 16-bit PNG of the same view in millimetres (0 = unknown); by default the first frame of
the sample room. The lit point lies 10 cm above the surface at the pixel, by default a little below the image's centre.
Output in FOLDER: light.exr and light.hdr for renderers, light.png to look at, light.json with the main light and the
spherical harmonics. In the output's world the camera stands at the origin and looks along -z, y up.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

import roomlight as rl
from roomlight.conventions import srgb8_to_linear


def main() -> None:
    sample = rl.sample_capture()
    parser = argparse.ArgumentParser()
    parser.add_argument("photo", type=Path, nargs="?", default=sample / "colour/000000.jpg")
    parser.add_argument("depth", type=Path, nargs="?", default=sample / "depth/000000.png")
    parser.add_argument("--fov", type=float, default=60.0, help="horizontal field of view in degrees")
    parser.add_argument("--pixel", type=float, nargs=2, metavar=("U", "V"), help="column and row in the photo")
    parser.add_argument("--out", type=Path, default=Path("out/light_one_photo"))
    args = parser.parse_args()

    rgb = np.asarray(ImageOps.exif_transpose(Image.open(args.photo)).convert("RGB"))
    depth_m = np.asarray(Image.open(args.depth)).astype(np.float32) / 1000
    height, width = rgb.shape[:2]
    focal = width / 2 / math.tan(math.radians(args.fov) / 2)
    frame = rl.Frame(
        index=0,
        image=srgb8_to_linear(rgb),
        clipped=rgb.max(axis=-1) >= 250,  # where the sensor saturated, the true radiance is higher
        depth_m=depth_m,
        intrinsics=rl.Intrinsics(focal, focal, width / 2, height / 2, width, height),
        camera_to_world=np.eye(4),
    )
    session = rl.Session()
    session.push(frame)
    u, v = args.pixel or (width / 2, 0.7 * height)
    light = session.light_at(rl.point_at_pixel(frame, u, v))
    for suffix in ("exr", "hdr", "png", "json"):
        light.save(args.out / f"light.{suffix}")
    print(f"{args.out}: light at {light.position}, main light from {light.main_light.direction}")


if __name__ == "__main__":
    main()
