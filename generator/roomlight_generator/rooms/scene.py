"""What a room is made of: textures, materials, meshes, items, openings and the sky; all that the transport reads.

Frames: world right-handed, y up, metres; floor level of the main room at y = 0. Radiance is linear RGB in kilocandela
per square metre (1.0 is 1,000 cd/m2: a white wall in good daylight is about 0.1, a bulb about 30, the sun's disc
1.6e6), so that every source has a physical size to check against.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

Rgb = tuple[float, float, float]
"""Linear RGB (Rec. 709 primaries)."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A repeating image of reflectance (or of emission), sRGB-encoded, row 0 at the top.

    Texture coordinates are in repeats: u to the right, v **down** the image's rows, wrapped. `size_m` is the width and
    height of one repeat where the texture has a physical size (walls and floors), for whoever makes the coordinates.
    """

    image: UInt8[np.ndarray, "h w 3"]
    size_m: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface reflects and shines. Every surface is two-sided and reflects alike on both sides.

    albedo (linear, 0 to 0.95) multiplies the texture. `roughness` (GGX alpha, 0.03 to 0.6) puts a clear dielectric coat
    of index 1.5 over the diffuse base (Mitsuba's `roughplastic`, nonlinear = false); None is plain Lambertian.
    `mirror` > 0 makes it a perfect mirror of that reflectance (albedo and roughness then mean nothing). `glass` is a
    thin clear pane: rays pass straight through, shadow rays too. `emission` is radiance, the same in every direction
    of both sides, times the texture where `textured_emission` says so.
    """

    name: str = ""
    albedo: Rgb = (0.5, 0.5, 0.5)
    texture: Texture | None = None
    roughness: float | None = None
    mirror: float = 0.0
    glass: bool = False
    emission: Rgb = (0.0, 0.0, 0.0)
    textured_emission: bool = False

    @property
    def emits(self) -> bool:
        """Whether it is a source of light."""
        return max(self.emission) > 0


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with per-vertex shading normals (split at creases), texture coordinates and a material for each."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]
    face_materials: Int[np.ndarray, " f"]
    materials: tuple[Material, ...]

    @classmethod
    def joined(cls, parts: Sequence["Mesh"]) -> "Mesh":
        """One mesh of all parts; materials that are the same object are kept once. ValueError without parts."""
        if not parts:
            raise ValueError("nothing to join: an item needs one mesh at least")
        materials: dict[int, Material] = {}
        places: dict[int, int] = {}
        face_materials: list[np.ndarray] = []
        for part in parts:
            for material in part.materials:
                materials.setdefault(id(material), material)
                places.setdefault(id(material), len(places))
            table = np.array([places[id(material)] for material in part.materials], np.int32)
            face_materials.append(table[part.face_materials])
        starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
        return cls(
            vertices=np.concatenate([part.vertices for part in parts]).astype(np.float32),
            normals=np.concatenate([part.normals for part in parts]).astype(np.float32),
            uvs=np.concatenate([part.uvs for part in parts]).astype(np.float32),
            faces=np.concatenate([part.faces + at for part, at in zip(parts, starts, strict=False)]).astype(np.int32),
            face_materials=np.concatenate(face_materials).astype(np.int32),
            materials=tuple(materials.values()),
        )

    def placed(self, x: float, y: float, z: float, *, degrees: float = 0.0) -> "Mesh":
        """Turned about the y axis (counter-clockwise seen from above: +z goes to +x at 90), then moved by metres."""
        c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], np.float32)
        return self.transformed(turn, np.array([x, y, z], np.float32))

    def transformed(self, linear: Float[np.ndarray, "3 3"], offset: Float[np.ndarray, "3"]) -> "Mesh":
        """vertices @ linear.T + offset; normals follow by the inverse transpose (a reflection flips the winding)."""
        linear = np.asarray(linear, np.float32)
        normals = self.normals @ np.linalg.inv(linear).astype(np.float32)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        faces = self.faces[:, ::-1] if np.linalg.det(linear) < 0 else self.faces
        return replace(
            self,
            vertices=(self.vertices @ linear.T + np.asarray(offset, np.float32)).astype(np.float32),
            normals=normals.astype(np.float32),
            faces=np.ascontiguousarray(faces),
        )

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


@dataclass(frozen=True, eq=False)
class Item:
    """One thing in the room, in world coordinates: a sofa, a wall, a lamp.

    `role` is a furniture role (`roomlight_generator.rooms.roles`) or a part of the shell (`wall`, `floor`, `ceiling`,
    `frame`, `door_leaf`, `curtain`, ...). `attribution` names the model's creator and licence where it has one.
    """

    name: str
    role: str
    mesh: Mesh
    attribution: str | None = None


@dataclass(frozen=True, eq=False)
class Opening:
    """A hole in the shell that outdoor light comes through: a parallelogram, corner + s edge_u + t edge_v."""

    corner: Float[np.ndarray, "3"]
    edge_u: Float[np.ndarray, "3"]
    edge_v: Float[np.ndarray, "3"]

    def area_m2(self) -> float:
        """Its area."""
        return float(np.linalg.norm(np.cross(self.edge_u, self.edge_v)))


@dataclass(frozen=True, eq=False)
class Sun:
    """A disc at infinity: unit direction toward it, its irradiance on a surface facing it, its angular radius."""

    direction: Float[np.ndarray, "3"]
    irradiance: Rgb
    angular_radius: float = 0.00465


@dataclass(frozen=True, eq=False)
class Sky:
    """What rays that leave through an opening see: a small equirectangular panorama (the project's convention), no sun
    in it, and the sun if it shines."""

    panorama: Float[np.ndarray, "h w 3"]
    sun: Sun | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that light meets. Watertight but for its openings (and what is seen through them)."""

    items: tuple[Item, ...]
    openings: tuple[Opening, ...]
    sky: Sky

    def triangle_count(self) -> int:
        """Triangles of all items."""
        return sum(len(item.mesh.faces) for item in self.items)

    def attributions(self) -> list[str]:
        """Who made the models in it, each once."""
        return sorted({item.attribution for item in self.items if item.attribution})
