# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportUnknownVariableType=false
"""Render the room of the documentation's film: a capture of 960 x 720 pixels with exact depth, 8 frames a second.

Its furniture is of the generator's own, which a later generator has no more: `film.sh` runs this with that generator.
World metres, y up.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from roomlight_generator.rooms.props import procedural_models
from roomlight_generator.transport.direct import DirectLight

from roomlight.camera import Intrinsics
from roomlight_generator.rooms.furniture.catalogue import Catalogue
from roomlight_generator.sequences import render
from roomlight_generator.sequences.exposure import expose
from roomlight_generator.sequences.sensor import Sensor, develop

SEED, ROOM = 11, 67
SIZE = 960, 720
FPS, FRAMES = 8, 81
FINER = 1.5
"""Samples along each side of a pixel."""
SUN_RAYS = 16
"""To each sample; the generator's own single ray leaves ragged rims on patches of sun."""
EXPOSURE = 0.75
"""Of a phone's: the sun on the floor keeps its colour."""
EYES = np.array([[-0.45, 1.5, -2.15], [0.9, 1.45, -2.1], [1.7, 1.3, -1.15]])
"""Bezier points of the camera's way around the table, between the armchairs and the wall."""
TARGETS = np.array([[-0.1, 0.5, 0.7], [0.2, 0.45, 0.5], [0.15, 0.42, 0.4]])


single_ray = DirectLight.sunlight


def sunlight(light: DirectLight, points: object, *, seed: int) -> np.ndarray:
    """Return the mean irradiance by several rays to the sun."""
    rays = [single_ray(light, points, seed=SUN_RAYS * seed + number) for number in range(SUN_RAYS)]
    return np.asarray(np.mean(rays, axis=0, dtype=np.float32))


def pose(share: float) -> np.ndarray:
    """Return the camera-to-world pose at a share 0 to 1 of the film."""
    t = share * share * (3 - 2 * share)
    weights = np.array([(1 - t) ** 2, 2 * t * (1 - t), t**2])
    eye, target = weights @ EYES, weights @ TARGETS
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3, :4] = np.stack([right, np.cross(back, right), back, eye], 1)
    return out


def main(out: Path) -> None:
    """Render the frames that are not there yet, and write the capture's index."""
    for name in ("colour", "depth"):
        (out / name).mkdir(parents=True, exist_ok=True)
    DirectLight.sunlight = sunlight
    catalogue = Catalogue().with_procedural([*procedural_models("train"), *procedural_models("test")])
    lit = render.solve_lighting(ROOM, seed=SEED, split="train", catalogue=catalogue)
    width, height = SIZE
    camera = Intrinsics(0.8 * width, 0.8 * width, width / 2, height / 2, width, height)
    seen = lit.light.frame(camera.resized(320, 240), pose(0.5), seed=1).radiance
    exposure = expose(seen[None], np.random.default_rng(1))
    frames: list[dict[str, object]] = []
    for number in range(FRAMES):
        colour, depth, at = f"colour/{number:06d}.png", f"depth/{number:06d}.png", pose(number / (FRAMES - 1))
        if not (out / depth).exists():
            view = lit.light.frame(camera.resized(round(FINER * width), round(FINER * height)), at, seed=1)
            image = develop(
                cv2.resize(view.radiance, SIZE, interpolation=cv2.INTER_AREA),
                Sensor(noise=0.15),
                np.random.default_rng(number),
                multiplier=EXPOSURE * float(exposure.multiplier[0]),
                gains=exposure.gains,
            )
            depth_m = cv2.resize(view.depth_m, SIZE, interpolation=cv2.INTER_NEAREST)
            cv2.imwrite(str(out / colour), image[..., ::-1])
            cv2.imwrite(str(out / depth), np.rint(depth_m * 1000).astype(np.uint16))
        lens = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "width": width, "height": height}
        own = {"colour": colour, "depth": depth, "intrinsics": lens, "camera_to_world": at.tolist()}
        frames.append({**own, "timestamp_s": number / FPS, "exposure": 1.0})
    head = {"format": "roomlight-capture", "version": 1, "name": "daylit living room", "frames": frames, "probes": []}
    (out / "capture.json").write_text(json.dumps(head))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
