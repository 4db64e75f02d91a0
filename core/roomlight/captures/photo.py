"""One photograph as a frame, with its depth or estimated depth: no capture, no poses, no stream.

The camera stands at the origin of a world whose y is up and whose negative z is where it looks, seen from above. How
far it looks up or down is told by the room's straight lines.
"Upright" is the photograph as viewers show it, rotated by its EXIF orientation.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from annotated_types import Interval
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.captures.bare_video import DEFAULT_FOV_DEG, bending_lens, panorama_like, unsure_horizon
from roomlight.captures.decoding import decode_depth_map
from roomlight.captures.notes import black_bars, round_picture, unlikely_depth, within_bars
from roomlight.captures.options import CaptureOptions, up_vector
from roomlight.conventions import rotation_to_y_up
from roomlight.depth import without_unseen
from roomlight.errors import FrameError, ImageError, OptionError
from roomlight.frame import ASPECT_TOLERANCE, Frame, hidden
from roomlight.images import MAX_PIXELS, decode_picture, exif_camera, read_bytes
from roomlight.imaging.exif import oriented
from roomlight.imaging.other_formats import as_png
from roomlight.monocular.estimate import srgb_picture
from roomlight.monocular.horizon import Upright, lines_of, upright
from roomlight.monocular.motion import SIDE
from roomlight.monocular.tracks import grey_picture
from roomlight.notes import Note
from roomlight.rules import check_options

DepthOrientation = Literal["auto", "upright", "stored"]
"""Whether the depth map is upright as viewers show the photo, or has the photo's stored rows and columns."""
FovSource = Literal["option", "exif", "depth", "default"]

_FARTHEST_M: Final = 1000.0
"""A median depth past this is in another unit."""
_MOSTLY_CLIPPED: Final = 0.9
"""Share of a picture's pixels."""


@dataclass(frozen=True)
class PhotoOptions:
    """What the files of a photograph do not state.

    Attributes:
        fov_deg: Horizontal field of view of the upright photo in degrees. Default: by the calibration of its own depth,
            else by the focal length in its EXIF, else 64 along its longer side.
        world_up: Up direction in the camera's axes, x right, y up, z backward: y for a camera that was level, or a
            vector X,Y,Z. Default: by the straight lines of the room.
        depth_unit_m: Metres per stored unit of the depth; of a portrait's own depth map a factor.
        depth_orientation: For a photo that EXIF rotates: whether the depth is upright, as viewers show the photo, or
            has its stored rows and columns. auto decides by the aspect.
        depth_model: An ONNX file that estimates the depth of a photo without, instead of the network in the package.

    Raises:
        OptionError: A value is out of range.
    """

    fov_deg: Annotated[float, Interval(ge=5, le=150)] | None = None
    world_up: str | tuple[float, float, float] | None = None
    depth_unit_m: Annotated[float, Interval(ge=1e-6, le=1000)] | None = None
    depth_orientation: DepthOrientation = "auto"
    depth_model: Path | None = None

    def __post_init__(self) -> None:
        check_options(self)
        CaptureOptions(world_up=self.world_up)  # the same rule


@dataclass(frozen=True)
class Photo:
    """A photograph as a frame, and where its field of view came from.

    Attributes:
        frame: The upright photograph with its depth.
        fov_deg: Horizontal field of view of the upright photograph, in degrees.
        fov_source: The caller's option, the calibration of the photo's own depth, its EXIF, or `DEFAULT_FOV_DEG`.
        focal_35mm: EXIF's focal length in millimetres, equivalent on 36 x 24 mm film; None if not stated.
        notes: What the file states and was not used, and what was estimated.
    """

    frame: Frame
    fov_deg: float
    fov_source: FovSource
    focal_35mm: float | None = None
    notes: tuple[Note, ...] = ()


