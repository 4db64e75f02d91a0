"""Render a sphere on a plane under our light with Mitsuba 3.

    pip install mitsuba
    python examples/mitsuba_render.py [CAPTURE] [--size PIXELS] [--out FOLDER]

Lights the point in front of the capture's first camera from its first frame; by default in the sample room. As an
environment map the panorama is rotated by rotate([0, 1, 0], 90); the scene has RoomLight's world axes, y up. Output in
FOLDER: light.exr (the panorama), render.exr (linear) and render.png.
"""

import argparse
from pathlib import Path

import mitsuba as mi
import numpy as np

import roomlight as rl


def scene_under(panorama: np.ndarray, size: int) -> dict[str, object]:
    """Describe a glossy sphere on a diffuse disk that the panorama alone lights."""
    to_world = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "light": {"type": "envmap", "bitmap": mi.Bitmap(panorama), "to_world": to_world().rotate([0, 1, 0], 90)},
        "sphere": {"type": "sphere", "radius": 0.25, "bsdf": {"type": "roughconductor", "alpha": 0.1}},
        "table": {
            "type": "disk",
            "to_world": to_world().translate([0, -0.25, 0]).rotate([1, 0, 0], -90).scale(0.7),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}},
        },
        "camera": {
            "type": "perspective",
            "fov": 50,
            "to_world": to_world().look_at(origin=[0, 0.6, 1.6], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size},
            "sampler": {"type": "independent", "sample_count": 64},
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("capture", type=Path, nargs="?", default=rl.sample_capture())
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--out", type=Path, default=Path("out/mitsuba_render"))
    args = parser.parse_args()

    session = rl.Session()
    frame = next(iter(rl.open_capture(args.capture)))
    session.push(frame)
    light = session.light_at(rl.point_in_view(frame))
    light.save(args.out / "light.exr")

    mi.set_variant("scalar_rgb")  # works everywhere; llvm_ad_rgb is faster where LLVM is installed
    image = mi.render(mi.load_dict(scene_under(light.panorama, args.size)))
    mi.util.write_bitmap(str(args.out / "render.exr"), image)
    mi.util.write_bitmap(str(args.out / "render.png"), image)
    print(args.out / "render.png")


if __name__ == "__main__":
    main()
