"""Light a Blender scene with a replay, frame by frame, without Blender's window.

    roomlight replay my-capture --out light
    blender --background SCENE.blend --python examples/blender_replay.py -- light/probe-00 [--out BLEND]

The world of the scene becomes the replay's panoramas: a keyframe for each, held until the next, as bright as the
recording shows the room. The scene gets the replay's frames and rate. Blender's world has z up; scenes with y up are
usually imported as (x, y, z) to (x, -z, y), and then the panoramas need no rotation. Blender's own Python runs this
script, so it does not import roomlight. Output: the scene, lit (out/blender_replay.blend).
"""

import argparse
import json
import re
import sys
from pathlib import Path

import bpy  # pyright: ignore[reportMissingImports]  (exists in Blender alone)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("panoramas", type=Path, nargs="?", default=Path("light/probe-00"))
    parser.add_argument("--out", type=Path, default=Path("out/blender_replay.blend"))
    args = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])

    files = {int(path.name.split(".")[1]): path for path in sorted(args.panoramas.glob("light.*.exr"))}
    if not files:
        sys.exit(f"{args.panoramas}: holds no light.000000.exr; make it with roomlight replay CAPTURE --out light")
    first, last = min(files), max(files)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = first, last
    stage = args.panoramas / "light.usda"
    found = re.search(r"framesPerSecond = (\S+)", stage.read_text()) if stage.is_file() else None
    rate = float(found[1]) if found else scene.render.fps / scene.render.fps_base
    scene.render.fps = max(1, round(rate))
    scene.render.fps_base = scene.render.fps / rate
    scene.world = scene.world or bpy.data.worlds.new("room")
    scene.world.use_nodes = True
    tree = scene.world.node_tree
    tree.nodes.clear()
    environment, background, output = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Background", "OutputWorld")
    )
    tree.links.new(environment.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])

    environment.image = bpy.data.images.load(str(files[first].resolve()))
    environment.image.source = "SEQUENCE"
    user = environment.image_user
    user.use_auto_refresh = True
    user.frame_start, user.frame_duration = first, 1  # one image, whose number is 1 + the offset
    report, strength = args.panoramas.parent / "report.json", background.inputs["Strength"]
    frames = json.loads(report.read_text())["frames"] if report.is_file() else []
    gains = {frame["index"]: frame["gain"][1] for frame in frames if "gain" in frame}  # of green
    for number in files:
        if number in gains:
            strength.default_value = 1 / gains[number]
            strength.keyframe_insert("default_value", frame=number)
        user.frame_offset = number - 1
        user.keyframe_insert("frame_offset", frame=number)
    action = tree.animation_data.action
    before_5 = hasattr(action, "fcurves")  # Blender 5 keeps curves by layers
    for curve in action.fcurves if before_5 else action.layers[0].strips[0].channelbags[0].fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT"
    args.out.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(args.out.resolve()))
    print(f"{args.out}: {len(files)} panoramas, frames {first} to {last} at {rate:.6g} a second")


main()
