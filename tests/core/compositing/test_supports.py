"""Objects reflect the surface that they stand on as a near one, and their shade on it."""

import cv2
import numpy as np
import pytest
from shading_reference import look_at, mirrored_rays, moved, paths

from roomlight.camera import Intrinsics
from roomlight.compositing.kernels.ground import Supports
from roomlight.compositing.light.lighting import ProbeSet
from roomlight.compositing.objects.materials import Material, diffuse, mirror
from roomlight.compositing.objects.primitives import cube, sphere
from roomlight.compositing.placed_object import supports_of
from roomlight.compositing.placement.places import Plane
from roomlight.compositing.rendering.renderer import RenderSettings, render_objects
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.conventions import panorama_directions

CAMERA = Intrinsics(180.0, 180.0, 64.0, 48.0, 128, 96)
EYE = np.array([0.3, 0.5, 1.2])
CENTRE, RADIUS = np.array([0.3, 0.12, 0.0]), 0.1
PROBE = (0.0, 0.4, 0.0)
EDGE_X = 0.3
FLOOR = np.array([[0, 0, 0]], np.float32), np.array([[0, 1, 0]], np.float32)


def supports(shade_radius: float = 0.0) -> Supports:
    spheres = np.array([[*CENTRE, shade_radius]], np.float32)
    return Supports(*FLOOR, spheres, np.zeros(1, np.int32), np.array([25.0], np.float32), reach_m=50.0)


def ball(material: Material) -> TracedObjects:
    return TracedObjects([moved(sphere(RADIUS, material), *CENTRE)])


def split_floor(rows: int = 256) -> ProbeSet:
    """Return a grey sky above a floor that is white from x = `EDGE_X` on, as a probe at `PROBE` sees it."""
    d = panorama_directions(rows)
    down = np.minimum(d[..., 1], -1e-6)
    white = PROBE[0] + d[..., 0] * (-PROBE[1] / down) > EDGE_X
    value = np.where(d[..., 1] < 0, white.astype(float), 0.5)
    return ProbeSet.single(np.repeat(value[..., None], 3, axis=2).astype(np.float32), PROBE)


def reflected_floor() -> tuple[np.ndarray, np.ndarray]:
    """Return where the mirror ball shows the floor, and the floor's x there."""
    place, turned, square = mirrored_rays(CAMERA, look_at(EYE, CENTRE), CENTRE, RADIUS)
    shown = (square > 0.002) & (turned[..., 1] < -0.2)
    x = place[..., 0] - turned[..., 0] / np.minimum(turned[..., 1], -1e-6) * place[..., 1]
    return shown, x


@pytest.mark.slow
def test_mirror_shows_the_floor_where_it_is() -> None:
    shown, x = reflected_floor()
    clear = shown & (np.abs(x - EDGE_X) > 0.02)
    white = x > EDGE_X
    assert (clear & white).sum() > 20
    assert (clear & ~white).sum() > 20
    pose = look_at(tuple(EYE), tuple(CENTRE))
    for quality in ("preview", paths(16, 2)):
        near = render_objects(ball(mirror()), CAMERA, pose, split_floor(), quality=quality, supports=supports())
        far = render_objects(ball(mirror()), CAMERA, pose, split_floor(), quality=quality)
        error = [np.abs(one.radiance[..., 0] - white)[clear].mean() for one in (near, far)]
        assert error[0] < 0.06
        assert error[1] > 0.2  # as a far surface the floor is in the wrong place


