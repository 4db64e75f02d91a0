"""What a photo's EXIF states: focal length, orientation, colour space."""

import io
import math
import warnings
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Shaped
from PIL import ExifTags, Image

_FILM_DIAGONAL_MM: Final = math.hypot(36, 24)
_PLANE_UNITS_MM: Final = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""Of EXIF's FocalPlaneResolutionUnit, an inch by default."""
_SENSORS_MM: Final = (3.0, 80.0)
"""Diagonals of cameras' sensors."""
_INTEROPERABILITY_INDEX: Final = 1
_PANORAMA: Final = 6
"""Of EXIF's CustomRendered, as iPhones write it."""

ADOBE_RGB, UNCALIBRATED = 2, 65535
"""Values of EXIF's ColorSpace."""


@dataclass(frozen=True)
class ExifCamera:
    """What a photo's EXIF states about its camera.

    Attributes:
        focal_35mm: Focal length in millimetres, equivalent on 36 x 24 mm film; None if neither it nor the sensor's size
            is stated.
        focal_mm: The lens's own focal length; None where the equivalent one is stated, or none.
        orientation: EXIF's orientation tag, 1 to 8. 1 is upright, 3 upside down; the stored pixels must be rotated
            by 90 degrees clockwise for 6 and counter-clockwise for 8; 2, 4, 5 and 7 are mirrored.
        no_orientation: What is stated as orientation and is none; 0, EXIF's "unknown", is left out.
        adobe_rgb: Whether the pixels are Adobe RGB, by the camera industry's DCF.
        uncalibrated: Whether they are of another space than sRGB, which a profile should state.
        aspect: Longer side of the picture that the camera took, by the shorter; None if not stated.
        zoom: Of its digital zoom; 1 without.
        lens: Names of the camera and its lens.
        panorama: Whether it was stitched while the camera turned, as phones state it.
    """

    focal_35mm: float | None = None
    focal_mm: float | None = None
    orientation: int = 1
    no_orientation: int | None = None
    adobe_rgb: bool = False
    uncalibrated: bool = False
    aspect: float | None = None
    zoom: float = 1.0
    lens: str = ""
    panorama: bool = False

    def fov_deg(self, width: int, height: int) -> float | None:
        """Return the horizontal field of view in degrees of an image of this size in pixels; None if not stated.

        The equivalence is by the diagonal, as the camera industry's CIPA DCG-001 defines it.
        """
        if self.focal_35mm is None:
            return None
        focal_px = self.focal_35mm * math.hypot(width, height) / _FILM_DIAGONAL_MM
        return math.degrees(2 * math.atan(width / (2 * focal_px)))


def read_exif(data: bytes) -> ExifCamera:
    """Read the EXIF of a JPEG or PNG whose structure has been checked; missing or damaged EXIF gives the defaults."""
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as image:
            return exif_camera_of(image.getexif())
    except Exception:  # Pillow raises whatever the damaged bytes lead to: SyntaxError, struct.error, KeyError, ...
        return ExifCamera()


def exif_camera_of(exif: Image.Exif) -> ExifCamera:
    """Return what EXIF states. Damaged EXIF gives the defaults."""
    try:
        orientation = exif.get(ExifTags.Base.Orientation)
        details = exif.get_ifd(ExifTags.IFD.Exif)
        interoperability = exif.get_ifd(ExifTags.IFD.Interop).get(_INTEROPERABILITY_INDEX)
        width, height, zoom, focal, focal_mm = (
            _positive(details.get(tag))
            for tag in (
                ExifTags.Base.ExifImageWidth,
                ExifTags.Base.ExifImageHeight,
                ExifTags.Base.DigitalZoomRatio,
                ExifTags.Base.FocalLengthIn35mmFilm,
                ExifTags.Base.FocalLength,
            )
        )
        focal_mm = focal_mm if focal is None else None
        if focal_mm is not None and (diagonal_mm := _sensor_mm(details)) is not None:
            focal = focal_mm * _FILM_DIAGONAL_MM / diagonal_mm
        names = (exif.get(ExifTags.Base.Make), exif.get(ExifTags.Base.Model), details.get(ExifTags.Base.LensModel))
        lens = " ".join(str(name).strip("\0 ") for name in names if name)
        adobe = details.get(ExifTags.Base.ColorSpace) == ADOBE_RGB or interoperability in ("R03", b"R03\0", "R03\0")
    except Exception:  # as above
        return ExifCamera()
    stated = orientation if isinstance(orientation, int) else 0
    known = 1 <= stated <= 8
    return ExifCamera(
        focal_35mm=focal,
        focal_mm=focal_mm,
        orientation=stated if known else 1,
        no_orientation=stated if stated and not known else None,
        adobe_rgb=adobe,
        uncalibrated=not adobe and details.get(ExifTags.Base.ColorSpace) == UNCALIBRATED,
        aspect=max(width, height) / min(width, height) if width and height else None,
        zoom=max(zoom or 1.0, 1.0),
        lens=lens[:80],
        panorama=details.get(ExifTags.Base.CustomRendered) == _PANORAMA,
    )


def _sensor_mm(details: dict[int, Any]) -> float | None:
    """Return the sensor's diagonal by the pixels of the picture and of a unit of the focal plane; None without."""
    unit_mm = _PLANE_UNITS_MM.get(details.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
    width, across, height, down = (
        _positive(details.get(tag))
        for tag in (
            ExifTags.Base.ExifImageWidth,
            ExifTags.Base.FocalPlaneXResolution,
            ExifTags.Base.ExifImageHeight,
            ExifTags.Base.FocalPlaneYResolution,
        )
    )
    if unit_mm is None or width is None or height is None or across is None:
        return None
    diagonal_mm = math.hypot(width / across, height / (down or across)) * unit_mm
    return diagonal_mm if _SENSORS_MM[0] <= diagonal_mm <= _SENSORS_MM[1] else None


def _positive(stated: object) -> float | None:
    """Return a number above 0; None for 0, which is EXIF's "unknown", and for what is no number."""
    try:
        value = float(stated)  # type: ignore[arg-type]  # whatever the file holds
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return value if 0 < value < math.inf else None


def oriented(pixels: Shaped[np.ndarray, "h w *c"], orientation: int) -> Shaped[np.ndarray, "uh uw *c"]:
    """Return stored pixels upright, by EXIF's orientation tag (1 to 8)."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    flip_rows, flip_columns = orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7)
    return np.ascontiguousarray(pixels[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1])
