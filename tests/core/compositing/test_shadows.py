"""Shadows and colour bleeding against closed forms: umbra and penumbra of a small light, a sphere under a white sky."""

from dataclasses import replace

import numpy as np
import pytest
from light_rooms import lit, unit
from shading_reference import moved

from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.objects.materials import diffuse, glass
from roomlight.compositing.objects.primitives import cube, plane, sphere
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.picture.crop import CropCamera
from roomlight.compositing.placement.places import Plane
from roomlight.compositing.placement.room_geometry import Hits, RoomGeometry
from roomlight.compositing.rendering.light_samples import light_samples
from roomlight.compositing.rendering.shadows import (
    QUALITIES,
    Caster,
    ShadowQuality,
    coarse_ratio,
    shadow_ratio,
    spread_ratio,
    surface_grid,
)
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.conventions import panorama_directions
from rooms import camera_at, pinhole

POSE = camera_at((0.0, 1.6, 1.6), pitch_degrees=-45)
CAMERA = CropCamera.of(pinhole(160, 120, 60.0))
FLOOR = Plane(np.zeros(3), np.array([0.0, 1.0, 0.0]))
FINE = ShadowQuality(step=1, samples=64, bounces=0)


def floor_depth():
    rays = CAMERA.rays().astype(np.float64)
    down = (rays @ POSE[:3, :3].T)[..., 1]
    return (POSE[1, 3] / -down).astype(np.float32)


def caster(held, panorama, centre, radius, support: Plane | None = FLOOR):
    spheres = np.array([[*centre, radius]], np.float32)
    light = LightSampler(panorama)
    return Caster(TracedObjects([held]), spheres, np.array([0], np.int32), light, light, support)


def ball(panorama, radius=0.2, height=0.5, material=None):
    return caster(moved(sphere(radius, material), 0, height), panorama, (0, height, 0), radius)


def ratio_of(shadow_caster, quality=FINE):
    grid = surface_grid(floor_depth(), CAMERA, POSE, [FLOOR])
    return coarse_ratio(shadow_caster, grid, quality)[0], grid


def from_axis(grid, centre, toward):
    """Return how far points are behind a centre in the light from a direction, and how far beside its axis."""
    offset = grid.points - np.array(centre, np.float32)
    along = -(offset @ toward)
    return along, np.linalg.norm(offset + along[..., None] * toward, axis=-1)


def test_points_on_a_support_stay_on_their_lines_of_sight():
    low = camera_at((0.0, 0.4, 1.6), pitch_degrees=-20)
    rays = CAMERA.rays().astype(np.float64) @ low[:3, :3].T
    exact = np.where(rays[..., 1] < -0.1, 0.4 / np.maximum(-rays[..., 1], 0.1), 9.0)
    depth_m = (exact * (1 + np.random.default_rng(1).normal(0, 0.003, exact.shape))).astype(np.float32)
    grid = surface_grid(depth_m, CAMERA, low, [FLOOR])
    snapped = np.abs(grid.points[..., 1]) < 1e-4
    assert snapped.mean() > 0.3
    truth = low[:3, 3] + exact[..., None] * rays
    assert np.linalg.norm(grid.points - truth, axis=-1)[snapped].max() < 1e-3


def test_a_support_is_flat_where_a_sensor_measures_in_steps():
    near, camera = camera_at((0.0, 0.7, 0.7), pitch_degrees=-45), CropCamera.of(pinhole(120, 90, 13.0))  # 1.9 mm
    exact = 0.7 / -(camera.rays().astype(np.float64) @ near[:3, :3].T)[..., 1]
    patches = np.kron(np.random.default_rng(1).integers(-1, 2, (30, 40)), np.ones((3, 3)))
    depth_m = (0.0036 * (np.round(exact / 0.0036) + patches)).astype(np.float32)  # a Kinect's at 1 m
    grid = surface_grid(depth_m, camera, near, [FLOOR])
    assert np.abs(grid.points[grid.known, 1]).max() < 1e-4


