"""The compositor on a room whose geometry and light are known: layers, stability, easing and refusals."""

import dataclasses
import inspect
import weakref
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from roomlight.camera import rigid_inverse, transform_points
from roomlight.compositing.compositor import Compositor, composite
from roomlight.compositing.kernels.reproject import accumulate_image
from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.light.probes import given_light
from roomlight.compositing.light.temporal import LIGHT_S, DepthFilter, EasedLight, share_of, without_gaps
from roomlight.compositing.objects.materials import diffuse, glass, mirror
from roomlight.compositing.objects.primitives import cube, plane, sphere
from roomlight.compositing.picture.camera_match import CameraModel, add_noise, measure_camera
from roomlight.compositing.picture.estimated_depth import fitted_to_supports
from roomlight.compositing.picture.layers import encode_srgb8
from roomlight.compositing.placement.places import Plane
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.compositing.placement.scene import AtPixel, AtPosition, Motion, MotionKey, SceneObject
from roomlight.conventions import linear_to_srgb, linear_to_srgb8, srgb8_to_linear
from roomlight.engine.session import Session
from roomlight.errors import FrameError, OptionError, SceneError
from roomlight.light.light import Light
from rooms import BoxRoom, camera_at
from sessions import session_of

LAMP = ((0.3, 3.0, 0.0), 0.5)
ROOM = BoxRoom(block=((-0.9, 0.0, -1.2), (-0.3, 0.6, -0.6)), lamp=LAMP, lamp_radiance=20.0)
EYE = (0.2, 1.4, 1.4)
SIZE = {"width": 320, "height": 240, "depth_size": (256, 192)}
BALL = SceneObject("ball", sphere(0.2, diffuse((0.8, 0.2, 0.2))), AtPosition((0.3, 0.0, -0.8)))


def view(yaw=0.0, index=0, position=EYE):
    return ROOM.frame(camera_at(position, yaw, -30), index=index, **SIZE)


def rest_variance(images, mask: Any = np.s_[:]):
    """The mean variance over time of encoded values in [0, 1], where camera and objects rest."""
    return (np.stack(images).astype(np.float32) / np.float32(255)).var(axis=0).mean(axis=-1)[mask].mean()


def warped_change(frames, layers, depths_m, number):
    """A layer's change against the one before, warped by depth and camera motion, where both show one surface."""
    frame, before, depth_m, before_m = frames[number], frames[number - 1], depths_m[number], depths_m[number - 1]
    points = transform_points(frame.camera_to_world, frame.intrinsics.rays() * depth_m[..., None])
    lens = dataclasses.astuple(before.intrinsics)[:4]
    warped, known = np.full(points.shape, np.float32(-10)), depth_m > 0
    accumulate_image(
        warped, warped.copy(), known, points, rigid_inverse(before.camera_to_world)[:3].astype(np.float32),
        np.array(lens, np.float32), np.concatenate([layers[number - 1], before_m[..., None]], axis=-1), before_m > 0,
        np.float32(0), np.float32(1e6), 0, len(known),
    )  # fmt: skip
    return (warped - layers[number])[known & (warped[..., 0] > -5)]


@pytest.fixture(scope="module")
def session():
    poses = [camera_at(EYE, 60 * index, (index % 3) * 40 - 40) for index in range(6)]
    around = [ROOM.frame(pose, index=index, width=96, height=72) for index, pose in enumerate(poses)]
    return session_of([*around, view(index=12)], height=32)


def test_layers_make_the_image(session):
    frame = view()
    made = composite(session, frame, [BALL], quality="preview")
    linear = frame.image * made.shadow * (1 - made.alpha[..., None]) + made.objects
    assert np.abs(made.radiance - linear).max() < 1e-6
    part = replace(frame, seen=np.arange(frame.image.shape[1]) + 0 * frame.image[..., 0] < 10)
    assert (replace(made, frame=part).radiance[:, 10:] == made.objects[:, 10:]).all()
    assert np.abs(made.image.astype(int) - linear_to_srgb8(linear)).max() <= 1  # this room has no noise to match
    outside = np.ones(frame.image.shape[:2], bool)
    outside[made.crop.slices] = False
    assert (made.image[outside] == encode_srgb8(frame.image)[outside]).all()
    assert (made.alpha[outside] == 0).all()
    assert (made.shadow[outside] == 1).all()
    assert made.alpha[made.object_crop.slices].sum() == made.alpha.sum() > 0
    assert made.crop.union(made.object_crop) == made.crop


