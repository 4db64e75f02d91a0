"""Read GLB and glTF files: primitives of the scene's nodes as meshes with materials.

Normals that a primitive does not state are flat (glTF 3.7.2.1). Skins are posed by their joints, morph targets by their
default weights. What is left out is noted.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Int64

from roomlight.compositing.objects.beside import FilesBeside
from roomlight.compositing.objects.gltf.accessors import Accessors
from roomlight.compositing.objects.gltf.container import buffer_views, json_size, parsed, split
from roomlight.compositing.objects.gltf.draco import DRACO, decode_draco, draco_available
from roomlight.compositing.objects.gltf.images import Images
from roomlight.compositing.objects.gltf.materials import MaterialReader, Surface, unlit_of
from roomlight.compositing.objects.gltf.meshopt import MESHOPT
from roomlight.compositing.objects.gltf.nodes import Placed, placed_meshes
from roomlight.compositing.objects.gltf.schema import Gltf, Primitive
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.materials import TEXTURES, Material
from roomlight.compositing.objects.polygons import face_normals
from roomlight.compositing.objects.shading import joined_corners, moved_apart, with_vertex_colours
from roomlight.compositing.objects.virtual_object import TriangleMesh, checked_transform
from roomlight.errors import ObjectError
from roomlight.notes import Note, distinct

Parts = tuple[tuple[TriangleMesh, Material], ...]

SUPPORTED_EXTENSIONS: Final = frozenset(
    {
        *("KHR_materials_transmission", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_unlit"),
        *("KHR_materials_emissive_strength", "KHR_materials_pbrSpecularGlossiness", "KHR_texture_transform"),
        *("KHR_materials_clearcoat", "KHR_materials_sheen"),
        *(
            "KHR_mesh_quantization",
            "EXT_mesh_gpu_instancing",
            *MESHOPT,
            "KHR_node_visibility",
            "EXT_texture_webp",
            "EXT_texture_avif",
            "KHR_texture_basisu",
            DRACO,
        ),
    }
)
_LOOKS: Final = ("KHR_materials_", "EXT_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "EXT_lights_")
_HARMLESS: Final = ("KHR_xmp", "KHR_animation", "EXT_structural", "EXT_mesh_features", "KHR_audio", "KHR_interactivity")
_EFFECTS: Final = {
    "KHR_materials_volume": "glass is tinted as by its stated thickness everywhere",
    "KHR_materials_iridescence": "there are no colours of thin films",
    "KHR_materials_anisotropy": "highlights are round",
    "KHR_materials_dispersion": "glass does not split colours",
    "KHR_materials_diffuse_transmission": "thin surfaces let no light through",
    "KHR_materials_variants": "its default materials are shown",
    "KHR_lights_punctual": "its lamps give no light",
}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_CLOSED: Final = 0.02
"""Of all area that single-sided surfaces may leave open without a note."""


@dataclass(frozen=True, eq=False)
class _Arrays:
    """The values of a primitive."""

    points: Float32[np.ndarray, "n 3"]
    faces: Int64[np.ndarray, "f 3"]
    normals: Float32[np.ndarray, "n 3"] | None
    tangents: Float32[np.ndarray, "n 4"] | None
    uvs: Float32[np.ndarray, "n 2"] | None
    colours: Float32[np.ndarray, "n 4"] | None
    packed: dict[str, np.ndarray]
    notes: list[Note]


def read_gltf(data: bytes, name: str, limits: ObjectLimits, beside: FilesBeside) -> tuple[Parts, tuple[Note, ...]]:
    """Read a GLB or glTF file; see `roomlight.compositing.loading`. Raises ObjectError."""
    text, binary = split(data, name)
    limits.check("json_bytes", json_size(text), name)
    clamped: list[str] = []
    gltf = parsed(text, name, clamped)
    notes = _extension_notes(gltf, name)
    views = buffer_views(gltf, binary, beside, limits, name)
    accessors = Accessors(gltf, views)
    placed = placed_meshes(gltf, accessors, name, limits)
    reader = _PrimitiveReader(gltf, accessors, views, name)
    reader.check_amounts(placed, limits)
    limits.check("materials", len(gltf.materials), name)
    materials = MaterialReader(Images(gltf, views, beside, name, limits), clamped)
    surfaces = {-1: Surface(Material(base_colour=(1.0, 1.0, 1.0), metallic=1.0))}
    parts: list[tuple[TriangleMesh, Material]] = []
    drawn: list[tuple[TriangleMesh, Surface]] = []
    volumes = [abs(np.linalg.det(node.transform)) if node.joints is None else np.inf for node in placed]
    least = 1e-20 * max((volume for volume in volumes if volume < np.inf), default=0.0)
    scaled = [node for node, volume in zip(placed, volumes, strict=True) if volume > least] or placed
    if len(scaled) < len(placed):  # animations hide a node so
        lost = f"{name}: meshes whose nodes have a scale of 0 ({len(placed) - len(scaled)})"
        notes.append(Note(lost, "they are missing", "export the pose you want"))
    for node in scaled:
        for index in reader.drawn(node.mesh):
            label = f"{name}: mesh {node.mesh}, primitive {index}"
            primitive = gltf.meshes[node.mesh].primitives[index]
            number = primitive.material
            if number >= len(gltf.materials):
                raise ObjectError(f"{label}: material {number} of {len(gltf.materials)} does not exist")
            if number not in surfaces:
                surfaces[number] = materials.surface(gltf.materials[number], f"{name}: materials.{number}")
            surface = surfaces[number]
            try:
                mesh, material, more = reader.part(node, primitive, surface, label)
            except ObjectError as error:
                message = str(error)
                raise ObjectError(message if message.startswith(name) else f"{label}: {message}") from error
            parts.append((mesh, material))
            drawn.append((mesh, surface))
            notes.extend(more)
    lines = sum(
        part.mode < _TRIANGLES for mesh in {node.mesh for node in placed} for part in gltf.meshes[mesh].primitives
    )
    if lines:
        notes.append(Note(f"{name}: primitives of points or lines ({lines})", "they are missing", "export surfaces"))
    for surface in surfaces.values():
        notes.extend(surface.notes)
    single_sided = [mesh for mesh, surface in drawn if not surface.double_sided and not surface.material.one_sided]
    if any(material.doubleSided for material in gltf.materials) and _are_open(single_sided):
        lost = f"{name}: single-sided surfaces that enclose nothing"
        notes.append(Note(lost, "they show from behind as well", "nothing to do if it looks right"))
    if hulls := sum(map(_is_inside_out, single_sided)):
        lost = f"{name}: closed single-sided surfaces that face inward ({hulls})"
        notes.append(Note(lost, "they show from outside as well", "leave out hulls that draw outlines"))
    culled = [index for index, (_, surface) in enumerate(drawn) if not surface.double_sided]
    if len(culled) > 1:
        for index, mesh in zip(culled, moved_apart([parts[index][0] for index in culled]), strict=True):
            parts[index] = mesh, parts[index][1]
    if clamped:
        notes.append(Note(f"{name}: {', '.join(clamped[:4])}", "clamped to 0 to 1", "nothing to do if it looks right"))
    return tuple(parts), distinct(notes)


def _are_open(meshes: list[TriangleMesh]) -> bool:
    """Return whether the faces' areas do not cancel as vectors, as those of closed surfaces do."""
    whole, total = np.zeros(3), 0.0
    for mesh in meshes:
        areas = face_normals(mesh.vertices, mesh.faces)
        whole, total = whole + areas.sum(axis=0), total + float(np.linalg.norm(areas, axis=1).sum())
    return float(np.linalg.norm(whole)) > _CLOSED * total


