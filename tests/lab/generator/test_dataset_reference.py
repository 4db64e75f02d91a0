"""The scene in the path tracer: energy, orientation of sky, sun and textures, mirror and coat.

With whichever variant of Mitsuba runs here; ray counts are small enough for the slowest.
"""

import subprocess

import cv2
import numpy as np
import pytest

from roomlight.conventions import uv_to_direction
from roomlight_generator.rooms.scene import Item, Material, Mesh, Opening, Scene, Sky, Sun, Texture
from roomlight_generator.rooms.shapes import rectangle, sphere, with_material
from roomlight_generator.transport.kernels.common import in_row, in_table
from roomlight_generator.transport.lights.coat import coat_table
from roomlight_generator.verification.reference import Reference, usable_variant

BLACK = Sky(np.zeros((8, 16, 3), np.float32))
EVEN = Sky(np.ones((8, 16, 3), np.float32))
ABOVE = Opening(np.array([-50.0, 0, -50]), np.array([0, 0, 100.0]), np.array([100.0, 0, 0]))
"""In the ground plane: a scene in that plane is open to the sky above, one that crosses it to all sides."""


def scene(*meshes: Mesh, sky: Sky = BLACK, openings: tuple[Opening, ...] = ()) -> Scene:
    return Scene(tuple(Item(str(k), "wall", mesh) for k, mesh in enumerate(meshes)), openings, sky)


def radiance_toward(traced: Scene, origin, target, *, samples: int = 64, seed: int = 0) -> np.ndarray:
    """One ray's radiance."""
    begin = np.array([origin], np.float64)
    return Reference(traced).radiance(begin, np.array([target], np.float64) - begin, samples=samples, seed=seed)[0]


@pytest.mark.slow
@pytest.mark.statistical
@pytest.mark.parametrize("albedo", [0.2, 0.7])
def test_white_furnace(albedo: float) -> None:
    """Inside a sphere that emits 1 and reflects rho the radiance is 1 / (1 - rho); its sheets lose nothing."""
    wall = with_material(
        sphere(2, rings=40, segments=80), Material("wall", (albedo, albedo, albedo), emission=(1.0, 1.0, 1.0))
    )
    directions = np.random.default_rng(0).normal(size=(150, 3))
    seen = Reference(scene(wall)).radiance(np.zeros((150, 3)), directions, samples=32, seed=1)
    # Of 4,800 paths, whose lengths differ: the standard error is 0.3 % at 0.7.
    assert seen.mean() == pytest.approx(1 / (1 - albedo), rel=0.012)


@pytest.mark.slow
@pytest.mark.statistical
def test_a_bulb_lights_the_floor_as_its_triangles_do() -> None:
    """The sum over a small bulb's triangles, in a corner of the world where float32 is coarse."""
    at = np.array([6.0, 0.5, -7.0])
    bulb = with_material(
        sphere(0.012, rings=6, segments=12), Material("bulb", (0.0, 0.0, 0.0), emission=(100.0, 50.0, 25.0))
    )
    floor = with_material(rectangle((5.03, 0, -6.03), (2, 0, 0), (0, 0, -2)), Material("floor", (1.0, 1.0, 1.0)))
    corners = bulb.vertices[bulb.faces].astype(np.float64)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    toward = corners.mean(1) + np.array([0, at[1], 0])  # from the floor below it
    distance = np.linalg.norm(toward, axis=1)
    shown = np.maximum(-(toward * area).sum(1) / distance, 0)
    irradiance = (shown * toward[:, 1] / distance**3).sum()
    radiance = radiance_toward(
        scene(bulb.placed(*at), floor), at + np.array([0.5, 0.2, 0]), at * np.array([1, 0, 1]), samples=2048
    )
    # The light's fraction that faces away is sampled in vain: a deviation of about 1 a path.
    np.testing.assert_allclose(radiance, np.array([100, 50, 25]) * irradiance / np.pi, rtol=0.08)


def test_an_emitting_sheet_shines_to_both_sides_and_is_opaque() -> None:
    sheet = with_material(
        rectangle((-1, 0, 0), (2, 0, 0), (0, 2, 0)), Material("pane", (0.0, 0.0, 0.0), emission=(3.0, 2.0, 1.0))
    )
    for z in (-2, 2):
        np.testing.assert_allclose(
            radiance_toward(scene(sheet), (0.31, 1.07, z), (0.33, 1.03, 0), samples=4), [3, 2, 1], rtol=1e-5
        )


