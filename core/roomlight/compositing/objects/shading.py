"""Meshes from what files hold: corners as vertices, and colours at vertices as texels."""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, Int64

from roomlight.compositing.objects.materials import TEXTURES, Material, colour_of
from roomlight.compositing.objects.polygons import face_normals, row_keys
from roomlight.compositing.objects.textures import MAX_TEXTURE_SIZE, Texture
from roomlight.compositing.objects.virtual_object import TriangleMesh
from roomlight.notes import Note

_SAME = 1 / 512
_TEXELS = 16
_OPPOSED = 0.01
_FAR = 1000
_BACK_TO_BACK = 1e-3
"""Of an object's size: most distance of the centres of triangles that count as two sides of one surface."""
_APART = 3e-4
"""Of an object's size: about what exporters' rounding moves such sides through each other."""


def agreeing_corners(
    points: Float[np.ndarray, "c 3"], normals: Float[np.ndarray, "c 3"], label: str
) -> tuple[Int64[np.ndarray, " c"], Float[np.ndarray, "c 3"], tuple[Note, ...]]:
    """Make the corners of triangles agree with their normals, where all three of a triangle oppose the order.

    Such triangles are turned round if they enclose a negative volume (a scale of -1 that was applied), else their
    normals are: glass goes by the order.

    Returns:
        The corners in order, their normals, and a note if more than `_OPPOSED` of the triangles are turned.
    """
    p, n, order = points.reshape(-1, 3, 3), normals.reshape(-1, 3, 3).copy(), np.arange(len(points)).reshape(-1, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        p = p - points.mean(axis=0)
        areas = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        opposed = (np.einsum("fa,fca->fc", areas, n) < 0).all(axis=1)
        inward = float((areas[opposed] * p[opposed, 0]).sum()) < 0
    if inward:
        order[opposed] = order[opposed, ::-1]
        n[opposed] = n[opposed, ::-1]
    else:
        n[opposed] *= -1
    notes: tuple[Note, ...] = ()
    if opposed.sum() > _OPPOSED * len(opposed):
        left_out = f"{label}: {int(opposed.sum())} triangles whose normals oppose the order of their corners"
        effect = f"their {'corners' if inward else 'normals'} are turned round"
        notes = (Note(left_out, effect, "nothing to do if it looks right"),)
    return order.reshape(-1), n.reshape(-1, 3), notes


def near_origin(
    points: Float[np.ndarray, "n 3"], used: Int64[np.ndarray, " c"], label: str
) -> tuple[Float[np.ndarray, "n 3"], tuple[Note, ...]]:
    """Move georeferenced points, of which the used ones are `_FAR` sizes from the origin, to it: float32 would round
    them there.
    """
    low, high = points[used].min(axis=0), points[used].max(axis=0)
    centre = low / 2 + high / 2
    with np.errstate(over="ignore"):
        if not _FAR * (high - low).max() < np.abs(centre).max():
            return points, ()
    left_out = f"{label}: its place at {', '.join(f'{value:.10g}' for value in centre.tolist())}"
    return points - centre, (Note(left_out, "it is moved to the origin", "nothing to do if it looks right"),)


def moved_apart(meshes: list[TriangleMesh]) -> list[TriangleMesh]:
    """Move single-sided meshes a little outward where triangles of two of them lie back to back.

    Viewers show the one that faces the camera. Rays meet both at once, or the wrong one first.
    """
    own = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes])
    size = max(float(np.ptp(corners, axis=(0, 1)).max()), 1e-30)
    normals = np.concatenate([face_normals(mesh.vertices, mesh.faces) for mesh in meshes])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    way = np.sign(normals @ [0.61, 0.35, 0.71])  # of two opposed normals one is turned round
    places = np.concatenate([corners.mean(axis=1) / (_BACK_TO_BACK * size), 2 * way[:, None] * normals], axis=1)
    opposed = np.zeros(len(meshes), bool)
    for shift in (0.0, 0.5):  # what one rounds apart the other does not
        keys = row_keys(np.rint(places + shift))
        order = np.argsort(keys)
        starts = np.flatnonzero(np.diff(keys[order], prepend=~keys[order[0]]))
        several, both = (
            np.minimum.reduceat(x[order], starts) < np.maximum.reduceat(x[order], starts) for x in (own, way)
        )
        lengths = np.diff(starts, append=len(order))
        opposed[own[order[np.repeat(several & both, lengths)]]] = True
    return [_grown(mesh, _APART * size) if moves else mesh for mesh, moves in zip(meshes, opposed, strict=True)]