@pytest.mark.parametrize("quality", ["preview", "good"])
def test_glass_shows_the_shadows_behind_it(session, quality):
    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    pane = plane(0.8, 0.8, glass(ior=1.0)).transformed(upright)  # casts no shadow and reflects nothing
    before = SceneObject("pane", pane, AtPosition((0.3, 0.2, -0.2)))
    made = composite(session, view(), [BALL, before], quality=quality)
    expected = view().image * made.shadow
    shaded = (made.object_id == 1) & (made.alpha > 0.99) & (made.shadow.max(axis=-1) < 0.8)
    shown = made.objects[shaded] / expected[shaded]
    assert len(shown) > 100
    assert np.median(shown) == pytest.approx(1, abs=0.02)  # in `good` some show the ball


def test_the_rim_of_an_object_in_a_soft_frame_has_its_depth_and_number(session, monkeypatch):
    sharp = composite(session, view(), [BALL], quality="preview")
    soft = replace(CameraModel.perfect(), blur_px=1.5)
    monkeypatch.setattr("roomlight.compositing.compositor.measure_camera", lambda _: soft)
    made = composite(session, view(), [BALL], quality="preview")
    assert ((made.alpha > 0) & (sharp.alpha == 0)).sum() > 50
    assert (made.object_id[made.alpha > 0] == 0).all()
    assert made.depth_m[made.alpha > 0].min() == sharp.depth_m[sharp.depth_m > 0].min()
    assert made.visible == pytest.approx(sharp.visible, abs=0.01)
    assert made.visible[0] > 0.98


@pytest.mark.parametrize("quality", ["preview", "good"])
def test_probes_close_behind_a_large_face_show_no_spots(session, quality):
    slab = cube(1.2, diffuse((1.0, 1.0, 1.0))).transformed(np.diag([1.0, 1.0, 0.5, 1.0]))
    large = SceneObject("slab", slab, AtPosition((0.2, 0.0, -1.2)))

    def light(at):  # at the probe 15 cm behind the upper left of the front
        return np.full((8, 16, 3), float(at[0] < 0.2 and at[1] > 0.6 and at[2] > -1.2), np.float32)

    made = composite(session, view(), [large], quality=quality, light=light)
    assert 0.3 < made.objects.max() < 0.5  # of 1


def test_light_may_be_a_light_a_panorama_or_a_function(session):
    panorama = np.full((16, 32, 3), 0.7, np.float32)
    light = Light((0.0, 0.0, 0.0), panorama)
    given = light, panorama, lambda _: panorama, lambda _: light
    made = [composite(session, view(), [BALL], quality="preview", light=light).image for light in given]
    assert all((image == made[0]).all() for image in made)


@pytest.mark.parametrize(
    ("panorama", "problem"),
    [
        (np.full((8, 32, 3), 0.7, np.float32), "a Light, a panorama or a function .* this is 32 x 8"),
        (np.zeros((16, 32, 3), np.uint8), "got uint8; .* decodes 8-bit sRGB"),
        (np.full((16, 32, 3), -1, np.float32), r"radiance is 0 to 1e\+12, got -1 to -1"),
        (np.full((16, 32, 3), 1e20, np.float32), r"radiance is 0 to 1e\+12, got 1e\+20"),
    ],
)
def test_given_light_is_checked_also_of_a_function(panorama, problem):
    for call in (lambda: inspect.unwrap(given_light)(panorama), lambda: given_light(lambda _: panorama)((0, 0, 0))):
        with pytest.raises(OptionError, match=problem):
            call()


