"""Furniture in rooms lit by panoramas: where it stands, the light that it gets, and its shadows."""

import numpy as np
import pytest
from panorama_files import panorama

from fixture_rooms import plain_catalogue
from roomlight.camera import Intrinsics, transform_points
from roomlight.conventions import panorama_directions, panorama_solid_angles
from roomlight.dataset.recording import GLASS, ORDINARY
from roomlight_generator.panoramas import furniture as furniture_module
from roomlight_generator.panoramas.furnished import FurnishedLight
from roomlight_generator.panoramas.furniture import Footprint, Furniture, furnish_shell
from roomlight_generator.panoramas.kernels import gather
from roomlight_generator.panoramas.room import PanoramaRoom, bright_parts
from roomlight_generator.panoramas.shell import draw_shell, inside_plan
from roomlight_generator.rooms import shapes
from roomlight_generator.rooms.furniture import fallback_models
from roomlight_generator.rooms.scene import Item, Material

GREY = Material("grey", albedo=(0.5, 0.5, 0.5))
BLACK_COATED = Material("black", albedo=(0.0, 0.0, 0.0), roughness=0.02)
LENS = Intrinsics(50.0, 50.0, 32.0, 24.0, 64, 48)
POSE = np.eye(4)  # looks along -z
POSE[:3, 3] = (0, 1.0, 0.2)


def box_shell(shape="box"):
    return next(
        shell
        for shell in (draw_shell(np.random.default_rng(seed)) for seed in range(99))
        if shell.facts["shape"] == shape and not shell.facts["hall"]
    )


def table_at(x, z, *, size=0.8, height=0.5, material=GREY):
    """A level square plate without legs, its lower side at `height`."""
    mesh = shapes.with_material(shapes.block(size, 0.04, size), material).placed(x, height, z)
    return Item("plate", "coffee_table", mesh)


def only(*items):
    return Furniture(items, tuple(Footprint(np.array([9.0, 9.0]), np.ones(2), np.array([1.0, 0.0])) for _ in items))


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["box", "corner", "gable"])
def test_irradiance_is_the_panoramas_integral(shape):
    """At a few places of the floor, against a panorama rendered there: the same light by another way."""
    shell = box_shell(shape)
    image = panorama(height=256)
    light = FurnishedLight(shell, image, bright_parts(image), only(table_at(30.0, 0.0)))  # outside of the room
    room = PanoramaRoom(shell, image, np.zeros(image.shape[:2], np.uint8))
    places = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, -0.4], [-0.6, 0.0, 0.3]])
    up = np.tile([0.0, 1.0, 0.0], (3, 1))
    irradiance, without = light._irradiance(light._sources, places, up)
    np.testing.assert_allclose(irradiance, without, rtol=1e-6)
    cosine = np.maximum(panorama_directions(128)[..., 1], 0)[..., None] * panorama_solid_angles(128)[..., None]
    expected = [
        (room.panorama(place + np.array([0, 0.002, 0]), height=128, seed=0) * cosine).sum((0, 1)) for place in places
    ]
    np.testing.assert_allclose(irradiance, expected, rtol=0.08)  # 96 light samples and 64 rays


@pytest.mark.parametrize(("material", "expected"), [(GREY, 0.5), (BLACK_COATED, 0.04)])
def test_an_even_room_lights_every_side_alike(material, expected):
    """In a furnace of radiance 1 every surface receives pi: a plate shines with its albedo, a coat of 1.5 with 4 %."""
    shell = box_shell()
    image = np.ones((64, 128, 3), np.float32)
    plate = table_at(0.0, 0.0, size=0.3, height=0.7, material=material)
    light = FurnishedLight(shell, image, bright_parts(image), only(plate))
    origin = np.array([[0.0, 1.2, 0.01]], np.float32)
    on, radiance, distance = light.shaded(
        origin, np.array([[0.0, -1.0, 0.0]], np.float32), np.array([9.0], np.float32), 0.002, cell_m=0.05
    )
    assert on.tolist() == [0]
    np.testing.assert_allclose(radiance, expected, rtol=0.02)
    assert distance[0] == pytest.approx(0.46, abs=0.03)


