"""A room as one indexed triangle soup that rays are shot at, with its materials and its lights.

Frames: world, y up, metres; radiance linear and relative. Rays go through embreex, which checks nothing: shapes
and dtypes are settled here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int

from roomlight_model.sample_room.light import Light, Sky
from roomlight_model.sample_room.shapes import Mesh

OFFSET_M = 5e-4
"""Rays start this far off a surface: ten times float32's error at 5 m, a sixth of the thinnest sheet."""


@dataclass(frozen=True)
class Material:
    """Diffuse colour (times a texture), an optional gloss over it, and light of its own.

    gloss scales the mirror reflection's Fresnel term (0: none); roughness is the spread of its half vector in
    radians. `found_by_samples` says that a Light stands for the emission in direct light, so that gathered light must
    not count it twice.
    """

    colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    texture: Float[np.ndarray, "h w 3"] | None = None
    tile_m: tuple[float, float] = (1.0, 1.0)
    gloss: float = 0.0
    roughness: float = 0.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    found_by_samples: bool = False
    textured_emission: bool = False


@dataclass(frozen=True)
class Hits:
    """Where rays ended: face (-1: nowhere), barycentric u and v, distance, and whether a back was met."""

    face: Int[np.ndarray, " n"]
    u: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]
    distance_m: Float[np.ndarray, " n"]
    from_behind: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class Surface:
    """What a shading point is made of; the normal looks toward the ray's origin."""

    position: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    albedo: Float[np.ndarray, "n 3"]
    emission: Float[np.ndarray, "n 3"]
    material: Int[np.ndarray, " n"]


@dataclass(frozen=True)
class Scene:
    """Triangles, materials and lights; made by `build`, traced by any number of threads."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    uv: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]
    face_material: Int[np.ndarray, " f"]
    face_tint: Float[np.ndarray, "f 3"]
    materials: tuple[Material, ...]
    lights: tuple[Light, ...]
    sky: Sky
    embree: EmbreeScene = field(repr=False)

    @classmethod
    def build(
        cls, meshes: Sequence[Mesh], materials: Mapping[str, Material], *, lights: Sequence[Light], sky: Sky
    ) -> "Scene":
        """Join the meshes and build the tree; KeyError names a material that does not exist."""
        names = list(materials)
        counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        faces = np.concatenate([mesh.faces + at for mesh, at in zip(meshes, counts, strict=False)]).astype(np.int32)
        vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32)
        corners = vertices[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        keep = area > 1e-10  # a box rounded to nothing has faces without an area
        each = [len(mesh.faces) for mesh in meshes]
        for mesh in meshes:
            if mesh.material not in materials:
                raise KeyError(f"no material is called {mesh.material!r}")
        faces = np.ascontiguousarray(faces[keep])
        embree = EmbreeScene(robust=True)
        TriangleMesh(embree, vertices, faces)
        scene = cls(
            vertices=vertices,
            normals=np.concatenate([mesh.normals for mesh in meshes]).astype(np.float32),
            uv=np.concatenate([mesh.uv for mesh in meshes]).astype(np.float32),
            faces=faces,
            face_material=np.repeat([names.index(mesh.material) for mesh in meshes], each)[keep],
            face_tint=np.repeat(np.array([mesh.tint for mesh in meshes], np.float32), each, axis=0)[keep],
            materials=tuple(materials.values()),
            lights=tuple(lights),
            sky=sky,
            embree=embree,
        )
        # The tree is built in the first query, unlocked: ask once before threads do.
        scene.trace(np.zeros((1, 3), np.float32), np.array([[0, 1, 0]], np.float32))
        return scene

    def trace(self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Hits:
        """The nearest hit of each ray (unit directions)."""
        origins, directions = (np.ascontiguousarray(array, np.float32) for array in (origins, directions))
        found = self.embree.run(origins, directions, output=1)
        return Hits(
            face=np.asarray(found["primID"], np.int32),
            u=found["u"],
            v=found["v"],
            distance_m=found["tfar"],
            from_behind=(found["Ng"] * directions).sum(1) > 0,
        )

    def visible(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        distance_m: Float[np.ndarray, " n"],
    ) -> Bool[np.ndarray, " n"]:
        """Whether nothing stands in the way within the distance."""
        if len(origins) == 0:
            return np.zeros(0, bool)
        origins, directions = (np.ascontiguousarray(array, np.float32) for array in (origins, directions))
        reach = np.array(distance_m, np.float32, copy=True)  # embreex overwrites it
        return self.embree.run(origins, directions, dists=reach, query="OCCLUDED") < 0

    def interpolate(self, hits: Hits, values: Float[np.ndarray, "v c"]) -> Float[np.ndarray, "n c"]:
        """Per-vertex values at the hits (which must all have a face)."""
        corner = self.faces[hits.face]
        u, v = hits.u[:, None], hits.v[:, None]
        return (1 - u - v) * values[corner[:, 0]] + u * values[corner[:, 1]] + v * values[corner[:, 2]]

    def surface(self, hits: Hits, directions: Float[np.ndarray, "n 3"]) -> Surface:
        """Geometry and material at hits that all have a face."""
        corner = self.faces[hits.face]
        u, v = hits.u[:, None], hits.v[:, None]
        a, b, c = (self.vertices[corner[:, k]] for k in range(3))
        wound = np.cross(b - a, c - a)
        wound *= np.where((wound * directions).sum(1) > 0, -1, 1)[:, None]
        wound /= np.linalg.norm(wound, axis=1, keepdims=True)
        normal = self.interpolate(hits, self.normals)
        normal *= np.where((normal * wound).sum(1) < 0, -1, 1)[:, None]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        position = (1 - u - v) * a + u * b + v * c + np.float32(OFFSET_M) * wound
        material = self.face_material[hits.face]
        albedo, emission = self._material(material, self.interpolate(hits, self.uv))
        albedo = np.minimum(albedo * self.face_tint[hits.face], np.float32(0.92))
        return Surface(
            position.astype(np.float32), normal.astype(np.float32), albedo, emission, np.asarray(material, np.int64)
        )

    def _material(
        self, material: Int[np.ndarray, " n"], uv: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        colours = np.array([one.colour for one in self.materials], np.float32)
        emissions = np.array([one.emission for one in self.materials], np.float32)
        albedo, emission = colours[material], emissions[material]
        for index in np.unique(material):
            one = self.materials[index]
            if one.texture is None:
                continue
            where = np.flatnonzero(material == index)
            texel = _bilinear(one.texture, uv[where] / np.array(one.tile_m, np.float32))
            if one.textured_emission:
                emission[where] *= texel
            else:
                albedo[where] *= texel
        return albedo, emission


def _bilinear(texture: Float[np.ndarray, "h w 3"], uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Repeating lookup; u runs along columns, v along rows."""
    height, width = texture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    column, row = np.floor(x), np.floor(y)
    fx, fy = (x - column)[:, None].astype(np.float32), (y - row)[:, None].astype(np.float32)
    c0, r0 = column.astype(np.int64) % width, row.astype(np.int64) % height
    c1, r1 = (c0 + 1) % width, (r0 + 1) % height
    top = texture[r0, c0] * (1 - fx) + texture[r0, c1] * fx
    low = texture[r1, c0] * (1 - fx) + texture[r1, c1] * fx
    return (top * (1 - fy) + low * fy).astype(np.float32)