@pytest.mark.parametrize("material", [diffuse((0.5, 0.5, 0.5)), glass()])
def test_objects_darken_at_once_with_a_frame_of_less_exposure(material):
    first = replace(view(), auto_exposed=True)
    dark, far = (replace(first, index=index, image=first.image * np.float32(0.4)) for index in (1, 11_000))
    session = session_of([first, dark], height=16)
    compositor = Compositor(session, [replace(BALL, geometry=sphere(0.2, material))], quality="preview")
    full, *darker = (compositor.composite(frame).objects.sum() for frame in (first, dark, far))
    assert darker == pytest.approx([0.4 * full] * 2, rel=0.05)
    again = Session.from_snapshot(session.snapshot())
    assert [again.gain_of(index) for index in (0, 1, 2)] == [session.gain_of(index) for index in (0, 1, 2)]
    assert again.gain_of(1) == pytest.approx((2.5,) * 3, rel=0.05)


@pytest.mark.parametrize("light", [None, np.full((16, 32, 3), 0.7, np.float32)])
@pytest.mark.parametrize("material", [diffuse((0.5, 0.5, 0.5)), glass()])
def test_a_stated_exposure_is_that_of_plate_and_objects(session, material, light):
    ball = replace(BALL, geometry=sphere(0.2, material))
    plain, darker = (
        composite(session, replace(view(), exposure=exposure), [ball], quality="preview", light=light)
        for exposure in (1.0, 0.5)
    )
    assert (plain.gain, darker.gain) == ((1, 1, 1), (2, 2, 2))
    np.testing.assert_allclose(darker.radiance, 0.5 * plain.radiance, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(darker.objects, 0.5 * plain.objects, rtol=1e-3, atol=1e-3)
    assert np.abs(darker.image.astype(int) - linear_to_srgb8(darker.radiance)).max() <= 1


def test_a_sphere_stands_casts_a_shadow_and_has_its_depth(session):
    frame = view()
    made = composite(session, frame, [BALL], quality="preview")
    covered = made.alpha > 0.99
    radius_px = 0.2 / np.linalg.norm(np.array([0.3, 0.2, -0.8]) - EYE) * frame.intrinsics.fx
    assert covered.sum() == pytest.approx(np.pi * radius_px**2, rel=0.1)
    assert (made.object_id[covered] == 0).all()
    centre = (np.array([0.3, 0.2, -0.8]) - EYE) @ frame.camera_to_world[:3, :3]
    assert made.depth_m[covered].min() == pytest.approx(-centre[2] - 0.2, abs=0.02)
    assert made.shadow.min() < 0.6  # under the ball
    assert (made.shadow[made.alpha > 0] > 0).all()
    red, green, _ = made.radiance[covered].mean(axis=0)
    assert red > 2 * green


def test_a_real_block_hides_the_ball_behind_it(session):
    hidden = replace(BALL, place=AtPosition((-0.35, 0.3, -1.5)))
    frame = view()
    made = composite(session, frame, [hidden], quality="preview")
    rays = frame.intrinsics.rays() @ frame.camera_to_world[:3, :3].T.astype(np.float32)
    _, distance = ROOM.cast(frame.camera_to_world[:3, 3], rays / np.linalg.norm(rays, axis=-1, keepdims=True))
    real = distance / np.linalg.norm(frame.intrinsics.rays(), axis=-1)
    covered = cv2.erode((made.depth_m > 0).astype(np.uint8), np.ones((5, 5))) > 0  # its own rim is soft
    in_front = covered & (real < made.depth_m - 0.1)
    assert in_front.sum() > 100
    behind = covered & (real > made.depth_m + 0.1)
    assert behind.sum() > 300
    assert (made.alpha[in_front] > 0.5).mean() < 0.04  # the rim, where alpha is soft
    assert (made.alpha[behind] < 0.5).mean() < 0.04
    assert made.visible[0] == pytest.approx(behind.sum() / (behind | in_front).sum(), abs=0.1)


@pytest.mark.parametrize("factor", [0.55, 0.75, 1.2])
def test_objects_stand_where_they_are_though_estimated_depth_is_wrong(session, factor):
    floating = replace(BALL, name="floating", place=AtPosition((0.9, 0.6, -0.8)))
    balls = [BALL, replace(BALL, name="behind the block", place=AtPosition((-0.3, 0.0, -1.45))), floating]
    frame = view()
    rows, columns = np.indices(frame.depth_m.shape) / 100
    smooth = np.exp(0.06 * np.sin(rows) * np.cos(columns))
    wrong = replace(frame, depth_m=(factor * smooth * frame.depth_m).astype(np.float32), depth_estimated=True)
    true, made = (composite(session, each, balls, quality="preview") for each in (frame, wrong))
    assert true.visible == pytest.approx({0: 1, 1: 0.64, 2: 1}, abs=0.02)
    assert made.visible == pytest.approx(true.visible, abs=0.04)
    shaded = true.shadow.min(axis=-1) < 0.9
    assert np.abs(made.shadow - true.shadow)[shaded].mean() < 0.02  # 0.3 if the floor is elsewhere


def test_estimated_depth_goes_to_the_nearest_support_alone():
    clean, up = view(), np.array([0.0, 1.0, 0.0])
    supports = [Plane(np.zeros(3), up), Plane(0.3 * up, up)]  # a ball on the floor, a wardrobe on a step
    spheres = [np.array([0.3, 0.1, -0.3, 0.1]), np.array([1.0, 1.0, -0.4, 0.7])]
    depth_m = clean.depth_m * np.float32(1.01)
    fitted = fitted_to_supports(depth_m, replace(clean, depth_estimated=True), supports, spheres, RoomGeometry())
    lens = clean.intrinsics.resized(*fitted.shape[::-1])
    points = transform_points(clean.camera_to_world, lens.rays() * fitted[..., None])
    around = np.linalg.norm(points - (0.3, 0, -0.3), axis=-1) < 0.15
    assert around.sum() > 200
    assert points[around, 1] == pytest.approx(0, abs=1e-3)


def test_an_object_is_placed_by_a_pixel_of_its_frame(session):
    before = session.handles
    held = replace(BALL, place=AtPixel(200.0, 180.0, frame=5))
    compositor = Compositor(session, [held], quality="preview")
    first = compositor.composite(view(index=4))
    assert first.waiting == ("ball",)
    assert (first.image == encode_srgb8(view().image)).all()
    second = compositor.composite(view(index=5))
    assert second.waiting == ()
    bottom = compositor.placement("ball").object_to_world[1, 3] - 0.2
    assert abs(bottom) < 0.005
    compositor.close()
    assert session.handles == before


@pytest.mark.slow
def test_still_objects_do_not_shimmer(session):
    compositor = Compositor(session, [BALL], quality="preview")
    frames = [compositor.composite(view(index=index)).image for index in range(4)]
    assert rest_variance(frames) < (0.05 / 255) ** 2  # a twentieth of a step of 8 bits


@pytest.mark.slow
def test_noise_of_depth_hardly_reaches_the_picture(session):
    rng = np.random.default_rng(4)
    compositor = Compositor(session, [BALL], quality="preview", match_camera=False)
    made = []
    for index in range(7):
        frame = view(index=index)
        noise = rng.normal(0, 0.006, frame.depth_m.shape).astype(np.float32)
        made.append(compositor.composite(replace(frame, depth_m=frame.depth_m + noise)))
    near = np.zeros(made[-1].alpha.shape, bool)
    near[made[-1].crop.slices] = True
    assert rest_variance([one.image for one in made[3:]], near) < (1.0 / 255) ** 2  # under one step of 8 bits


@pytest.mark.slow
def test_shadows_keep_still_under_a_moving_camera(session):
    compositor = Compositor(session, [BALL], quality="preview")
    frames = [view(1.0 * index, index, (0.2 + 0.01 * index, 1.4, 1.4)) for index in range(5)]
    made = [compositor.composite(frame) for frame in frames]
    exact = [ROOM.frame(f.camera_to_world, width=320, height=240) for f in frames]
    depths = [np.where(m.alpha > 0, 0, f.depth_m).astype(np.float32) for m, f in zip(made, exact, strict=True)]
    changes = [warped_change(frames, [one.shadow for one in made], depths, number) for number in (3, 4)]
    assert (np.concatenate(changes) ** 2).mean() / 2 < 0.01**2  # a standard deviation of 1 % of the light


@pytest.mark.slow
def test_a_moving_object_changes_without_steps(session):
    motion = Motion.model_validate({"unit": "frames", "keys": [{"at": 0}, {"at": 30, "offset_m": [-0.9, 0, 0.6]}]})
    compositor = Compositor(session, [replace(BALL, motion=motion)], quality="preview")
    means = []
    for index in range(0, 16, 2):
        made = compositor.composite(view(index=index))
        covered = made.alpha > 0.99
        means.append(made.radiance[covered].mean())
    steps = np.abs(np.diff(means)) / np.mean(means)
    assert steps.max() < 0.08
    assert np.ptp(means) > 0.001 * np.mean(means)  # but it does change


def test_the_first_frame_is_not_kept_and_a_moving_object_leaves_materials_alone(session):
    motion = Motion.model_validate({"unit": "frames", "keys": [{"at": 0}, {"at": 4, "offset_m": [-0.3, 0, 0]}]})
    still = SceneObject("still", cube(0.2, mirror()), AtPosition((0.8, 0.0, -0.8)))
    compositor = Compositor(session, [replace(BALL, motion=motion), still], quality="preview")
    frames = [view(index=index) for index in range(2)]
    first, tables = weakref.ref(frames[0].image), []
    while frames:
        compositor.composite(frames.pop(0))
        tables.append(compositor._objects.materials)
    assert tables[0] is tables[1]
    assert first() is None


def test_the_shadow_of_a_moving_object_is_where_the_object_is(session):
    motion = Motion.model_validate({"unit": "frames", "keys": [{"at": 0}, {"at": 4, "offset_m": [-0.3, 0, 0]}]})
    there = replace(BALL, place=AtPosition((0.0, 0.0, -0.8)))
    light = np.full((16, 32, 3), 0.5, np.float32)
    moving, resting = (Compositor(session, [one], light=light) for one in (replace(BALL, motion=motion), there))
    for index in range(4):
        moving.follow(view(index=index))
    moved, expected = (compositor.composite(view(index=4)).shadow for compositor in (moving, resting))
    assert expected.min() < 0.5
    np.testing.assert_allclose(moved, expected, atol=1e-3)


def test_light_is_eased_in_with_its_time_constant():
    dark, bright = np.full((16, 32, 3), 0.2, np.float32), np.full((16, 32, 3), 1.2, np.float32)
    light = EasedLight((0.0, 0.0, 0.0), dark)
    light.aim(bright)
    for _ in range(12):
        light.advance(LIGHT_S / 12)
    assert light.sampler.panorama.mean() == pytest.approx(0.2 + (1 - np.exp(-1)), abs=1e-3)
    assert isinstance(light.sampler, LightSampler)
    assert share_of(0.0, LIGHT_S) == 0


def test_depth_is_averaged_where_it_agrees_else_replaced():
    rng = np.random.default_rng(6)
    clean = view()
    depth_filter, results = DepthFilter(), []
    for index in range(12):
        noise = rng.normal(0, 0.01, clean.depth_m.shape).astype(np.float32)
        results.append(depth_filter.push(replace(clean, index=index, depth_m=clean.depth_m + noise)))
    assert (results[-1] - clean.depth_m).std() < 0.5 * 0.01
    nearer = replace(clean, index=12, depth_m=clean.depth_m * 0.7)
    assert depth_filter.push(nearer) == pytest.approx(nearer.depth_m)
    hole = replace(clean, index=13, depth_m=np.zeros_like(clean.depth_m))
    assert depth_filter.push(hole) == pytest.approx(nearer.depth_m)  # held for some frames


def test_estimated_depth_is_near_only_where_two_frames_show_it():
    clean, depth_filter, results = view(), DepthFilter(), []
    for index, factor in enumerate((1.0, 1.15, 0.85, 1.0, 0.5, 0.5)):  # factors of the estimate, then a hand
        frame = replace(clean, index=index, depth_m=clean.depth_m * np.float32(factor), depth_estimated=True)
        results.append(float((depth_filter.push(frame) / clean.depth_m).mean()))
    assert min(results[:5]) > 0.95
    assert results[5] == pytest.approx(0.5)
    later = replace(clean, index=66, depth_m=clean.depth_m * np.float32(0.3), depth_estimated=True)
    assert float((depth_filter.push(later) / clean.depth_m).mean()) == pytest.approx(0.3)  # 2 s tell nothing


def test_gaps_between_reprojected_pixels_are_filled_and_what_was_not_seen_is_not():
    depth_m = np.full((20, 30), 2.0, np.float32)
    depth_m[:, 20:] = 1.0
    depth_m[5], depth_m[:, 12], depth_m[10:, 25:] = 0, 0, 0
    filled = without_gaps(depth_m)
    expected = np.where(depth_m > 0, depth_m, np.float32(2))
    expected[5, 19:] = 1.0
    expected[11:, 26:] = 0
    inside = np.s_[1:-1, 1:-1]
    assert (filled[inside] == expected[inside]).mean() > 0.95
    assert (filled[5, 1:-1] > 0).all()
    assert (filled[12:-1, 27:-1] == 0).all()


def test_depth_follows_a_moving_camera_and_its_lens():
    depth_filter = DepthFilter()
    frames = [view(0.7 * index, index) for index in range(6)]
    results = [depth_filter.push(frame) for frame in frames]
    for frame, result in zip(frames, results, strict=True):
        assert np.percentile(np.abs(result - frame.depth_m) / frame.depth_m, 95) < 0.01
    frame, result = frames[-1], results[-1]
    zoomed = replace(frame.intrinsics, fx=2 * frame.intrinsics.fx, fy=2 * frame.intrinsics.fy)
    held = depth_filter.push(replace(frame, intrinsics=zoomed, depth_m=np.zeros_like(frame.depth_m), index=6))
    middle, known = np.kron(result[48:144, 64:192], np.ones((2, 2))), held > 0
    assert known.any()
    assert np.percentile(np.abs(held - middle)[known] / middle[known], 95) < 0.02


def test_noise_and_blur_of_the_frame_are_measured_and_matched():
    rng = np.random.default_rng(8)
    smooth = np.clip(linear_to_srgb(view().image), 0, 1)
    noisy = np.clip(smooth + rng.normal(0, 0.02, smooth.shape), 0, 1).astype(np.float32)
    camera = measure_camera(noisy)
    assert camera.noise[2:6].mean() == pytest.approx(0.02, rel=0.1)
    grey = np.full((64, 64, 3), 0.5, np.float32)
    added = add_noise(grey, np.ones((64, 64), np.float32), camera, frame_index=3)
    assert added.std() == pytest.approx(0.02, rel=0.15)
    again = add_noise(grey, np.ones((64, 64), np.float32), camera, frame_index=3)
    other = add_noise(grey, np.ones((64, 64), np.float32), camera, frame_index=4)
    assert (added == again).all()
    assert not (added == other).all()
    part = add_noise(grey[8:24, 16:40], np.ones((16, 24), np.float32), camera, frame_index=3, at=(8, 16))
    assert (part == added[8:24, 16:40]).all()
    assert not measure_camera(smooth.astype(np.float32)).noise.any()
    assert (add_noise(grey, np.zeros((64, 64), np.float32), camera, frame_index=3) == grey).all()
    assert CameraModel.perfect().blur_px == 0


@pytest.mark.parametrize("shared", [0.0, 0.8])
def test_noise_that_channels_share_is_measured_and_matched(shared: float):
    """The pattern of cameras that compress has hardly any colours, and a carpet at one brightness is no noise."""
    rng = np.random.default_rng(8)
    image = np.clip(linear_to_srgb(view().image), 0, 1)
    own, common = rng.normal(0, 0.01, image.shape), rng.normal(0, 0.01, (*image.shape[:2], 1))
    noisy = np.clip(image + np.sqrt(1 - shared) * own + np.sqrt(shared) * common, 0, 1).astype(np.float32)
    camera = measure_camera(noisy)
    assert camera.shared == pytest.approx(shared, abs=0.1)
    added = add_noise(np.full((64, 64, 3), 0.5, np.float32), np.ones((64, 64), np.float32), camera, frame_index=3)
    assert np.corrcoef(added[..., 0].ravel(), added[..., 2].ravel())[0, 1] == pytest.approx(shared, abs=0.15)
    striped = noisy + np.where(np.abs(image - 0.45) < 0.06, rng.normal(0, 0.1, image.shape), 0).astype(np.float32)
    assert measure_camera(striped).noise.max() < 2.5 * camera.noise.max()


@pytest.mark.parametrize("blur_px", [0.6, 1.0, 1.5])
def test_blur_is_measured_at_the_sharpest_edges(blur_px):
    fine = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((192, 192))).astype(np.float32) * 0.6 + 0.2
    sheared = np.array([[1, 0.05, 0], [-0.04, 1, 30]], np.float32)
    rows, columns = fine.shape
    fine = cv2.warpAffine(fine, sheared, (columns, rows), borderMode=cv2.BORDER_REFLECT)
    image = cv2.resize(cv2.GaussianBlur(fine, (0, 0), 4 * blur_px), (384, 288), interpolation=cv2.INTER_AREA)
    assert measure_camera(np.repeat(image[..., None], 3, axis=-1)).blur_px == pytest.approx(blur_px, abs=0.25)