def test_a_plate_shades_the_floor_below_and_not_afar():
    shell = box_shell()
    image = np.full((64, 128, 3), 0.4, np.float32)
    light = FurnishedLight(shell, image, bright_parts(image), only(table_at(0.0, 0.0, height=0.1)))
    position, normal = np.empty((shell.nodes, 3)), np.empty((shell.nodes, 3))
    gather.nodes(shell.arrays, position, normal)
    floor = normal[:, 1] > 0.9
    off = np.abs(position[:, [0, 2]]).max(axis=1)
    below, afar = floor & (off < 0.2), floor & (off > 1.0)
    assert light.shade[below].mean() < 0.45
    assert light.shade[afar].min() > 0.9
    assert light.shade.max() < 1.1


def test_light_sources_are_not_shaded():
    """What an albedo of 0.9 cannot reflect is emitted: the window keeps its radiance behind furniture."""
    shell = box_shell()
    image = panorama(height=128)
    light = FurnishedLight(shell, image, bright_parts(image), only(table_at(0.0, 0.0)))
    np.testing.assert_allclose(light.emitted + light.reflected, image, rtol=1e-5)
    window = image[..., 0] == 20
    assert (light.emitted[window] > 0.85 * image[window]).all()
    floor = panorama_directions(128)[..., 1] < -0.5
    assert (light.reflected[floor] > 0.5 * image[floor]).mean() > 0.9


def test_frames_and_probes_show_the_furniture():
    shell = box_shell()
    image = np.full((128, 256, 3), 0.4, np.float32)
    kinds = np.full(image.shape[:2], 3, np.uint8)
    plate = table_at(0.0, -1.0, size=0.6, height=0.6)
    room = PanoramaRoom(shell, image, kinds, only(plate))
    bare = PanoramaRoom(shell, image, kinds)
    view, empty = room.frame(LENS, POSE, seed=0), bare.frame(LENS, POSE, seed=0)
    nearer = view.depth_m < empty.depth_m - 0.01
    assert 50 < nearer.sum() < 1500
    assert (view.surface[nearer] == ORDINARY).all()
    assert (view.surface[~nearer] == 3).all()
    np.testing.assert_array_equal(view.depth_m[~nearer], empty.depth_m[~nearer])
    np.testing.assert_allclose(room.depth(LENS, POSE), view.depth_m, rtol=1e-5)
    above = room.panorama(np.array([0.0, 1.0, -1.0]), height=32, seed=0)
    assert above.shape == (32, 64, 3)
    assert above[-3:].mean() < 0.3  # the grey plate below: half of what it receives
    np.testing.assert_allclose(above[:8], 0.4, rtol=0.1)


def test_panes_of_furniture_are_glass():
    image = np.full((64, 128, 3), 0.4, np.float32)
    pane = table_at(0.0, -1.0, size=0.6, height=0.6, material=Material("pane", glass=True))
    room = PanoramaRoom(box_shell(), image, np.zeros(image.shape[:2], np.uint8), only(pane, table_at(0.0, -1.0)))
    view = room.frame(LENS, POSE, seed=0)
    points = transform_points(POSE, LENS.rays() * view.depth_m[..., None])
    on_pane = (np.abs(points - (0, 0.62, -1)) < (0.301, 0.021, 0.301)).all(axis=-1)
    assert on_pane.sum() > 50
    np.testing.assert_array_equal(view.surface, np.where(on_pane, GLASS, ORDINARY))


@pytest.mark.parametrize("seed", range(6))
def test_furniture_stands_in_the_room_and_leaves_a_way(seed):
    rng = np.random.default_rng(seed)
    shell = draw_shell(rng)
    furniture = furnish_shell(shell, plain_catalogue(), rng, split="train")
    assert len(furniture.footprints) <= 8
    for item in furniture.items:
        low, high = item.mesh.bounds()
        assert low[1] > -0.01
        assert high[1] < shell.lowest_m + 0.6  # small things on top may be higher than the piece allows
    for number, footprint in enumerate(furniture.footprints):
        assert inside_plan(footprint.grid(), shell.plan, 0.0).all()
        for other in furniture.footprints[number + 1 :]:
            assert (footprint.distance(other.grid()) > 0).all()
    room = PanoramaRoom(shell, np.ones((16, 32, 3), np.float32), np.zeros((16, 32), np.uint8), furniture)
    assert room.free_space().walkable.sum() >= 25


def test_mirrors_become_matt_and_keep_their_mesh():
    mesh = shapes.with_material(shapes.block(1, 1, 0.1), Material("m", mirror=0.9))
    model = next(candidate for candidate in fallback_models("train") if candidate.role == "chair")
    item = furniture_module._item(model, mesh)
    assert all(material.mirror == 0 for material in item.mesh.materials)
    np.testing.assert_array_equal(item.mesh.faces, mesh.faces)
