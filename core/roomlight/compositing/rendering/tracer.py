"""Virtual objects in the world as one Embree tree, and the rays traced through it. World metres, y up."""

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32, Int64

from roomlight.camera import rigid_inverse
from roomlight.compositing.kernels.rigid import fill_open, grow_boxes, turn_vectors
from roomlight.compositing.kernels.surfaces import EMISSIVE
from roomlight.compositing.objects.materials import Material, MaterialArrays, material_arrays
from roomlight.compositing.objects.polygons import row_keys
from roomlight.compositing.objects.textures import LEVELS, TextureArrays
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.conventions import panorama_directions
from roomlight.errors import ObjectError
from roomlight.rays import RayHits, RayTree

MAX_TRIANGLES: Final = 2_000_000
"""Most triangles of a scene: about 500 MB for the tree and the tables."""
_RIGID: Final = 1e-6
_OPEN_TESTS: Final = 200_000_000
"""Most tests of a corner against a plane for `TracedObjects.is_open`: 0.1 s; a sphere of 14,000 triangles."""
_EVERYWHERE: Final = panorama_directions(12).reshape(-1, 3).astype(np.float32)
"""Directions in which the farthest corners are tested first; most planes have one of them above."""
_NOWHERE: Final = np.zeros(3, np.float32)


class Surfaces(NamedTuple):
    """All triangles of the scene, object by object, as the kernels read them.

    tangents has a single row when no material has a normal texture.
    """

    corners: Float32[np.ndarray, "f 3 3"]
    normals: Float32[np.ndarray, "f 3 3"]
    uvs: Float32[np.ndarray, "f 3 2"]
    tangents: Float32[np.ndarray, "t 3 4"]
    material: Int32[np.ndarray, " f"]
    object_id: Int32[np.ndarray, " f"]


class Emitters(NamedTuple):
    """Triangles that emit light; a point of them is drawn by its material's mean emission.

    Attributes:
        face: their numbers.
        upto: sum of the odds of drawing them and those before, up to 1.
        density: of drawing a point of each material, per square metre.
    """

    face: Int64[np.ndarray, " e"]
    upto: Float64[np.ndarray, " e"]
    density: Float64[np.ndarray, " m"]


def is_rigid(transform: Float[np.ndarray, "4 4"]) -> bool:
    """Return whether a transform turns and moves only, within a millionth: no scale, no mirror image."""
    rotation = transform[:3, :3]
    exact = np.abs(rotation @ rotation.T - np.eye(3)).max() < _RIGID and np.linalg.det(rotation) > 0
    return bool(exact and np.abs(transform[3] - [0, 0, 0, 1]).max() < _RIGID)


