"""Blender scenes: depth, direction and light against closed form, and whole recordings. Skipped without `bpy`."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from blender_scenes import SIZE_M, box_room, box_room_of_many_settings, material

from roomlight.camera import Intrinsics
from roomlight.conventions import panorama_rays, panorama_solid_angles
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import LIGHT, ORDINARY
from roomlight.errors import DatasetError
from roomlight.images import write_png
from roomlight_generator.blender.cycles import CyclesViews
from roomlight_generator.blender.floor import find_floor
from roomlight_generator.blender.render import render_room
from roomlight_generator.blender.scene import blender, open_scene
from roomlight_generator.room_request import RoomRequest

with_blender = pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="bpy is not installed")

CAMERA = Intrinsics(fx=60.0, fy=60.0, cx=45.0, cy=28.0, width=80, height=60)


def _views(path: Path) -> CyclesViews:
    room = open_scene(path)
    floor_y, _ = find_floor(room)
    return CyclesViews(room, floor_y, samples=16)


def _command(*arguments) -> subprocess.CompletedProcess[str]:
    """Run `dataset render` in a process that has not imported `bpy`, as its users do."""
    command = [Path(sys.prefix) / "bin/python", "-c", "from roomlight_cli.main import main; main()"]
    return subprocess.run([*command, "dataset", "render", *arguments], capture_output=True, text=True, check=False)


def _pose(forward, position) -> np.ndarray:
    forward = np.asarray(forward, float) / np.linalg.norm(forward)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(right, forward), -forward], axis=1)
    pose[:3, 3] = position
    return pose


def test_without_blender_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(DatasetError, match=r"roomlight\[blender\]"):
        open_scene(tmp_path / "room.blend")


@with_blender
def test_a_lamp_is_where_its_direction_and_depth_say(tmp_path):
    """A lamp at Blender's (1.5, 1.0, 2.0) is at (1.5, 2.0, -1.0): in frames, depth, kinds and panoramas."""
    views = _views(box_room(tmp_path / "room.blend", albedo=0.0, lamps=((1.5, 1.0, 2.0, 0.2, 50.0),)))
    lamp, eye = np.array([1.5, 2.0, -1.0]), np.array([-1.0, 1.2, 0.5])
    pose = _pose(lamp - eye + [0.3, -0.2, 0.1], eye)
    view = views.frame(CAMERA, pose, seed=1)
    (xy,), (z,) = CAMERA.project(((lamp - eye) @ pose[:3, :3])[None])
    bright = view.radiance.mean(-1)
    v, u = (np.indices(bright.shape) + 0.5) * bright / bright.sum()
    np.testing.assert_allclose([u.sum(), v.sum()], xy, atol=0.5)
    column, row = xy.astype(int)
    assert view.surface[row, column] == LIGHT
    assert abs(view.depth_m[row, column] - z) < 0.15  # its front, half a side nearer at most
    panorama = views.panorama(eye, 64, seed=1).mean(-1) * panorama_solid_angles(64)
    direction = panorama.reshape(-1) @ panorama_rays(64)
    towards = (lamp - eye) / np.linalg.norm(lamp - eye)
    assert direction / np.linalg.norm(direction) @ towards > np.cos(np.radians(1.5))


@with_blender
def test_depth_of_the_walls_is_exact(tmp_path):
    views = _views(box_room(tmp_path / "room.blend"))
    depth = views.depth(CAMERA, _pose([1, 0, 0], [0.5, 1.5, 0.2]))
    np.testing.assert_allclose(depth[20:40, 30:60], SIZE_M[0] / 2 - 0.5, atol=1e-4)


@with_blender
def test_the_floor_is_not_the_ground_outside_the_wall_beside_the_camera(tmp_path):
    path = box_room(tmp_path / "room.blend")
    bpy = blender()
    bpy.context.scene.camera.location.y = 0.4 - SIZE_M[1] / 2
    bpy.ops.mesh.primitive_plane_add(size=60, location=(0, 0, -0.15))
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert find_floor(open_scene(path))[0] == pytest.approx(0, abs=1e-5)


