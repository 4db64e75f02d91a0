"""Build a mesh in the model frame from a library entry: read, rotate, scale, weld, simplify, shade."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.compositing.objects.polygons import corner_normals
from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture.exceptions import KIND_OF
from roomlight_generator.rooms.furniture.files.archive import Archive
from roomlight_generator.rooms.furniture.files.materials import looks_like_shade, make_material
from roomlight_generator.rooms.furniture.files.obj import MtlMaterial, Obj, parse_mtl, parse_obj
from roomlight_generator.rooms.furniture.files.sh3f import LibraryEntry, WarningCallback
from roomlight_generator.rooms.furniture.files.textures import MAX_IMAGE_BYTES, MAX_SIDE, decode_image
from roomlight_generator.rooms.furniture.simplify import TriangleSoup, simplified, welded
from roomlight_generator.rooms.roles import CEILING_ROLES, LAMP_ROLES, TOP_ROLES
from roomlight_generator.rooms.scene import Material, Mesh, Texture

TARGET_TRIANGLES: Final = 8_000
"""Target number of triangles of a piece of furniture; more of them cost little ray tracing time, but much for the
irradiance cache."""

_SMALL_TARGET_TRIANGLES: Final = 2_500
"""Target number of triangles of an object that stands on furniture: it covers some tens of pixels."""

_LARGE_TEXTURE_ROLES: Final = frozenset({"rug", "picture", "whiteboard", "curtain", "wardrobe"})
"""Roles whose textures are kept at twice the side: one repeat covers metres."""

_LEAFY_ROLES: Final = frozenset({"plant", "small_plant", "vase"})

_HOLE_LEVELS: Final = 4
"""Number of subdivisions of a leafy object's triangles where its texture has holes. Other triangles are kept or
removed whole: a texture with holes that lies over another surface is a print on it."""


def build_mesh(archive: Archive, entry: LibraryEntry, *, role: str, warn: WarningCallback) -> Mesh:
    """Build the model's mesh: metres, y up, front toward +z, standing on y = 0.

    Raises:
        FurnitureError: the model cannot be read, or no triangle is visible and of non-zero area.
    """
    where = f"{archive.path}: {entry.member}"
    obj = parse_obj(archive.read(entry.member), where)
    materials, coverages = _load_materials(obj, archive, entry, role, warn)
    levels = _HOLE_LEVELS if role in _LEAFY_ROLES else 0
    soup = _drop_unused_uvs(_cut_holes(_soup(obj, entry), coverages, levels), materials)
    soup = welded(soup) if len(soup.faces) else soup
    if not len(soup.faces):
        raise FurnitureError(f"{where}: all its triangles have zero area or are transparent")
    small = role in TOP_ROLES or (role in CEILING_ROLES and entry.width_m < 0.3)
    return _indexed_mesh(simplified(soup, _SMALL_TARGET_TRIANGLES if small else TARGET_TRIANGLES), materials)


def _soup(obj: Obj, entry: LibraryEntry) -> TriangleSoup:
    """Return the OBJ's triangles in the model frame, scaled to the size in the catalogue file."""
    rotation = np.eye(3) if entry.rotation is None else entry.rotation
    points = obj.positions @ rotation.T
    used = points[np.unique(obj.faces)]
    low, high = used.min(0), used.max(0)
    size = np.array([entry.width_m, entry.height_m, entry.depth_m])
    extent = high - low
    points = (points - (low + high) / 2) * np.where(extent > 1e-9, size / np.maximum(extent, 1e-9), 0)
    points[:, 1] += entry.height_m / 2
    uvs = np.concatenate([obj.uvs * [1, -1] + [0, 1], np.zeros((1, 2))])  # v down; the last for corners without any
    faces = obj.faces[:, ::-1] if np.linalg.det(rotation) < 0 else obj.faces
    uv_faces = obj.uv_faces[:, ::-1] if np.linalg.det(rotation) < 0 else obj.uv_faces
    return TriangleSoup(points, uvs, faces, np.where(uv_faces < 0, len(uvs) - 1, uv_faces), obj.face_materials)


def _load_materials(
    obj: Obj, archive: Archive, entry: LibraryEntry, role: str, warn: WarningCallback
) -> tuple[tuple[Material, ...], dict[int, Float[np.ndarray, "h w"]]]:
    """Return the materials in the order of the OBJ's names, and the coverage of those with holes."""
    mtl_materials: dict[str, MtlMaterial] = {}
    for library in obj.libraries:
        member = archive.find(library, relative_to=entry.member)
        if member is not None:
            mtl_materials |= parse_mtl(archive.read(member))
    side = MAX_SIDE * 2 if role in _LARGE_TEXTURE_ROLES else MAX_SIDE
    materials: list[Material] = []
    coverages: dict[int, np.ndarray] = {}
    textures: dict[str, tuple[Texture | None, Float[np.ndarray, "h w"] | None]] = {}
    kinds = KIND_OF.get(entry.id, {})
    for k, name in enumerate(obj.material_names):
        mtl = mtl_materials.get(name, MtlMaterial(name))
        texture, coverage = None, None
        if mtl.texture is not None:
            if mtl.texture not in textures:
                textures[mtl.texture] = _load_texture(archive, entry, mtl.texture, side, warn)
            texture, coverage = textures[mtl.texture]
        if coverage is not None:
            coverages[k] = coverage
        may_be_shade = role in LAMP_ROLES and entry.id not in KIND_OF
        shade = name in entry.glowing or (may_be_shade and looks_like_shade(name))
        kind = kinds.get(name) or ("shade" if shade else None)
        materials.append(make_material(mtl, texture, role=role, identity=entry.id, kind=kind))
    if all(material.glass for material in materials):
        # Rays pass straight through glass, so a model made only of glass would be invisible.
        materials = [replace(material, glass=False, roughness=0.08) for material in materials]
    return tuple(materials), coverages


