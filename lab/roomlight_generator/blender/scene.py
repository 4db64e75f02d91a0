"""A Blender file as RoomLight sees it: triangles in metres, y up, with the kind of surface of each.

Blender's world is z up; its point (x, y, z) is (x, z, -y) here. Lengths are multiplied by the scene's unit scale.
"""

import importlib
import importlib.util
import os
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

from roomlight.dataset.recording import GLASS, LIGHT, MIRROR, ORDINARY
from roomlight.errors import DatasetError
from roomlight.rays import RayTree

BLENDER_TO_WORLD: Final = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Blender's axes in RoomLight's world: x, up, toward the viewer."""
_BLOCK: Final = 1 << 16


@dataclass(frozen=True, eq=False)
class BlenderRoom:
    """An open scene.

    Attributes:
        scene: `bpy.types.Scene`.
        unit_m: Metres of Blender's unit.
        vertices: Corners in metres, y up, in the file's own origin.
        kinds: Kind of surface of each triangle (`roomlight.dataset.recording`).
        tree: The triangles, for rays.
        anchor: Where the scene's camera is, in metres; None if the scene has none.
        lamps: Names of the light objects.
    """

    scene: Any
    path: Path
    unit_m: float
    vertices: Float32[np.ndarray, "v 3"]
    kinds: UInt8[np.ndarray, " f"]
    tree: RayTree
    anchor: Float[np.ndarray, "3"] | None
    lamps: tuple[str, ...]


def require_blender() -> None:
    """Check that Blender is installed, without importing it: that changes the module path.

    Raises:
        DatasetError: it is not installed.
    """
    if importlib.util.find_spec("bpy") is None:
        raise DatasetError(
            "Blender scenes need Blender as a Python module, whose wheel is for Python 3.11: in an environment of that "
            "version, pip install 'roomlight[blender]'"
        )


def blender() -> Any:
    """Import `bpy` with the renderer Cycles.

    Raises:
        DatasetError: it is not installed.
    """
    require_blender()
    bpy = importlib.import_module("bpy")
    importlib.import_module("addon_utils").enable("cycles")
    return bpy


@contextmanager
def quiet() -> Generator[None]:
    """Drop what Blender prints to standard output: a line for each sample."""
    kept, nothing = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nothing)


def open_scene(path: Path) -> BlenderRoom:
    """Open a .blend file with all that a render of it would show.

    Raises:
        DatasetError: `bpy` is not installed, the file cannot be opened or is of a newer Blender, a file that it needs
            is missing, drivers of it need Python, or it shows no triangle.
    """
    bpy = blender()
    try:
        with quiet():
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise DatasetError(f"{path}: Blender {bpy.app.version_string} cannot open it ({reason})") from error
    if bpy.data.version[:2] > bpy.app.version[:2]:
        saved, this = ("{}.{}".format(*version) for version in (bpy.data.version, bpy.app.version))
        raise DatasetError(
            f"{path}: Blender {saved} saved it, and this is Blender {this}, which drops what it does not know; open "
            f"the scene in Blender {this}, check that it renders, and save it there"
        )
    scene = bpy.context.scene
    _show_what_is_rendered(bpy, scene)
    graph = bpy.context.evaluated_depsgraph_get()
    if bpy.app.autoexec_fail and bpy.app.autoexec_fail_message.startswith("Driver"):
        raise DatasetError(
            f"{path}: drivers that need Python are not run ({bpy.app.autoexec_fail_message}), and what they drive "
            "would be 0; in Blender, delete them or replace them by keyframes, and save the scene"
        )
    _check_files(bpy, graph, path)
    unit_m = float(scene.unit_settings.scale_length)
    parts = [part for instance in graph.object_instances if (part := _triangles(instance, unit_m)) is not None]
    if not parts:
        raise DatasetError(f"{path}: it shows no mesh; open the scene in Blender and check that it renders")
    first = np.cumsum([0] + [len(vertices) for vertices, _, _ in parts])
    vertices = np.concatenate([vertices for vertices, _, _ in parts])
    faces = np.concatenate([faces + start for (_, faces, _), start in zip(parts, first, strict=False)])
    kinds = np.concatenate([kinds for _, _, kinds in parts])
    if not np.isfinite(vertices).all():
        raise DatasetError(f"{path}: a vertex is not a finite number")
    camera = scene.camera
    anchor = None if camera is None else BLENDER_TO_WORLD @ np.array(camera.matrix_world.translation) * unit_m
    lamps = dict.fromkeys(
        instance.object.name for instance in graph.object_instances if instance.object.type == "LIGHT"
    )
    return BlenderRoom(scene, path, unit_m, vertices, kinds, RayTree(vertices, faces), anchor, tuple(lamps))


def distances(
    room: BlenderRoom, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return the metres along each ray to the first surface, inf without; in this thread."""
    parts = [
        room.tree.trace_here(
            np.ascontiguousarray(origins[start : start + _BLOCK], np.float32),
            np.ascontiguousarray(directions[start : start + _BLOCK], np.float32),
        ).distance_m
        for start in range(0, len(origins), _BLOCK)
    ]
    return np.concatenate(parts) if parts else np.zeros(0, np.float32)


