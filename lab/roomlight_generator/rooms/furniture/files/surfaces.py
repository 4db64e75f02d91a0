"""Wall and floor textures of Sweet Home 3D, from its jar or from `.sh3t` texture libraries."""

import re
from dataclasses import dataclass
from typing import Final, Literal

from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture.files.archive import Archive
from roomlight_generator.rooms.furniture.files.properties import numbered_entries, parse_properties
from roomlight_generator.rooms.furniture.files.sh3f import WarningCallback
from roomlight_generator.rooms.furniture.files.textures import read_image
from roomlight_generator.rooms.scene import Texture

SurfaceKind = Literal["wall", "floor"]

CATALOGUES: Final = (
    "PluginTexturesCatalog.properties",
    "com/eteks/sweethome3d/io/DefaultTexturesCatalog.properties",
)

_OUTDOOR: Final = re.compile(r"grass|box tree|hedge|pebble|paving|gravel|asphalt|roof|sky|cloud|water", re.IGNORECASE)

_MAX_SIDE: Final = 512
"""Pixels of a repeat, which is 0.2 to 0.8 m wide: 1 to 2 mm each."""


@dataclass(frozen=True, eq=False)
class SurfaceTexture:
    """A texture for a wall or a floor with its physical size."""

    id: str
    kind: SurfaceKind
    texture: Texture
    attribution: str | None = None


def read_surfaces(archive: Archive, warn: WarningCallback) -> list[SurfaceTexture]:
    """Read the indoor textures of an archive; empty if it has no texture catalogue."""
    member = next((catalogue for name in CATALOGUES if (catalogue := archive.find(name)) is not None), None)
    if member is None:
        return []
    general, entries = numbered_entries(parse_properties(archive.read(member, limit=8 << 20)))
    surfaces: list[SurfaceTexture] = []
    for number, properties in entries.items():
        try:
            surface = _surface(archive, number, properties, general)
        except FurnitureError as error:
            warn(f"{error}; left out")
            continue
        if surface is not None:
            surfaces.append(surface)
    return surfaces


def _surface(
    archive: Archive, number: int, properties: dict[str, str], general: dict[str, str]
) -> SurfaceTexture | None:
    category = properties.get("category", "").strip().lower()
    name = properties.get("name", f"texture {number}")
    if category not in ("wall", "floor") or _OUTDOOR.search(name):
        return None
    identity = properties.get("id") or f"{archive.path.stem}#{number}"
    where = f"{archive.path}: texture {identity!r}"
    try:
        size = (float(properties["width"]) / 100, float(properties["height"]) / 100)
    except (KeyError, ValueError) as error:
        raise FurnitureError(f"{where} has no numeric size") from error
    if not all(0.01 <= side <= 20 for side in size):
        raise FurnitureError(
            f"{where}: its size {size[0]:g} x {size[1]:g} m is implausible (catalogues are in centimetres)"
        )
    member = archive.find(properties.get("image", ""))
    if member is None:
        raise FurnitureError(f"{where}: its image {properties.get('image')!r} is not in the file")
    picture = read_image(archive, member, side=_MAX_SIDE)
    made_by = ", ".join(
        " ".join(part.split())
        for part in (properties.get("creator") or general.get("provider"), general.get("license"))
        if part
    )
    return SurfaceTexture(
        identity,
        "wall" if category == "wall" else "floor",
        Texture(picture.image, size),
        f"{name}: {made_by}" if made_by else None,
    )