@with_blender
@pytest.mark.parametrize(("shader", "socket"), [("VolumeScatter", "Volume"), ("BsdfTransparent", "Surface")])
def test_fog_and_transparent_faces_are_no_surfaces(tmp_path, shader, socket):
    """A cube of the material, and one of whose faces the first has it."""
    path = box_room(tmp_path / "room.blend")
    bpy = blender()
    clear = material("clear")
    tree = clear.node_tree
    out = tree.nodes["Material Output"]
    tree.links.remove(out.inputs["Surface"].links[0])
    tree.links.new(tree.nodes.new(f"ShaderNode{shader}").outputs[0], out.inputs[socket])
    for materials in ([clear], [clear, bpy.data.materials["walls"]]):
        bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 1.4))
        mesh = bpy.context.object.data
        for made in materials:
            mesh.materials.append(made)
        for face in mesh.polygons[1:]:
            face.material_index = 1
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert len(open_scene(path).kinds) == 12 + 10


@with_blender
def test_particles_are_those_of_renders(tmp_path):
    """Cubes on a plane that no render shows; the viewport shows it, and a tenth of them."""
    path = box_room(tmp_path / "room.blend")
    bpy = blender()
    bpy.ops.mesh.primitive_plane_add(size=2, location=(0, 0, 1))
    emitter = bpy.context.object
    emitter.modifiers.new("cubes", "PARTICLE_SYSTEM")
    cubes = emitter.particle_systems[0].settings
    cubes.type, cubes.use_advanced_hair, cubes.count, cubes.display_percentage = "HAIR", True, 20, 10
    cubes.render_type, cubes.instance_object = "OBJECT", bpy.data.objects["Cube"]
    emitter.show_instancer_for_render = False
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert len(open_scene(path).kinds) == 12 * (1 + 20)


@with_blender
@pytest.mark.parametrize(
    ("scale", "areas"),
    [((1, 1, 0.4), ("0.0", "0.0", "0.0")), ((1, 1, 4), ("20.9", "0.0", "0.0")), ((0.06, 1, 1), ("1.2", "1.2", "0.0"))],
    ids=["low", "high", "narrow"],
)
def test_where_no_floor_is_free_the_error_says_what_lacks(tmp_path, scale, areas):
    path = box_room(tmp_path / "room.blend")
    cube = blender().data.objects["Cube"]
    cube.scale = scale
    cube.location.z *= scale[2]
    blender().ops.wm.save_as_mainfile(filepath=str(path))
    says = "{} m2 is seen from 1.6 m above, {} m2 of that has a ceiling within 8 m, and {} m2 of that room for a body"
    with pytest.raises(DatasetError, match=re.escape(says.format(*areas))):
        find_floor(open_scene(path))


@with_blender
def test_light_between_walls_is_that_of_the_furnace(tmp_path):
    """Walls that emit E and reflect rho shine with E / (1 - rho) everywhere: every bounce counts."""
    views = _views(box_room(tmp_path / "room.blend", albedo=0.5, walls_emit=40.0))
    panorama = views.panorama(np.array([0.3, 1.1, 0.4]), 16, seed=3)
    mean = float((panorama[..., 1] * panorama_solid_angles(16)).sum() / (4 * np.pi))
    assert mean == pytest.approx(80.0, rel=0.01)
    assert panorama.min() > 60


@with_blender
def test_light_is_physical_whatever_the_settings_of_the_file(tmp_path):
    """The furnace of E / (1 - rho) in three colours, with one of two cubes and an instance of the other in it."""
    room = open_scene(box_room_of_many_settings(tmp_path / "room.blend"))
    assert room.kinds.tolist() == [LIGHT] * 36
    np.testing.assert_allclose(room.vertices.mean(axis=0), [0, 5.5 / 3, 0], atol=1e-5)  # between room and both cubes
    panorama = CyclesViews(room, 0.0, samples=16).panorama(np.array([0.3, 1.1, 0.4]), 16, seed=3)
    np.testing.assert_allclose(panorama.mean(axis=(0, 1)), [80, 40, 20], rtol=0.01)
    assert (panorama.min(axis=(0, 1)) > [60, 30, 15]).all()


@with_blender
def test_light_through_glass_that_casts_no_shadow_arrives_once(tmp_path):
    """Where a file has no caustics, a pane that shadow rays pass lets a lamp's light through, not a dark ceiling's."""
    path = box_room(tmp_path / "room.blend", albedo=0.05, lamps=((0, 0, 2.8, 0.2, 200.0),))
    bpy = blender()
    bpy.context.scene.cycles.caustics_refractive = bpy.context.scene.cycles.caustics_reflective = False
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    eye = np.array([0.0, 0.5, 0.0])
    without = _views(path).panorama(eye, 24, seed=1)[13:]  # what lies below the eye
    bpy.ops.wm.open_mainfile(filepath=str(path))
    bpy.ops.mesh.primitive_cube_add(location=(0, 0, 2.0), scale=(2.49, 1.99, 0.005))
    pane = material("pane")
    tree = pane.node_tree
    glass, clear, mix, path_of_light = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfGlass", "BsdfTransparent", "MixShader", "LightPath")
    )
    glass.inputs["IOR"].default_value = 1.0
    for socket, value in zip(mix.inputs, (path_of_light.outputs["Is Shadow Ray"], glass, clear), strict=True):
        tree.links.new(getattr(value, "outputs", [value])[0], socket)
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    bpy.context.object.data.materials.append(pane)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert _views(path).panorama(eye, 24, seed=1)[13:].mean() == pytest.approx(without.mean(), rel=0.1)


