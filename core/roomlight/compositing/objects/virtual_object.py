"""Virtual objects: triangle meshes with materials. Metres, y up, counter-clockwise faces seen from outside."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Int32, Integer

from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.polygons import face_normals
from roomlight.errors import ObjectError
from roomlight.notes import Note

SIZE_ADVICE: Final = "state size_m, the length"
MAX_COORDINATE_M: Final = 1e5
"""Coordinates beyond this are refused: float32 resolves 8 mm there."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles with a normal and texture coordinates at each vertex.

    Attributes:
        vertices: [n, 3] metres.
        normals: [n, 3] unit length.
        uvs: [n, 2] texture coordinates; v = 0 is the image's top row.
        faces: [f, 3] vertex indices.
        tangents: [n, 4] direction of growing u, and in w the sign of the bitangent (glTF); None: made when needed.

    Raises:
        ObjectError: There is no triangle, an index points nowhere, or a coordinate is not finite or beyond 100 km.
    """

    vertices: Float32[np.ndarray, "n 3"]
    normals: Float32[np.ndarray, "n 3"]
    uvs: Float32[np.ndarray, "n 2"]
    faces: Int32[np.ndarray, "f 3"]
    tangents: Float32[np.ndarray, "n 4"] | None = None

    def __post_init__(self) -> None:
        if len(self.faces) == 0:
            raise ObjectError("a mesh needs one triangle at least, got none: is the file a point cloud or empty?")
        low, high = int(self.faces.min()), int(self.faces.max())
        if low < 0 or high >= len(self.vertices):
            raise ObjectError(f"faces point at vertices {low} to {high}, but the mesh has {len(self.vertices)}")
        for name in ("vertices", "normals", "uvs", "tangents"):
            values = getattr(self, name)
            if values is not None and not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
                raise ObjectError(f"{name}[{row}] is {values[row].tolist()}: every coordinate must be a finite number")
        reach = float(np.abs(self.vertices).max())
        if reach > MAX_COORDINATE_M:
            raise ObjectError(
                f"a vertex is {reach:g} m from the origin; at most {MAX_COORDINATE_M:g}: "
                "check the unit; move georeferenced objects to the origin"
            )

    @classmethod
    def build(
        cls,
        vertices: Float[np.ndarray, "n 3"],
        faces: Integer[np.ndarray, "f 3"],
        *,
        normals: Float[np.ndarray, "n 3"] | None = None,
        uvs: Float[np.ndarray, "n 2"] | None = None,
    ) -> "TriangleMesh":
        """Make a mesh; normals not given are the area-weighted means of the faces' normals, uvs not given are 0.

        Raises:
            ObjectError: As the class.
        """
        points = np.ascontiguousarray(vertices, np.float32)
        corners = np.clip(faces.astype(np.int64), -1, 2**31 - 1).astype(np.int32)
        texture = np.zeros((len(points), 2), np.float32) if uvs is None else np.ascontiguousarray(uvs, np.float32)
        flat = np.zeros_like(points)
        mesh = cls(points, flat, texture, corners)  # checks the indices before they are used
        unit_normals = mesh.smooth_normals() if normals is None else _unit(normals, mesh.smooth_normals())
        return replace(mesh, normals=unit_normals)

    def smooth_normals(self) -> Float32[np.ndarray, "n 3"]:
        """Return the area-weighted mean normal of the faces around each vertex; +Y where there is none."""
        weighted = face_normals(self.vertices, self.faces)
        total = np.stack([self._at_vertices(weighted[:, axis]) for axis in range(3)], axis=1)
        return _unit(total, np.broadcast_to(np.array([0.0, 1.0, 0.0]), total.shape))

    def with_tangents(self) -> "TriangleMesh":
        """Return the mesh with a tangent at each vertex: the faces' directions of growing u, by area, made normal.

        Vertices where a texture meets its mirror image are there twice (MikkTSpace): their directions are opposed.
        """
        if self.tangents is not None:
            return self
        a, b, c = (self.uvs[self.faces[:, k]].astype(np.float64) for k in range(3))
        areas = (b - a)[:, 0] * (c - a)[:, 1] - (c - a)[:, 0] * (b - a)[:, 1]  # twice each face's, with its sign
        mesh = self._split(areas)
        corner = [mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3)]
        e1, e2 = corner[1] - corner[0], corner[2] - corner[0]
        texture = [mesh.uvs[mesh.faces[:, k], 1].astype(np.float64) for k in range(3)]
        v1, v2 = texture[1] - texture[0], texture[2] - texture[0]
        mirrored = np.where(areas < 0, -1.0, 1.0)  # a mirrored half of a texture turns the bitangent round
        along = (e1 * v2[:, None] - e2 * v1[:, None]) * mirrored[:, None]
        total = np.stack([mesh._at_vertices(along[:, axis]) for axis in range(3)], axis=1)
        normals = mesh.normals.astype(np.float64)
        total -= (total * normals).sum(1, keepdims=True) * normals
        axis = np.where(np.abs(normals[:, :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
        tangent = _unit(total, _unit(np.cross(axis, normals), axis))
        # glTF's bitangent is cross(n, t) w and points up the image: against v.
        sign = np.where(mesh._at_vertices(mirrored) < 0, 1.0, -1.0)
        return replace(mesh, tangents=np.concatenate([tangent, sign[:, None].astype(np.float32)], axis=1))

    def _split(self, areas: Float[np.ndarray, " f"]) -> "TriangleMesh":
        """Give faces of negative area their own vertices where faces of positive area use them too."""
        count = len(self.vertices)
        shared = np.flatnonzero((self._at_vertices(1.0 * (areas > 0)) > 0) & (self._at_vertices(1.0 * (areas < 0)) > 0))
        own = np.arange(count, dtype=np.int32)
        own[shared] = count + np.arange(len(shared))
        at = np.concatenate([np.arange(count), shared])
        faces = np.where(areas[:, None] < 0, own[self.faces], self.faces)
        return replace(self, vertices=self.vertices[at], normals=self.normals[at], uvs=self.uvs[at], faces=faces)

    def transformed(self, transform: Float[np.ndarray, "4 4"]) -> "TriangleMesh":
        """Apply an affine transform; normals go with the inverse transpose, and a mirror image turns faces round.

        Raises:
            ObjectError: The transform is not affine, not finite or flattens the object.
        """
        linear = checked_transform(transform)[:3, :3]
        vertices = self.vertices.astype(np.float64) @ linear.T + transform[:3, 3]
        normals = _unit(self.normals.astype(np.float64) @ np.linalg.inv(linear), self.normals)
        mirrored = np.linalg.det(linear) < 0
        tangents = None
        if self.tangents is not None:
            turned = _unit(self.tangents[:, :3].astype(np.float64) @ linear.T, self.tangents[:, :3])
            tangents = np.concatenate([turned, self.tangents[:, 3:] * np.float32(-1 if mirrored else 1)], axis=1)
        faces = np.ascontiguousarray(self.faces[:, ::-1]) if mirrored else self.faces
        return replace(self, vertices=vertices.astype(np.float32), normals=normals, faces=faces, tangents=tangents)

    def _at_vertices(self, per_face: Float[np.ndarray, " f"]) -> Float[np.ndarray, " n"]:
        return np.bincount(self.faces.reshape(-1), np.repeat(per_face, 3), len(self.vertices))


@dataclass(frozen=True, eq=False)
class VirtualObject:
    """A named object of one or more parts, each a mesh with its material.

    Attributes:
        notes: What the object's file states and was left out or changed.

    Raises:
        ObjectError: There is no part.
    """

    name: str
    parts: tuple[tuple[TriangleMesh, Material], ...]
    notes: tuple[Note, ...] = ()

    def __post_init__(self) -> None:
        if not self.parts:
            raise ObjectError(f"object {self.name!r} has no surface: it needs one part at least")

    @property
    def triangles(self) -> int:
        """Number of triangles."""
        return sum(len(mesh.faces) for mesh, _ in self.parts)

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the least and the greatest corner of the axis-aligned box around all used vertices, in metres."""
        used = [mesh.vertices[mesh.faces.reshape(-1)] for mesh, _ in self.parts]
        low = np.min([points.min(axis=0) for points in used], axis=0)
        high = np.max([points.max(axis=0) for points in used], axis=0)
        return np.stack([low, high]).astype(np.float64)

    def scaled_to(self, size_m: float) -> "VirtualObject":
        """Scale about the origin until the longest side of the bounds is `size_m` metres.

        Raises:
            ObjectError: The size is not positive and finite, or the object has no extent.
        """
        low, high = self.bounds()
        extent = float((high - low).max())
        if not np.isfinite(size_m) or size_m <= 0:
            raise ObjectError(f"size_m must be a positive number of metres, got {size_m}")
        if extent <= 0:
            raise ObjectError(f"object {self.name!r} has no extent and cannot be scaled")
        scaled = self.transformed(np.diag([size_m / extent] * 3 + [1.0]))
        return replace(scaled, notes=tuple(note for note in self.notes if SIZE_ADVICE not in note.advice))

    def transformed(self, transform: Float[np.ndarray, "4 4"]) -> "VirtualObject":
        """Apply an affine 4 x 4 transform, such as a pose in the world.

        Raises:
            ObjectError: The transform is not affine, not finite or flattens the object.
        """
        checked_transform(transform)
        return replace(self, parts=tuple((mesh.transformed(transform), material) for mesh, material in self.parts))

    def with_material(self, material: Material) -> "VirtualObject":
        """Return the object with one material on all its parts."""
        return replace(self, parts=tuple((mesh, material) for mesh, _ in self.parts))


def checked_transform(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return an affine transform. Raises ObjectError for one that is not affine, not finite or flattens."""
    if not np.isfinite(transform).all():
        raise ObjectError("the object's transform holds NaN or infinity")
    if np.abs(transform[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise ObjectError(f"the object's transform has the last row {transform[3].tolist()}, not 0 0 0 1")
    scale = np.linalg.svd(transform[:3, :3].astype(np.float64), compute_uv=False)
    if scale[2] <= 1e-9 * max(scale[0], 1e-30) or scale[2] < 1e-12:
        raise ObjectError(f"the object's transform flattens it: scales {scale.tolist()}")
    return transform


def _unit(vectors: Float[np.ndarray, "n 3"], fallback: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Normalise; rows without a direction take the fallback's."""
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(vectors.astype(np.float64), axis=1, keepdims=True)
        usable = np.isfinite(length) & (length > 1e-30)
        return np.where(usable, vectors / np.where(usable, length, 1), fallback).astype(np.float32)
