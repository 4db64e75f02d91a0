"""Draw docs/images/hero.jpg: two spheres composited into a frame of the sample room, beside the light used.

    python docs/scripts/hero.py            needs Mitsuba, which is in the dev extra; a few minutes

The spheres stand on a sideboard and are lit by RoomLight's panorama at their place (model single), after all 31
frames. Their shadows are differential: the frame is multiplied by (plane with spheres) / (plane without them).
"""

from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from roomlight.camera import Intrinsics
from roomlight.captures import open_capture
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import Session, SessionOptions
from roomlight.frame import Frame
from roomlight.placement import point_at_pixel
from roomlight.sample import sample_capture

FRAME = 30
SCALE = 3
RADIUS_M = 0.075
PIXELS = ((208, 146), (262, 126))
SAMPLES = 64


def main() -> None:
    """Write the picture."""
    mi.set_variant("scalar_rgb")
    frames = list(open_capture(sample_capture()))
    session = Session(SessionOptions(model="single"))
    for each in frames:
        session.push(each)
    frame = frames[FRAME]
    centres = [np.array(point_at_pixel(frame, *pixel, above_m=RADIUS_M)) for pixel in PIXELS]
    middle = np.mean(centres, axis=0)
    light = session.light_at(tuple(middle.tolist()))
    composite = insert(frame, centres, light.panorama)
    photo = Image.fromarray(linear_to_srgb8(np.clip(composite, 0, 1)))
    sheet(photo, light.panorama, light.observed).save(Path(__file__).parents[1] / "images" / "hero.jpg", quality=90)


def insert(frame: Frame, centres: list[np.ndarray], panorama: np.ndarray) -> np.ndarray:
    """Composite the spheres: linear RGB [SCALE h, SCALE w, 3]."""
    height, width = frame.image.shape[:2]
    size = (width * SCALE, height * SCALE)
    background = np.stack(
        [np.asarray(Image.fromarray(frame.image[..., k]).resize(size, Image.Resampling.BICUBIC)) for k in range(3)], -1
    )
    support_m = centres[0][1] - RADIUS_M
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": sensor(frame),
        "light": {
            "type": "envmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(panorama, np.float32)),
            "to_world": mi.ScalarTransform4f().rotate([0, 1, 0], 90),
        },
        "support": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, support_m, 0]).rotate([1, 0, 0], -90).scale(20),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.35, 0.2]}},
        },
    }
    materials = (
        {"type": "conductor", "material": "none"},
        {"type": "roughplastic", "diffuse_reflectance": {"type": "rgb", "value": [0.75, 0.2, 0.12]}, "alpha": 0.08},
    )
    spheres = {
        f"sphere{k}": {"type": "sphere", "center": centre.tolist(), "radius": RADIUS_M, "bsdf": material}
        for k, (centre, material) in enumerate(zip(centres, materials, strict=True))
    }
    empty, empty_alpha = render(scene)
    full, _ = render({**scene, **spheres})
    only = {name: part for name, part in scene.items() if name not in ("support", "light")}
    _, alpha = render({**only, **spheres})
    shadow = np.clip(full / np.maximum(empty, 1e-4), 0, 1.5) * empty_alpha[..., None] + (1 - empty_alpha[..., None])
    behind = background * np.where(alpha[..., None] > 0.98, 1, shadow)
    return behind * (1 - alpha[..., None]) + full * alpha[..., None]


def sensor(frame: Frame) -> dict[str, object]:
    """Describe the frame's camera to Mitsuba, whose camera looks along +z with x to the left."""
    lens: Intrinsics = frame.intrinsics
    pose = np.asarray(frame.camera_to_world, np.float64) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(lens.width / 2 / lens.fx))),
        "fov_axis": "x",
        "principal_point_offset_x": float((lens.cx - lens.width / 2) / lens.width),
        "principal_point_offset_y": float((lens.cy - lens.height / 2) / lens.height),
        "to_world": mi.ScalarTransform4f(pose),
        "sampler": {"type": "independent", "sample_count": SAMPLES},
        "film": {
            "type": "hdrfilm",
            "width": lens.width * SCALE,
            "height": lens.height * SCALE,
            "pixel_format": "rgba",
            "rfilter": {"type": "box"},
        },
    }


def render(scene: dict[str, object]) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance [h, w, 3] and coverage [h, w]."""
    image = np.array(mi.render(mi.load_dict(scene), seed=1))
    return image[..., :3], np.clip(image[..., 3], 0, 1)


def sheet(photo: Image.Image, panorama: np.ndarray, observed: np.ndarray) -> Image.Image:
    """Lay out the frame beside the estimated panorama, and the part of it that the camera saw."""
    gap, label = 12, 30
    panel_height = (photo.height - gap - 2 * label) // 2
    panel = (2 * panel_height, panel_height)
    out = Image.new("RGB", (photo.width + gap + panel[0], photo.height), "white")
    out.paste(photo, (0, 0))
    draw, font = ImageDraw.Draw(out), ImageFont.load_default(19)
    x = photo.width + gap
    seen = panorama * observed[..., None] + 0.8 * (1 - observed[..., None])
    for k, (text, shown) in enumerate(
        (("Light at the spheres, from 31 frames", panorama), ("The part that was seen", seen))
    ):
        y = k * (panel_height + label + gap)
        draw.text((x, y + 4), text, fill=(40, 40, 40), font=font)
        picture = Image.fromarray(linear_to_srgb8(np.clip(shown, 0, 1)))
        out.paste(picture.resize(panel, Image.Resampling.BICUBIC), (x, y + label))
    return out


if __name__ == "__main__":
    main()
