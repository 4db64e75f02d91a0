"""Rendered scenes in files: the same after reading, rendered once, damaged ones are refused."""

from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from roomlight.compositing.placement.scene import AtPixel, Scene, SceneObject
from roomlight.errors import OutputError
from roomlight_evaluation.composites import files as composite_files
from roomlight_evaluation.composites.files import kept_scene, read_scene, write_scene
from roomlight_evaluation.composites.regions import REGIONS
from roomlight_evaluation.composites.scenes import NAME, CompositeScene, virtual_object
from rooms import BoxRoom, camera_at

SHAPE = (48, 64)


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    frames = tuple(
        BoxRoom().frame(camera_at((0.2, 1.4, 1.2), yaw, -30.0), index=number, width=SHAPE[1], height=SHAPE[0])
        for number, yaw in enumerate((0.0, 10.0, 20.0))
    )
    frames = tuple(type(one)(**{**vars(one), "timestamp_s": float(one.index)}) for one in frames)
    pictures = [rng.random((*SHAPE, 3)).astype(np.float32) for _ in range(3)]
    return CompositeScene(
        name="room",
        shape="vase",
        material="glossy",
        frame=frames[1],
        objects=Scene((SceneObject(NAME, virtual_object("vase", "glossy"), AtPixel(30.5, 40.0)),)),
        position=(0.1, 0.2, -0.3),
        truth=pictures[0],
        clean=(pictures[1], pictures[2]),
        covered=rng.random(SHAPE) > 0.5,
        masks={region: rng.random(SHAPE) > 0.5 for region in REGIONS},
        true_light=rng.random((8, 16, 3)).astype(np.float32),
        frames=frames,
        shift_m=0.004,
    )


def test_a_scene_is_the_same_after_reading(scene, tmp_path):
    write_scene(tmp_path / "scene.npz", scene)
    found = read_scene(tmp_path / "scene.npz")
    for name in ("name", "shape", "material", "position", "shift_m"):
        assert getattr(found, name) == getattr(scene, name)
    for name in ("truth", "covered", "true_light"):
        assert_array_equal(getattr(found, name), getattr(scene, name))
    assert set(found.masks) == set(REGIONS)
    for region in REGIONS:
        assert_array_equal(found.masks[region], scene.masks[region])
    assert found.frame is found.frames[1]
    for one, other in zip(found.frames, scene.frames, strict=True):
        assert (one.index, one.timestamp_s, one.intrinsics) == (other.index, other.timestamp_s, other.intrinsics)
        for name in ("image", "clipped", "depth_m", "camera_to_world"):
            assert_array_equal(getattr(one, name), getattr(other, name))
    (held,) = found.objects.objects
    assert held.place == AtPixel(30.5, 40.0)
    assert_array_equal(held.geometry.bounds(), scene.objects.objects[0].geometry.bounds())
    assert {field.name for field in fields(found)} == {field.name for field in fields(scene)}


def test_a_scene_is_rendered_once(scene, tmp_path, monkeypatch):
    rendered = []

    def render(number, *, seed):
        rendered.append((number, seed))
        return scene

    monkeypatch.setattr(composite_files, "scene_for", render)
    for _ in range(2):
        assert kept_scene(tmp_path / "kept", 7, seed=3).name == "room"
    assert rendered == [(7, 3)]
    assert kept_scene(None, 7, seed=3) is scene
    assert len(rendered) == 2


def test_a_damaged_file_is_named(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(composite_files, "scene_for", lambda *_, **__: scene)
    kept_scene(tmp_path, 1, seed=0)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(OutputError, match=f"{path.name}: is damaged .* remove it"):
        kept_scene(tmp_path, 1, seed=0)