def test_noise_of_the_frame_is_given_to_objects(session):
    rng = np.random.default_rng(9)
    clean = view()
    noisy = linear_to_srgb(clean.image) + rng.normal(0, 0.02, clean.image.shape)
    frame = replace(clean, image=srgb8_to_linear(np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8)))
    compositor = Compositor(session, [BALL], quality="preview")
    compositor.follow(replace(clean, image=0 * clean.image))  # the lens is covered
    compositor.follow(clean.resized(160, 120))
    matched = compositor.composite(frame)
    plain = Compositor(session, [BALL], quality="preview", match_camera=False).composite(frame)
    covered = plain.alpha == 1
    difference = (matched.image.astype(float) - plain.image)[covered] / 255
    assert difference.std() == pytest.approx(0.02, rel=0.35)


def test_clipped_light_on_objects_is_white(session):
    bright = SceneObject("mirror", sphere(0.2, mirror()), AtPosition((0.3, 0.0, -0.8)))
    made = composite(session, view(), [bright], quality="preview")
    assert made.radiance[made.alpha > 0.99].max() > 1
    assert (made.image[made.radiance.min(axis=-1) > 1] == 255).all()


def test_clipped_light_hides_weak_shadows_and_takes_deep_ones(session):
    clipped = np.zeros(view().clipped.shape, bool)
    clipped[:, 160:] = True
    image = np.where(clipped[..., None], np.float32([1.0, 0.99, 0.98]), np.float32(0.5))
    plain, kept = (
        composite(session, frame, [BALL], quality="preview").shadow
        for frame in (view(), replace(view(), image=image, clipped=clipped))
    )
    assert (kept[~clipped] == plain[~clipped]).all()
    before, after = plain[clipped], kept[clipped]
    weak, deep = (before > 0.88) & (before < 1), before < 0.5
    assert weak.sum() > 100
    assert deep.sum() > 100
    assert ((1 - after)[weak] < 0.3 * (1 - before)[weak]).all()
    assert (after[deep] < 1.3 * before[deep]).all()