def test_the_sky_follows_the_panorama_convention() -> None:
    rng = np.random.default_rng(1)
    panorama = cv2.resize(np.tile(rng.random((4, 8, 3)), (1, 3, 1)), (96, 16), interpolation=cv2.INTER_LINEAR)
    panorama = panorama[:, 32:64].astype(np.float32) + 0.1
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, (np.arange(16) + 0.5) / 16)
    directions = uv_to_direction(np.stack([u, v], -1)).reshape(-1, 3)
    speck = with_material(rectangle((50, -1, 50), (0.01, 0, 0), (0, 2, 0)), Material())
    traced = Reference(scene(speck, sky=Sky(panorama), openings=(ABOVE,)))
    seen = traced.radiance(np.zeros((512, 3)), directions, samples=1, seed=0).reshape(16, 32, 3)
    # Bilinear on another grid: pixels at the peaks of a random picture lose a little.
    np.testing.assert_allclose(seen, panorama, atol=0.03)


def test_the_sky_is_black_where_no_opening_shows_it() -> None:
    """A window in the wall at x = 1 of things at x < 1: the sky beyond it stays, the other half goes."""
    window = Opening(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0]))
    thing = with_material(rectangle((-3, 0, 0), (2, 0, 0), (0, 2, 0)), Material())
    traced = Reference(scene(thing, sky=EVEN, openings=(window,)))
    directions = np.array([[1, 0.2, 0], [0.1, 1, 0.4], [-1, 0.2, 0], [-0.3, -1, 0.1]])
    seen = traced.radiance(np.full((4, 3), [0, 5.0, 0]), directions, samples=1, seed=0)
    np.testing.assert_allclose(seen[:, 0], [1, 1, 0, 0])


def test_the_sun_lights_by_its_cosine_and_casts_soft_shadows() -> None:
    direction = np.array([0.48, 0.6, 0.64])
    sky = Sky(BLACK.panorama, Sun(direction, (30.0, 20.0, 10.0), angular_radius=0.02))
    floor = with_material(rectangle((-9, 0, 9), (18, 0, 0), (0, 0, -18), step=5), Material("floor", (0.5, 0.5, 0.5)))
    # A wide board whose lower edge is the x axis' parallel at height 3.
    board = with_material(rectangle((-40, 3, 0), (80, 0, 0), (0, 40, 0), step=50), Material("board", (0.0, 0.0, 0.0)))
    traced = scene(floor, board, sky=sky, openings=(ABOVE,))
    edge = -3 * direction[2] / direction[1]
    half_width = 0.02 * 3 / direction[1] ** 2  # of the penumbra, along z at least
    lit = 0.5 / np.pi * np.array([30, 20, 10]) * direction[1]
    for z, share in ((edge + 2 * half_width, 1.0), (edge - 2 * half_width, 0.0), (edge, 0.5)):
        radiance = radiance_toward(traced, (1, 2, z - 1), (1.01, 0, z), samples=64)
        np.testing.assert_allclose(radiance, share * lit, rtol=0.02, atol=0.2 * lit.max() * (share == 0.5))


def test_texture_rows_run_down() -> None:
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 0], image[0, 1], image[1, 0], image[1, 1] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)
    picture = Material("picture", (0.8, 0.8, 0.8), Texture(image))
    plate = with_material(rectangle((0, 0, 0), (1, 0, 0), (0, 0, -1), unit_uv=True, step=2), picture)
    traced = Reference(scene(plate, sky=EVEN, openings=(ABOVE,)))
    at = np.array([[0.25, 0, -0.75], [0.75, 0, -0.75], [0.25, 0, -0.25], [0.75, 0, -0.25]])
    seen = traced.radiance(at + np.array([0, 1, 0]), np.tile([[0, -1.0, 0]], (4, 1)), samples=64, seed=0)
    np.testing.assert_array_equal(seen > 0.2 * seen.max(), image.reshape(4, 3) > 0)