def test_umbra_of_a_small_light_is_the_analytic_one():
    toward, angle = unit(0.35, 1.0, 0.2), np.radians(3.0)
    panorama = lit(240, [(toward, 3.0, 100.0)], level=0.0)
    ratio, grid = ratio_of(ball(panorama))
    along, across = from_axis(grid, (0, 0.5, 0), toward)
    spread, margin = along * np.tan(angle), 0.02  # a pixel of the floor is 1.5 cm
    umbra = across < 0.2 - spread - margin
    outside = across > 0.2 + spread + margin
    assert umbra.sum() > 150
    assert ratio[umbra].max() < 0.04  # 0.02 is the least
    assert ratio[outside & grid.known].min() > 0.98
    between = ratio[~umbra & ~outside & grid.known]
    assert 0.3 < between.mean() < 0.7


def test_far_from_objects_nothing_changes():
    ratio, grid = ratio_of(ball(lit(60, [], level=1.0)))
    distance = np.linalg.norm(grid.points - np.array([0, 0.5, 0]), axis=-1)
    far = distance > 0.2 * FINE.reach
    assert far.any()
    assert (ratio[far] == 1).all()


def test_a_red_cube_bleeds_red_onto_a_white_floor():
    held = moved(cube(0.4, diffuse((0.8, 0.05, 0.05))), 0, 0.2)
    lit_cube = caster(held, lit(60, [], level=1.0), (0, 0.2, 0), 0.4 * np.sqrt(0.75))
    ratio, grid = ratio_of(lit_cube, ShadowQuality(step=1, samples=64, bounces=8))
    beside = grid.known & (np.abs(grid.points[..., 0]) < 0.2) & (np.abs(grid.points[..., 2] - 0.26) < 0.03)
    red, green, _ = ratio[beside].mean(axis=0)
    # at 6 cm from a wall of 0.4 m its cosine-weighted share of the hemisphere is about 0.35
    # and a floor as bright as the sky has, for the compositor, an albedo of 0.8: its own light is larger by 1 / 0.8
    assert 0.35 * 0.75 * 0.8 * 0.75 < red - green < 0.35 * 0.75
    assert green < 0.75


def test_the_lit_inside_of_a_closed_box_lights_no_floor_beside_it():
    toward = unit(np.cos(np.radians(20)), np.sin(np.radians(20)), 0)
    panorama = lit(120, [(toward, 4.0, 200.0)], level=0.1)
    held = moved(cube(0.4, diffuse((0.8, 0.8, 0.8))), 0, 0.2)
    white = caster(held, panorama, (0, 0.2, 0), 0.4 * np.sqrt(0.75))
    ratio, grid = ratio_of(white, QUALITIES["final"])
    x, _, z = np.moveaxis(grid.points, -1, 0)
    foot, away = ((x < -begin) & (x > -begin - 0.02) & (np.abs(z) < 0.1) for begin in (0.2, 0.35))
    assert ratio[foot].mean() < 1.1 * ratio[away].mean()


def test_reflected_light_conserves_a_white_furnace():
    """A white object under a white sky reflects what it blocks: only its own underside is dark."""
    white = ball(lit(60, [], level=1.0), height=0.6, material=diffuse((1.0, 1.0, 1.0)))
    ratio, grid = ratio_of(white, ShadowQuality(step=1, samples=64, bounces=16))
    assert ratio[grid.known].min() > 0.9
    assert ratio[grid.known].max() < 1.03