def test_shadows_where_red_alone_is_clipped_stay_warm(session):
    clipped = np.zeros(view().clipped.shape, bool)
    clipped[:, 160:] = True
    image = np.where(clipped[..., None], np.float32([1.0, 0.75, 0.4]), np.float32([0.75, 0.45, 0.24]))  # red is 1.25
    frame = replace(view(), image=image, clipped=clipped)
    plain, kept = (composite(session, one, [BALL], quality="preview").shadow for one in (view(), frame))
    near = clipped & (np.indices(clipped.shape)[1] < 180) & (plain.max(axis=-1) < 0.7) & (plain.min(axis=-1) > 0.2)
    assert near.sum() > 100
    rise = kept[near] / plain[near]
    assert ((rise[:, 0] > 1.08 * rise[:, 1]) & (rise[:, 0] < 1.25 * rise[:, 1])).all()


def test_one_clipped_pixel_does_not_change_a_shadow_on_a_bright_table(session):
    clipped = np.zeros(view().clipped.shape, bool)
    clipped[90, 150] = True
    image = np.where(clipped[..., None], np.float32([1.0, 1.0, 1.0]), np.float32(0.94))
    bright, dot = replace(view(), image=np.full_like(image, 0.94)), replace(view(), image=image, clipped=clipped)
    plain, kept = (composite(session, frame, [BALL], quality="preview").shadow for frame in (bright, dot))
    np.testing.assert_allclose(kept[~clipped], plain[~clipped], atol=0.005)


