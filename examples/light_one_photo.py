"""Light a point of a single photograph with depth.

    python examples/light_one_photo.py [PHOTO DEPTH] [--fov DEGREES] [--pixel U V] [--out FOLDER]

PHOTO and DEPTH are read as by `roomlight light`: DEPTH is a 16-bit PNG of the same view in millimetres (0 = unknown),
an EXR, a TIFF or a .npy; by default both are the first frame of the sample room. The lit point lies 10 cm above the
surface at the pixel, by default a little below the image's centre. Output in FOLDER: light.exr and light.hdr for
renderers, light.png to look at, light.json with the main light and the spherical harmonics. In the output's world the
camera stands at the origin and looks along -z, y up.
"""

import argparse
from pathlib import Path

import roomlight as rl
from roomlight.captures.photo import PhotoOptions, read_photo


def main() -> None:
    sample = rl.sample_capture()
    parser = argparse.ArgumentParser()
    parser.add_argument("photo", type=Path, nargs="?", default=sample / "colour/000000.jpg")
    parser.add_argument("depth", type=Path, nargs="?", default=sample / "depth/000000.png")
    parser.add_argument("--fov", type=float, help="horizontal field of view in degrees; default: by EXIF")
    parser.add_argument("--pixel", type=float, nargs=2, metavar=("U", "V"), help="column and row in the upright photo")
    parser.add_argument("--out", type=Path, default=Path("out/light_one_photo"))
    args = parser.parse_args()

    # level: the world is the camera's; without world_up it would be turned by the straight lines of the room
    frame = read_photo(args.photo, args.depth, PhotoOptions(fov_deg=args.fov, world_up="y")).frame
    session = rl.Session()
    session.push(frame)
    u, v = args.pixel or (frame.intrinsics.width / 2, 0.7 * frame.intrinsics.height)
    light = session.light_at(rl.point_at_pixel(frame, u, v))
    for suffix in ("exr", "hdr", "png", "json"):
        light.save(args.out / f"light.{suffix}")
    print(f"{args.out}: light at {light.position}, main light from {light.main_light.direction}")


if __name__ == "__main__":
    main()