def _show_what_is_rendered(bpy: Any, scene: Any) -> None:
    """Make the viewport's evaluation, which scripts read, that of a render of the first view layer that is in use."""
    layer = next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
    for other in [other for other in scene.view_layers if other != layer]:
        scene.view_layers.remove(other)
    for part in ("use", "use_solid", "use_sky", "use_strand", "use_volumes", "use_pass_combined"):
        setattr(layer, part, True)
    layer.material_override = None
    scene.render.use_simplify = False
    for thing in (*bpy.data.objects, *bpy.data.collections):
        thing.hide_viewport = thing.hide_render
    nested = [layer.layer_collection]
    for part in nested:
        part.hide_viewport = part.holdout = part.indirect_only = False
        nested.extend(part.children)
    for thing in layer.objects:
        thing.hide_set(False)
    for particles in bpy.data.particles:
        particles.display_percentage = 100
    for thing in bpy.data.objects:
        thing.show_instancer_for_viewport = thing.show_instancer_for_render
        for modifier in thing.modifiers:
            modifier.show_viewport = modifier.show_render
            if modifier.type in ("SUBSURF", "MULTIRES"):
                modifier.levels = modifier.render_levels
    layer.update()


def _check_files(bpy: Any, graph: Any, path: Path) -> None:
    """Refuse a scene that would show the colour of missing textures, or lacks what other files hold.

    Cycles takes 100 as the factor of an IES file that it cannot read.
    """
    unpacked = [library.filepath for library in bpy.data.libraries if library.packed_file is None]
    files = {name: bpy.path.abspath(name) for name in unpacked}
    images: dict[Any, str] = {}
    for owner in (part.original for part in graph.ids):
        if isinstance(owner, bpy.types.Material | bpy.types.World | bpy.types.Light):
            for node in _shader_nodes(owner):
                if node.type == "TEX_IES" and node.mode == "EXTERNAL":
                    file = bpy.path.abspath(node.filepath, library=node.id_data.library)
                    files[node.filepath or node.name] = file
                image = getattr(node, "image", None)
                if image is not None and image.source in ("FILE", "MOVIE", "SEQUENCE", "TILED"):
                    images[image] = image.filepath or image.name
                    if image.packed_file is None:
                        file = bpy.path.abspath(image.filepath, library=image.library)
                        files[images[image]] = image.filepath_from_user() if image.source == "TILED" else file
    missing = {name for name, file in files.items() if not Path(file).is_file()}
    for image, name in images.items():
        if image.source != "SEQUENCE" and not any(image.size):  # a sequence's is that of frame 0
            missing.add(name)
        image.buffers_free()
    if missing:
        raise DatasetError(
            f"{path}: textures, IES files or libraries of it are missing or cannot be read ({len(missing)}): "
            f"{', '.join(sorted(missing)[:4])}; "
            "find them in Blender (File > External Data > Find Missing Files), or take them out, and save the scene"
        )


