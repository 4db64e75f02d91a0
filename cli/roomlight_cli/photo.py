"""Light from one photograph, or from the frames of a video.

Positions and panoramas are in the world of `roomlight.captures.photo`: the first camera at the origin, y up, metres.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from annotated_types import Interval

from roomlight.conventions import Position
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import OptionError, OutputError
from roomlight.files import check_writable, remove_outputs, write_json
from roomlight.frame import Frame
from roomlight.images import write_png
from roomlight.imaging.drawing import LABEL_ROWS, Canvas
from roomlight.light.light import ENDINGS, Light
from roomlight.light.sources import SavedFormat
from roomlight.placement import ABOVE_M, point_at_pixel
from roomlight.rules import check_options
from roomlight.spheres import Material, SphereRenderer, view_toward

_SPHERE: Final = 256
_GAP: Final = 16
_REPORT: Final = "light.json"
_ENDINGS: Final = (".png", "-spheres.png", *ENDINGS.values())
_OUTPUTS: Final = (_REPORT, *(f"probe-{'[0-9]' * digits}{end}" for digits in (2, 3) for end in _ENDINGS))


@dataclass(frozen=True)
class PhotoPoints:
    """The points to light.

    Attributes:
        probes: Light this point: metres from the camera, x right, y up, z backward (negative in front), level.
            Repeatable.
        pixels: Light a point above the surface that this pixel of the upright photo, or of a video's first frame
            that is used, shows: column U, row V from the top left. Repeatable.
        above_m: Distance in metres of the points of `--pixel` from their surface.

    Raises:
        OptionError: A value is out of range, or there is no point.
    """

    probes: tuple[Position, ...] = ()
    pixels: tuple[tuple[float, float], ...] = ()
    above_m: Annotated[float, Interval(ge=0, le=10)] = ABOVE_M

    def __post_init__(self) -> None:
        check_options(self)
        if not self.probes and not self.pixels:
            raise OptionError("give the points to light: --pixel U,V of the photo, or --probe X,Y,Z in metres")

    def positions(self, frame: Frame) -> list[Position]:
        """Return the points in metres from the camera. Raises OptionError and ProbeError as `point_at_pixel` does."""
        return [*self.probes, *(point_at_pixel(frame, u, v, above_m=self.above_m) for u, v in self.pixels)]


@dataclass(frozen=True)
class PhotoLight:
    """The light at one position.

    Attributes:
        position: Metres from the camera.
        light: The light in all its forms.
        behind_camera: Whether it lies behind the (first) camera, where the photograph shows nothing around it.
        inside_volume: Whether the position lies in the lighting volume; outside, only distant light is known.
        files: Names in the output folder: panorama (EXR), picture of it (PNG), picture of spheres (PNG).
        forms: Names of other forms that were asked for.
    """

    position: Position
    light: Light
    behind_camera: bool
    inside_volume: bool
    files: tuple[str, str, str]
    forms: Mapping[SavedFormat, str] = field(default_factory=dict[SavedFormat, str])

    @property
    def heading(self) -> tuple[float, float]:
        """(elevation, azimuth) of the main light in degrees; azimuth 0 is the camera's view, 90 its right."""
        x, y, z = self.light.main_light.direction.tolist()
        return math.degrees(math.asin(max(-1.0, min(1.0, y)))), math.degrees(math.atan2(x, -z))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        elevation, azimuth = self.heading
        return {
            "position": list(self.position),
            "files": dict(zip(("panorama", "picture", "spheres"), self.files, strict=True)) | dict(self.forms),
            "seen_share": self.light.coverage,
            "inside_volume": self.inside_volume,
            "main_light": {
                "direction": self.light.main_light.direction.tolist(),
                "intensity": self.light.main_light.intensity.tolist(),
                "elevation_deg": elevation,
                "azimuth_deg": azimuth,
            },
        }


def check_output(out: Path, *, overwrite: bool) -> None:
    """Check before long work that light can be written to `out`; leaves nothing behind.

    Args:
        out: The folder.
        overwrite: Whether it may hold files of the names that are written.

    Raises:
        OutputError: It cannot be written, or holds such files.
    """
    check_writable(out / _REPORT)
    there = sorted(path.name for pattern in _OUTPUTS for path in out.glob(pattern))
    if there and not overwrite:
        raise OutputError(f"{out}: holds {there[0]} already; choose another --out, or replace it with --overwrite")


def light_photo(
    frames: Iterable[Frame],
    positions: Sequence[Position],
    out: Path,
    *,
    options: SessionOptions,
    graphs: LightingGraphs | None = None,
    forms: Sequence[SavedFormat] = (),
) -> list[PhotoLight]:
    """Estimate the light at the positions and write it to `out`: an EXR and two PNGs for each, light.json for all.

    Args:
        frames: The photograph, or the frames of a video.
        positions: In the world of the frames.
        out: The folder.
        options: Of the session.
        graphs: The networks, if they are loaded already.
        forms: Other forms that are written too, as `probe-00.usdz` and the like.

    Raises:
        FrameError: A frame cannot be used.
        ProbeError: A position cannot be used.
        ModelError: The weights cannot be used.
        OutputError: `out` cannot be written.
    """
    session = Session(options, graphs=graphs)
    first: Frame | None = None
    for frame in frames:
        session.push(frame)
        first = first or frame
    assert session.grid is not None
    assert first is not None
    lights: list[PhotoLight] = []
    remove_outputs(out, _OUTPUTS)  # an earlier run may have had more points
    for number, position in enumerate(positions):
        light = session.light_at(position)
        files = (f"probe-{number:02d}.exr", f"probe-{number:02d}.png", f"probe-{number:02d}-spheres.png")
        light.save(out / files[0])
        write_png(out / files[1], light.reflection)
        write_png(out / files[2], _spheres(light, view_toward(first.camera_to_world, position)))
        behind = bool((np.array(position) - first.camera_to_world[:3, 3]) @ first.camera_to_world[:3, 2] > 0)
        others: dict[SavedFormat, str] = {form: f"probe-{number:02d}{ENDINGS[form]}" for form in forms}
        for name in others.values():
            light.save(out / name)
        lights.append(PhotoLight(position, light, behind, session.grid.contains(position), files, others))
    report = {
        "model": session.model,
        "source": first.source,
        "intrinsics": asdict(first.intrinsics),
        "camera_to_world": first.camera_to_world.tolist(),
    }
    write_json(out / _REPORT, report | {"probes": [light.to_json() for light in lights]})
    return lights


def _spheres(light: Light, view: tuple[float, float, float]) -> np.ndarray:
    """Draw a mirror and a glossy sphere under the light, labelled, as 8-bit sRGB."""
    canvas = Canvas(2 * _SPHERE + 3 * _GAP, _SPHERE + 2 * _GAP + LABEL_ROWS)
    spheres = SphereRenderer(view, size=_SPHERE)
    materials: tuple[Material, Material] = ("mirror", "glossy")
    for left, material in zip((_GAP, _SPHERE + 2 * _GAP), materials, strict=True):
        canvas.text((left, _GAP), f"{material} sphere", width=_SPHERE)
        panorama = light.reflection if material == "mirror" else light.panorama
        canvas.sphere((left, _GAP + LABEL_ROWS), panorama, spheres, material)
    return canvas.image