def test_ball_on_the_floor_is_darker_below_than_above() -> None:
    pose = look_at((0.3, 0.12, 1.2), tuple(CENTRE))
    light = ProbeSet.single(np.ones((32, 64, 3), np.float32), (0.3, 0.12, 0.0))
    plain, shaded = (
        render_objects(ball(diffuse((0.5, 0.5, 0.5))), CAMERA, pose, light, quality=paths(64, 3), supports=under)
        for under in (None, supports(RADIUS))
    )
    inside = plain.alpha == 1
    rows = np.flatnonzero(inside.any(axis=1))
    top, bottom = (np.zeros_like(inside), np.zeros_like(inside))
    top[rows[:5]], bottom[rows[-5:]] = inside[rows[:5]], inside[rows[-5:]]
    assert shaded.radiance[bottom].mean() < 0.87 * plain.radiance[bottom].mean()
    assert shaded.radiance[top].mean() > 0.95 * plain.radiance[top].mean()


@pytest.mark.parametrize("quality", ["preview", paths(16, 2)])
def test_a_table_ends_beside_the_objects_on_it(quality: str | RenderSettings) -> None:
    pose = look_at(tuple(EYE), tuple(CENTRE))
    scene, light = ball(mirror()), split_floor()
    plain = render_objects(scene, CAMERA, pose, light, quality=quality)
    for other, ends in (((2.0, 0.1, 0.0, 0.1), True), ((0.4, 0.1, 0.2, 0.1), False)):
        carrier, end_m = np.zeros(1, np.int32), np.array([0.6], np.float32)
        near = Supports(*FLOOR, np.array([other], np.float32), carrier, end_m, reach_m=1.0)
        beside = render_objects(scene, CAMERA, pose, light, quality=quality, supports=near)
        assert (np.abs(beside.radiance - plain.radiance).max() < 1e-5) == ends


@pytest.mark.parametrize(("quality", "crosses"), [("preview", True), ("preview", False), (paths(256, 2), True)])
def test_light_has_no_step_where_the_table_of_another_object_ends(quality: str | RenderSettings, crosses: bool) -> None:
    """A mirror stands on the floor through the height of a table, or hangs over it; a ball lies on the table."""
    table, floor = (Plane(np.array([0, y, 0]), np.array([0.0, 1, 0])) for y in (0.5, 0.0))
    centre = 0.3, 0.5 if crosses else 1.05, 0.0
    panel = cube(1.0, mirror()).transformed(np.diag([1.0, 1.0, 0.02, 1.0]))
    objects = TracedObjects([moved(sphere(0.1), -0.6, 0.6), moved(panel, *centre)])
    spheres = [np.array([-0.6, 0.6, 0, 0.1]), np.array([*centre, 0.71])]
    supports = supports_of(objects, spheres, [table, floor if crosses else None])
    up = panorama_directions(64)[..., 1:2]
    panorama = np.repeat(np.where(up < -0.5, 0.8, 0.2), 3, axis=2).astype(np.float32)  # a bright patch of table
    light = ProbeSet.single(panorama, (0.0, 0.8, 0.3))
    pose = look_at((0.3, centre[1] + 0.3, 1.6), centre)
    picture = render_objects(objects, CAMERA, pose, light, quality=quality, supports=supports)
    whole = (picture.object_id == 1) & (picture.alpha > 0.999)
    smooth = cv2.GaussianBlur(picture.radiance[..., 0], (0, 0), 1.0)
    whole = cv2.erode(whole.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert whole.sum() > 1000
    along_x = np.abs(np.diff(smooth, axis=1))[whole[:, 1:] & whole[:, :-1]]
    assert along_x.max() < 0.06  # a seam steps by 0.2


def test_a_table_ends_where_an_object_passes_through_its_plane() -> None:
    table = Plane(np.array([0, 0.5, 0]), np.array([0.0, 1, 0]))
    objects = [moved(sphere(0.1), 0, 0.6), moved(cube(0.2), 0.4, 0.5)]
    spheres = [np.array([0, 0.6, 0, 0.1]), np.array([0.4, 0.5, 0, 0.2])]
    alone = supports_of(TracedObjects(objects[:1]), spheres[:1], [table])
    beside = supports_of(TracedObjects(objects), spheres, [table, None])
    assert alone.ends_m[0] == pytest.approx(0.6)
    assert beside.ends_m[0] == pytest.approx(0.3)  # the cube's near face