def test_encoding_agrees_with_the_reference():
    linear = np.random.default_rng(1).uniform(-0.1, 1.2, (40, 30, 3)).astype(np.float32) ** 2
    assert np.abs(encode_srgb8(linear).astype(int) - linear_to_srgb8(linear)).max() <= 1
    codes = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, axis=2)
    assert (encode_srgb8(srgb8_to_linear(codes)) == codes).all()


@pytest.mark.slow
def test_paths_are_limited_for_objects_that_cover_many_pixels(session):
    near = SceneObject("near", cube(0.8), AtPosition((0.2, 0.6, 0.4)))
    made = Compositor(session, [near], max_paths=400_000).composite(view())
    covered = int((made.alpha > 0).sum())
    assert covered > 12_500  # 32 paths for each would be too many
    assert 1 <= made.samples <= 400_000 / covered
    assert Compositor(session, [BALL], max_paths=10**9).composite(view()).samples == 64


def test_what_cannot_be_composited_is_refused(session):
    with pytest.raises(SceneError, match="push a frame first"):
        Compositor(session_of(height=16), [BALL]).composite(view())
    compositor = Compositor(session, [BALL])
    compositor.close()
    with pytest.raises(SceneError, match="the compositor is closed"):
        compositor.composite(view())
    with pytest.raises(OptionError, match="quality must be one of preview, good, final; got 'best'"):
        Compositor(session, [BALL], quality="best")
    for place, message in (
        (AtPosition((0.2, 1.2, 2.4)), "ball: lies behind the camera"),
        (AtPosition((-2.8, 0.0, 0.4)), "ball: lies outside the picture"),
        (AtPixel(10.0, 10.0, frame=99), "ball: the pixel belongs to another frame"),
    ):
        with pytest.raises(SceneError, match=message):
            composite(session, view(), [replace(BALL, place=place)], quality="preview")


