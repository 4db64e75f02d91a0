"""Light from one photograph with depth: no capture, no poses, no stream.

The camera stands at the origin and is level: x right, y up, z backward, so that what it looks at has negative z.
Positions and panoramas are in these axes, metres.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.captures.decoding import decode_depth_map
from roomlight.conventions import Position
from roomlight.drawing import Canvas
from roomlight.engine.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import FrameError
from roomlight.files import write_json
from roomlight.frame import Frame
from roomlight.images import read_bytes, read_colour, write_exr, write_png
from roomlight.light.light import Light
from roomlight.light.main_light import MainLight, main_light
from roomlight.spheres import SphereRenderer, view_toward

MILLIMETRE_M = 0.001
_BALL = 256
_GAP = 16
_FARTHEST_M = 1000.0
"""A photograph's depth past this is in another unit."""


@dataclass(frozen=True)
class PhotoLight:
    """What was found at one position; files are names in the output folder."""

    position: Position
    light: Light
    main: MainLight
    inside: bool
    """Whether the position lies in the lighting volume; outside, only distant light is known."""
    files: tuple[str, str, str]

    @property
    def heading(self) -> tuple[float, float]:
        """(elevation, azimuth) of the main light in degrees; azimuth 0 is where the camera looks, 90 its right."""
        x, y, z = self.main.direction.tolist()
        return math.degrees(math.asin(max(-1.0, min(1.0, y)))), math.degrees(math.atan2(x, -z))

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        elevation, azimuth = self.heading
        return {
            "position": list(self.position),
            "files": dict(zip(("panorama", "picture", "spheres"), self.files, strict=True)),
            "seen_share": self.light.coverage,
            "inside_volume": self.inside,
            "main_light": {
                "direction": self.main.direction.tolist(),
                "intensity": self.main.intensity.tolist(),
                "elevation_deg": elevation,
                "azimuth_deg": azimuth,
            },
        }


def read_photo(image: Path, depth: Path, *, fov_deg: float, depth_unit_m: float | None = None) -> Frame:
    """The photograph as a frame.

    fov_deg is horizontal. depth is a 16-bit PNG or integer .npy in millimetres, an EXR or float .npy in metres;
    `depth_unit_m` says otherwise for PNG and .npy. ImageError and FrameError name the file.
    """
    colour, clipped = read_colour(image)
    data = read_bytes(depth)
    unit_m = depth_unit_m or (1.0 if data[:6] == b"\x93NUMPY" and _is_float(data) else MILLIMETRE_M)
    depth_m = decode_depth_map(data, str(depth), unit_m=unit_m)
    height, width = colour.shape[:2]
    known = depth_m[depth_m > 0]
    if known.size == 0:
        raise FrameError(f"{depth}: no pixel has a depth, so nothing is known of where the light is")
    middle_m = float(np.median(known))
    if not 0.02 < middle_m < _FARTHEST_M:
        raise FrameError(
            f"{depth}: its median depth would be {middle_m:.3g} m, which is no room; say what one stored unit is "
            f"with --depth-unit (it was taken to be {unit_m:g} m)"
        )
    focal = 0.5 * width / math.tan(math.radians(fov_deg) / 2)
    return Frame(
        index=0,
        image=colour,
        clipped=clipped,
        depth_m=depth_m,
        intrinsics=Intrinsics(focal, focal, width / 2, height / 2, width, height),
        camera_to_world=np.eye(4),
        source=str(image),
    )


def light_photo(
    frame: Frame,
    positions: Sequence[Position],
    out: Path,
    *,
    options: SessionOptions,
    graphs: LightingGraphs | None = None,
) -> list[PhotoLight]:
    """Light at the positions, written to `out`: an EXR, a PNG and two spheres for each, and light.json for all.

    FrameError, ProbeError and ModelError as the session raises them; OutputError where `out` cannot be written.
    """
    session = Session(options, graphs=graphs)
    session.push(frame)
    assert session.grid is not None
    found: list[PhotoLight] = []
    for number, position in enumerate(positions):
        light = session.light_at(position)
        files = (f"probe-{number:02d}.exr", f"probe-{number:02d}.png", f"probe-{number:02d}-spheres.png")
        write_exr(out / files[0], light.panorama)
        write_png(out / files[1], light.panorama)
        write_png(out / files[2], _spheres(light, view_toward(frame.camera_to_world, position)))
        found.append(PhotoLight(position, light, main_light(light.panorama), session.grid.contains(position), files))
    report = {"model": session.model, "source": frame.source, "intrinsics": asdict(frame.intrinsics)}
    write_json(out / "light.json", report | {"probes": [one.to_json() for one in found]})
    return found


def _spheres(light: Light, view: tuple[float, float, float]) -> np.ndarray:
    canvas = Canvas(2 * _BALL + 3 * _GAP, _BALL + 2 * _GAP)
    spheres = SphereRenderer(view, size=_BALL)
    canvas.sphere((_GAP, _GAP), light.panorama, spheres, "mirror")
    canvas.sphere((_BALL + 2 * _GAP, _GAP), light.panorama, spheres, "glossy")
    return canvas.image


def _is_float(data: bytes) -> bool:
    """Whether a .npy file's header names a float type; its text begins at byte 10 or 12."""
    header = data[:256].decode("latin-1")
    return any(f"'descr': '{order}f" in header for order in "<>=|")
