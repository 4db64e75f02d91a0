"""Light from one photograph with depth: no capture, no poses, no stream.

The camera stands at the origin and is level: x right, y up, z backward, so that points in front of it have negative z.
Positions and panoramas are in these axes, in metres. "Upright" is the photograph as viewers show it, rotated by its
EXIF orientation.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from annotated_types import Interval
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures.decoding import decode_depth_map
from roomlight.conventions import Position
from roomlight.drawing import LABEL_ROWS, Canvas
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import FrameError, OptionError
from roomlight.files import write_json
from roomlight.frame import ASPECT_TOLERANCE, Frame, hidden
from roomlight.images import decode_picture, exif_camera, read_bytes, write_exr, write_png
from roomlight.imaging.exif import oriented
from roomlight.light.light import Light
from roomlight.notes import Note
from roomlight.placement import ABOVE_M, point_at_pixel
from roomlight.rules import check_options
from roomlight.spheres import Material, SphereRenderer, view_toward

DepthOrientation = Literal["auto", "upright", "stored"]
"""Whether the depth map is upright as viewers show the photo, or has the photo's stored rows and columns."""
FovSource = Literal["option", "exif", "default"]

DEFAULT_FOV_DEG: Final = 60.0
"""Horizontal field of view without any better knowledge: a phone's main camera held level has 65 to 70 degrees, upright
about 52."""
_FARTHEST_M: Final = 1000.0
"""A median depth past this is in another unit."""
_SPHERE: Final = 256
_GAP: Final = 16