def test_reflected_light_ends_where_shadows_end():
    quality = ShadowQuality(step=1, samples=16, bounces=16)
    dark, white = (
        ratio_of(ball(lit(60, [], level=1.0), height=0.6, material=diffuse((albedo,) * 3)), quality)[0].mean(axis=-1)
        for albedo in (0.0, 1.0)
    )
    _, grid = ratio_of(ball(lit(60, [], level=1.0)))
    radii = np.linalg.norm(grid.points - np.float32([0, 0.6, 0]), axis=-1) / 0.2
    rings = [(white - dark)[grid.known & (radii > begin) & (radii < begin + 0.2)].mean() for begin in (3.6, 4.2)]
    assert rings[1] > 0.5 * rings[0] > 0


@pytest.mark.parametrize(
    ("material", "left"),
    [(glass(tint=(0.9, 0.9, 0.9)), 0.9 * 0.96**2), (replace(diffuse((0.8, 0.8, 0.8)), opacity=0.3), 0.7**2)],
    ids=["glass", "opacity"],
)
def test_light_passes_both_walls_of_a_clear_ball_but_nothing_opaque_in_it(material, left):
    panorama = lit(240, [((0.35, 1.0, 0.2), 3.0, 100.0)], level=0.0)
    shell = ball(panorama, material=material)
    clear, grid = ratio_of(shell)
    dark, _ = ratio_of(ball(panorama))
    umbra = grid.known & (dark[..., 1] < 0.03)
    assert clear[umbra].mean() == pytest.approx(left, abs=0.02)
    core = moved(sphere(0.19), 0, 0.5)
    both = TracedObjects([*shell.scene.objects, core])
    filled, _ = ratio_of(replace(shell, scene=both, spheres=shell.spheres.repeat(2, axis=0), object_ids=np.arange(2)))
    assert np.median(filled[umbra]) < 0.03


@pytest.mark.parametrize("tint", [None, 0.5], ids=["opaque", "glass"])
def test_a_lamp_that_two_casters_hide_is_lost_once(tint):
    toward = unit(0.35, 1.0, 0.2)
    high = np.array([0, 0.5, 0]) + 0.6 * toward
    lower = ball(lit(240, [(toward, 3.0, 100.0)], level=1.0), material=tint and glass(tint=(tint,) * 3))
    scene = TracedObjects([*lower.scene.objects, moved(sphere(0.2), *high)])
    both = replace(lower, scene=scene, spheres=np.float32([[0, 0.5, 0, 0.2], [*high, 0.2]]), object_ids=np.arange(2))
    casters = [replace(both, spheres=both.spheres[[k]], object_ids=np.array([k])) for k in (0, 1)]
    apart, together = (shadow_ratio(held, floor_depth(), CAMERA, POSE, FINE) for held in (casters, [both]))
    _, grid = ratio_of(both)
    umbra = grid.known & (from_axis(grid, high, toward)[1] < 0.1)
    assert apart[umbra].mean() == pytest.approx(together[umbra].mean(), rel=0.02)


@pytest.mark.parametrize("cutoff", [None, 0.5])
def test_a_cut_out_casts_a_shadow_where_it_is_there(cutoff):
    image = np.full((1, 64, 4), 255, np.uint8)
    image[:, :32, 3] = 0
    right = replace(diffuse(), base_colour_texture=Texture.from_srgb8(image), alpha_cutoff=cutoff)
    panorama = lit(240, [((0.0, 1.0, 0.0), 3.0, 100.0)], level=0.0)
    ratio, grid = ratio_of(caster(moved(plane(0.6, 0.6, right), 0, 0.3), panorama, (0, 0.3, 0), 0.43))
    x, z = grid.points[..., 0], grid.points[..., 2]
    there, gone = (np.maximum(np.abs(x - middle), np.abs(z)) < 0.1 for middle in (0.15, -0.15))
    assert ratio[there].max() < 0.04
    assert ratio[gone].min() > 0.98