@with_blender
def test_a_room_without_light_or_with_a_missing_texture_is_refused(tmp_path):
    scene = box_room(tmp_path / "room.blend")
    bpy = blender()
    tree = bpy.data.materials["walls"].node_tree
    tree.nodes.new("ShaderNodeEmission")  # connected with nothing
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("wood", 4, 4)
    texture.image.source, texture.image.filepath = "FILE", "//wood.png"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    room = open_scene(scene)
    assert set(room.kinds) == {ORDINARY}
    with pytest.raises(DatasetError, match=r"no light arrives at \(0\.0, 1\.0, 0\.0\) m"):
        CyclesViews(room, 0.0, samples=1).set_median(np.array([0.0, 1, 0]), 1.0)
    tree = bpy.data.materials["walls"].node_tree
    tree.links.new(tree.nodes["Image Texture"].outputs[0], tree.nodes["Diffuse BSDF"].inputs["Color"])
    profile = tree.nodes.new("ShaderNodeTexIES")
    profile.mode, profile.filepath = "EXTERNAL", "//lamp.ies"
    tree.links.new(profile.outputs[0], tree.nodes["Diffuse BSDF"].inputs["Roughness"])
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    with pytest.raises(DatasetError, match=r"IES files or libraries .* missing .*\(2\): //lamp\.ies, //wood\.png"):
        open_scene(scene)


@with_blender
def test_textures_that_cannot_be_read_are_refused(tmp_path):
    """Pointers to large files that were not downloaded, and sequences that are missing; frame 10 is no fault."""
    path = box_room(tmp_path / "room.blend")
    bpy = blender()
    (tmp_path / "pointer.png").write_text("version https://git-lfs.github.com/spec/v1")
    write_png(tmp_path / "good0010.png", np.zeros((2, 2, 3), np.uint8))
    tree = bpy.data.materials["walls"].node_tree
    socket = tree.nodes["Diffuse BSDF"].inputs["Color"]
    for name, source in (("pointer.png", "FILE"), ("bad0010.png", "SEQUENCE"), ("good0010.png", "SEQUENCE")):
        texture, mix = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeMixRGB")
        texture.image = bpy.data.images.new(name, 2, 2)
        texture.image.source, texture.image.filepath = source, f"//{name}"
        tree.links.new(texture.outputs[0], mix.inputs[1])
        tree.links.new(mix.outputs[0], socket)
        socket = mix.inputs[2]
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    with pytest.raises(DatasetError, match=r"cannot be read \(2\): //bad0010\.png, //pointer\.png;"):
        open_scene(path)


@with_blender
@pytest.mark.parametrize("place", [(0.0, 0.0, 2.5), (1.5, 0.0, 2.0)], ids=["above", "aside"])
def test_irradiance_of_a_small_lamp_is_radiance_times_solid_angle(tmp_path, place):
    """A lamp that is small against its distance lights as the solid angle of its faces, and from where it is."""
    side, radiance, eye = 0.1, 500.0, np.array([0.0, 0.5, 0.0])
    views = _views(box_room(tmp_path / "room.blend", albedo=0.0, lamps=((*place, side, radiance),)))
    panorama = views.panorama(eye, 120, seed=2)[..., 1]
    flux = float((panorama * panorama_solid_angles(120)).sum())
    away = np.array([place[0], place[2], -place[1]]) - eye
    squares = np.abs(away) - side / 2  # distance of the near face along each axis
    expected = sum(
        radiance * side**2 * squares[axis] / np.linalg.norm(np.where(np.arange(3) == axis, squares, away)) ** 3
        for axis in range(3)
        if squares[axis] > 0
    )
    assert flux == pytest.approx(expected, rel=0.03)


