"""The light transport against closed forms: furnace, lamps, sky, sun, mirrors, panes, depth."""

import numpy as np
import pytest
from plain_shapes import rectangle, room_sides

from roomlight.camera import Intrinsics
from roomlight.conventions import direction_to_uv, panorama_directions, panorama_solid_angles
from roomlight.dataset.recording import GLASS, LIGHT, MIRROR, ORDINARY
from roomlight_generator.rooms.scene import Item, Material, Mesh, Opening, Scene, Sky, Sun
from roomlight_generator.rooms.shapes import block, sphere, with_material
from roomlight_generator.transport import RoomLight, Tracer
from roomlight_generator.transport.kernels.lights import coat_gains
from roomlight_generator.transport.lights.coat import INDEX, ROUGHEST, boundary, coat_table
from roomlight_generator.transport.lights.direct import Points
from roomlight_generator.transport.paths import follow_view, surfaces_of, unit_rows
from roomlight_generator.transport.tracer import OFFSET_M

NIGHT = Sky(np.zeros((32, 64, 3), np.float32))
GREY = Material("grey", (0.5, 0.5, 0.5))
BLACK = Material("black", (0.0, 0.0, 0.0))
CAMERA = Intrinsics(60.0, 60.0, 40.0, 30.0, 80, 60)
SIZE = (4.0, 2.5, 3.0)


def looking_along_minus_z(x=0.0, y=1.2, z=1.0):
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def walls(material, *, without=(), step=0.1):
    """The sides of a room of SIZE, of triangles with edges of `step`."""
    sides = room_sides(*SIZE, step=step)
    return [item(name, side, material) for name, side in sides.items() if name not in without]


def item(name, mesh, material):
    return Item(name, "wall", with_material(mesh, material))


def solved(items, openings=(), sky=NIGHT):
    return RoomLight.solve(Tracer(Scene(tuple(items), tuple(openings), sky)), 0)


def irradiance(light, points, normals):
    """Irradiance (kcd/m2 times steradians) on small planes in space or on surfaces, by many rays a plane."""
    count, normal = len(points), unit_rows(normals)
    position = (points + OFFSET_M * normal).astype(np.float32)
    row = np.full(count, -1, np.int32)  # on no surface: its visibility is unknown
    samples = Points(position, normal, normal, np.zeros(count, np.float32), row, np.arange(count, dtype=np.int64))
    direct = light.light.received(samples, candidates=512, picks=128, sun_picks=64, seed=1)
    return direct.irradiance + light.irradiance_cache.gathered(samples, rays=1024, first=0)[0]


@pytest.mark.slow
@pytest.mark.parametrize("albedo", [0.3, 0.8])
def test_white_furnace(albedo):
    """In a closed room that emits evenly, radiance is e / (1 - a) in every direction at every point."""
    light = solved(walls(Material("glow", (albedo, albedo, albedo), emission=(1.0, 2.0, 0.5)), step=0.25))
    expected = np.array([1.0, 2.0, 0.5]) / (1 - albedo)
    panorama = light.panorama(np.array([0.4, 1.0, 0.3]), 16, seed=0)
    np.testing.assert_allclose(panorama.mean((0, 1)), expected, rtol=0.02)
    assert np.abs(panorama / expected - 1).max() < 0.2
    frame = light.frame(CAMERA, looking_along_minus_z(), seed=0).radiance
    np.testing.assert_allclose(frame.mean((0, 1)), expected, rtol=0.02)


@pytest.mark.slow
def test_a_coat_neither_adds_nor_loses_light():
    """The furnace with coated walls stays within what a linear coat model loses between its layers."""
    light = solved(walls(Material("coated", (0.5, 0.5, 0.5), roughness=0.2, emission=(1.0, 1.0, 1.0)), step=0.25))
    panorama = light.panorama(np.array([0.0, 1.2, 0.0]), 16, seed=0)
    assert 1.7 < panorama.mean() < 2.05
    assert np.abs(panorama / panorama.mean() - 1).max() < 0.25


def test_a_room_without_any_light_is_black():
    light = solved(walls(GREY))
    assert light.panorama(np.array([0.4, 1.0, 0.3]), 16, seed=0).max() == 0