def test_a_scene_may_be_a_path_and_other_types_are_refused(session, tmp_path):
    path = tmp_path / "scene.json"
    path.write_text('{"objects": [{"name": "ball", "shape": "sphere", "position": [0.3, 0, -0.8]}]}')
    assert composite(session, view(), str(path), quality="preview").alpha.any()
    with pytest.raises(OptionError, match="session is of the type str; it must be Session"):
        inspect.unwrap(Compositor.__init__)(object.__new__(Compositor), "session", [BALL])
    with pytest.raises(FrameError, match="frame is of the type str; it must be Frame"):
        inspect.unwrap(Compositor._step)(Compositor(session, [BALL]), "frame", is_drawn=True)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"place": AtPixel(9999.0, 3.0)}, "pixel"),
        ({"motion": Motion(keys=[MotionKey(at=0, offset_m=(1e4, 0.0, 0.0))])}, "motion"),
    ],
)
def test_a_refused_place_names_the_object_and_changes_nothing(session, changes, problem):
    before = session.handles
    compositor = Compositor(session, [BALL, replace(BALL, name="lost", **changes)], quality="preview")
    with pytest.raises(SceneError, match=rf"objects\[1\] \(lost\): {problem}"):
        compositor.composite(view())
    assert compositor.waiting == ("ball", "lost")
    assert session.handles == before


@pytest.mark.slow
def test_a_big_object_has_several_probes(session):
    before = len(session.handles)
    big = SceneObject("big", cube(1.0), AtPosition((0.6, 0.0, -1.2)))
    compositor = Compositor(session, [big], quality="preview")
    compositor.composite(view())
    assert len(session.handles) == before + 8
    compositor.close()