def _grown(mesh: TriangleMesh, distance: float) -> TriangleMesh:
    """Move the vertices along the mean normal of the faces at their place: none come apart."""
    _, first, at = np.unique(row_keys(mesh.vertices), return_index=True, return_inverse=True)
    joined = first[at.reshape(-1)].astype(np.int32)
    outward = replace(mesh, faces=joined[mesh.faces]).smooth_normals()[joined]
    return replace(mesh, vertices=mesh.vertices + np.float32(distance) * outward)


def joined_corners(
    points: Float[np.ndarray, "c 3"],
    uvs: Float[np.ndarray, "c 2"],
    normals: Float[np.ndarray, "c 3"],
    colours: Float[np.ndarray, "c 4"] | None,
) -> tuple[TriangleMesh, Float32[np.ndarray, "n 4"] | None]:
    """Make a mesh from the corners of its triangles in order; corners that are alike share a vertex.

    Raises:
        ObjectError: As `TriangleMesh`.
    """
    columns = [points, uvs, normals] + ([] if colours is None else [colours])
    rows = np.concatenate([np.asarray(column, np.float32) for column in columns], axis=1)
    _, first, index = np.unique(row_keys(rows), return_index=True, return_inverse=True)
    in_order = np.argsort(first)
    rank = np.empty(len(first), np.int64)
    rank[in_order] = np.arange(len(first))
    rows = rows[first[in_order]]
    mesh = TriangleMesh.build(rows[:, :3], rank[index].reshape(-1, 3), normals=rows[:, 5:8], uvs=rows[:, 3:5])
    return mesh, None if colours is None else rows[:, 8:]


def colours_in_range(encoded: Float[np.ndarray, "n c"], name: str) -> tuple[Float[np.ndarray, "n c"], list[Note]]:
    """Return colours of floats from 0 to 1: of 255 if one is above 2, else clipped, with a note."""
    encoded = np.nan_to_num(encoded / 255 if encoded.max(initial=0) > 2 else encoded)
    low, high = float(encoded.min(initial=0)), float(encoded.max(initial=0))
    lost = f"{name}: vertex colours from {low:g} to {high:g}"
    notes = [Note(lost, "clamped to 0 to 1", "nothing to do if it looks right")] if low < 0 or high > 1 else []
    return np.clip(encoded, 0, 1), notes


def with_vertex_colours(
    mesh: TriangleMesh, colours: Float32[np.ndarray, "n 4"], material: Material
) -> tuple[TriangleMesh, Material, bool]:
    """Multiply a material by linear colours at the vertices.

    One colour goes into the factors. Others become texels, a square for each triangle that bilinear filtering reads as
    the triangle's linear interpolation; squares are as fine as `MAX_TEXTURE_SIZE` allows, because texels beyond the
    diagonal are clipped to 0 to 1. A material that has textures keeps them, with the mean colour.

    Returns:
        The mesh, its material, and whether all colours are kept.
    """
    used = colours[mesh.faces.reshape(-1)]
    mean = used.mean(axis=0)
    count = len(mesh.faces)
    across = math.ceil(math.sqrt(count))
    texels = min(_TEXELS, MAX_TEXTURE_SIZE // across)
    textured = [getattr(material, f"{name}_texture") for name in TEXTURES]
    uniform = bool(np.abs(used - mean).max() < _SAME)
    if uniform or any(texture is not None for texture in textured) or texels < 2:
        base = colour_of(np.minimum(np.array(material.base_colour) * mean[:3], 1.0))
        opacity = min(1.0, material.opacity * float(mean[3]))
        return mesh, replace(material, base_colour=base, opacity=opacity), uniform
    steps = np.arange(texels, dtype=np.float32) / np.float32(texels - 1)
    b, c = np.meshgrid(steps, steps)
    weights = np.stack([1 - b - c, b, c], axis=-1)  # of the corners, at each texel
    column, row = np.arange(count) % across, np.arange(count) // across
    tiles = np.zeros((across * across, texels, texels, 4), np.float32)
    tiles[:count] = np.einsum("vuk,fkc->fvuc", weights, used.reshape(count, 3, 4))
    side = across * texels
    image = tiles.reshape(across, across, texels, texels, 4).transpose(0, 2, 1, 3, 4).reshape(side, side, 4)
    places = np.array([[0.5, 0.5], [texels - 0.5, 0.5], [0.5, texels - 0.5]])  # centres of the tile's corner texels
    uvs = (np.stack([column, row], axis=1)[:, None] * texels + places) / side
    at = mesh.faces.reshape(-1)
    corners = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    split = TriangleMesh(mesh.vertices[at], mesh.normals[at], uvs.reshape(-1, 2).astype(np.float32), corners)
    texture = replace(Texture.from_linear(image), by_triangle=True)
    return split, replace(material, base_colour_texture=texture), True