class TracedObjects:
    """Objects with their tree; safe to use from several threads, and worth keeping while the objects rest.

    Attributes:
        objects: As they were given; a scene of `moved` keeps those of the scene that it was made from.
        surfaces: All triangles in the world.
        bounds: [n, 2, 3] least and greatest corner of each object's box, in world metres; not to be written.
    """

    def __init__(self, objects_in_world: Sequence[VirtualObject], *, like: "TracedObjects | None" = None) -> None:
        """Build the tree: 10 ms for 7,000 triangles, linear in their number.

        Args:
            objects_in_world: The objects.
            like: Scene whose tables of materials and textures are taken if these objects have the same materials.

        Raises:
            ObjectError: There is no object, or more than `MAX_TRIANGLES` triangles.
        """
        self.objects = tuple(objects_in_world)
        if not self.objects:
            raise ObjectError("a scene needs one object at least, got none")
        triangles = sum(item.triangles for item in self.objects)
        if triangles > MAX_TRIANGLES:
            raise ObjectError(
                f"the objects have {triangles} triangles together, at most {MAX_TRIANGLES}: simplify them"
            )
        self.bounds = np.stack([item.bounds() for item in self.objects])
        self.bounds.setflags(write=False)
        self.surfaces, self._used = _flatten(self.objects)
        if like is not None and [*map(id, self._used)] == [*map(id, like._used)]:
            self.materials, self.textures, self._texture_means = like.materials, like.textures, like._texture_means
        else:
            self.materials, self.textures = material_arrays(self._used)
            self._texture_means = _texture_means(self.textures)
        self._tree = RayTree(*_indexed(self.objects))
        self._shift: tuple[Float32[np.ndarray, "3 3"], Float32[np.ndarray, " 3"]] | None = None
        self._base: TracedObjects = self

    def moved(self, transform: Float[np.ndarray, "4 4"]) -> "TracedObjects":
        """Return the scene with all objects moved together by a rigid transform; the tree is shared, not built anew.

        Rays are moved to the tree instead. For 7,000 triangles this takes 0.3 ms, a new scene 12 ms.

        Args:
            transform: from the world of the scene's own objects, also if this scene is moved already.

        Raises:
            ValueError: The transform is not rigid.
        """
        if not is_rigid(transform):
            raise ValueError(f"objects are moved together by a rigid transform; got {transform.tolist()}")
        base = self._base
        rotation, offset_m = transform[:3, :3].astype(np.float32), transform[:3, 3].astype(np.float32)
        surfaces = base.surfaces
        tangents = surfaces.tangents.copy()
        tangents[..., :3] = _turned(tangents[..., :3], rotation)
        copied = copy(base)
        copied.surfaces = surfaces._replace(
            corners=_turned(surfaces.corners, rotation, offset_m),
            normals=_turned(surfaces.normals, rotation),
            tangents=tangents,
        )
        inverse = rigid_inverse(transform)
        copied._base = base
        copied._shift = inverse[:3, :3].astype(np.float32), inverse[:3, 3].astype(np.float32)
        copied.__dict__.pop("shade_radii", None)  # seen from above, a turned object is another size
        boxes = np.tile(np.array([[np.inf], [-np.inf]]), (len(base.objects), 1, 3))
        grow_boxes(copied.surfaces.corners, surfaces.object_id, boxes)
        copied.bounds = boxes
        copied.bounds.setflags(write=False)
        return copied

    @cached_property
    def shade_radii(self) -> Float32[np.ndarray, " n"]:
        """For each object the radius in metres of a sphere that is as large as it seen from above."""
        corners = self.surfaces.corners
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area_m2 = np.abs(a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]) / 4  # half of a triangle's: two are above each other
        total_m2 = np.bincount(self.surfaces.object_id, area_m2, len(self.objects))
        return np.sqrt(total_m2 / np.pi).astype(np.float32)

    def texture_means(self) -> Float32[np.ndarray, "t1 4"]:
        """Return the mean linear RGBA of each texture; the last row, which the index -1 reads, is opaque white."""
        return self._texture_means

    def materials_from(self, eye: Float[np.ndarray, " 3"], focal_px: float) -> MaterialArrays:
        """Return the materials with levels of their textures whose texels are about as large as pixels of a camera.

        A material has one level of each texture, for the nearest object that has it.
        """
        texture, table = self.materials.texture, self.textures
        if texture.max() < 0:
            return self.materials
        material, object_id, uvs_per_m = self._base._uv_densities
        low, high = self.bounds[object_id].swapaxes(0, 1)
        distance_m = np.linalg.norm(np.maximum(np.maximum(low - eye, eye - high), 0), axis=1)
        uvs_per_px = np.full(len(texture), np.inf)
        np.minimum.at(uvs_per_px, material, uvs_per_m * distance_m / focal_px)
        texels = (table.width * table.height.astype(np.float64)).reshape(LEVELS, -1)
        per_px = np.clip(uvs_per_px[:, None] * np.sqrt(texels[0])[texture], 1, 2**LEVELS)
        last = np.count_nonzero(texels, axis=0)[texture] - 1
        level = np.minimum(np.rint(np.log2(per_px)), last).astype(np.int32)
        return self.materials._replace(texture=np.where(texture < 0, -1, texture + level * texels.shape[1]))

    @cached_property
    def _uv_densities(self) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
        """Return the materials of each object, those objects, and how much u and v change in a metre there."""
        surfaces, count = self.surfaces, len(self.objects)
        pair = surfaces.material * np.int64(count) + surfaces.object_id
        ways = (values[:, 1:] - values[:, :1] for values in (surfaces.corners, surfaces.uvs))
        (a, b), (p, q) = (way.astype(np.float64).swapaxes(0, 1) for way in ways)
        area_m2 = np.bincount(pair, np.linalg.norm(np.cross(a, b), axis=1))
        area = np.bincount(pair, np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
        used = np.flatnonzero(area_m2)
        return used // count, used % count, np.sqrt(area[used] / area_m2[used])

    @cached_property
    def emitters(self) -> Emitters:
        """The triangles that emit light; a rigid motion changes nothing."""
        means = self.texture_means()[self.materials.texture[:, EMISSIVE], :3]
        level = (self.materials.emissive * means).mean(axis=1, dtype=np.float64)
        face = np.flatnonzero(level[self.surfaces.material])
        a, b, c = self.surfaces.corners[face].astype(np.float64).swapaxes(0, 1)
        odds = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2 * level[self.surfaces.material[face]]
        total = max(odds.sum(), 1e-30)
        return Emitters(face, np.cumsum(odds) / total, level / total)

    def is_open(self) -> Bool[np.ndarray, " f"]:
        """Return which triangles have nothing of the scene above their plane: light reaches them unhindered.

        False where that is not known: in scenes with so many triangles and corners that asking would take seconds.
        """
        return self._base._is_open  # a rigid motion changes nothing

    @cached_property
    def _is_open(self) -> Bool[np.ndarray, " f"]:
        corners = self.surfaces.corners.reshape(-1, 3)
        vertices = corners[np.unique(row_keys(corners), return_index=True)[1]]
        open_faces = np.zeros(len(self.surfaces.corners), bool)
        extremes = vertices[np.unique([np.argmax(vertices @ toward) for toward in _EVERYWHERE])]
        tolerance = np.float32(0.25 * self.offset_m())
        fill_open(self.surfaces.corners, extremes, tolerance, np.ones_like(open_faces), open_faces)
        if int(open_faces.sum()) * len(vertices) > _OPEN_TESTS:
            return np.zeros_like(open_faces)
        rest = open_faces.copy()
        fill_open(self.surfaces.corners, vertices, tolerance, rest, open_faces)
        return open_faces

    def offset_m(self) -> float:
        """Return how far off a surface rays start: beyond float32's rounding, far below the objects' size."""
        boxes = self.bounds
        extent = float((boxes[:, 1] - boxes[:, 0]).max())
        return max(2e-5 * extent, 2e-6 * float(np.abs(boxes).max()), 1e-7)

    def trace(self, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"]) -> RayHits:
        """Trace a block of rays in this thread."""
        return self._tree.trace_here(*self._at_tree(origins, directions))

    def blocked(
        self,
        origins: Float32[np.ndarray, "n 3"],
        directions: Float32[np.ndarray, "n 3"],
        reach_m: Float32[np.ndarray, " n"] | None = None,
    ) -> Bool[np.ndarray, " n"]:
        """Trace a block of shadow rays in this thread."""
        return self._tree.blocked_here(*self._at_tree(origins, directions), reach_m)

    def _at_tree(
        self, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"]
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
        """Return rays of the world where the tree was built."""
        if self._shift is None:
            return origins, directions
        rotation, offset_m = self._shift
        return _turned(origins, rotation, offset_m), _turned(directions, rotation)


def _texture_means(table: TextureArrays) -> Float32[np.ndarray, "t1 4"]:
    firsts = table.first[: len(table.first) // LEVELS]
    ends = firsts + table.width[: len(firsts)].astype(np.int64) * table.height[: len(firsts)]
    images = [table.texels[first:end] for first, end in zip(firsts, ends, strict=True)]
    means = [image.mean(axis=0, dtype=np.float64) / 65535 for image in images]
    return np.array([*means, np.ones(4)], np.float32)


def _turned(
    vectors: Float32[np.ndarray, "*n 3"],
    rotation: Float32[np.ndarray, "3 3"],
    offset: Float32[np.ndarray, "3"] = _NOWHERE,
) -> Float32[np.ndarray, "*n 3"]:
    """Return rotation x vector + offset, in this thread."""
    out = np.empty(vectors.shape, np.float32)
    turn_vectors(vectors.reshape(-1, 3), rotation, offset, out.reshape(-1, 3), 0, out.size // 3)
    return out


def _indexed(objects: Sequence[VirtualObject]) -> tuple[Float32[np.ndarray, "n 3"], Int32[np.ndarray, "f 3"]]:
    meshes = [mesh for item in objects for mesh, _ in item.parts]
    firsts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])[:-1]
    faces = np.concatenate([mesh.faces + np.int32(first) for mesh, first in zip(meshes, firsts, strict=True)])
    return np.concatenate([mesh.vertices for mesh in meshes]), faces.astype(np.int32)


def _flatten(objects: Sequence[VirtualObject]) -> tuple[Surfaces, list[Material]]:
    materials: list[Material] = []
    rows: dict[int, int] = {}
    bent = any(material.normal_texture is not None for item in objects for _, material in item.parts)
    pieces: list[Surfaces] = []
    for index, item in enumerate(objects):
        for mesh, material in item.parts:
            if id(material) not in rows:
                rows[id(material)] = len(materials)
                materials.append(material)
            count = len(mesh.faces)
            mesh = mesh.with_tangents() if bent else mesh
            pieces.append(
                Surfaces(
                    corners=mesh.vertices[mesh.faces],
                    normals=mesh.normals[mesh.faces],
                    uvs=mesh.uvs[mesh.faces],
                    tangents=np.zeros((0, 3, 4), np.float32) if mesh.tangents is None else mesh.tangents[mesh.faces],
                    material=np.full(count, rows[id(material)], np.int32),
                    object_id=np.full(count, index, np.int32),
                )
            )
    joined = Surfaces(*(np.concatenate(column) for column in zip(*pieces, strict=True)))
    if not bent:
        joined = joined._replace(tangents=np.zeros((1, 3, 4), np.float32))
    return joined, materials
