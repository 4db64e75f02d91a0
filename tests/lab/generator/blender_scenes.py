"""Small scenes that the tests make with `bpy`: a room with lamps, in metres, z up."""

import importlib
from pathlib import Path
from typing import Any

from roomlight_generator.blender.scene import blender, quiet

SIZE_M = (5.0, 4.0, 3.0)


def material(name: str, *, albedo: float = 0.5, emission: float = 0.0) -> Any:
    """Make a diffuse or an emitting material."""
    made = blender().data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (albedo, albedo, albedo, 1)
    shader = diffuse
    if emission:
        light = tree.nodes.new("ShaderNodeEmission")
        light.inputs["Strength"].default_value = emission
        shader = tree.nodes.new("ShaderNodeAddShader")
        tree.links.new(diffuse.outputs[0], shader.inputs[0])
        tree.links.new(light.outputs[0], shader.inputs[1])
    tree.links.new(shader.outputs[0], out.inputs["Surface"])
    return made


def box_room(
    path: Path, *, albedo: float = 0.5, walls_emit: float = 0.0, lamps: tuple[Any, ...] = (), watts: Any = None
) -> Path:
    """Save a closed box with its floor at z = 0, a camera inside, and emitting cubes (x, y, z, side, radiance).

    `watts` is a light object: type, place and power.
    """
    bpy = blender()
    with quiet():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        importlib.import_module("addon_utils").enable("cycles")
        bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, SIZE_M[2] / 2), scale=SIZE_M)
        bpy.context.object.data.materials.append(material("walls", albedo=albedo, emission=walls_emit))
        for x, y, z, side, radiance in lamps:
            bpy.ops.mesh.primitive_cube_add(size=side, location=(x, y, z))
            bpy.context.object.data.materials.append(material("lamp", albedo=0, emission=radiance))
        if watts is not None:
            kind, place, power = watts
            bpy.ops.object.light_add(type=kind, location=place)  # an area shines down
            bpy.context.object.data.energy = power
            bpy.context.object.data.shadow_soft_size = 0.05
        bpy.ops.object.camera_add(location=(0, 0, 1.5))
        bpy.context.scene.camera = bpy.context.object
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path