def test_a_small_sphere_lights_by_the_inverse_square():
    radius, glow = 0.05, 40.0
    bulb = Item(
        "bulb",
        "lamp",
        with_material(sphere(radius), Material("b", (0.0, 0.0, 0.0), emission=(glow, glow, glow))).placed(
            0.0, 1.5, 0.0
        ),
    )
    light = solved([*walls(BLACK), bulb])
    points = np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.4], [1.5, 0.0, -1.0]])
    up = np.tile([0.0, 1.0, 0.0], (3, 1))
    away = np.array([0, 1.5, 0]) - points
    distance = np.linalg.norm(away, axis=1)
    expected = np.pi * glow * radius**2 / distance**2 * away[:, 1] / distance
    np.testing.assert_allclose(irradiance(light, points, up)[:, 1], expected, rtol=0.03)


@pytest.mark.slow
def test_a_small_lamp_has_its_energy_and_place_in_a_panorama():
    radius, glow = 0.02, 500.0  # a third of a pixel across
    place = np.array([1.2, 1.9, -0.8])
    shape = with_material(sphere(radius), Material("b", (0.0, 0.0, 0.0), emission=(glow, glow, glow)))
    bulb = Item("bulb", "lamp", shape.placed(*(float(x) for x in place)))
    light = solved([*walls(BLACK), bulb])
    eye = np.array([-0.5, 1.0, 0.3])
    panorama = light.panorama(eye, 60, seed=3)[..., 1]
    away = place - eye
    expected = glow * np.pi * radius**2 / (away @ away)
    energy = panorama * panorama_solid_angles(60)
    assert energy.sum() == pytest.approx(expected, rel=0.04)
    seen = (panorama_directions(60) * energy[..., None]).sum((0, 1)) / energy.sum()
    assert np.degrees(np.arccos(seen @ away / np.linalg.norm(away) / np.linalg.norm(seen))) < 1.5


def window(low=(-0.8, 0.9), high=(0.8, 1.9)):
    """The back wall with a hole, and the hole."""
    (x0, y0), (x1, y1) = low, high
    wall = rectangle([-2, 0, -1.5], [4, 0, 0], [0, 2.5, 0], hole=(x0 + 2, x1 + 2, y0, y1))
    opening = Opening(np.array([x0, y0, -1.5]), np.array([x1 - x0, 0, 0]), np.array([0, y1 - y0, 0]))
    return wall, opening


