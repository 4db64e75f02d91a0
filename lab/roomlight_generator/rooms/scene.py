"""Scene description for the light transport: textures, materials, meshes, items, openings and the sky.

Frames: world right-handed, y up, metres; floor level of the main room at y = 0. Radiance is linear RGB in kilocandela
per square metre (1.0 is 1,000 cd/m2: a white wall in good daylight is about 0.1, a bulb about 30, the sun's disc
1.6e6), so that every source can be checked against a physical value.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

Rgb = tuple[float, float, float]
"""Linear RGB (Rec. 709 primaries)."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A repeating image of reflectance (or of emission).

    Texture coordinates are in repeats: u to the right, v **down** the image's rows, wrapped.

    Attributes:
        image: sRGB-encoded, row 0 at the top.
    """

    image: UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False)
class Material:
    """Reflection and emission of a surface. Every surface is two-sided and reflects alike on both sides.

    Attributes:
        albedo: Linear, 0 to 0.95; multiplies the texture.
        roughness: GGX alpha, 0.03 to 0.6, of a clear dielectric coat of index 1.5 over the diffuse base (Mitsuba's
            `roughplastic`, nonlinear = false); None is plain Lambertian.
        mirror: Reflectance of a perfect mirror; above 0, albedo and roughness are ignored.
        glass: A thin clear pane: rays pass straight through, shadow rays too.
        emission: Radiance, the same in every direction on both sides.
    """

    name: str = ""
    albedo: Rgb = (0.5, 0.5, 0.5)
    texture: Texture | None = None
    roughness: float | None = None
    mirror: float = 0.0
    glass: bool = False
    emission: Rgb = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with per-vertex shading normals (split at creases) and texture coordinates, and a material for each
    face."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]
    face_materials: Int[np.ndarray, " f"]
    materials: tuple[Material, ...]

    @classmethod
    def joined(cls, parts: Sequence["Mesh"]) -> "Mesh":
        """Join parts into one mesh; materials that are the same object are kept once.

        Raises:
            ValueError: `parts` is empty.
        """
        if not parts:
            raise ValueError("cannot join zero meshes: an item needs at least one")
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
        """Rotate about the y axis (counter-clockwise seen from above: +z goes to +x at 90), then translate by
        metres."""
        c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
        rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], np.float32)
        return self.transformed(rotation, np.array([x, y, z], np.float32))

    def transformed(self, linear: Float[np.ndarray, "3 3"], offset: Float[np.ndarray, "3"]) -> "Mesh":
        """Apply vertices @ linear.T + offset; normals use the inverse transpose (a reflection reverses the vertex
        order)."""
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
        """Return the corners of the bounding box: minimum, maximum."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


@dataclass(frozen=True, eq=False)
class Item:
    """An object in the room, in world coordinates: a sofa, a wall, a lamp.

    Attributes:
        role: A furniture role (`roomlight_generator.rooms.roles`) or a part of the shell (`wall`, `floor`, `ceiling`,
            `frame`, `door_leaf`, `curtain`, ...).
        attribution: The model's creator and licence, if known.
    """

    name: str
    role: str
    mesh: Mesh
    attribution: str | None = None


@dataclass(frozen=True, eq=False)
class Opening:
    """A hole in the shell that admits outdoor light: a parallelogram, corner + s edge_u + t edge_v."""

    corner: Float[np.ndarray, "3"]
    edge_u: Float[np.ndarray, "3"]
    edge_v: Float[np.ndarray, "3"]

    def area_m2(self) -> float:
        """Return the area in square metres."""
        return float(np.linalg.norm(np.cross(self.edge_u, self.edge_v)))


@dataclass(frozen=True, eq=False)
class Sun:
    """A disc at infinity: unit direction toward it, its irradiance on a surface facing it, its angular radius."""

    direction: Float[np.ndarray, "3"]
    irradiance: Rgb
    angular_radius: float = 0.00465


@dataclass(frozen=True, eq=False)
class Sky:
    """Radiance seen by rays that leave through an opening: a small equirectangular panorama (the project's
    convention) without the sun, and the sun if it shines."""

    panorama: Float[np.ndarray, "h w 3"]
    sun: Sun | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """All geometry and light sources of a room. Watertight except at its openings."""

    items: tuple[Item, ...]
    openings: tuple[Opening, ...]
    sky: Sky

    def triangle_count(self) -> int:
        """Return the number of triangles of all items."""
        return sum(len(item.mesh.faces) for item in self.items)


def attributions(items: Iterable[Item]) -> list[str]:
    """Return the sorted, distinct attributions of the models used."""
    return sorted({item.attribution for item in items if item.attribution})
