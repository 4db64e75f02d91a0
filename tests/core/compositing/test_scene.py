"""Scenes: what a `scene.json` may hold, and how motions are interpolated."""

import inspect
import json

import numpy as np
import pytest

from roomlight.compositing.objects.primitives import cube
from roomlight.compositing.placement.scene import AtPixel, AtPosition, Motion, Scene, load_scene, parse_scene, slerp
from roomlight.errors import ObjectError, SceneError

BALL = {"name": "ball", "shape": "sphere", "size_m": 0.2, "position": [0, 0, -1]}


def scene_of(*objects):
    return parse_scene({"objects": list(objects)}, load=lambda _: cube(1.0))


def test_a_scene_has_objects_of_their_size_and_place():
    scene = scene_of(
        BALL,
        {"name": "box", "file": "box.glb", "size_m": 0.4, "pixel": [10, 20], "frame": 3, "yaw_degrees": 15},
        {"name": "own", "file": "box.glb", "position": [1, 2, 3], "material": {"kind": "metal", "roughness": 0.3}},
    )
    assert [held.name for held in scene.objects] == ["ball", "box", "own"]
    low, high = scene.objects[0].geometry.bounds()
    assert high - low == pytest.approx([0.2] * 3)
    assert np.ptp(scene.objects[2].geometry.bounds(), axis=0) == pytest.approx([1.0] * 3)  # the file's own metres
    assert scene.objects[0].place == AtPosition((0.0, 0.0, -1.0))
    assert scene.objects[1].place == AtPixel(10.0, 20.0, 3, 15.0)
    assert scene.objects[2].geometry.parts[0][1].roughness == 0.3


def test_an_object_with_z_up_is_turned_upright():
    tall = cube(1.0).transformed(np.diag([1.0, 2.0, 6.0, 1.0]))
    document = {"objects": [{"name": "post", "file": "post.obj", "up": "z", "position": [0, 0, 0]}]}
    (held,) = parse_scene(document, load=lambda _: tall).objects
    assert np.ptp(held.geometry.bounds(), axis=0) == pytest.approx([1.0, 6.0, 2.0])
    ((mesh, _),) = held.geometry.parts
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), a) > 0).all()  # not a mirror image


def test_a_file_s_own_size_has_the_limit_of_a_stated_one():
    document = {"objects": [{"name": "hall", "file": "hall.glb", "position": [0, 0, 0]}]}
    with pytest.raises(ObjectError, match=r"\(hall\): its size of 120 m is beyond 100 m; state size_m"):
        parse_scene(document, load=lambda _: cube(120.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size_m": -1}, r"objects\[0\]\.size_m: .*greater than 0; got -1"),
        ({"size_m": float("nan")}, r"objects\[0\]\.size_m"),
        ({"name": ""}, r"objects\[0\]\.name"),
        ({"up": "x"}, r"objects\[0\]\.up"),
        ({"up": "z"}, "up belongs to a file"),
        ({"shape": "monkey"}, r"objects\[0\]\.shape: .*'sphere'.*got .*monkey"),
        ({"file": "a.glb"}, r"objects\[0\]: give either file or shape"),
        ({"position": [0, 1]}, r"objects\[0\]\.position\[2\]"),
        ({"position": [0, 1, 2e5]}, r"objects\[0\]\.position\[2\]: .*10000; got 200000"),
        ({"position": None}, r"objects\[0\]: give exactly one of position, pose and pixel"),
        ({"pixel": [1, 2]}, r"objects\[0\]: give exactly one"),
        ({"frame": 3}, r"objects\[0\]: frame belongs to pixel"),
        ({"colour": "red"}, r"objects\[0\]\.colour: Extra inputs"),
        ({"material": {"kind": "wood"}}, r"objects\[0\]\.material\.kind"),
        ({"material": {"kind": "mirror", "roughness": 0.5}}, r"objects\[0\]\.material: roughness has no effect"),
        ({"material": {"kind": "diffuse", "base_colour": [2, 0, 0]}}, r"objects\[0\]\.material\.base_colour\[0\]"),
        ({"motion": {"keys": []}}, r"objects\[0\]\.motion\.keys"),
        ({"motion": {"keys": [{"at": 1}, {"at": 1}]}}, r"objects\[0\]\.motion: keys\[1\]\.at must be later than 1"),
        ({"motion": {"keys": [{"at": 0, "rotation_xyzw": [0, 0, 0, 0]}]}}, r"motion\.keys\[0\]: rotation_xyzw is zero"),
        ({"motion": {"keys": [{"at": 0, "scale": 0}]}}, r"motion\.keys\[0\]\.scale"),
    ],
)
def test_a_bad_field_is_named(change, message):
    spec = {name: value for name, value in {**BALL, **change}.items() if value is not None}
    with pytest.raises(SceneError, match=message):
        scene_of(spec)


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b'{"objects": []}', b"[" * 5000])
def test_damaged_json_is_refused(text):
    with pytest.raises(SceneError):
        parse_scene(text, load=lambda _: cube(1.0))


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-8-sig"])
def test_a_scene_in_another_encoding_and_with_comments_is_read(tmp_path, encoding):
    text = json.dumps({"objects": [{**BALL, "name": "Krügel"}]}, ensure_ascii=False)
    (tmp_path / "scene.json").write_text(f"// one ball\r\n{text} /* no more */", encoding)
    (ball,) = load_scene(tmp_path / "scene.json").objects
    assert ball.name == "Krügel"


