"""Light around objects against closed forms: contact shadows, small lamps, reflected light, few samples."""

from dataclasses import replace

import numpy as np
import pytest
from light_rooms import lit, unit
from shading_reference import moved
from test_shadows import CAMERA, FLOOR, POSE, ball, caster, floor_depth, from_axis, ratio_of

from roomlight.compositing.compositor import shadow_step
from roomlight.compositing.objects.materials import diffuse, mirror
from roomlight.compositing.objects.primitives import cube, plane, sphere
from roomlight.compositing.placement.places import Plane
from roomlight.compositing.rendering.shadows import QUALITIES, ShadowQuality, coarse_ratio, surface_grid
from roomlight.conventions import panorama_directions, panorama_solid_angles

FINE = ShadowQuality(step=1, samples=256, bounces=16, radius=4)


def irradiance(panorama, normal):
    cosine = np.maximum(panorama_directions(len(panorama)) @ np.asarray(normal), 0)[..., None]
    return (panorama * cosine * panorama_solid_angles(len(panorama))[..., None]).sum(axis=(0, 1))


def places(grid):
    """Return the distance on the floor from the origin."""
    return np.where(grid.known, np.hypot(grid.points[..., 0], grid.points[..., 2]), np.inf)


@pytest.mark.parametrize("quality", [FINE, QUALITIES["preview"]])
def test_a_ball_on_the_floor_has_a_dark_contact(quality):
    black = ball(lit(60, [], level=1.0), height=0.2, material=diffuse((0.0, 0.0, 0.0)))
    ratio, grid = ratio_of(black, quality)
    far = places(grid)
    expected = 1 - 0.2**3 / (0.2**2 + far**2) ** 1.5
    for ring in ((0.03, 0.06), (0.1, 0.14), (0.2, 0.24), (0.4, 0.44)):
        chosen = (far > ring[0]) & (far < ring[1])
        assert chosen.sum() > 10
        assert ratio[chosen].mean() == pytest.approx(expected[chosen].mean(), abs=0.06)


@pytest.mark.parametrize("material", [diffuse((0.8, 0.8, 0.8)), mirror()])
def test_bright_objects_keep_a_contact_shadow(material):
    """What a bright object shows of the floor beneath it is dark, so it lights the contact little."""
    ratio, grid = ratio_of(ball(lit(60, [], level=1.0), height=0.2, material=material), FINE)
    far = places(grid)
    assert ratio[(far > 0.02) & (far < 0.05)].mean() < 0.4
    assert 0.6 < ratio[(far > 0.2) & (far < 0.24)].mean() < 1.0
    assert ratio[(far > 0.6) & (far < 0.7)].mean() == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("name", ["preview", "good"])
@pytest.mark.parametrize("lamp_deg", [1.0, 4.0])
def test_the_umbra_of_a_lamp_keeps_the_other_light(name, lamp_deg):
    toward = unit(0.5, 1.0, 0.3)
    level = 12.0 / lamp_deg**2
    panorama = lit(120, [(toward, lamp_deg, 1000.0 * level)], level=0.4)
    lamp = irradiance(panorama, (0, 1, 0)) - 0.4 * np.pi
    ratio, grid = ratio_of(ball(panorama, height=0.5, material=diffuse((0.0, 0.0, 0.0))), QUALITIES[name])
    along, across = from_axis(grid, (0, 0.5, 0), toward)
    umbra = grid.known & (across < 0.1) & (grid.points[..., 1] < 0.01)
    distance = np.hypot(along, across)[umbra]
    sky = 0.4 * np.pi * (1 - 0.2**2 * 0.5 / distance**3)
    expected = (sky / (0.4 * np.pi + lamp.mean())).mean()
    assert umbra.sum() > 50
    assert ratio[umbra].mean() == pytest.approx(expected, abs=0.03)


def test_a_mirror_throws_the_light_that_it_receives():
    """The flux on the floor is the lamp's on the mirror; a lamp from below lights the floor by the mirror alone."""
    toward = unit(0.1, -1.0, 0.05)
    panorama = lit(120, [(toward, 3.0, 60.0)], level=0.5)
    ceiling = Plane(np.array([0.0, 3.0, 0.0]), np.array([0.0, -1.0, 0.0]))
    plate = caster(moved(plane(0.2, 0.2, mirror()), 0, 0.4), panorama, (0, 0.4, 0), 0.1415, support=ceiling)
    ratio, grid = ratio_of(plate, replace(FINE, reach=4.0))  # the plate's faint shadow lies beyond
    glow = (ratio[..., 1] - 1)[1:-1, 1:-1] * irradiance(panorama, (0, 1, 0))[1]
    right, down = grid.points[1:-1, 2:] - grid.points[1:-1, :-2], grid.points[2:, 1:-1] - grid.points[:-2, 1:-1]
    area = np.linalg.norm(np.cross(right, down), axis=-1) / 4
    flux = float((glow * area)[grid.known[1:-1, 1:-1]].sum())
    received = (irradiance(panorama, (0, -1, 0))[1] - 0.5 * np.pi) * 0.2**2
    assert 0.7 * received < flux < 1.05 * received


@pytest.mark.parametrize("held", [sphere(0.2, mirror()), cube(0.3, diffuse((0.9, 0.9, 0.9)))])
def test_few_samples_are_as_bright_as_many(held):
    """Next to a strong lamp that lights the floor at a grazing angle, few samples show the rest of the light."""
    panorama = lit(120, [(unit(1.0, 0.03, 0.0), 3.0, 2000.0)], level=0.5)
    one = caster(moved(held, 0, 0.2), panorama, (0, 0.2, 0), 0.26)
    grid = surface_grid(floor_depth(), CAMERA, POSE, [FLOOR])
    few, _ = coarse_ratio(one, grid, ShadowQuality(step=1, samples=16, bounces=2))
    many, _ = coarse_ratio(one, grid, FINE)
    near = places(grid) < 0.6
    assert few[near].mean() == pytest.approx(many[near].mean(), rel=0.05)


def test_light_that_the_panorama_lacks_makes_no_bright_spot():
    """The floor is brighter than the panorama's sky explains: a mirror on it throws no bright light on it."""
    panorama = lit(60, [], level=0.2)
    panorama[30:] = 0.6
    mirrored = ball(panorama, height=0.2, material=mirror())
    ratio, grid = ratio_of(mirrored, FINE)
    far = places(grid)
    assert ratio[far < 0.8].max() < 1.02
    assert ratio[(far > 0.02) & (far < 0.05)].mean() < 0.4


@pytest.mark.parametrize(("width", "steps"), [(256, (4, 2, 1)), (640, (4, 2, 1)), (1920, (12, 6, 3))])
def test_shadows_of_wide_frames_have_a_bounded_resolution(width, steps):
    assert tuple(shadow_step(name, width) for name in ("preview", "good", "final")) == steps
