"""From a library's entry to a Mesh in the Model frame: read, turn, scale, clean, simplify, shade, dress."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture.archive import Archive
from roomlight_generator.rooms.furniture.exceptions import KIND_OF, TURNED_DEGREES
from roomlight_generator.rooms.furniture.materials import looks_like_shade, make_material
from roomlight_generator.rooms.furniture.obj import Finish, Obj, parse_mtl, parse_obj
from roomlight_generator.rooms.furniture.sh3f import Entry, Warn
from roomlight_generator.rooms.furniture.simplify import Soup, cleaned, shaded, simplified
from roomlight_generator.rooms.furniture.textures import MAX_SIDE, Picture, read_picture
from roomlight_generator.rooms.roles import CEILING_ROLES, TOP_ROLES
from roomlight_generator.rooms.scene import Material, Mesh, Texture

TRIANGLES: Final = 8_000
"""Most triangles of a piece of furniture; the tracer's time grows little with them, its light cache much."""

_SMALL_TRIANGLES: Final = 2_500
"""Most triangles of a thing that stands on furniture: it covers some tens of pixels."""

_LARGE_PICTURES: Final = frozenset({"rug", "picture", "whiteboard", "curtain", "wardrobe"})
"""Roles whose textures are kept at twice the side: one repeat covers metres."""

_LEAFY: Final = frozenset({"plant", "small_plant", "vase"})

_HOLE_LEVELS: Final = 4
"""How often a leafy thing's triangle is halved both ways where its texture has holes. Elsewhere triangles are kept or
left out whole: what lies over a surface with holes is a print on it."""

_UNNAMED: Final = Finish("default")


@dataclass(frozen=True, eq=False)
class Dress:
    """Materials of a model, in the order of its OBJ's names, and the coverage of those with holes."""

    materials: tuple[Material, ...]
    coverages: Mapping[int, Float[np.ndarray, "h w"]]


def build_mesh(archive: Archive, entry: Entry, *, role: str, warn: Warn) -> Mesh:
    """The model's mesh: metres, y up, front toward +z, standing on y = 0. FurnitureError when it cannot be read."""
    where = f"{archive.path}: {entry.member}"
    return mesh_of(parse_obj(archive.read(entry.member), where), archive, entry, role=role, warn=warn)


def mesh_of(obj: Obj, archive: Archive, entry: Entry, *, role: str, warn: Warn) -> Mesh:
    """`build_mesh` of an OBJ that is read already."""
    dress = _dress(obj, archive, entry, role, warn)
    levels = _HOLE_LEVELS if role in _LEAFY else 0
    soup = _plain(_with_holes(_soup(obj, entry), dress.coverages, levels), dress.materials)
    soup = cleaned(soup) if len(soup.faces) else soup
    if not len(soup.faces):
        raise FurnitureError(f"{archive.path}: {entry.member}: all its triangles are without area or see-through")
    small = role in TOP_ROLES or (role in CEILING_ROLES and entry.width_m < 0.3)
    return _joined(simplified(soup, _SMALL_TRIANGLES if small else TRIANGLES), dress.materials)


def _soup(obj: Obj, entry: Entry) -> Soup:
    """The OBJ's triangles in the Model frame, of the size the catalogue gives."""
    turn = np.eye(3) if entry.rotation is None else entry.rotation
    points = obj.positions @ turn.T
    used = points[np.unique(obj.faces)]
    low, high = used.min(0), used.max(0)
    size = np.array([entry.width_m, entry.height_m, entry.depth_m])
    extent = high - low
    points = (points - (low + high) / 2) * np.where(extent > 1e-9, size / np.maximum(extent, 1e-9), 0)
    points[:, 1] += entry.height_m / 2
    degrees = TURNED_DEGREES.get(entry.id, 0)
    if degrees:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        points = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    uvs = np.concatenate([obj.uvs * [1, -1] + [0, 1], np.zeros((1, 2))])  # v down; the last for corners without any
    faces = obj.faces[:, ::-1] if np.linalg.det(turn) < 0 else obj.faces
    uv_faces = obj.uv_faces[:, ::-1] if np.linalg.det(turn) < 0 else obj.uv_faces
    return Soup(points, uvs, faces, np.where(uv_faces < 0, len(uvs) - 1, uv_faces), obj.face_materials)


def _dress(obj: Obj, archive: Archive, entry: Entry, role: str, warn: Warn) -> Dress:
    finishes: dict[str, Finish] = {}
    for library in obj.libraries:
        member = archive.find(library, relative_to=entry.member)
        if member is not None:
            finishes |= parse_mtl(archive.read(member))
    side = MAX_SIDE * 2 if role in _LARGE_PICTURES else MAX_SIDE
    materials: list[Material] = []
    coverages: dict[int, Float[np.ndarray, "h w"]] = {}
    textures: dict[str, tuple[Picture, Texture] | None] = {}
    kinds = KIND_OF.get(entry.id, {})
    for k, name in enumerate(obj.material_names):
        finish = finishes.get(name, replace(_UNNAMED, name=name))
        found = None
        if finish.texture is not None:
            if finish.texture not in textures:
                textures[finish.texture] = _picture(archive, entry, finish.texture, side, warn)
            found = textures[finish.texture]
        if found is not None and found[0].coverage is not None:
            coverages[k] = found[0].coverage
        kind = kinds.get(name) or ("shade" if _glows(name, entry, role) else None)
        texture = found[1] if found is not None else None
        materials.append(make_material(finish, texture, role=role, identity=entry.id, kind=kind))
    if all(material.glass for material in materials):
        # Rays pass glass straight through: a thing of nothing else would not be seen.
        materials = [replace(material, glass=False, roughness=0.08) for material in materials]
    return Dress(tuple(materials), coverages)


