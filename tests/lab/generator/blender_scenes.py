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


def box_room_of_many_settings(path: Path) -> Path:
    """Save `box_room` with walls that emit (40, 20, 10) and settings that would hide or change light.

    It also has a cube of the walls' material that only renders show; one that only the viewport shows, and an instance
    of it by geometry nodes; and a room that no ray sees. The material is the objects', not their mesh's.
    """
    box_room(path, albedo=0.5, walls_emit=40.0)
    bpy = blender()
    scene, room = bpy.context.scene, bpy.data.objects["Cube"]
    walls = room.data.materials[0].node_tree
    add, light = walls.nodes["Add Shader"], walls.nodes["Emission"]
    light.inputs["Color"].default_value = (1, 0.5, 0.25, 1)
    lamp = bpy.data.node_groups.new("lamp", "ShaderNodeTree")
    lamp.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    inner = lamp.nodes.new("ShaderNodeEmission")
    for socket in ("Color", "Strength"):
        inner.inputs[socket].default_value = light.inputs[socket].default_value
    lamp.links.new(inner.outputs[0], lamp.nodes.new("NodeGroupOutput").inputs[0])
    group = walls.nodes.new("ShaderNodeGroup")
    group.node_tree = lamp
    walls.links.new(group.outputs[0], add.inputs[1])
    walls.nodes.remove(light)
    for place, (render, viewport) in (((1.5, 1, 2), (True, False)), ((-1.5, -1, 2), (False, True))):
        collection = bpy.data.collections.new("half shown")
        scene.collection.children.link(collection)
        cube = bpy.data.objects.new("cube", room.data)
        cube.location, cube.scale = place, (0.1, 0.1, 0.1)
        collection.objects.link(cube)
        collection.hide_render, collection.hide_viewport = not render, not viewport
        cube.hide_render = not render
    group = bpy.data.node_groups.new("copy", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    source = group.nodes.new("GeometryNodeObjectInfo")
    source.transform_space = "RELATIVE"
    source.inputs["Object"].default_value, source.inputs["As Instance"].default_value = cube, True
    group.links.new(source.outputs["Geometry"], group.nodes.new("NodeGroupOutput").inputs[0])
    copy = bpy.data.objects.new("copy", bpy.data.meshes.new("empty"))
    copy.modifiers.new("copy", "NODES").node_group = group
    unseen = bpy.data.objects.new("unseen", room.data)
    for kind in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(unseen, f"visible_{kind}", False)
    for thing in (copy, unseen):
        scene.collection.objects.link(thing)
    emitting = room.data.materials[0]
    for (slot,) in (thing.material_slots for thing in scene.objects if thing.data == room.data):
        slot.link, slot.material = "OBJECT", emitting
    room.data.materials[0] = bpy.data.materials.new("grey")
    outside = bpy.data.objects.new("outside", bpy.data.cameras.new("outside"))
    outside.location = (0, 0, -50)
    scene.collection.objects.link(outside)
    scene.timeline_markers.new("cut", frame=1).camera = outside
    room.visible_transmission = False
    scene.view_layers.new("beauty").material_override = bpy.data.materials.new("clay")
    scene.view_layers[0].use = False
    scene.cycles.transmission_bounces = scene.cycles.glossy_bounces = 0
    scene.world = bpy.data.worlds.new("outside")  # without one there is no fast light
    scene.cycles.use_fast_gi, scene.cycles.ao_bounces_render = True, 1
    scene.render.use_stamp = scene.render.use_multiview = scene.render.use_simplify = True
    settings = scene.render.image_settings
    settings.file_format, settings.color_management = "OPEN_EXR", "OVERRIDE"
    settings.linear_colorspace_settings.name = "ACES2065-1"
    with quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path
