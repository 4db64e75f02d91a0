"""A room flattened into arrays, and the rays traced through it.

Frames: world, y up, metres; radiance in kcd/m2. Two trees: one of everything opaque (mirrors too), one of the glass
panes, which stop no light.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from roomlight.rays import RayHits, RayTree
from roomlight_generator.rooms.scene import Material, Scene, Texture
from roomlight_generator.transport.atlas import Atlas, build_atlas

OFFSET_M: Final = 1e-4
"""Rays start this far off a surface: 200 times float32's step at 5 m; lampshades have skins 1 mm apart."""

FAR_M: Final = 1e4
"""Longer than any room: the reach of a ray toward the sky."""
_MISSED_M: Final = np.float32(1e37)
"""Distance of rays that met nothing: finite, because kernels take quotients of distances."""


class Geometry(NamedTuple):
    """Triangles as the kernels read them: the faces of both trees, opaque first.

    Corner data is stored by face, so that a hit is one read.
    """

    corners: Float32[np.ndarray, "f 3 3"]
    normals: Float32[np.ndarray, "f 3 3"]
    uvs: Float32[np.ndarray, "f 3 2"]
    material: Int32[np.ndarray, " f"]
    item: Int32[np.ndarray, " f"]


class Materials(NamedTuple):
    """A row for each material: roughness 0 is Lambertian, texture -1 is none, mirror is the reflectance."""

    albedo: Float32[np.ndarray, "m 3"]
    emission: Float32[np.ndarray, "m 3"]
    roughness: Float32[np.ndarray, " m"]
    mirror: Float32[np.ndarray, " m"]
    texture: Int32[np.ndarray, " m"]


class SceneArrays(NamedTuple):
    """The surfaces of a scene as the kernels read them."""

    geometry: Geometry
    materials: Materials
    atlas: Atlas


class Tracer:
    """Geometry, materials, textures and trees of a scene; safe to use from several threads at once."""

    def __init__(self, scene: Scene) -> None:
        """Flatten the scene and build its trees.

        Raises:
            ValueError: if the scene holds no opaque triangle, or a coordinate that is not finite.
        """
        self.scene = scene
        geometry, materials = _flatten(scene)
        if not np.isfinite(geometry.corners).all():
            broken = np.flatnonzero(~np.isfinite(geometry.corners).all((1, 2)))[0]
            raise ValueError(f"item {scene.items[geometry.item[broken]].name!r} has a vertex that is not a number")
        textures: dict[int, Texture] = {}
        for material in materials:
            if material.texture is not None:
                textures.setdefault(id(material.texture), material.texture)
        self.materials = _material_table(materials, list(textures))
        self.has_mirrors = bool((self.materials.mirror > 0).any())
        glass = np.array([material.glass for material in materials], bool)[geometry.material]
        order = np.concatenate([np.flatnonzero(~glass), np.flatnonzero(glass)])
        self.geometry = Geometry(*(np.ascontiguousarray(part[order]) for part in geometry))
        self.opaque_faces = int((~glass).sum())
        if self.opaque_faces == 0:
            raise ValueError("a scene needs one opaque triangle at least")
        self._opaque = _tree(self.geometry.corners[: self.opaque_faces])
        self._glass = _tree(self.geometry.corners[self.opaque_faces :]) if glass.any() else None
        self.has_glass = self._glass is not None
        self.arrays = SceneArrays(self.geometry, self.materials, build_atlas(list(textures.values())))

    def trace(self, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"]) -> RayHits:
        """Find the nearest opaque surface along each ray (unit directions)."""
        return _trace(self._opaque, origins, directions)

    def trace_glass(self, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"]) -> RayHits:
        """Find the nearest pane along each ray, where `has_glass`; panes' faces are numbered after the opaque ones."""
        assert self._glass is not None
        hits = _trace(self._glass, origins, directions)
        return hits._replace(face=np.where(hits.face >= 0, hits.face + np.int32(self.opaque_faces), np.int32(-1)))

    def visible(
        self,
        origins: Float32[np.ndarray, "n 3"],
        directions: Float32[np.ndarray, "n 3"],
        reach_m: Float32[np.ndarray, " n"],
    ) -> Bool[np.ndarray, " n"]:
        """Return whether each ray is free of opaque surfaces within reach (panes let light through)."""
        return ~self._opaque.blocked(origins, directions, reach_m)

    def distances(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, " n"]:
        """Return the distance in metres to the nearest surface of any kind, panes too; inf where there is none."""
        begin, along = (np.ascontiguousarray(part, np.float32) for part in (origins, directions))
        hits = self.trace(begin, along)
        out = np.where(hits.face >= 0, hits.distance_m, np.float32(np.inf))
        if self.has_glass:
            panes = self.trace_glass(begin, along)
            out = np.where(panes.face >= 0, np.minimum(out, panes.distance_m), out)
        return out.astype(np.float32)


def _flatten(scene: Scene) -> tuple[Geometry, list[Material]]:
    materials: list[Material] = []
    rows: dict[int, int] = {}
    parts: list[Geometry] = []
    for index, item in enumerate(scene.items):
        mesh = item.mesh
        for material in mesh.materials:
            if id(material) not in rows:
                rows[id(material)] = len(materials)
                materials.append(material)
        table = np.array([rows[id(material)] for material in mesh.materials], np.int32)
        faces = mesh.faces
        corners = mesh.vertices[faces].astype(np.float32)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        # A box rounded to nothing has faces without an area. NaN is kept here and refused later.
        keep = ~(area <= 1e-11)
        faces = faces[keep]
        parts.append(
            Geometry(
                corners=corners[keep],
                normals=mesh.normals[faces].astype(np.float32),
                uvs=mesh.uvs[faces].astype(np.float32),
                material=table[mesh.face_materials[keep]],
                item=np.full(len(faces), index, np.int32),
            )
        )
    if not parts:
        raise ValueError("a scene needs one item at least")
    return Geometry(*(np.concatenate(column) for column in zip(*parts, strict=True))), materials


def _material_table(materials: list[Material], texture_ids: list[int]) -> Materials:
    places = {identity: place for place, identity in enumerate(texture_ids)}
    return Materials(
        albedo=np.array([material.albedo for material in materials], np.float32),
        emission=np.array([material.emission for material in materials], np.float32),
        roughness=np.array([material.roughness or 0.0 for material in materials], np.float32),
        mirror=np.array([material.mirror for material in materials], np.float32),
        texture=np.array(
            [-1 if material.texture is None else places[id(material.texture)] for material in materials], np.int32
        ),
    )


def _tree(corners: Float32[np.ndarray, "f 3 3"]) -> RayTree:
    return RayTree(corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3), robust=False)


def _trace(tree: RayTree, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"]) -> RayHits:
    hits = tree.trace(origins, directions)
    return hits._replace(distance_m=np.minimum(hits.distance_m, _MISSED_M))