def read_photo(image: Path, depth: Path | None = None, options: PhotoOptions | None = None) -> Photo:
    """Read a photograph and its depth, or estimate its depth; both come out upright.

    Args:
        image: JPEG, PNG, HEIC, WebP, TIFF, BMP, or linear EXR. Its orientation is applied.
        depth: A 16-bit PNG or integer .npy or TIFF in millimetres, an EXR or float .npy or TIFF in metres. None: the
            depth that the photo itself holds, as phones' portraits and EXR with Z do; without, a network estimates it.
        options: What the files do not state.

    Raises:
        ImageError: A file cannot be read.
        FrameError: Depth and photo do not fit, the depth is empty or in another unit, or there is none.
        OptionError: `depth_orientation` "auto" cannot decide, because the depth's aspect fits both orientations; or it
            fits only the orientation that was not stated; or a depth model is given beside depth.
        ModelError: The depth model cannot be used.
    """
    options = options or PhotoOptions()
    if depth is not None and options.depth_model is not None:
        raise OptionError(f"leave out depth_model={options.depth_model}, or the depth {depth}: one of them is used")
    data = as_png(read_bytes(image), str(image), max_pixels=MAX_PIXELS)
    picture = decode_picture(data, str(image))
    colour, exif, own = picture.image, exif_camera(data, str(image)), picture.own_depth
    height, width = colour.shape[:2]
    shapes = (
        panorama_like(str(image), width, height, stated=exif.panorama),
        black_bars(str(image), [within_bars(colour)]),
        round_picture(str(image), colour),
    )
    notes = (*picture.notes, *(shape for shape in shapes if shape is not None))
    if (share := float(picture.clipped.mean())) > _MOSTLY_CLIPPED:
        text = f"{image}: {share:.0%} of its pixels are clipped"
        notes = (*notes, Note(text, "its light is a guess", "take it with less exposure"))
    estimated = depth is None and (own is None or options.depth_model is not None)
    if depth is not None:
        depth_m = decode_depth_map(read_bytes(depth), str(depth), unit_m=options.depth_unit_m)
        _check_depth(depth_m, str(depth))
        depth_m = _upright_depth(depth_m, exif.orientation, (width, height), options.depth_orientation, str(depth))
    elif own is not None and not estimated:
        depth_m = own.depth_m * np.float32(options.depth_unit_m or 1.0)
        _check_depth(depth_m, f"{image}: its own depth map")
        notes = (*notes, *(own.notes if options.depth_unit_m is None else ()))
    else:
        depth_m = np.zeros((height, width), np.float32)
    fov_deg, source = options.fov_deg, "option"
    if fov_deg is None and own is not None and own.focal is not None:
        fov_deg, source = math.degrees(2 * math.atan(0.5 * width / (own.focal * max(width, height)))), "depth"
    if fov_deg is None:
        fov_deg, source = exif.fov_deg(width, height), "exif"
    if fov_deg is None:
        half = math.tan(math.radians(DEFAULT_FOV_DEG) / 2) * width / max(width, height)
        fov_deg, source = math.degrees(2 * math.atan(half)), "default"
    if source == "exif" and exif.focal_mm is not None:
        text = f"{image}: its focal length of {exif.focal_mm:.3g} mm, with the sensor's size by EXIF's focal plane"
        effect = f"gives a field of view of {fov_deg:.0f} degrees"
        notes = (*notes, Note(text, effect, "state fov_deg (--fov) if the picture was cropped or shrunk since"))
    elif source == "default" and exif.focal_mm is not None:
        text = f"{image}: its focal length of {exif.focal_mm:.3g} mm"
        effect = "is not used, because the sensor's size is not stated"
        notes = (*notes, Note(text, effect, "state fov_deg (--fov)"))
    aspect = max(width, height) / min(width, height)
    if source == "exif" and exif.aspect is not None and abs(exif.aspect / aspect - 1) > ASPECT_TOLERANCE:
        text = f"{image}: it is cropped, by its EXIF from an aspect of {exif.aspect:.3g} to {aspect:.3g}"
        notes = (*notes, Note(text, f"its field of view of {fov_deg:.0f} degrees is a guess", "state fov_deg (--fov)"))
    if source == "exif" and exif.zoom > 1:
        text = f"{image}: a digital zoom of {exif.zoom:.3g}"
        effect = f"its field of view of {fov_deg:.0f} degrees is taken to include it"
        notes = (*notes, Note(text, effect, "state fov_deg (--fov) if it is too wide"))
    notes = (*notes, *bending_lens(str(image), exif.lens))
    if picture.seen is not None:
        colour, depth_m = hidden(colour, depth_m, picture.seen)
    focal = 0.5 * width / math.tan(math.radians(fov_deg) / 2)
    try:
        intrinsics = Intrinsics(focal, focal, width / 2, height / 2, width, height)
    except ValueError as error:
        message = f"{image}: {width} x {height} pixels with a field of view of {fov_deg:g} degrees are no photo"
        raise ImageError(f"{message} ({error})") from error
    frame = Frame(
        index=0,
        image=colour,
        clipped=picture.clipped,
        seen=picture.seen,
        depth_m=depth_m,
        intrinsics=intrinsics,
        camera_to_world=np.eye(4),
        source=str(image),
    )
    if options.world_up is not None:
        frame = replace(frame, camera_to_world=rotation_to_y_up(np.array(up_vector(options.world_up), np.float64)))
    elif (up := _up(frame)).sure:
        frame = replace(frame, camera_to_world=rotation_to_y_up(np.array(up.up)))
    else:
        notes = (*notes, unsure_horizon(str(image)))
    if estimated:
        from roomlight.monocular.stream import open_depth_stream  # onnxruntime takes a while to import

        stream = open_depth_stream(options.depth_model, gravity=False)
        frame = stream.complete(frame)
        frame = replace(frame, depth_m=without_unseen(frame.depth_m, frame.seen))
        notes = (*notes, stream.note(str(image)))
    elif (odd := unlikely_depth(str(depth or image), [frame])) is not None:
        notes = (*notes, odd)
    return Photo(frame, fov_deg, source, exif.focal_35mm, notes)


def _up(frame: Frame) -> Upright:
    small = replace(frame, depth_m=np.zeros(frame.image.shape[:2], np.float32)).resized(SIDE, SIDE)
    return upright([lines_of(grey_picture(srgb_picture(small)), small.intrinsics)], [np.eye(3)])


def _check_depth(depth_m: Float[np.ndarray, "h w"], path: str) -> None:
    known = depth_m[depth_m > 0]
    if known.size == 0:
        raise FrameError(f"{path}: no pixel has a depth; the light cannot be placed in the room without it")
    median_m = float(np.median(known))
    if not 0.02 < median_m < _FARTHEST_M:
        raise FrameError(
            f"{path}: its median depth would be {median_m:.3g} m, which no room has; state the metres per stored unit "
            f"as depth_unit_m (integers are taken for millimetres, floats for metres)"
        )


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