def _is_inside_out(mesh: TriangleMesh) -> bool:
    """Return whether a closed mesh encloses a negative volume, as hulls do whose far side is an outline."""
    areas, corners = face_normals(mesh.vertices, mesh.faces), mesh.vertices[mesh.faces[:, 0]].astype(np.float64)
    least = _CLOSED * np.linalg.norm(areas, axis=1).sum() * np.ptp(corners, axis=0).max()
    return not _are_open([mesh]) and bool((areas * (corners - corners.mean(axis=0))).sum() < -least)


def _extension_notes(gltf: Gltf, name: str) -> list[Note]:
    """Refuse what geometry needs and is not read; note what only looks need."""
    for key in sorted(set(gltf.extensionsRequired) - SUPPORTED_EXTENSIONS):
        if not key.startswith((*_LOOKS, *_HARMLESS)):
            raise ObjectError(f"{name}: needs the extension {key[:60]!r}, which is not read; export without it")
    if DRACO in gltf.extensionsRequired and not draco_available():
        raise ObjectError(f"{name}: needs {DRACO}: pip install 'roomlight[draco]', or export without compression")
    notes: list[Note] = []
    primitives = [primitive for mesh in gltf.meshes for primitive in mesh.primitives]
    objects = (*gltf.materials, *gltf.textures, *gltf.nodes, *gltf.meshes, *primitives, gltf)
    used = {*gltf.extensionsUsed, *(key for part in objects for key in part.extensions)}  # some exporters list none
    for key in sorted(used - SUPPORTED_EXTENSIONS):
        if key.startswith(_HARMLESS):
            continue
        effect = _EFFECTS.get(key, "it is not read")
        notes.append(Note(f"{name}: the extension {key[:60]}", effect, "bake it into the base material if it matters"))
    if gltf.animations:
        notes.append(
            Note(f"{name}: its animations", "the object stands in its pose at rest", "export the pose you want")
        )
    if len(gltf.scenes) > 1:
        notes.append(Note(f"{name}: {len(gltf.scenes)} scenes", f"scene {gltf.scene} is shown", "export one scene"))
    return notes