def test_samples_estimate_the_irradiance():
    panorama = lit(120, [((0.3, 1.0, 0.1), 8.0, 40.0)], level=0.4)
    light = LightSampler(panorama)
    for normal in (np.array([0.0, 1, 0]), unit(1, 1, 0), unit(0, 0.2, -1)):
        samples = light_samples(light, 64, toward=np.array([0.0, 1, 0]))
        cosine = np.maximum(samples.directions @ normal.astype(np.float32), 0)
        estimates = (samples.weights * cosine[..., None]).sum(axis=1)
        lamp = 40 * np.pi * np.sin(np.radians(8)) ** 2 * max(normal @ unit(0.3, 1.0, 0.1), 0)
        assert estimates.mean() == pytest.approx(0.4 * np.pi + lamp, rel=0.03)
        assert estimates.std(axis=0).max() < 0.25 * estimates.mean()


def test_coarse_shadows_agree_with_fine_ones():
    panorama = lit(60, [((0.35, 1.0, 0.2), 15.0, 10.0)], level=0.5)
    fine = shadow_ratio([ball(panorama, height=0.25)], floor_depth(), CAMERA, POSE, FINE)
    coarse = shadow_ratio([ball(panorama, height=0.25)], floor_depth(), CAMERA, POSE, ShadowQuality(2, 32, 0))
    assert np.abs(fine - coarse).mean() < 0.01
    assert np.percentile(np.abs(fine - coarse), 99) < 0.15


@pytest.mark.parametrize("step", [2, 4])
def test_contact_has_the_detail_of_fine_shadows(step):
    small = ball(lit(60, [], level=1.0), radius=0.06, height=0.06)
    fine = shadow_ratio([small], floor_depth(), CAMERA, POSE, FINE)
    coarse = shadow_ratio([small], floor_depth(), CAMERA, POSE, ShadowQuality(step, 64, 0))
    _, grid = ratio_of(small)
    below = grid.known & (np.linalg.norm(grid.points, axis=-1) < 0.06)
    assert fine[below].min() < 0.15
    assert np.abs(fine - coarse)[below].mean() < 0.04 * (step - 2) + 1e-4  # interpolation alone: 0.06 and 0.15


def test_contact_has_no_bright_outline():
    large = ball(lit(60, [], level=1.0), radius=0.5, height=0.5)
    fine, coarse = (shadow_ratio([large], floor_depth(), CAMERA, POSE, ShadowQuality(step, 64, 0)) for step in (1, 2))
    assert (coarse - fine).max() < 0.04


@pytest.mark.parametrize("step", [1, 2, 4])
def test_the_edges_of_real_things_are_as_dark_as_the_shadow_around_them(step):
    low = ball(lit(60, [((0.0, 1.0, 0.0), 3.0, 100.0)], level=0.0), radius=0.5, height=0.8)
    depth_m = floor_depth()
    middle = np.s_[48:70, 68:92]
    depth_m[middle][4:-4, 5:-5] *= 0.9  # a board 16 cm above the floor
    ratio = shadow_ratio([low], depth_m, CAMERA, POSE, ShadowQuality(step, 32, 0))
    assert ratio[middle].max() < 0.15


@pytest.mark.parametrize("step", [1, 2, 4])
def test_a_ratio_of_1_stays_exactly_so_beside_edges(step):
    known = np.random.default_rng(0).random((30, 40)) < 0.5
    ratio, depth_m = np.ones((30, 40, 3), np.float32), np.ones((30, 40), np.float32)
    assert (spread_ratio(ratio, known, depth_m, np.ones((30 * step, 40 * step), np.float32), step) == 1).all()


@pytest.mark.parametrize("rim", [np.s_[:, 70:71], np.s_[80:81, :]])
def test_a_rim_of_one_pixel_has_no_normals_and_stays_unchanged(rim):
    held = ball(lit(60, [((0.35, 1.0, 0.2), 15.0, 10.0)], level=0.5), height=0.2)
    depth_m = np.ascontiguousarray(floor_depth()[rim])
    camera = replace(CAMERA, cx=CAMERA.cx - (rim[1].start or 0), cy=CAMERA.cy - (rim[0].start or 0))
    camera = replace(camera, width=depth_m.shape[1], height=depth_m.shape[0])
    ratio = shadow_ratio([held], depth_m, camera, POSE, ShadowQuality(1, 16, 2))
    assert (ratio == 1).all()


