"""Complete rooms: reproducible, separate splits, never dark, light sources of the reported brightness."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plain_shapes import area_m2

from fixture_rooms import plain_catalogue
from roomlight.dataset.recording import Split
from roomlight_generator.rooms.build import build_room, room_generator
from roomlight_generator.rooms.furniture_model import FurnitureModel, LightSource
from roomlight_generator.rooms.lights import light_room, switch_on
from roomlight_generator.rooms.plan import Placement
from roomlight_generator.rooms.planner import ROOM_TYPES
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import block, lathe, with_material


@cache
def room(index, seed=0, split: Split = "train"):
    return build_room(index, seed=seed, split=split, catalogue=plain_catalogue())


def flux_klm(mesh):
    """Return pi x area x luminance summed over all faces."""
    luminance = np.array([material.emission for material in mesh.materials]) @ [0.2126, 0.7152, 0.0722]
    return np.pi * (area_m2(mesh.vertices, mesh.faces) * luminance[mesh.face_materials]).sum()


def lamp(mesh, lights=()):
    low, high = mesh.bounds()
    width, height, depth = (float(x) for x in high - low)
    model = FurnitureModel("m", "lamp", "table_lamp", "train", width, height, depth, lambda: mesh, lights=lights)
    return Placement(model, 1.0, 0.5, -2.0, 30.0)


def test_the_same_arguments_give_the_same_room():
    first, again = room(0), build_room(0, seed=0, split="train", catalogue=plain_catalogue())
    assert first.facts == again.facts
    for item, same in zip(first.scene.items, again.scene.items, strict=True):
        assert item.name == same.name
        np.testing.assert_array_equal(item.mesh.vertices, same.mesh.vertices)
        assert [m.emission for m in item.mesh.materials] == [m.emission for m in same.mesh.materials]
    np.testing.assert_array_equal(first.scene.sky.panorama, again.scene.sky.panorama)


@pytest.mark.parametrize(
    "change", [{"index": 1}, {"seed": 1}, {"split": "test"}, {"purpose": 1}], ids=lambda change: next(iter(change))
)
def test_rooms_have_independent_random_streams(change):
    given = {"index": 0, "seed": 0, "split": "train", "purpose": 0}
    numbers = room_generator(**given).random(4)
    assert not np.array_equal(numbers, room_generator(**(given | change)).random(4))


@pytest.mark.parametrize("count", [1, pytest.param(12, marks=pytest.mark.slow)])
def test_the_test_split_has_its_own_models_and_room_types(count):
    reserved = {name for name, kind in ROOM_TYPES.items() if kind.split == "test"}
    assert len(reserved) == 2
    train = [room(index) for index in range(count)]
    test = [room(index, split="test") for index in range(count)]
    assert not {built.facts["room_type"] for built in train} & reserved
    assert {built.facts["room_type"] for built in test} & reserved
    models = [{name for built in rooms for name in built.facts["models"]} for rooms in (train, test)]
    assert not models[0] & models[1]


@pytest.mark.parametrize("index", range(2))
def test_no_room_is_dark(index):
    built = room(index)
    shining = any(any(material.emission) for item in built.scene.items for material in item.mesh.materials)
    assert shining or built.scene.openings
    assert built.facts["light"]["sources"]
    assert built.facts["triangles"] == built.scene.triangle_count()
    assert np.isfinite(built.scene.sky.panorama).all()


@pytest.mark.parametrize(
    ("seeds", "expected"), [(8, {"night"}), pytest.param(60, {"sunny", "overcast", "night"}, marks=pytest.mark.slow)]
)
def test_scenarios_and_lamp_states_vary(seeds, expected):
    built = room(0)
    seen, lit = set(), set()
    for seed in range(seeds):
        items = [placement.item() for placement in built.placements]
        rng = np.random.default_rng(seed)
        lighting = light_room(built.shell, built.placements, items, rng)
        seen.add(lighting.facts["scenario"])
        lit.add(lighting.facts["lamps_on"] > 0)
        assert len(lighting.items) >= len(items) + len(built.shell.items)
    assert built.shell.openings
    assert seen >= expected
    assert lit == {True, False}


def test_a_closed_shade_emits_the_whole_flux():
    shade = with_material(block(0.3, 0.3, 0.3), Material(name="shade"))
    placement = lamp(shade, (LightSource(np.array([0.0, 0.15, 0.0]), 0.05),))
    lit = switch_on(placement.item(), placement, flux_klm=0.8, colour=(1.0, 1.0, 1.0))
    assert flux_klm(lit.mesh) == pytest.approx(0.8, rel=1e-3)
    assert len(lit.mesh.faces) == len(shade.faces)  # no bulb inside


def test_an_open_shade_shares_the_flux_with_its_bulb():
    tube = with_material(lathe([[(0.15, 0.0), (0.15, 0.3)]]), Material(name="shade cloth"))
    placement = lamp(tube, (LightSource(np.array([0.0, 0.15, 0.0]), 0.06),))
    lit = switch_on(placement.item(), placement, flux_klm=0.8, colour=(1.2, 0.95, 0.8))
    total = flux_klm(lit.mesh)
    bulb = [k for k, material in enumerate(lit.mesh.materials) if material.name == "bulb"]
    assert len(bulb) == 1
    part = replace(lit.mesh, faces=lit.mesh.faces[np.isin(lit.mesh.face_materials, bulb)],
                   face_materials=lit.mesh.face_materials[np.isin(lit.mesh.face_materials, bulb)])  # fmt: skip
    white = float(np.dot((1.2, 0.95, 0.8), [0.2126, 0.7152, 0.0722]))
    assert total == pytest.approx(0.8 * white, rel=0.06)  # a faceted sphere has slightly less area
    assert 0.1 < flux_klm(part) / total < 0.9
    centre = part.vertices[np.unique(part.faces)].mean(0)
    np.testing.assert_allclose(centre, placement.light_positions()[0], atol=0.01)


def test_a_lamp_without_bulb_or_shade_gets_a_bulb_below():
    plain = with_material(block(0.2, 0.1, 0.2), Material(name="metal"))
    placement = lamp(plain)
    lit = switch_on(placement.item(), placement, flux_klm=0.5, colour=(1.0, 1.0, 1.0))
    assert flux_klm(lit.mesh) == pytest.approx(0.5, rel=0.06)
    assert isinstance(lit.mesh, Mesh)
    assert lit.mesh.bounds()[0, 1] < placement.item().mesh.bounds()[0, 1]