class _PrimitiveReader:
    """Decodes primitives; one of several nodes is decoded once."""

    def __init__(self, gltf: Gltf, accessors: Accessors, views: list[memoryview], name: str) -> None:
        self._gltf, self._accessors, self._views, self._name = gltf, accessors, views, name
        self._decoded: dict[tuple[int, int], _Arrays] = {}

    def drawn(self, mesh: int) -> list[int]:
        """Return the primitives of a mesh that have a surface; points, lines and empty ones have none."""
        return [
            index
            for index, primitive in enumerate(self._gltf.meshes[mesh].primitives)
            if primitive.mode >= _TRIANGLES
            and "POSITION" in primitive.attributes
            and self._corners(primitive, mesh) >= 3
        ]

    def check_amounts(self, placed: list[Placed], limits: ObjectLimits) -> None:
        """Refuse more parts, vertices and triangles than the limits, and none. Raises ObjectError."""
        parts = vertices = triangles = 0
        amounts: dict[int, tuple[int, int, int]] = {}
        for node in placed:
            if node.mesh not in amounts:
                drawn = [self._gltf.meshes[node.mesh].primitives[index] for index in self.drawn(node.mesh)]
                label = f"{self._name}: mesh {node.mesh}"
                points = [self._accessors.declared(part.attributes["POSITION"], label).count for part in drawn]
                corners = [self._corners(part, node.mesh) for part in drawn]
                faces = [n // 3 if part.mode == _TRIANGLES else n - 2 for part, n in zip(drawn, corners, strict=True)]
                amounts[node.mesh] = len(drawn), sum(points), sum(faces)
            amount = amounts[node.mesh]
            parts, vertices, triangles = parts + amount[0], vertices + amount[1], triangles + amount[2]
        if parts == 0:
            raise ObjectError(
                f"{self._name}: no node of the scene has a mesh of triangles; there is no surface to light"
            )
        limits.check("parts", parts, self._name)
        limits.check("vertices", vertices, self._name)
        limits.check("triangles", triangles, self._name)

    def part(
        self, placed: Placed, primitive: Primitive, surface: Surface, label: str
    ) -> tuple[TriangleMesh, Material, list[Note]]:
        """Return a primitive as it stands in the scene, with its material. Raises ObjectError."""
        arrays = self._arrays(primitive, surface, label)
        points, normals = self._morphed(arrays, primitive, placed.weights, label)
        tangents = None if arrays.tangents is None else np.clip(arrays.tangents, -1, 1)
        transform, notes = placed.transform, list(arrays.notes)
        skinned = placed.joints is not None and {"JOINTS_0", "WEIGHTS_0"} <= primitive.attributes.keys()
        if placed.joints is not None and not skinned:
            effect = "it stands where its node is"
            notes.append(Note(f"{label}: its skin, without joints of the vertices", effect, "export it anew"))
        if placed.joints is not None and skinned:
            blended, lost = self._blended(primitive, placed.joints, arrays, label)
            if lost:
                effect = "they follow the first joint that they name"
                notes.append(Note(f"{label}: {lost} vertices whose weights are 0", effect, "weight them"))
            points = np.einsum("nij,nj->ni", blended[:, :3, :3], points) + blended[:, :3, 3]
            normals = None if normals is None else _skinned_normals(blended, normals)
            if tangents is not None:
                turned = np.einsum("nij,nj->ni", blended[:, :3, :3], tangents[:, :3])
                tangents = np.concatenate([turned, tangents[:, 3:]], axis=1).astype(np.float32)
            transform = np.eye(4)
        uvs = arrays.uvs
        textures = (getattr(surface.material, f"{key}_texture") for key in TEXTURES)
        if uvs is None and any(texture is not None for texture in textures):
            effect = "its textures show the one texel at (0, 0)"
            notes.append(Note(f"{label}: no TEXCOORD_{surface.uv_set}", effect, "unwrap the object"))
        scales = np.linalg.svd(checked_transform(transform)[:3, :3], compute_uv=False)
        # limits are of the scene's metres, which `transformed` checks too
        size = np.ldexp(0.5, np.frexp(max(scales[2], 1e-6 * scales[0]))[1])
        points = (points * size).astype(np.float32)
        if normals is None:
            mesh, colours = _flat(points, arrays)
        else:
            mesh, colours = TriangleMesh.build(points, arrays.faces, normals=normals, uvs=uvs), arrays.colours
            if tangents is not None:
                mesh = TriangleMesh(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces, tangents)
        material = surface.scaled(float(np.cbrt(abs(np.linalg.det(transform[:3, :3])))))
        if colours is not None:
            colours = np.where([True, True, True, not surface.opaque], colours, np.float32(1)).astype(np.float32)
            mesh, material, kept = with_vertex_colours(mesh, colours, material)
            if not kept:
                notes.append(
                    Note(f"{label}: its vertex colours", "their mean tints the textures", "bake them into the texture")
                )
        mesh = mesh.transformed(transform @ np.diag([1 / size] * 3 + [1.0]))
        return mesh, unlit_of(material) if surface.unlit else material, notes

    def _corners(self, primitive: Primitive, mesh: int) -> int:
        index = primitive.attributes.get("POSITION") if primitive.indices is None else primitive.indices
        return self._accessors.declared(index, f"{self._name}: mesh {mesh}").count

    def _arrays(self, primitive: Primitive, surface: Surface, label: str) -> _Arrays:
        key = id(primitive), surface.uv_set
        if key in self._decoded:
            return self._decoded[key]
        count = self._accessors.declared(primitive.attributes["POSITION"], f"{label}: POSITION").count
        packed = decode_draco(primitive, self._views, self._accessors, count, label)
        read = self._accessors.floats

        def values(attribute: str, kind: str | tuple[str, ...]) -> Float32[np.ndarray, "n c"] | None:
            if packed is not None and attribute in packed:
                return packed[attribute]
            if attribute not in primitive.attributes:
                return None
            return read(primitive.attributes[attribute], kind, count, f"{label}: {attribute}")

        def finite(attribute: str, rows: Float32[np.ndarray, "n c"] | None) -> Float32[np.ndarray, "n c"] | None:
            if rows is None or np.isfinite(rows).all():
                return rows
            effect = "normals and tangents are made from the faces, coordinates are 0"
            notes.append(Note(f"{label}: values of {attribute} that are not finite numbers", effect, "export it anew"))
            return np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, np.float32(0))

        notes = list[Note]()
        points = values("POSITION", "VEC3")
        assert points is not None
        normals, tangents = finite("NORMAL", values("NORMAL", "VEC3")), values("TANGENT", "VEC4")
        tangents = tangents if finite("TANGENT", tangents) is tangents else None
        normals = normals if normals is None or normals.any() else None  # none are stated
        uvs = finite(f"TEXCOORD_{surface.uv_set}", values(f"TEXCOORD_{surface.uv_set}", "VEC2"))
        if uvs is not None:
            uvs = (uvs @ surface.uv_transform[:, :2].T + surface.uv_transform[:, 2]).astype(np.float32)
        colours = values("COLOR_0", ("VEC3", "VEC4"))
        if colours is not None:
            opaque = np.ones((count, 1), np.float32)
            colours = np.clip(np.nan_to_num(np.concatenate([colours, opaque], axis=1)[:, :4]), 0, 1)
        faces = packed["faces"].astype(np.int64) if packed is not None else self._faces(primitive, count, label)
        if len(faces) and int(faces.max()) >= count:
            raise ObjectError(f"{label}: an index points at vertex {int(faces.max())} of {count}")
        self._decoded[key] = _Arrays(points, faces, normals, tangents, uvs, colours, packed or {}, notes)
        return self._decoded[key]

    def _faces(self, primitive: Primitive, count: int, label: str) -> Int64[np.ndarray, "f 3"]:
        if primitive.indices is None:
            corners = np.arange(count)
        else:
            corners = self._accessors.integers(primitive.indices, "SCALAR", f"{label}: indices")[:, 0].astype(np.int64)
        if primitive.mode == _TRIANGLES:
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)  # viewers leave out an incomplete triangle
        if primitive.mode == _FAN:
            first = np.full(len(corners) - 2, corners[0])
            return np.stack([first, corners[1:-1], corners[2:]], axis=1)
        strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        strip[1::2] = strip[1::2][:, [1, 0, 2]]
        distinct_corners = (strip[:, 0] != strip[:, 1]) & (strip[:, 1] != strip[:, 2]) & (strip[:, 0] != strip[:, 2])
        return strip[distinct_corners]

    def _morphed(
        self, arrays: _Arrays, primitive: Primitive, weights: tuple[float, ...], label: str
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"] | None]:
        points, normals = arrays.points.astype(np.float64), arrays.normals
        for weight, target in zip(weights, primitive.targets, strict=False):
            for key in ("POSITION", "NORMAL") if weight else ():
                if key not in target:
                    continue
                change = weight * self._accessors.floats(target[key], "VEC3", len(points), f"{label}: target {key}")
                if key == "POSITION":
                    points = points + change
                elif normals is not None:
                    normals = normals + change
        return points, normals

    def _blended(
        self, primitive: Primitive, joints: Float[np.ndarray, "j 4 4"], arrays: _Arrays, label: str
    ) -> tuple[Float[np.ndarray, "n 4 4"], int]:
        """Return what the joints do to each vertex, and how many have no weight and follow their first joint."""
        count, packed = len(arrays.points), arrays.packed
        total, share, first = np.zeros((count, 4, 4)), np.zeros(count), np.zeros(count, np.int64)
        for index in range(8):
            if f"JOINTS_{index}" not in primitive.attributes or f"WEIGHTS_{index}" not in primitive.attributes:
                break
            if {f"JOINTS_{index}", f"WEIGHTS_{index}"} <= packed.keys():
                which, weights = packed[f"JOINTS_{index}"], packed[f"WEIGHTS_{index}"]
            else:
                which = self._accessors.integers(primitive.attributes[f"JOINTS_{index}"], "VEC4", f"{label}: joints")
                stated_weights = primitive.attributes[f"WEIGHTS_{index}"]
                weights = self._accessors.floats(stated_weights, "VEC4", count, f"{label}: weights")
            if which.shape != weights.shape:
                raise ObjectError(f"{label}: {which.shape} joints have {weights.shape} weights; both need one shape")
            if (highest := int(which[weights != 0].max(initial=0))) >= len(joints):
                raise ObjectError(f"{label}: a vertex names joint {highest} of {len(joints)}")
            which = np.where(which < len(joints), which, 0)  # exporters fill places of weight 0 with any number
            first = which[:, 0].astype(np.int64) if index == 0 else first
            for corner in range(which.shape[1]):
                total += weights[:, corner, None, None] * joints[which[:, corner].astype(np.int64)]
                share += weights[:, corner]
        if not np.isfinite(total).all() or (share < 0).any():
            raise ObjectError(f"{label}: a vertex of a skin has weights that are negative or not finite numbers")
        free = share == 0
        total[free], share[free] = joints[first[free]], 1
        return total / share[:, None, None], int(free.sum())


def _flat(
    points: Float32[np.ndarray, "n 3"], arrays: _Arrays
) -> tuple[TriangleMesh, Float32[np.ndarray, "m 4"] | None]:
    """Give each triangle its own corners and normal. Raises ObjectError."""
    corners = arrays.faces.reshape(-1)
    normals = face_normals(points, arrays.faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    normals = np.repeat(normals.astype(np.float32), 3, axis=0)
    uvs = np.zeros((len(corners), 2), np.float32) if arrays.uvs is None else arrays.uvs[corners]
    return joined_corners(points[corners], uvs, normals, None if arrays.colours is None else arrays.colours[corners])


def _skinned_normals(
    blended: Float[np.ndarray, "n 4 4"], normals: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Turn normals by the cofactors, which exist where a joint flattens too."""
    m = blended[:, :3, :3]
    cofactors = np.stack([np.cross(m[:, 1], m[:, 2]), np.cross(m[:, 2], m[:, 0]), np.cross(m[:, 0], m[:, 1])], axis=1)
    return np.einsum("nij,nj->ni", cofactors, normals)