@with_blender
@pytest.mark.parametrize(("kind", "per_watt"), [("POINT", 1 / (4 * np.pi)), ("AREA", 1 / np.pi)])
def test_light_objects_are_seen_with_their_power(tmp_path, kind, per_watt):
    """A lamp that is no mesh, which Cycles hides from cameras, is in panoramas and frames; an area faces the eye."""
    views = _views(box_room(tmp_path / "room.blend", albedo=0.0, watts=(kind, (0.5, 1.0, 2.7), 40.0)))
    lamp, eye = np.array([0.5, 2.7, -1.0]), np.array([0.0, 0.3, -0.6])
    panorama = views.panorama(eye, 120, seed=2)[..., 1]
    flux = float((panorama * panorama_solid_angles(120)).sum())
    away = np.linalg.norm(lamp - eye)
    along = (lamp - eye)[1] / away if kind == "AREA" else 1.0
    assert flux == pytest.approx(40.0 * per_watt * along / away**2, rel=0.06)
    frame = views.frame(CAMERA, _pose(lamp - eye, eye), seed=1).radiance.mean(-1)
    assert frame.max() > 1.0
    assert (frame > 0.5 * frame.max()).mean() < 0.3


@with_blender
@pytest.mark.parametrize("linked", [False, True], ids=["instanced", "linked"])
def test_lamps_without_size_of_collections_are_seen(tmp_path, linked):
    """A point of an instanced collection, of the file itself or of a linked library."""
    path = box_room(tmp_path / "library.blend", albedo=0.0, watts=("POINT", (0.5, 1.0, 2.7), 40.0))
    bpy = blender()
    lamp, scene = bpy.context.scene.objects["Point"], bpy.context.scene
    lamp.data.shadow_soft_size = 0.0
    asset = bpy.data.collections.new("asset")
    asset.objects.link(lamp)
    scene.collection.objects.unlink(lamp)
    if linked:
        asset.use_fake_user = True
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        box_room(tmp_path / "room.blend", albedo=0.0)
        with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
            wanted.collections = ["asset"]
        (asset,), scene = wanted.collections, bpy.context.scene
    instance = bpy.data.objects.new("instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", asset
    scene.collection.objects.link(instance)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    panorama = _views(tmp_path / "room.blend").panorama(np.array([0.0, 0.3, -0.6]), 120, seed=2)[..., 1]
    flux = float((panorama * panorama_solid_angles(120)).sum())
    assert flux == pytest.approx(40.0 / (4 * np.pi) / (0.5**2 + 2.4**2 + 0.4**2), rel=0.15)


@with_blender
def test_a_point_six_metres_away_is_seen_with_its_power(tmp_path):
    """At the command's default of 64 samples."""
    path = box_room(tmp_path / "room.blend", albedo=0.0, watts=("POINT", (2.4, 1.9, 2.9), 40.0))
    blender().data.lights["Point"].shadow_soft_size = 0.0
    blender().ops.wm.save_as_mainfile(filepath=str(path))
    panorama = CyclesViews(open_scene(path), 0.0, samples=64).panorama(np.array([-2.2, 0.2, 1.7]), 120, seed=0)
    flux = float((panorama[..., 1] * panorama_solid_angles(120)).sum())
    assert flux == pytest.approx(40.0 / (4 * np.pi) / (4.6**2 + 2.7**2 + 3.6**2), rel=0.15)


@with_blender
def test_a_lamp_that_casts_no_shadow_does_not_shine_through_walls(tmp_path):
    path = box_room(tmp_path / "room.blend", watts=("POINT", (0, 0, 4), 100.0))
    bpy = blender()
    bpy.data.lights["Point"].use_shadow = False
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert _views(path).panorama(np.array([0.0, 1.5, 0.0]), 16, seed=1).max() < 1e-3


@with_blender
def test_reflected_light_is_smooth_after_few_samples_and_a_lamp_sharp(tmp_path):
    """A small lamp between grey walls, of whose light few paths find the way."""
    scene = box_room(tmp_path / "room.blend", albedo=0.5, lamps=((1.5, 1.0, 2.5, 0.2, 100.0),))
    eye = np.array([0.0, 1.0, 0.0])
    room = open_scene(scene)
    few, many = (
        CyclesViews(room, find_floor(room)[0], samples=samples).panorama(eye, 32, seed=samples)[..., 1]
        for samples in (4, 64)
    )
    lamp, weight = many > 20, panorama_solid_angles(32)
    assert 0 < lamp.sum() < 10
    assert (few * weight)[~lamp].sum() == pytest.approx((many * weight)[~lamp].sum(), rel=0.03)
    assert (few * weight)[lamp].sum() == pytest.approx((many * weight)[lamp].sum(), rel=0.2)  # 16 paths in 4 pixels
    assert np.median(np.abs(np.log(few[~lamp] / many[~lamp]))) < 0.07


@with_blender
def test_very_bright_reflected_light_is_not_denoised(tmp_path):
    """The wall beside a lamp is brighter than 30 medians: its noise stays, once the median is known."""
    room = open_scene(box_room(tmp_path / "room.blend", lamps=((2.4, 0.0, 1.5, 0.1, 3000.0),)))
    views, eye = CyclesViews(room, find_floor(room)[0], samples=1), np.array([-1.0, 1.0, 0.5])
    smooth = views.panorama(eye, seed=1)
    views.set_median(eye, 0.1)
    noisy = views.panorama(eye, seed=1) / views.kcd_m2
    wall = (smooth.max(-1) > 40 * np.median(smooth)) & (smooth.max(-1) < 1000)
    assert 0 < wall.sum() < 200
    changed = np.abs(np.log(noisy / smooth)).max(-1)
    assert np.median(changed[wall]) > 2 * np.median(changed[~wall])


@with_blender
def test_a_scene_becomes_a_dataset_that_is_not_made_twice(tmp_path):
    scene = box_room(tmp_path / "room.blend", lamps=((1.0, 1.0, 2.8, 0.3, 60.0), (-1.5, -1.0, 1.0, 0.2, 20.0)))
    first, second = (_command(scene, "--out", tmp_path / "rooms", "--frames", "2", "--samples", "1") for _ in range(2))
    assert "1 made" in first.stdout
    assert "already has 1 train sequence\n" in second.stdout
    recording = Dataset(tmp_path / "rooms").read(0)
    assert recording.facts["scene"] == "room.blend"
    assert recording.probe_panoramas.shape == (3, 120, 240, 3)
    assert (recording.depth_mm > 0).all()
    assert 0.1 < np.percentile(recording.colour[0].max(-1), 80) / 255 < 1


@with_blender
def test_all_scenes_are_checked_before_one_is_rendered(tmp_path):
    (tmp_path / "broken.blend").write_bytes(b"not a scene")
    good = box_room(tmp_path / "room.blend")
    blender().data.objects["Cube"].scale.z = 0.1
    blender().ops.wm.save_as_mainfile(filepath=str(tmp_path / "low.blend"))
    scenes = good, tmp_path / "broken.blend", tmp_path / "low.blend"
    run = _command(*scenes, "--out", tmp_path / "rooms")
    says = r"[^\n]*broken\.blend: Blender[^\n]*\n[^\n]*low\.blend: [^\n]*\n2 of 3 scenes are refused"
    assert run.returncode != 0
    assert re.search(says, run.stderr)
    assert not (tmp_path / "rooms" / "dataset.json").exists()


@with_blender
def test_the_same_numbers_give_the_same_recording(tmp_path):
    scene = box_room(tmp_path / "room.blend", lamps=((1.0, 1.0, 2.8, 0.3, 60.0),))
    request = RoomRequest(0, 5, "train", count=1, frames=1, scenes=(scene,), samples=1)
    first, second = (next(render_room(request)) for _ in range(2))
    np.testing.assert_array_equal(first.colour, second.colour)
    np.testing.assert_array_equal(first.probe_panoramas, second.probe_panoramas)


@with_blender
def test_files_that_are_no_scene_are_refused_by_name(tmp_path):
    (tmp_path / "broken.blend").write_bytes(b"not a scene")
    with pytest.raises(DatasetError, match=r"broken\.blend: Blender .* cannot open it"):
        open_scene(tmp_path / "broken.blend")


@with_blender
def test_a_file_of_a_newer_blender_or_with_drivers_that_need_python_is_refused(tmp_path):
    scene = box_room(tmp_path / "room.blend")
    data = scene.read_bytes()
    (tmp_path / "newer.blend").write_bytes(data[:9] + b"499" + data[12:])  # after BLENDER-v
    with pytest.raises(DatasetError, match=r"newer\.blend: Blender 4\.99 saved it, and this is Blender 4\.2"):
        open_scene(tmp_path / "newer.blend")
    bpy = blender()
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    bpy.data.objects["Cube"].driver_add("location", 0).driver.expression = "__import__('os').getpid()"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "driven.blend"))
    with pytest.raises(DatasetError, match=r"driven\.blend: .*Driver '__import__"):
        open_scene(tmp_path / "driven.blend")
    open_scene(scene)