def _load_texture(
    archive: Archive, entry: LibraryEntry, name: str, side: int, warn: WarningCallback
) -> tuple[Texture | None, Float[np.ndarray, "h w"] | None]:
    """Load a texture and its coverage; warn if it is missing: the material's colour replaces it."""
    try:
        member = archive.find(name, relative_to=entry.member)
        if member is None:
            member = archive.find(name.replace("\\", "/").rpartition("/")[2], relative_to=entry.member)
        if member is None:
            warn(
                f"{archive.path}: model {entry.id!r}: its texture {name!r} is not in the library; using a plain colour"
            )
            return None, None
        data = archive.read(member, limit=MAX_IMAGE_BYTES)
        return decode_image(data, f"{archive.path}: texture {member}", side=side)
    except FurnitureError as error:
        warn(f"{error}; using a plain colour")
        return None, None


def _drop_unused_uvs(soup: TriangleSoup, materials: tuple[Material, ...]) -> TriangleSoup:
    """Drop the texture coordinates of untextured faces, whose seams would block simplification."""
    textured = np.array([material.texture is not None for material in materials])
    last = len(soup.uvs) - 1
    return replace(soup, uv_faces=np.where(textured[soup.materials][:, None], soup.uv_faces, last))


def _cut_holes(soup: TriangleSoup, coverages: Mapping[int, Float[np.ndarray, "h w"]], most: int) -> TriangleSoup:
    """Remove triangles that their texture does not cover: leaves on rectangles, a chair's cane."""
    for material, coverage in coverages.items():
        chosen = soup.materials == material
        if not chosen.any() or coverage.max() < 0.5:
            continue
        levels = int(np.clip(np.log2(6000 / max(int(chosen.sum()), 1)) / 2, 0, most))
        part = soup.select(chosen)
        points, uvs = part.points[part.faces], part.uvs[part.uv_faces]
        done_points: list[np.ndarray] = []
        done_uvs: list[np.ndarray] = []
        for level in range(levels + 1):
            share = _covered_share(uvs, coverage)
            whole = (share > 0.9) if level < levels else (share > 0.5)
            done_points.append(points[whole])
            done_uvs.append(uvs[whole])
            mixed = ~whole & (share > 0.02)
            points, uvs = _subdivided(points[mixed]), _subdivided(uvs[mixed])
        new_points, new_uvs = np.concatenate(done_points), np.concatenate(done_uvs)
        rest = soup.select(~chosen)
        count = len(new_points)
        index = np.arange(3 * count).reshape(-1, 3)
        soup = TriangleSoup(
            points=np.concatenate([soup.points, new_points.reshape(-1, 3)]),
            uvs=np.concatenate([new_uvs.reshape(-1, 2), soup.uvs]),
            faces=np.concatenate([rest.faces, index + len(soup.points)]),
            uv_faces=np.concatenate([rest.uv_faces + 3 * count, index]),
            materials=np.concatenate([rest.materials, np.full(count, material, rest.materials.dtype)]),
        )
    return soup


def _covered_share(uvs: Float[np.ndarray, "f 3 2"], coverage: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " f"]:
    """Return the share of each triangle that its texture covers, from 28 sample points."""
    grid = np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)], np.float64)
    weights = (grid + 1 / 3) / 7
    places = np.einsum("sk,fkc->fsc", weights, uvs) % 1.0
    height, width = coverage.shape
    columns = np.minimum((places[..., 0] * width).astype(int), width - 1)
    rows = np.minimum((places[..., 1] * height).astype(int), height - 1)
    return (coverage[rows, columns] > 0.5).mean(1)


def _subdivided(corners: Float[np.ndarray, "f 3 c"]) -> Float[np.ndarray, "g 3 c"]:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    rows = [np.stack(three, 1) for three in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate(rows)


def _indexed_mesh(soup: TriangleSoup, materials: tuple[Material, ...]) -> Mesh:
    """Build a mesh of vertices unique in position, texture coordinates and normal, with the materials in use."""
    normals = corner_normals(soup.points, soup.faces.astype(np.int64))
    uvs = soup.uvs[soup.uv_faces].reshape(-1, 2)
    keys = np.concatenate([soup.faces.reshape(-1, 1), np.rint(normals * 200), np.rint(uvs * 4096)], axis=1).astype(
        np.int64
    )
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    used, face_materials = np.unique(soup.materials, return_inverse=True)
    uvs = uvs[first]
    return Mesh(
        vertices=soup.points[soup.faces.reshape(-1)[first]].astype(np.float32),
        normals=normals[first].astype(np.float32),
        uvs=(uvs - np.floor(uvs.min(0))).astype(np.float32),
        faces=index.reshape(-1, 3).astype(np.int32),
        face_materials=face_materials.reshape(-1).astype(np.int32),
        materials=tuple(materials[k] for k in used),
    )