def _glows(name: str, entry: Entry, role: str) -> bool:
    lamp = role in ("ceiling_lamp", "floor_lamp", "table_lamp", "wall_lamp")
    return name in entry.glowing or (lamp and entry.id not in KIND_OF and looks_like_shade(name))


def _picture(archive: Archive, entry: Entry, name: str, side: int, warn: Warn) -> tuple[Picture, Texture] | None:
    """The texture, or None with a warning: a missing picture is replaced by its material's colour."""
    try:
        member = archive.find(name, relative_to=entry.member)
        if member is None:
            member = archive.find(name.replace("\\", "/").rpartition("/")[2], relative_to=entry.member)
        if member is None:
            warn(
                f"{archive.path}: model {entry.id!r}: its texture {name!r} is not in the library; plain colour instead"
            )
            return None
        picture = read_picture(archive, member, side=side)
    except FurnitureError as error:
        warn(f"{error}; plain colour instead")
        return None
    return picture, Texture(picture.image)


def _plain(soup: Soup, materials: tuple[Material, ...]) -> Soup:
    """Without the texture coordinates that no texture needs: their seams would only be in the way."""
    textured = np.array([material.texture is not None for material in materials])
    last = len(soup.uvs) - 1
    return replace(soup, uv_faces=np.where(textured[soup.materials][:, None], soup.uv_faces, last))


def _with_holes(soup: Soup, coverages: Mapping[int, Float[np.ndarray, "h w"]], most: int) -> Soup:
    """Triangles whose texture does not cover them cut away: leaves on rectangles, a chair's cane."""
    for material, coverage in coverages.items():
        chosen = soup.materials == material
        if not chosen.any() or coverage.max() < 0.5:
            continue
        levels = int(np.clip(np.log2(6000 / max(int(chosen.sum()), 1)) / 2, 0, most))
        part = soup.only(chosen)
        points, uvs = part.points[part.faces], part.uvs[part.uv_faces]
        done_points: list[np.ndarray] = []
        done_uvs: list[np.ndarray] = []
        for level in range(levels + 1):
            share = _covered(uvs, coverage)
            whole = (share > 0.9) if level < levels else (share > 0.5)
            done_points.append(points[whole])
            done_uvs.append(uvs[whole])
            mixed = ~whole & (share > 0.02)
            points, uvs = _quartered(points[mixed]), _quartered(uvs[mixed])
        new_points, new_uvs = np.concatenate(done_points), np.concatenate(done_uvs)
        rest = soup.only(~chosen)
        count = len(new_points)
        index = np.arange(3 * count).reshape(-1, 3)
        soup = Soup(
            points=np.concatenate([soup.points, new_points.reshape(-1, 3)]),
            uvs=np.concatenate([new_uvs.reshape(-1, 2), soup.uvs]),
            faces=np.concatenate([rest.faces, index + len(soup.points)]),
            uv_faces=np.concatenate([rest.uv_faces + 3 * count, index]),
            materials=np.concatenate([rest.materials, np.full(count, material, rest.materials.dtype)]),
        )
    return soup


def _covered(uvs: Float[np.ndarray, "f 3 2"], coverage: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " f"]:
    """The share of each triangle that its texture covers, from 28 points in it."""
    grid = np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)], np.float64)
    weights = (grid + 1 / 3) / 7
    places = np.einsum("sk,fkc->fsc", weights, uvs) % 1.0
    height, width = coverage.shape
    columns = np.minimum((places[..., 0] * width).astype(int), width - 1)
    rows = np.minimum((places[..., 1] * height).astype(int), height - 1)
    return (coverage[rows, columns] > 0.5).mean(1)


def _quartered(corners: Float[np.ndarray, "f 3 c"]) -> Float[np.ndarray, "g 3 c"]:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    rows = [np.stack(three, 1) for three in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate(rows)


def _joined(soup: Soup, materials: tuple[Material, ...]) -> Mesh:
    """Vertices where position, texture coordinates and normal agree; only the materials that occur."""
    normals, _ = shaded(soup)
    uvs = soup.uvs[soup.uv_faces].reshape(-1, 2)
    keys = np.concatenate(
        [soup.faces.reshape(-1, 1), np.rint(normals.reshape(-1, 3) * 200), np.rint(uvs * 4096)], axis=1
    ).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    used, face_materials = np.unique(soup.materials, return_inverse=True)
    uvs = uvs[first]
    return Mesh(
        vertices=soup.points[soup.faces.reshape(-1)[first]].astype(np.float32),
        normals=normals.reshape(-1, 3)[first].astype(np.float32),
        uvs=(uvs - np.floor(uvs.min(0))).astype(np.float32),
        faces=index.reshape(-1, 3).astype(np.int32),
        face_materials=face_materials.reshape(-1).astype(np.int32),
        materials=tuple(materials[k] for k in used),
    )
