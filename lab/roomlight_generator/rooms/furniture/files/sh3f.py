"""Furniture libraries of Sweet Home 3D: `.sh3f` zip files with a catalogue file and OBJ models.

Lengths in catalogue files are centimetres; here they are metres. Light sources there have x from the left, y from the
front and z from the floor (checked on all 34 lamps of the Debian libraries); OBJ files have y up and the front toward
+z once `modelRotation` is applied, which is the model frame of `rooms.furniture_model`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import srgb8_to_linear
from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture.files.archive import Archive
from roomlight_generator.rooms.furniture.files.properties import numbered_entries, parse_properties
from roomlight_generator.rooms.furniture_model import LightSource

CATALOGUE_FILE: Final = "PluginFurnitureCatalog.properties"

WarningCallback = Callable[[str], None]
"""Called with a one-line message for each item left out."""

_SIZES_M: Final = (0.0005, 60.0)
"""Plausible sizes: the thinnest model of the Debian libraries is 1 mm, the largest a truck of 21 m."""


@dataclass(frozen=True, eq=False)
class LibraryEntry:
    """A model as described in the library's catalogue file; metres, lights in the model frame.

    Attributes:
        rotation: Applied to the OBJ's coordinates first.
        drop_top_m: Height, over its bottom, at which objects may be placed on it; None: nothing may be.
        glowing: Names of materials that the model's author marked as emitting.
    """

    id: str
    name: str
    tags: tuple[str, ...]
    category: str
    member: str
    width_m: float
    depth_m: float
    height_m: float
    elevation_m: float = 0.0
    drop_top_m: float | None = None
    rotation: Float[np.ndarray, "3 3"] | None = None
    lights: tuple[LightSource, ...] = ()
    glowing: tuple[str, ...] = ()
    opening: bool = False
    attribution: str | None = None

    @property
    def words(self) -> frozenset[str]:
        """Lower-case words of its name and tags."""
        text = " ".join([self.name, *self.tags]).lower()
        return frozenset("".join(c if c.isalnum() else " " for c in text).split())


def read_entries(archive: Archive, warn: WarningCallback) -> list[LibraryEntry]:
    """Read the entries of a library's catalogue file. Malformed entries are left out with a warning.

    Raises:
        FurnitureError: there is no catalogue file, or none of its entries can be used.
    """
    member = archive.find(CATALOGUE_FILE)
    if member is None:
        raise FurnitureError(f"{archive.path}: has no {CATALOGUE_FILE} in it; it is not a furniture library")
    general, models = numbered_entries(parse_properties(archive.read(member, limit=32 << 20)))
    entries: list[LibraryEntry] = []
    for number, properties in models.items():
        try:
            entries.append(_entry(archive, number, properties, general))
        except FurnitureError as error:
            warn(f"{error}; left out")
    if not entries:
        raise FurnitureError(f"{archive.path}: none of the {len(models)} models of its catalogue can be used")
    return entries


def _entry(archive: Archive, number: int, properties: dict[str, str], general: dict[str, str]) -> LibraryEntry:
    name = properties.get("name", "").strip() or f"model {number}"
    identity = properties.get("id", "").strip() or f"{general.get('id', archive.path.stem)}#{number}"
    where = f"{archive.path}: model {identity!r}"
    path = properties.get("model", "")
    if not path.lower().endswith(".obj"):
        raise FurnitureError(f"{where} is {path or 'no file'!r}; only OBJ models are read")
    member = archive.find(path)
    if member is None:
        raise FurnitureError(f"{where}: its file {path!r} is not in the library")
    width, depth, height = (_metres(properties, key, where) for key in ("width", "depth", "height"))
    for value in (width, depth, height):
        if not _SIZES_M[0] <= value <= _SIZES_M[1]:
            raise FurnitureError(
                f"{where}: size {width:g} x {depth:g} x {height:g} m is implausible (the catalogue is in centimetres)"
            )
    drop = _metres(properties, "dropOnTopElevation", where, default=height)
    creator = properties.get("creator") or general.get("provider")
    licence = properties.get("license") or general.get("license")
    who = ", ".join(" ".join(part.split()) for part in (creator, licence) if part)
    return LibraryEntry(
        id=identity,
        name=name,
        tags=tuple(tag.strip() for tag in properties.get("tags", "").split(",") if tag.strip()),
        category=properties.get("category", "").strip(),
        member=member,
        width_m=width,
        depth_m=depth,
        height_m=height,
        elevation_m=min(max(_metres(properties, "elevation", where, default=0.0), 0.0), 10.0),
        drop_top_m=drop if 0 <= drop <= height * 1.001 else None,
        rotation=_rotation(properties.get("modelRotation", ""), where),
        lights=_lights(properties, (width, height, depth), where),
        glowing=tuple(properties.get("lightSourceMaterialName", "").split()),
        opening=properties.get("doorOrWindow", "").lower() == "true",
        attribution=f"{name}: {who}" if who else None,
    )


def _metres(properties: dict[str, str], key: str, where: str, *, default: float | None = None) -> float:
    text = properties.get(key, "").strip()
    if not text and default is not None:
        return default
    return _finite(text, key, where) / 100


def _finite(text: str, key: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise FurnitureError(f"{where}: its {key} is {text!r}, not a number") from error
    if not math.isfinite(value):
        raise FurnitureError(f"{where}: its {key} is {text}")
    return value


def _rotation(text: str, where: str) -> Float[np.ndarray, "3 3"] | None:
    if not text.strip():
        return None
    values = [_finite(word, "modelRotation", where) for word in text.split()]
    matrix = np.array(values, np.float64).reshape(3, 3) if len(values) == 9 else np.zeros((3, 3))
    if not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3):
        raise FurnitureError(f"{where}: its modelRotation {text!r} is not a rotation")
    return matrix


def _lights(properties: dict[str, str], size_m: tuple[float, float, float], where: str) -> tuple[LightSource, ...]:
    columns = [
        [_finite(word, f"lightSource{axis}", where) / 100 for word in properties.get(f"lightSource{axis}", "").split()]
        for axis in "XYZ"
    ]
    colours = properties.get("lightSourceColor", "").split()
    diameters = [
        _finite(word, "lightSourceDiameter", where) / 100 for word in properties.get("lightSourceDiameter", "").split()
    ]
    lights: list[LightSource] = []
    for k, (x, y, z) in enumerate(zip(*columns, strict=False)):
        lights.append(
            LightSource(
                position=np.array([x - size_m[0] / 2, z, size_m[2] / 2 - y], np.float32),
                diameter_m=min(max(diameters[k] if k < len(diameters) else 0.05, 0.01), 0.5),
                colour=_colour(colours[k]) if k < len(colours) else (1.0, 1.0, 1.0),
            )
        )
    reach = np.array([size_m[0] / 2, size_m[1] / 2, size_m[2] / 2]) + 0.01
    inside = [light for light in lights if (abs(light.position - [0, size_m[1] / 2, 0]) <= reach).all()]
    if lights and not inside:
        # Some lanterns have light sources around them, since opaque panes would hide one inside.
        middle = np.mean([light.position for light in lights], axis=0)
        middle = np.clip(middle, [-reach[0], 0, -reach[2]], [reach[0], size_m[1], reach[2]])
        return (replace(lights[0], position=middle.astype(np.float32)),)
    return tuple(inside)


def _colour(text: str) -> tuple[float, float, float]:
    """Parse `#rrggbb` to relative linear RGB, brightest channel 1; white if it is malformed or black."""
    try:
        code = int(text.lstrip("#"), 16)
    except ValueError:
        return (1.0, 1.0, 1.0)
    levels = np.array([[[code >> 16 & 255, code >> 8 & 255, code & 255]]], np.uint8)
    linear = srgb8_to_linear(levels)[0, 0].astype(np.float64)
    if linear.max() <= 0:
        return (1.0, 1.0, 1.0)
    red, green, blue = linear / linear.max()
    return (float(red), float(green), float(blue))