@pytest.mark.slow
@pytest.mark.statistical
def test_a_texture_is_decoded_and_multiplied_by_the_albedo() -> None:
    grey = Texture(np.full((1, 1, 3), 188, np.uint8))  # 0.503 linear
    plate = with_material(rectangle((-1, 0, 1), (2, 0, 0), (0, 0, -2)), Material("plate", (0.8, 0.4, 0.2), grey))
    radiance = radiance_toward(scene(plate, sky=EVEN, openings=(ABOVE,)), (0.3, 2, 0.2), (0.31, 0, 0.17), samples=3000)
    np.testing.assert_allclose(radiance, np.array([0.8, 0.4, 0.2]) * 0.5029, rtol=0.02)


def test_a_mirror_reflects_what_is_in_front_of_it() -> None:
    mirror = with_material(rectangle((-1, 0, 0), (2, 0, 0), (0, 2, 0)), Material("mirror", mirror=0.9))
    poster = with_material(
        rectangle((1, 0, 1), (1, 0, 0), (0, 2, 0)), Material("poster", (0.0, 0.0, 0.0), emission=(1.0, 2.0, 3.0))
    )
    # From (-1.5, 1, 1) by the mirror's point (0.03, 1.03) to (1.56, 1.06, 1).
    radiance = radiance_toward(scene(mirror, poster), (-1.5, 1.0, 1.0), (0.03, 1.03, 0.0), samples=2)
    np.testing.assert_allclose(radiance, [0.9, 1.8, 2.7], rtol=1e-4)


@pytest.mark.slow
@pytest.mark.statistical
@pytest.mark.parametrize(("alpha", "albedo"), [(0.05, 0.5), (0.3, 0.8), (0.6, 0.0)])
@pytest.mark.parametrize("cosine", [0.95, 0.3])
def test_the_coat_equals_the_transports_tables(alpha: float, albedo: float, cosine: float) -> None:
    """Under an even sky a coated plate reflects what the transport's tables say, and never more than arrives."""
    plate = with_material(
        rectangle((-1, 0, 1), (2, 0, 0), (0, 0, -2)), Material("plate", (albedo, albedo, albedo), roughness=alpha)
    )
    offset = np.array([np.sqrt(1 - cosine**2), cosine, 0])
    target = np.array([0.03, 0, 0.04])
    radiance = radiance_toward(scene(plate, sky=EVEN, openings=(ABOVE,)), target + offset, target, samples=3000)[0]
    table = coat_table()
    base = (
        albedo * in_row(table.scale, alpha) * in_table(table.through, alpha, cosine) * in_row(table.mean_through, alpha)
    )
    assert radiance == pytest.approx(in_table(table.reflected, alpha, cosine) + base, rel=0.02, abs=0.003)
    assert radiance < 1.01


def test_panes_and_faces_without_area_are_left_out() -> None:
    wall = with_material(
        rectangle((0, 0, -1), (1, 0, 0), (0, 1, 0)), Material("wall", (0.0, 0.0, 0.0), emission=(1.0, 1.0, 1.0))
    )
    pane = with_material(rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)), Material("pane", glass=True))
    line = with_material(
        rectangle((0, 0, 0.5), (1, 0, 0), (0, 1, 0), step=2), Material("line", emission=(5.0, 5.0, 5.0))
    )
    flat = Mesh(
        line.vertices[[0, 0, 1]], line.normals[:3], line.uvs[:3], np.array([[0, 1, 2]]), np.array([0]), line.materials
    )
    np.testing.assert_allclose(
        radiance_toward(scene(wall, pane, flat), (0.4, 0.5, 2), (0.41, 0.52, -1), samples=2), 1, rtol=1e-5
    )


def test_without_llvm_the_scalar_variant_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    import drjit

    usable_variant.cache_clear()
    monkeypatch.setattr(drjit, "has_backend", lambda _: False)
    assert usable_variant() == "scalar_rgb"
    usable_variant.cache_clear()
    monkeypatch.setattr(drjit, "has_backend", lambda _: True)
    ended = subprocess.CompletedProcess([], returncode=-6)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: ended)
    assert usable_variant() == "scalar_rgb"
    usable_variant.cache_clear()
    wall = with_material(sphere(2), Material("wall", (0.0, 0.0, 0.0), emission=(1.0, 1.0, 1.0)))
    traced = Reference(scene(wall), variant="scalar_rgb")
    np.testing.assert_allclose(
        traced.radiance(np.zeros((2, 3)), np.array([[1, 0.2, 0.3], [0.1, -1, 0.4]]), samples=2, seed=0), 1, rtol=1e-4
    )