def test_an_even_sky_in_a_window_is_a_lamp_of_its_shape():
    wall, opening = window()
    sky = Sky(np.full((32, 64, 3), 3.0, np.float32))
    light = solved([*walls(BLACK, without=("back",)), item("back", wall, BLACK)], [opening], sky)
    point = np.array([0.3, 0.0, 0.5])
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 401), np.linspace(0.9, 1.9, 251))
    away = np.stack([x, y, np.full_like(x, -1.5)], -1) - point
    distance = np.linalg.norm(away, axis=-1)
    inner = away[..., 1] / distance * -away[..., 2] / distance / distance**2
    expected = 3.0 * inner.mean() * 1.6
    received = irradiance(light, point[None], np.array([[0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(received[0], expected, rtol=0.03)


def test_a_sunlit_patch_has_the_suns_irradiance_and_its_outline():
    wall, opening = window()
    toward = np.array([0.1, 0.6, -0.8])
    toward /= np.linalg.norm(toward)
    sky = Sky(np.zeros((32, 64, 3), np.float32), Sun(toward, (60.0, 50.0, 40.0)))
    light = solved([*walls(BLACK, without=("back",)), item("back", wall, BLACK)], [opening], sky)
    through = np.array([0.0, 1.4, -1.5])
    lit = through - toward * (1.4 / toward[1])  # where the ray through the window's middle meets the floor
    beside = lit + np.array([1.4, 0, 0])
    up = np.tile([0.0, 1.0, 0.0], (2, 1))
    received = irradiance(light, np.stack([lit, beside]), up)
    np.testing.assert_allclose(received[0], np.array([60.0, 50.0, 40.0]) * toward[1], rtol=0.02)
    assert received[1].max() < 0.01


@pytest.mark.slow
def test_a_mirror_shows_its_surroundings_and_ends_depth():
    card = item("card", rectangle([0.35, 0.75, 0.2], [0.8, 0, 0], [0, 0.8, 0]), Material("c", emission=(0.0, 5.0, 0.0)))
    glass = item("mirror", rectangle([-1.5, 0.2, -1.45], [3, 0, 0], [0, 2, 0]), Material("m", mirror=0.9))
    light = solved([*walls(BLACK), card, glass])
    eye = np.array([0.0, 1.15, 1.0])
    panorama = light.panorama(eye, 60, seed=0)[..., 1]
    image = np.array([0.75, 1.15, -1.45 * 2 - 0.2])  # the card's middle behind the mirror
    u, v = direction_to_uv((image - eye) / np.linalg.norm(image - eye))
    assert panorama[int(v * 60), int(u * 120)] == pytest.approx(4.5, rel=0.02)
    view = light.frame(CAMERA, looking_along_minus_z(z=1.0), seed=0)
    assert view.depth_m[30, 40] == pytest.approx(2.45, abs=1e-3)
    assert view.surface[30, 40] == MIRROR


def test_a_perfect_mirror_shows_a_sunlit_floor():
    """A plane that faces the mirror receives what the sunlit patch's image sends."""
    wall, opening = window()
    sky = Sky(np.zeros((32, 64, 3), np.float32), Sun(np.array([0.0, 0.6, -0.8]), (60.0, 60.0, 60.0)))
    sides = [*walls(BLACK, without=("back", "front", "floor")), item("back", wall, BLACK)]
    floor = item("floor", rectangle([-2, 0, -1.5], [0, 0, 3.0], [4.0, 0, 0]), GREY)
    mirror = item("front", rectangle([-2, 0, 1.5], [0, 2.5, 0], [4, 0, 0]), Material("m", mirror=1.0))
    light = solved([*sides, floor, mirror], [opening], sky)
    # The window casts its light from z = -0.3 to z = 1.033; its image is as far behind the mirror at z = 1.5.
    x, z = np.meshgrid((np.arange(160) + 0.5) / 100 - 0.8, 3 - (np.arange(200) + 0.5) / 150 + 0.3)
    away = np.stack([x, np.zeros_like(x), z], -1) - np.array([0.0, 1.0, 1.0])
    distance_sq = (away**2).sum(-1)
    expected = (0.5 / np.pi * 60 * 0.6 * away[..., 2] / distance_sq**2).mean() * 1.6 * 4 / 3
    received = irradiance(light, np.array([[0.0, 1.0, 1.0]]), np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(received[0], expected, rtol=0.05)


@pytest.mark.slow
def test_depth_is_exact_and_surfaces_are_classified():
    pane = item("pane", rectangle([-2, 1.0, -1.0], [1.2, 0, 0], [0, 1.0, 0]), Material("p", glass=True))
    lamp = item("lamp", rectangle([0.6, 1.0, -1.2], [0.8, 0, 0], [0, 0.8, 0]), Material("l", emission=(2.0, 2.0, 2.0)))
    light = solved([*walls(GREY), pane, lamp])
    view = light.frame(CAMERA, looking_along_minus_z(y=1.25), seed=0)
    assert view.depth_m[30, 40] == pytest.approx(2.5, abs=1e-3)
    assert view.surface[30, 40] == ORDINARY
    assert (view.surface == GLASS).any()
    assert (view.surface == LIGHT).any()
    np.testing.assert_allclose(view.depth_m[view.surface == GLASS], 2.0, atol=2e-3)
    np.testing.assert_allclose(view.depth_m[view.surface == LIGHT], 2.2, atol=2e-3)
    alone = light.depth(CAMERA, looking_along_minus_z(y=1.25))
    assert (np.abs(alone - view.depth_m) < 1e-3).mean() > 0.99  # a ray along an edge may fall to either side


def test_a_pane_lets_light_through():
    wall, opening = window()
    sky = Sky(np.full((32, 64, 3), 3.0, np.float32))
    box = [*walls(BLACK, without=("back",)), item("back", wall, BLACK)]
    pane = item("pane", rectangle([-0.8, 0.9, -1.45], [1.6, 0, 0], [0, 1, 0]), Material("p", glass=True))
    point, up = np.array([[0.0, 0.0, 0.5]]), np.array([[0.0, 1.0, 0.0]])
    bare, glazed = (irradiance(solved(items, [opening], sky), point, up) for items in (box, [*box, pane]))
    np.testing.assert_allclose(glazed, bare, rtol=0.02)


@pytest.mark.slow
def test_the_same_calls_give_the_same_bytes():
    lamp = item("lamp", rectangle([-0.3, 2.4, -0.3], [0.6, 0, 0], [0, 0, 0.6]), Material("l", emission=(8.0, 8.0, 8.0)))
    views = []
    for _ in range(2):
        light = solved([*walls(GREY), lamp])
        frame = light.frame(CAMERA, looking_along_minus_z(), seed=5)
        views.append((frame.radiance.tobytes(), light.panorama(np.array([0.2, 1.0, 0.1]), 24, seed=6).tobytes()))
    assert views[0] == views[1]


@pytest.mark.slow
def test_bounces_between_walls_follow_radiosity():
    """A lamp in a grey closed room: flux in = flux absorbed, so the mean irradiance is flux / (area (1 - albedo))."""
    lamp = rectangle([-0.3, 2.49, -0.3], [0.6, 0, 0], [0, 0, 0.6])
    light = solved([*walls(GREY), item("lamp", lamp, Material("l", (0.0, 0.0, 0.0), emission=(8.0, 8.0, 8.0)))])
    rng = np.random.default_rng(0)
    w, h, d = SIZE
    points, normals = [], []
    for axis, size in enumerate(SIZE):
        for sign in (-1, 1):
            count = round(40 * w * h * d / size / 10)
            place = rng.uniform(-0.5, 0.5, (count, 3)) * SIZE
            place[:, axis] = sign * size / 2
            points.append(place + np.array([0, h / 2, 0]))
            normal = np.zeros((count, 3))
            normal[:, axis] = -sign
            normals.append(normal)
    points, normals = np.concatenate(points), np.concatenate(normals)
    under = (np.abs(points[:, 0]) < 0.31) & (np.abs(points[:, 2]) < 0.31) & (points[:, 1] > 2.4)
    mean_irradiance = irradiance(light, points[~under], normals[~under])[:, 1].mean()
    area = 2 * (w * h + h * d + w * d)
    flux = np.pi * 8.0 * 0.36
    # the lamp's two sides both emit (the upper onto the ceiling right above) and both absorb what falls on them
    assert mean_irradiance == pytest.approx(flux / (area * 0.5), rel=0.12)


def test_vertices_that_are_not_finite_are_refused():
    broken = rectangle([0, 0, 0], [1, 0, 0], [0, 1, 0])
    broken = Mesh(broken.vertices * np.nan, broken.normals, broken.uvs, broken.faces, broken.face_materials, (GREY,))
    with pytest.raises(ValueError, match="'bad' has a vertex that is not a number"):
        Tracer(Scene((Item("bad", "wall", broken),), (), NIGHT))
    with pytest.raises(ValueError, match="one item at least"):
        Tracer(Scene((), (), NIGHT))


def ggx(normal, view, light, alpha):
    """The coat's reflection (GGX, Smith's masking, index 1.5) of a unit of irradiance across its way, in radiance."""
    half = (view + light) / np.linalg.norm(view + light, axis=-1, keepdims=True)
    cos_v, cos_l, cos_h, toward = (np.abs((a * b).sum(-1)) for a, b in
                                   ((view, normal), (light, normal), (half, normal), (half, light)))  # fmt: skip
    spread = alpha**2 / (np.pi * (cos_h**2 * (alpha**2 - 1) + 1) ** 2)
    mask = 4 / ((1 + np.sqrt(1 + alpha**2 * (1 / cos_v**2 - 1))) * (1 + np.sqrt(1 + alpha**2 * (1 / cos_l**2 - 1))))
    inner = np.sqrt(1 - (1 - toward**2) / 1.5**2)
    across, along = (toward - 1.5 * inner) / (toward + 1.5 * inner), (1.5 * toward - inner) / (1.5 * toward + inner)
    return spread * mask * (across**2 + along**2) / 2 / (4 * cos_v)


@pytest.mark.slow
def test_a_coat_reflects_the_sun_about_the_mirrored_direction():
    """The sunlit patch of a black, coated floor lights the opposite wall as the sum over the patch says."""
    wall, opening = window()
    toward = np.array([0.0, 0.6, -0.8])
    sky = Sky(np.zeros((32, 64, 3), np.float32), Sun(toward, (60.0, 60.0, 60.0)))
    coated = Material("coated", (0.0, 0.0, 0.0), roughness=0.25)
    sides = [side for side in walls(BLACK, without=("back",)) if side.name != "floor"]
    floor = item("floor", rectangle([-2, 0, -1.5], [0, 0, 3.0], [4.0, 0, 0]), coated)
    light = solved([*sides, floor, item("back", wall, BLACK)], [opening], sky)
    # The window casts its light from z = -1.5 + 0.9 * 0.8 / 0.6 to z = -1.5 + 1.9 * 0.8 / 0.6.
    x, z = np.meshgrid((np.arange(160) + 0.5) / 100 - 0.8, (np.arange(200) + 0.5) / 150 - 0.3)
    patch = np.stack([x, np.zeros_like(x), z], -1)
    points = np.array([[0.0, 0.5, 1.5], [0.0, 1.0, 1.5], [1.0, 1.6, 1.5]])
    normal = np.array([0.0, 0.0, -1.0])
    expected = []
    for point in points:
        away = point - patch
        distance = np.linalg.norm(away, axis=-1, keepdims=True)
        out = away / distance
        radiance = 60 * ggx(np.array([0.0, 1.0, 0.0]), out, toward, 0.25)
        expected.append((radiance * out[..., 1] * -(out @ normal) / distance[..., 0] ** 2).mean() * 1.6 * 4 / 3)
    received = irradiance(light, points, np.tile(normal, (3, 1)))[:, 1]
    # 3,072 spots and a wall's 512 candidates: 3 % were measured. Spread over all directions, the first would get 0.4.
    np.testing.assert_allclose(received, expected, rtol=0.05)


def test_sunlight_on_coats_between_the_tables_steps_is_interpolated():
    coat, alpha, cosine = coat_table(), 0.43, 0.57
    base, lobe = np.empty(1, np.float32), np.empty(1, np.float32)
    coat_gains(np.array([alpha], np.float32), np.array([cosine], np.float32), coat, base, lobe)
    (passed,) = boundary(alpha, np.array([cosine]), INDEX)[1]
    steps = np.linspace(0, ROUGHEST, len(coat.scale))
    scale, reflected, mean = (np.interp(alpha, steps, row) for row in coat[2:])
    assert base[0] == pytest.approx(scale * passed * mean, rel=0.002)
    assert lobe[0] == pytest.approx((1 - passed) / (np.pi * (1 - mean)) * reflected, rel=0.002)


def test_a_coat_reflects_a_lamp_alike_however_little_of_it_was_seen():
    """The shares of the two samples of a lobe sum to 1 whatever the patches saw of the lamp."""
    floor = item(
        "floor", rectangle([-2, 0, -1.5], [0, 0, 3.0], [4, 0, 0], step=5), Material("c", BLACK.albedo, roughness=0.4)
    )
    lamp = rectangle([-0.6, 0.2, -0.6], [0, 0, 1.2], [1.2, 0, 0], step=5)
    light = solved([floor, item("lamp", lamp, Material("l", emission=(10.0, 10.0, 10.0)))])
    along = np.tile(unit_rows(np.array([[0.0, -0.35, -1.0]])), (200, 1))
    paths = follow_view(light.tracer, np.tile(np.array([[0.0, 0.3, 1.2]], np.float32), (200, 1)), along)
    points = surfaces_of(light.tracer, paths.ends, paths.length_m * np.float32(0.003))
    reflections = []
    for seen in (255, 10):
        light.light.visibility[:] = seen
        reflections.append(light._viewer.reflections.lobes(points, np.arange(200), seed=0))
    assert reflections[0].max() > 0
    np.testing.assert_allclose(*reflections, rtol=1e-4)


def test_a_closed_lamps_inside_does_not_leak_through_a_bulb():
    """Half of a bulb's face lies in a glowing box, in a furnace of 4 / (1 - 0.8) = 20; outside, the rest of it and the
    box's bottom receive little."""
    shade = with_material(block(0.3, 0.06, 0.3), Material("shade", (0.8, 0.8, 0.8), emission=(4.0, 4.0, 4.0)))
    bulb = with_material(sphere(0.04), Material("bulb", (0.8, 0.8, 0.8), emission=(0.5, 0.5, 0.5)))
    lamp = Mesh.joined([shade, bulb.placed(0.0, -0.005, 0.0)]).placed(0.0, 2.0, 0.0)
    light = solved([*walls(BLACK), Item("lamp", "lamp", lamp)])
    rng = np.random.default_rng(0)
    target = np.array([0.0, 2.0, 0.0]) + rng.uniform(-0.06, 0.06, (4000, 3)) * [1, 0, 1]
    origin = np.tile(np.array([[0.2, 0.1, 0.3]], np.float32), (4000, 1))
    away = target - origin
    direction = (away / np.linalg.norm(away, axis=1, keepdims=True)).astype(np.float32)
    face, _, reflected = light.irradiance_cache._seen(origin, direction, 0)
    assert face.min() >= 0
    # 0.25 were measured; what is inside would send 16.
    assert reflected.mean() < 0.5
    assert np.percentile(reflected, 99) < 5