def test_scenes_with_wrong_names_counts_and_files_are_refused(tmp_path):
    with pytest.raises(SceneError, match=r"objects\[1\]\.name: 'ball' is used twice"):
        scene_of(BALL, BALL)
    with pytest.raises(SceneError, match=r"objects: .*64"):
        scene_of(*({**BALL, "name": str(number)} for number in range(65)))
    with pytest.raises(SceneError, match="1 to 64 objects, got 0"):
        Scene(())
    with pytest.raises(SceneError, match=r"objects\[0\] is of the type str; it must be SceneObject"):
        inspect.unwrap(Scene.__init__)(object.__new__(Scene), ("cube",))
    with pytest.raises(SceneError, match=r"scene\.json: cannot be read"):
        load_scene(tmp_path / "scene.json")
    document = {"objects": [{"name": "a", "file": "no.glb", "position": [0, 0, 0]}]}
    (tmp_path / "scene.json").write_text(json.dumps(document))
    with pytest.raises(ObjectError, match=r"no\.glb"):
        load_scene(tmp_path / "scene.json")


def motion_of(**options):
    keys = [
        {"at": 1},
        {"at": 3, "offset_m": [2, 0, 0], "rotation_xyzw": [0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)], "scale": 3},
    ]
    return Motion.model_validate({"keys": keys, **options})


def test_motion_is_interpolated_about_the_pivot():
    pivot = np.array([1.0, 0, 0])
    middle = motion_of().transform_at(2.0, pivot)
    half = np.sqrt(0.5)
    assert middle[:3, :3] == pytest.approx(2 * np.array([[half, 0, half], [0, 1, 0], [-half, 0, half]]))
    assert (middle @ np.append(pivot, 1))[:3] == pytest.approx([2, 0, 0])


def test_motion_in_time():
    def at(time, **options):
        return motion_of(**options).transform_at(time, np.zeros(3))[0, 3]

    for time, x in ((-5.0, 0), (1.0, 0), (3.0, 2), (99.0, 2)):  # held before and after its keys
        assert at(time) == pytest.approx(x)
    assert at(2.5 + 4, loop=True) == pytest.approx(at(2.5))
    assert at(2.0, easing="smooth") == pytest.approx(1.0)  # it stops at the keys
    assert at(1.01, easing="smooth") < 1e-3
    assert 2 - at(2.99, easing="smooth") < 1e-3


def test_slerp_takes_the_shorter_arc():
    first, second = np.array([0.0, 0, 0, 1]), -np.array([0.0, np.sin(0.1), 0, np.cos(0.1)])
    assert slerp(first, second, 0.5) == pytest.approx([0, np.sin(0.05), 0, np.cos(0.05)])
