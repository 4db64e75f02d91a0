"""How paths are sampled: without bias, and with less noise than independent samples have."""

import numpy as np
import pytest
from kernel_calls import compiled
from shading_reference import lit_room, look_at, moved, paths

from roomlight.camera import Intrinsics
from roomlight.compositing.kernels.environment import mean_around, place_of
from roomlight.compositing.kernels.ground import Supports
from roomlight.compositing.light.lighting import LightSampler, ProbeSet
from roomlight.compositing.objects.materials import Material, diffuse, glossy, mirror, rough_metal
from roomlight.compositing.objects.primitives import cube, plane, sphere
from roomlight.compositing.rendering import tracer
from roomlight.compositing.rendering.renderer import render_objects
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.conventions import direction_to_uv, panorama_directions, panorama_solid_angles
from roomlight.kernels.common import point
from roomlight.spheres import resize_panorama

CAMERA = Intrinsics(36.0, 36.0, 10.0, 10.0, 20, 20)
POSE = look_at((0, 0.5, 2.5), (0, 0, 0))
MATERIALS = {"diffuse": diffuse(), "glossy": glossy((0.6, 0.3, 0.2), 0.3), "metal": rough_metal(0.5)}
FLOOR = Supports(
    np.array([[0, -0.5, 0]], np.float32),
    np.array([[0, 1, 0]], np.float32),
    np.array([[0, 0, 0, 0.5]], np.float32),
    np.zeros(1, np.int32),
    np.array([1.0], np.float32),
    reach_m=1.0,
)


def picture(scene: TracedObjects, lights: ProbeSet, samples: int, seed: int = 0, **options) -> np.ndarray:
    """Return the pixels in the middle of an object about the origin, [n, 3]."""
    found = render_objects(scene, CAMERA, POSE, lights, quality=paths(samples), seed=seed, **options)
    return found.radiance[5:15, 5:15].reshape(-1, 3)