@dataclass(frozen=True)
class PhotoOptions:
    """What the files of a photograph do not state.

    Attributes:
        fov_deg: Horizontal field of view of the upright photo in degrees. Default: by the focal length in its EXIF,
            else 60.
        depth_unit_m: Metres per stored unit of a PNG or .npy.
        depth_orientation: For a photo that EXIF rotates: whether the depth is upright, as viewers show the photo, or
            has its stored rows and columns. auto decides by the aspect.

    Raises:
        OptionError: A value is out of range.
    """

    fov_deg: Annotated[float, Interval(ge=5, le=150)] | None = None
    depth_unit_m: Annotated[float, Interval(ge=1e-6, le=1000)] | None = None
    depth_orientation: DepthOrientation = "auto"

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class PhotoPoints:
    """The points to light.

    Attributes:
        probes: Light this point: metres from the camera, x right, y up, z backward (negative in front). Repeatable.
        pixels: Light a point above the surface that this pixel of the upright photo shows: column U, row V from the
            top left. Repeatable.
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
class Photo:
    """A photograph as a frame, and where its field of view came from.

    Attributes:
        frame: The upright photograph with its depth; the camera's pose is the identity.
        fov_deg: Horizontal field of view of the upright photograph, in degrees.
        fov_source: The caller's option, the photo's EXIF, or `DEFAULT_FOV_DEG`.
        focal_35mm: EXIF's focal length in millimetres, equivalent on 36 x 24 mm film; None if not stated.
        notes: What the file states and was not used.
    """

    frame: Frame
    fov_deg: float
    fov_source: FovSource
    focal_35mm: float | None = None
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class PhotoLight:
    """The light at one position.

    Attributes:
        position: Metres from the camera.
        light: The light in all its forms.
        inside_volume: Whether the position lies in the lighting volume; outside, only distant light is known.
        files: Names in the output folder: panorama (EXR), picture of it (PNG), picture of spheres (PNG).
    """

    position: Position
    light: Light
    inside_volume: bool
    files: tuple[str, str, str]

    @property
    def behind_camera(self) -> bool:
        """Whether the position lies behind the camera, where the photograph shows nothing around it."""
        return self.position[2] > 0

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
            "files": dict(zip(("panorama", "picture", "spheres"), self.files, strict=True)),
            "seen_share": self.light.coverage,
            "inside_volume": self.inside_volume,
            "main_light": {
                "direction": self.light.main_light.direction.tolist(),
                "intensity": self.light.main_light.intensity.tolist(),
                "elevation_deg": elevation,
                "azimuth_deg": azimuth,
            },
        }


def read_photo(image: Path, depth: Path, options: PhotoOptions | None = None) -> Photo:
    """Read a photograph and its depth; both come out upright.

    Args:
        image: JPEG, PNG, or linear EXR. Its EXIF orientation is applied.
        depth: A 16-bit PNG or integer .npy in millimetres, an EXR or float .npy in metres.
        options: What the files do not state.

    Raises:
        ImageError: A file cannot be read.
        FrameError: Depth and photo do not fit, or the depth is empty or in another unit.
        OptionError: `depth_orientation` "auto" cannot decide, because the depth's aspect fits both orientations; or it
            fits only the orientation that was not stated.
    """
    options = options or PhotoOptions()
    data = read_bytes(image)
    picture = decode_picture(data, str(image))
    colour, exif = picture.image, exif_camera(data, str(image))
    height, width = colour.shape[:2]
    depth_m = _read_depth(depth, options.depth_unit_m)
    depth_m = _upright_depth(depth_m, exif.orientation, (width, height), options.depth_orientation, str(depth))
    fov_deg, source = options.fov_deg, "option"
    if fov_deg is None:
        fov_deg, source = exif.fov_deg(width, height), "exif"
    if fov_deg is None:
        fov_deg, source = DEFAULT_FOV_DEG, "default"
    if picture.seen is not None:
        colour, depth_m = hidden(colour, depth_m, picture.seen)
    focal = 0.5 * width / math.tan(math.radians(fov_deg) / 2)
    frame = Frame(
        index=0,
        image=colour,
        clipped=picture.clipped,
        seen=picture.seen,
        depth_m=depth_m,
        intrinsics=Intrinsics(focal, focal, width / 2, height / 2, width, height),
        camera_to_world=np.eye(4),
        source=str(image),
    )
    return Photo(frame, fov_deg, source, exif.focal_35mm, picture.notes)


def _read_depth(path: Path, unit_m: float | None) -> Float[np.ndarray, "h w"]:
    """Return the depth in metres as stored. Raises ImageError, and FrameError for empty or mis-scaled depth."""
    data = read_bytes(path)
    depth_m = decode_depth_map(data, str(path), unit_m=unit_m)
    known = depth_m[depth_m > 0]
    if known.size == 0:
        raise FrameError(f"{path}: no pixel has a depth; the light cannot be placed in the room without it")
    median_m = float(np.median(known))
    if not 0.02 < median_m < _FARTHEST_M:
        raise FrameError(
            f"{path}: its median depth would be {median_m:.3g} m, which no room has; state the metres per stored unit "
            f"as depth_unit_m (integers are taken for millimetres, floats for metres)"
        )
    return depth_m


def _upright_depth(
    depth_m: Float[np.ndarray, "h w"],
    orientation: int,
    photo_size: tuple[int, int],
    depth_orientation: DepthOrientation,
    name: str,
) -> Float[np.ndarray, "uh uw"]:
    """Rotate the depth as EXIF rotates the photo, if it is stored like the photo.

    `orientation` is EXIF's, 1 to 8; `photo_size` is (width, height) of the upright photo. A depth map that fits
    neither way is returned as it is, for `Frame` to refuse. Raises OptionError if "auto" cannot decide, or if the
    depth fits only the other orientation.
    """
    if orientation == 1:
        return depth_m
    rotated = oriented(depth_m, orientation)
    fits = {"upright": _same_aspect(depth_m, photo_size), "stored": _same_aspect(rotated, photo_size)}
    if depth_orientation != "auto":
        other = "stored" if depth_orientation == "upright" else "upright"
        if fits[other] and not fits[depth_orientation]:
            raise OptionError(
                f"depth_orientation is {depth_orientation}; the aspect of {name} fits the photo only as {other}"
            )
        return depth_m if depth_orientation == "upright" else rotated
    if all(fits.values()):
        raise OptionError(
            f"{name}: the photo's EXIF orientation is {orientation}, and the depth's aspect does not show whether the "
            "depth has it too; state depth_orientation as upright (as viewers show the photo) or stored"
        )
    return rotated if fits["stored"] else depth_m


def _same_aspect(depth_m: Float[np.ndarray, "h w"], photo_size: tuple[int, int]) -> bool:
    (height, width), (photo_width, photo_height) = depth_m.shape, photo_size
    aspect = photo_width / photo_height
    return abs(width / height - aspect) <= ASPECT_TOLERANCE * aspect


def light_photo(
    frame: Frame,
    positions: Sequence[Position],
    out: Path,
    *,
    options: SessionOptions,
    graphs: LightingGraphs | None = None,
) -> list[PhotoLight]:
    """Estimate the light at the positions and write it to `out`: an EXR and two PNGs for each, light.json for all.

    Raises:
        FrameError: The photograph cannot start a session.
        ProbeError: A position cannot be used.
        ModelError: The weights cannot be used.
        OutputError: `out` cannot be written.
    """
    session = Session(options, graphs=graphs)
    session.push(frame)
    assert session.grid is not None
    lights: list[PhotoLight] = []
    for number, position in enumerate(positions):
        light = session.light_at(position)
        files = (f"probe-{number:02d}.exr", f"probe-{number:02d}.png", f"probe-{number:02d}-spheres.png")
        write_exr(out / files[0], light.panorama)
        write_png(out / files[1], light.panorama)
        write_png(out / files[2], _spheres(light, view_toward(frame.camera_to_world, position)))
        lights.append(PhotoLight(position, light, session.grid.contains(position), files))
    report = {"model": session.model, "source": frame.source, "intrinsics": asdict(frame.intrinsics)}
    write_json(out / "light.json", report | {"probes": [one.to_json() for one in lights]})
    return lights


def _spheres(light: Light, view: tuple[float, float, float]) -> np.ndarray:
    """Draw a mirror and a glossy sphere under the light, labelled, as 8-bit sRGB."""
    canvas = Canvas(2 * _SPHERE + 3 * _GAP, _SPHERE + 2 * _GAP + LABEL_ROWS)
    spheres = SphereRenderer(view, size=_SPHERE)
    materials: tuple[Material, Material] = ("mirror", "glossy")
    for left, material in zip((_GAP, _SPHERE + 2 * _GAP), materials, strict=True):
        canvas.text((left, _GAP), f"{material} sphere", width=_SPHERE)
        canvas.sphere((left, _GAP + LABEL_ROWS), light.panorama, spheres, material)
    return canvas.image