def test_an_emissive_texture_dims_the_light_that_an_object_gives():
    spots = np.zeros((64, 64, 3), np.float32)
    spots[0, :2] = 1  # 0.05 % of the texture
    panorama = lit(60, [], level=1.0)
    dim = diffuse((0.1, 0.1, 0.1))
    dark, grid = ratio_of(ball(panorama, height=0.25, material=dim), ShadowQuality(1, 64, 8))
    bright = replace(dim, emissive=(1.0, 1.0, 1.0))
    spotted = replace(bright, emissive_texture=Texture.from_linear(spots))
    lamp, _ = ratio_of(ball(panorama, height=0.25, material=bright), ShadowQuality(1, 64, 8))
    faint, _ = ratio_of(ball(panorama, height=0.25, material=spotted), ShadowQuality(1, 64, 8))
    below = grid.known & (np.linalg.norm(grid.points, axis=-1) < 0.15)
    assert lamp[below].mean() > dark[below].mean() + 0.3
    assert faint[below].mean() == pytest.approx(dark[below].mean(), abs=0.002)


def test_a_glowing_ball_lights_the_floor_in_its_colour_and_ends_softly():
    glow = replace(diffuse((0.0, 0.0, 0.0)), emissive=(100.0, 50.0, 10.0))
    ratio, grid = ratio_of(ball(lit(60, [], level=1.0), 0.1, 0.2, glow), ShadowQuality(1, 64, 8))
    distance_m = np.linalg.norm(grid.points - np.array([0, 0.2, 0], np.float32), axis=-1)
    lit_by = grid.known & (distance_m < 0.6)
    assert ratio.max() == pytest.approx(4, abs=1e-3)
    red, green, blue = ratio[lit_by].T
    np.testing.assert_allclose((red - green) / (red - blue), 5 / 9, rtol=0.02)  # of the light, also at the limit
    near = grid.known & (distance_m > 0.38) & (distance_m < 0.55)  # 0.4 is 4 radii
    exact = 1 + 0.8 * 100 * 0.1**2 * 0.2 / distance_m[near] ** 3  # the floor counts as of an albedo of 0.8
    np.testing.assert_allclose(ratio[near][:, 0], exact, rtol=0.15)


class Ceiling(RoomGeometry):
    """A ceiling 2 m above the floor and nothing else."""

    def cast(self, origins, directions):
        up = directions[:, 1] > 0.01
        distance_m = np.where(up, (2 - origins[:, 1]) / np.where(up, directions[:, 1], 1), np.inf)
        normals = np.where(up[:, None], np.array([0.0, -1, 0]), 0)
        return Hits(distance_m.astype(np.float32), normals.astype(np.float32))


def test_a_lamp_on_a_near_ceiling_casts_a_wider_shadow():
    far = ball(lit(240, [((0.0, 1.0, 0.0), 2.0, 200.0)], level=0.0), radius=0.1)
    light = LightSampler(far.light.panorama, (0.0, 0.5, 0.0))
    near = replace(far, light=light, reflection=light, room=Ceiling())
    parallel, grid = ratio_of(far, replace(FINE, room_shade=False))
    widened, _ = ratio_of(near, replace(FINE, room_shade=False))
    beside = np.hypot(grid.points[..., 0], grid.points[..., 2])
    # the lamp is 1.5 m above the ball: its shadow on the floor is 2 / 1.5 times as wide, 13 cm; the lamp is 10 cm wide
    assert widened[beside < 0.10].max() < 0.2
    ring = (beside > 0.108) & (beside < 0.118)
    assert widened[ring].mean() < 0.5
    assert parallel[(beside > 0.13) & (beside < 0.16)].min() > 0.9
    assert widened[(beside > 0.16) & grid.known].min() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("albedo", "sides"), [(0.0, (0.75, 0.84, 0.92)), (0.8, (0.86, 0.92, 0.96))])