def test_points_are_stratified_in_every_shape() -> None:
    for dimension in range(3):
        drawn = np.array([compiled(point)(np.uint64(1234), index, dimension) for index in range(64)])
        for rows in (1, 2, 4, 8, 16, 32, 64):
            cells = np.floor(drawn * [rows, 64 // rows]) @ [64 // rows, 1]
            assert len(np.unique(cells)) == 64, (dimension, rows)


def test_panoramas_are_read_where_the_conventions_say() -> None:
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = np.concatenate([directions, np.eye(3), 0 - np.eye(3)])
    places = np.array([compiled(place_of)(*direction) for direction in directions.tolist()])
    off = (places - direction_to_uv(directions) + 0.5) % 1 - 0.5  # u wraps around
    assert np.abs(off * [2 * np.pi, np.pi]).max() < 2e-8


def test_faces_under_nothing_are_open() -> None:
    assert TracedObjects([sphere(0.5)]).is_open().all()
    assert TracedObjects([cube(0.5)]).is_open().all()
    # two cubes side by side: the faces toward each other are closed
    pair = TracedObjects([cube(0.5), moved(cube(0.5), 1.0)])
    first, second = (pair.surfaces.corners[:, k] - pair.surfaces.corners[:, 0] for k in (1, 2))
    normals = np.cross(first, second)
    left = pair.surfaces.object_id == 0
    np.testing.assert_array_equal(pair.is_open(), np.where(left, normals[:, 0] <= 0, normals[:, 0] >= 0))


def test_open_faces_move_with_the_objects() -> None:
    scene = TracedObjects([cube(0.5), moved(cube(0.3), 0.1, 0.4, 0.0)])
    turn = np.array([[0, -1, 0, 3.0], [1, 0, 0, 1.0], [0, 0, 1, -2.0], [0, 0, 0, 1.0]])
    np.testing.assert_array_equal(scene.moved(turn).is_open(), scene.is_open())
    assert 0 < scene.is_open().mean() < 1


def test_scenes_too_large_to_ask_are_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracer, "_OPEN_TESTS", 1000)
    assert not TracedObjects([sphere(0.5)]).is_open().any()


@pytest.mark.slow
@pytest.mark.parametrize("standing", [False, True], ids=["free", "on a floor"])
@pytest.mark.parametrize("name", MATERIALS)
def test_open_faces_show_what_traced_ones_show(monkeypatch: pytest.MonkeyPatch, name: str, standing: bool) -> None:
    scene, lights = TracedObjects([sphere(0.5, MATERIALS[name])]), ProbeSet.single(lit_room(), (0.0, 0.1, 0.0))
    options = {"supports": FLOOR} if standing else {}
    known = np.stack([picture(scene, lights, 64, seed, **options) for seed in range(4)])
    monkeypatch.setattr(tracer, "_OPEN_TESTS", -1)
    scene = TracedObjects([sphere(0.5, MATERIALS[name])])
    traced = np.stack([picture(scene, lights, 64, seed, **options) for seed in range(4, 8)])
    error = np.sqrt((known.var(axis=0, ddof=1) + traced.var(axis=0, ddof=1)).mean(axis=0) / 4 / known.shape[1])
    difference = np.abs(known.mean(axis=(0, 1)) - traced.mean(axis=(0, 1)))
    # irradiance is known within 0.1 %
    assert np.all(difference < 4 * error + 0.001 * known.mean(axis=(0, 1))), (difference, error)


@pytest.mark.parametrize("is_open", [True, False])
def test_two_probes_light_as_their_mean(monkeypatch: pytest.MonkeyPatch, is_open: bool) -> None:
    if not is_open:
        monkeypatch.setattr(tracer, "_OPEN_TESTS", -1)
    rooms = lit_room(1), lit_room(2)[:, ::-1]
    scene = TracedObjects([sphere(0.5, MATERIALS["glossy"])])
    both = picture(scene, ProbeSet([LightSampler(room) for room in rooms]), 256)
    mean = picture(scene, ProbeSet.single(np.mean(rooms, axis=0)), 256, seed=1)
    # a pixel's noise is 2 % of its value, and there are 100
    np.testing.assert_allclose(both.mean(axis=0), mean.mean(axis=0), rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "is_open", "most"),
    [*((name, False, 0.5) for name in MATERIALS), ("metal", True, 0.5), ("diffuse", True, 0.02)],
)
def test_variance_is_below_independent_samples(
    monkeypatch: pytest.MonkeyPatch, name: str, is_open: bool, most: float
) -> None:
    if not is_open:
        monkeypatch.setattr(tracer, "_OPEN_TESTS", -1)
    scene, lights = TracedObjects([sphere(0.5, MATERIALS[name])]), ProbeSet.single(lit_room())
    # pictures of one sample with different seeds are independent samples
    single = np.stack([picture(scene, lights, 1, seed) for seed in range(32)]).var(axis=0, ddof=1).mean() / 64
    together = np.stack([picture(scene, lights, 64, seed) for seed in range(6)]).var(axis=0, ddof=1).mean()
    assert together < most * single, together / single


@pytest.mark.slow
@pytest.mark.parametrize("rows", [16, 32, 120])
def test_irradiance_agrees_with_a_dense_sum(rows: int) -> None:
    panorama = resize_panorama(lit_room(), rows)
    toward, weight = panorama_directions(256).reshape(-1, 3), np.repeat(panorama_solid_angles(256)[:, 0], 512)
    fine = LightSampler(panorama).radiance(toward) * weight[:, None] / np.pi
    normals = np.array([[0, 1, 0], [0, -1, 0], [1, 0, 0], [0.6, 0.8, 0], [0.36, -0.48, 0.8], [-0.08, 0.6, 0.796]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    exact = np.maximum(normals @ toward.T, 0) @ fine
    environment = ProbeSet.single(panorama).environment
    known = np.array([compiled(mean_around)(environment, np.ones(1), tuple(normal)) for normal in normals])
    np.testing.assert_allclose(known, exact, rtol=0.003)


def test_mirrors_are_not_sampled_by_light() -> None:
    light = np.zeros((32, 64, 3), np.float32)
    light[2, 5] = 1000.0
    seen = picture(TracedObjects([moved(plane(9.0, 9.0, mirror()), 0.0, -0.5, 0.0)]), ProbeSet.single(light), 4)
    assert seen.max() == 0  # the lamp is not where the mirror shows


def test_dark_bases_stay_dark_under_supports() -> None:
    black = Material(base_colour=(0.0, 0.0, 0.0), specular=0.0)
    scene = TracedObjects([sphere(0.5, black)])
    assert picture(scene, ProbeSet.single(lit_room()), 4, supports=FLOOR).max() == 0
    white = TracedObjects([sphere(0.5, diffuse((1.0, 1.0, 1.0)))])
    assert picture(white, ProbeSet.single(lit_room()), 4, supports=FLOOR).min() >= 0