def _output(owner: Any) -> Any:
    return owner.node_tree.get_output_node("CYCLES") if owner.use_nodes and owner.node_tree is not None else None


def _shader_nodes(owner: Any) -> list[Any]:
    """Return the nodes that the output of a material, world or lamp depends on, depth first."""
    output = _output(owner)
    seen: dict[Any, None] = {}

    def walk(inputs: Iterable[Any]) -> None:
        for node in (link.from_node for socket in inputs for link in socket.links if not link.is_muted):
            if node in seen:
                continue
            seen[node] = None
            if node.type == "GROUP" and node.node_tree is not None:
                ends = [end for end in node.node_tree.nodes if end.type == "GROUP_OUTPUT" and end.is_active_output]
                walk(socket for end in ends for socket in end.inputs)
            walk(node.inputs)

    if output is not None:
        walk(output.inputs)
    return list(seen)


def _triangles(
    instance: Any, unit_m: float
) -> tuple[Float32[np.ndarray, "v 3"], Int32[np.ndarray, "f 3"], UInt8[np.ndarray, " f"]] | None:
    """Return vertices, faces and kinds of an instance of an object; None if it has no surface."""
    thing = instance.object
    hidden = not instance.show_self or (thing.hide_render and not instance.is_instance)
    hidden = hidden or not (thing.visible_camera or thing.visible_diffuse)  # as in `cycles`
    if hidden or thing.type not in ("MESH", "CURVE", "SURFACE", "META", "FONT"):
        return None
    mesh = thing.to_mesh()
    if mesh is None:
        return None
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    points, faces = np.empty(3 * len(mesh.vertices), np.float32), np.empty(3 * count, np.int32)
    slots = np.zeros(count, np.int32)
    mesh.vertices.foreach_get("co", points)
    mesh.loop_triangles.foreach_get("vertices", faces)
    mesh.loop_triangles.foreach_get("material_index", slots)
    materials = [slot.material for slot in thing.material_slots] or [None]
    kind_of = np.array([_kind(material) for material in materials], np.uint8)
    slots = np.minimum(slots, len(materials) - 1)
    thing.to_mesh_clear()
    seen = np.array([_has_surface(material) for material in materials])[slots]
    if not seen.any():
        return None
    matrix = np.array(instance.matrix_world)
    placed = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    world = (placed @ BLENDER_TO_WORLD.T * unit_m).astype(np.float32)
    return world, faces.reshape(-1, 3)[seen], kind_of[slots[seen]]


def _has_surface(material: Any) -> bool:
    """Return whether a material is more than a volume or a transparent shader."""
    output = None if material is None else _output(material)
    if output is None:
        return True
    shaders = [link.from_node.type for link in output.inputs["Surface"].links if not link.is_muted]
    return shaders != ["BSDF_TRANSPARENT"] if shaders else not output.inputs["Volume"].is_linked


def _kind(material: Any) -> int:
    """Return the kind of surface of a material, by the first of its shaders that decides it."""
    for node in _shader_nodes(material) if material is not None else []:
        sockets = node.inputs
        principled = node.type == "BSDF_PRINCIPLED"
        if node.type == "EMISSION" or (principled and any(sockets["Emission Color"].default_value[:3])):
            strength = sockets["Emission Strength" if principled else "Strength"]
            if strength.is_linked or strength.default_value > 0:
                return LIGHT
        if node.type == "BSDF_GLASS" or (principled and sockets["Transmission Weight"].default_value > 0.5):
            return GLASS
        if principled and sockets["Metallic"].default_value > 0.9:
            roughness = sockets["Roughness"]
            if not roughness.is_linked and roughness.default_value < 0.1:
                return MIRROR
    return ORDINARY