def test_ratios_around_a_ball_on_a_grey_floor_are_those_of_mitsuba(albedo, sides):
    """Mitsuba 3: a sphere of radius 0.2 on a floor of albedo 0.5 under a white sky, path tracing of depth 8.

    Means of the ratio at 0.22 to 0.27, 0.27 to 0.35 and 0.35 to 0.5 m from the point of contact.
    """
    sky = np.where(panorama_directions(60)[..., 1:2] > 0, 1.0, 0.5).repeat(3, axis=-1)
    for quality in QUALITIES.values():
        held = ball(sky.astype(np.float32), height=0.2, material=diffuse((albedo,) * 3))
        ratio = shadow_ratio([held], floor_depth(), CAMERA, POSE, quality)[..., 1]
        _, grid = ratio_of(held, quality)
        beside = np.hypot(grid.points[..., 0], grid.points[..., 2])
        for (begin, end), expected in zip(((0.22, 0.27), (0.27, 0.35), (0.35, 0.5)), sides, strict=True):
            assert ratio[(beside > begin) & (beside < end)].mean() == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_white_ball_under_a_lamp_is_as_dark_at_its_foot_as_in_path_tracing(quality):
    """Path tracing of depth 8, floor of albedo 0.5: the mean at 0.3 radii from the point of contact."""
    light = lit(120, [(unit(np.cos(np.radians(85)), np.sin(np.radians(85)), 0), 4.0, 60.0)], level=0.1)
    up = panorama_directions(120)[..., 1:2] > 0
    below = 0.5 * (0.1 + 60 * np.sin(np.radians(4)) ** 2 * np.sin(np.radians(85)))
    held = ball(np.where(up, light, below).astype(np.float32), height=0.2)
    ratio = shadow_ratio([held], floor_depth(), CAMERA, POSE, QUALITIES[quality])
    grid = surface_grid(floor_depth(), CAMERA, POSE, [FLOOR])
    foot = grid.known & (np.abs(np.hypot(grid.points[..., 0], grid.points[..., 2]) - 0.06) < 0.015)
    assert ratio[foot].mean() == pytest.approx(0.07, abs=0.03)


@pytest.mark.parametrize("place", ["wall", "floor"])
def test_a_window_keeps_its_light_and_the_suns_patch_on_a_floor_does_not(place):
    toward = unit(0.3, 0.8, -0.5) if place == "wall" else unit(0.3, -0.05, 0.0)
    shaded = ball(lit(120, [(toward, 12.0, 30.0)], level=0.3), height=0.8, material=diffuse((0.0, 0.0, 0.0)))
    shaded.reflection.position = (0.0, 0.0, 0.0) if place == "wall" else (0.0, 0.05, 0.0)
    pose = camera_at((0.0, 0.8, 1.6)) if place == "wall" else POSE
    depth_m = np.full((120, 160), 2.1, np.float32) if place == "wall" else floor_depth()
    bare, kept = (
        shadow_ratio([shaded], depth_m, CAMERA, pose, QUALITIES["good"], white=white)
        for white in (None, np.ones_like(depth_m))
    )
    grid = surface_grid(depth_m, CAMERA, pose, [FLOOR])
    offset = grid.points - np.array(shaded.reflection.position, np.float32)
    window = offset @ toward > np.cos(np.radians(10)) * np.linalg.norm(offset, axis=-1)
    assert np.abs(bare[window] - 1).max() > 0.02
    if place == "wall":
        np.testing.assert_allclose(kept[window], 1, atol=1e-3)
        assert kept.min() < 0.95
    else:
        np.testing.assert_array_equal(kept, bare)
