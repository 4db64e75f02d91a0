"""Render a sphere on a plane under our light with Blender, without its window.

    python examples/light_one_photo.py                    # writes out/light_one_photo/light.exr
    blender --background --python examples/blender_render.py -- [LIGHT.exr] [--size PIXELS] [--samples N] [--out PNG]

Blender's world has z up. With the usual import of scenes that have y up, (x, y, z) to (x, -z, y), the panorama needs no
rotation. Blender's own Python runs this script, so it does not import roomlight. Output: PNG (out/blender_render.png).
"""

import argparse
import sys
from pathlib import Path

import bpy  # pyright: ignore[reportMissingImports]  (exists in Blender alone)


def imported(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Convert a position from RoomLight's world (y up) to Blender's (z up)."""
    return x, -z, y


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("light", type=Path, nargs="?", default=Path("out/light_one_photo/light.exr"))
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--out", type=Path, default=Path("out/blender_render.png"))
    args = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("room")
    scene.world.use_nodes = True
    nodes = scene.world.node_tree.nodes
    environment = nodes.new("ShaderNodeTexEnvironment")
    environment.image = bpy.data.images.load(str(args.light.resolve()))
    scene.world.node_tree.links.new(environment.outputs["Color"], nodes["Background"].inputs["Color"])

    bpy.ops.mesh.primitive_plane_add(size=1.4, location=imported(0, -0.25, 0))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.25, segments=64, ring_count=32, location=(0, 0, 0))
    bpy.ops.object.shade_smooth()
    metal = bpy.data.materials.new("metal")
    metal.use_nodes = True
    metal.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = 1.0
    metal.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.1
    bpy.context.object.data.materials.append(metal)
    bpy.ops.object.camera_add(location=imported(0, 0, 1.6), rotation=(1.5707963, 0, 0))  # looks along our -z
    scene.camera = bpy.context.object

    scene.render.engine = "CYCLES"
    scene.cycles.samples = args.samples
    scene.render.resolution_x = scene.render.resolution_y = args.size
    scene.view_settings.view_transform = "Standard"  # sRGB alone: radiance 1.0 is white
    scene.render.filepath = str(args.out.resolve())
    bpy.ops.render.render(write_still=True)


main()
