"""The sample room's light: energy, agreement of independent estimators, no leaks, frames and probes of one radiance."""

from dataclasses import replace

import numpy as np
import pytest

from roomlight.camera import Intrinsics
from roomlight.conventions import direction_to_uv, panorama_directions
from roomlight_model.sample_room import camera_path, room
from roomlight_model.sample_room.light import DiscLight, GlobeLight, Sky, SunLight, WindowLight, frames_about
from roomlight_model.sample_room.render import render_depth, render_frame, render_probe
from roomlight_model.sample_room.scene import Material, Scene
from roomlight_model.sample_room.shapes import Mesh, box, rectangle, sphere
from roomlight_model.sample_room.transport import (
    Indirect,
    bake_indirect,
    direct_irradiance,
    radiance,
    sequence,
)


def closed_room(step: float = 0.5) -> list[Mesh]:
    """An empty 4 x 3 x 2 m room around the origin's floor, all in the material 'wall'."""
    x, h, z = 2.0, 3.0, 1.0
    sides = [
        rectangle((-x, 0, z), (2 * x, 0, 0), (0, 0, -2 * z), step=step),
        rectangle((-x, h, -z), (2 * x, 0, 0), (0, 0, 2 * z), step=step),
        rectangle((-x, 0, -z), (2 * x, 0, 0), (0, h, 0), step=step),
        rectangle((x, 0, z), (-2 * x, 0, 0), (0, h, 0), step=step),
        rectangle((-x, 0, z), (0, 0, -2 * z), (0, h, 0), step=step),
        rectangle((x, 0, -z), (0, 0, 2 * z), (0, h, 0), step=step),
    ]
    return [side.of("wall") for side in sides]


def hemisphere(normal: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Cosine-weighted directions: pi times the mean radiance along them is the irradiance."""
    side, up = frames_about(normal[None].astype(np.float32))
    radius, angle = np.sqrt(rng.random((count, 1))), 2 * np.pi * rng.random((count, 1))
    height = np.sqrt(1 - radius**2)
    return (radius * np.cos(angle) * side + radius * np.sin(angle) * up + height * normal).astype(np.float32)


@pytest.fixture(scope="module")
def sample() -> Scene:
    return room.build_room(detail_m=0.3)


@pytest.fixture(scope="module")
def indirect(sample: Scene) -> Indirect:
    return bake_indirect(sample, rays=12, bounces=4, points_per_face=1)


@pytest.mark.parametrize("albedo", [0.2, 0.6])
def test_white_furnace(albedo: float) -> None:
    """Walls that emit e and reflect rho have radiance e / (1 - rho), furniture or not, from any point."""
    meshes = [*closed_room(), box(0.8, 0.7, 0.5, step=0.2).turned(20).moved(0.3, 0, 0.1).of("wall")]
    scene = Scene.build(meshes, {"wall": Material((albedo,) * 3, emission=(0.7,) * 3)}, lights=(), sky=Sky(scale=0.0))
    indirect = bake_indirect(scene, rays=64, bounces=40)
    directions = panorama_directions(24).reshape(-1, 3)
    origins = np.broadcast_to(np.array([-0.9, 1.4, -0.2], np.float32), directions.shape)
    turn = np.zeros((len(directions), 2))
    seen = radiance(scene, indirect, origins, directions, turn, rng=np.random.default_rng(0))
    # Only rays lost in the crack under the box and 40 bounces' remainder (0.6^41) differ from the exact value.
    np.testing.assert_allclose(seen, 0.7 / (1 - albedo), rtol=5e-3)


def test_a_globe_and_a_disc_give_their_closed_forms() -> None:
    points = np.array([[0.3, 0.1, -0.2], [-1.0, 0.0, 0.4]], np.float32)
    normals = np.array([[0, 1, 0], [0, 1, 0]], np.float32)
    globe = GlobeLight((0.0, 2.0, 0.0), 0.3, (5.0, 4.0, 3.0), samples=64)
    far = [rectangle((-1, 50, 1), (2, 0, 0), (0, 0, -2)).of("wall")]

    def irradiance(light: GlobeLight | DiscLight) -> np.ndarray:
        scene = Scene.build(far, {"wall": Material()}, lights=(light,), sky=Sky())
        return direct_irradiance(scene, points, normals, np.zeros((2, 2)), boost=16)

    offset = np.array([0, 2, 0]) - points
    squared = (offset**2).sum(1)
    expected = np.pi * 0.3**2 / squared * offset[:, 1] / np.sqrt(squared)
    np.testing.assert_allclose(
        irradiance(globe), expected[:, None] * [5, 4, 3], rtol=2e-3
    )  # 1024 low-discrepancy samples
    disc = DiscLight((0.3, 1.1, -0.2), 0.5, (2.0, 2.0, 2.0), up=False, samples=64)
    on_axis = np.pi * 2 * 0.5**2 / (0.5**2 + 1.0**2)
    np.testing.assert_allclose(irradiance(disc)[0], on_axis, rtol=2e-3)
    assert irradiance(replace(disc, up=True)).max() == 0


@pytest.mark.parametrize(
    ("point", "normal"),
    [((0.4, 0.02, 0.9), (0, 1, 0)), ((1.6, 1.9, -1.99), (0, 0, 1)), ((2.49, 1.0, 0.5), (-1, 0, 0))],
)
def test_shadow_rays_agree_with_gathering(sample: Scene, point: tuple, normal: tuple) -> None:
    """All lights but the sun, from floor, wall beside the lamp and wall opposite: two estimators, one irradiance."""
    rng = np.random.default_rng(4)
    lights = tuple(light for light in sample.lights if not isinstance(light, SunLight))
    count = 400
    points = np.broadcast_to(np.array(point, np.float32), (count, 3))
    normals = np.broadcast_to(np.array(normal, np.float32), (count, 3))
    scene = replace(sample, lights=lights)
    sampled = direct_irradiance(scene, points, normals, rng.random((count, 2)), boost=2).mean(0)
    directions = hemisphere(np.array(normal, np.float32), 300_000, rng)
    hits = scene.trace(np.broadcast_to(points[:1], directions.shape), directions)
    arriving = scene.sky.radiance(directions)
    emission = np.array([one.emission if one.found_by_samples else (0, 0, 0) for one in scene.materials])
    on = hits.face >= 0
    arriving[on] = emission[scene.face_material[hits.face[on]]]
    # 300,000 rays of which a few per cent meet a light: a standard error of about 1.5 %.
    np.testing.assert_allclose(sampled, np.pi * arriving.mean(0), rtol=0.05)


def test_the_sun_lights_the_floor_by_its_cosine_and_only_in_the_beam(sample: Scene) -> None:
    sun = SunLight(sample.sky)
    direction = np.array(sample.sky.sun_direction)
    through = np.array([0.8, 1.9, -room.HALF_Z_M])  # a pane, clear of its bars
    lit = through - direction * through[1] / direction[1]
    points = np.array([lit + np.array([0, 0.02, 0]), [1.5, 0.02, 1.5]], np.float32)
    normals = np.array([[0, 1, 0], [0, 1, 0]], np.float32)
    received = direct_irradiance(replace(sample, lights=(sun,)), points, normals, np.full((2, 2), 0.3), boost=32)
    np.testing.assert_allclose(received[0], np.array(room.SUN_IRRADIANCE) * direction[1], rtol=0.01)
    assert received[1].max() == 0
    for probe in camera_path.PROBES_M:  # a probe in the beam would hold the sun itself
        blocked = sample.visible(
            np.array([probe], np.float32), direction[None].astype(np.float32), np.full(1, 1e4, np.float32)
        )
        assert not blocked[0]


def test_light_enters_by_the_window_only(sample: Scene) -> None:
    """Every ray that leaves the room, from many points in all directions, leaves through the opening."""
    directions = panorama_directions(160).reshape(-1, 3)
    window = next(light for light in sample.lights if isinstance(light, WindowLight))
    for position in (*camera_path.PROBES_M, *camera_path.poses(31)[::6, :3, 3]):
        origins = np.broadcast_to(np.asarray(position, np.float32), directions.shape)
        out = directions[sample.trace(origins, directions).face < 0]
        assert len(out) > 50
        assert (out[:, 2] < 0).all()
        at = np.asarray(position) + out * ((window.z_m - position[2]) / out[:, 2])[:, None]
        assert (at[:, 0] >= window.x_m[0]).all()
        assert (at[:, 0] <= window.x_m[1]).all()
        assert (at[:, 1] >= window.y_m[0]).all()
        assert (at[:, 1] <= window.y_m[1]).all()


def test_depth_is_along_the_axis() -> None:
    """In an empty box room every depth is known: the nearest of five planes, whatever the tilt."""
    scene = Scene.build(closed_room(), {"wall": Material()}, lights=(), sky=Sky())
    camera = Intrinsics(60.0, 60.0, 40.0, 30.0, 80, 60)
    pose = camera_path.poses(7)[2]
    pose[:3, 3] = [0.2, 1.4, 0.1]
    depth = render_depth(scene, camera, pose)
    rays = camera.rays().astype(np.float64) @ pose[:3, :3].T  # z = -1 in the camera: the factor is the z-depth
    low, high = np.array([-2.0, 0.0, -1.0]), np.array([2.0, 3.0, 1.0])
    expected = np.max(np.stack([(low - pose[:3, 3]) / rays, (high - pose[:3, 3]) / rays]), axis=0).min(-1)
    np.testing.assert_allclose(depth, expected, rtol=1e-4)


def test_what_is_outside_has_no_depth(sample: Scene) -> None:
    camera = camera_path.intrinsics(64, 48)
    poses = camera_path.poses(31)
    none = [(render_depth(sample, camera, pose) == 0).mean() for pose in poses[[0, 12, 15, 18, 30]]]
    assert none[0] == none[-1] == 0
    assert min(none[1:-1]) > 0.08


def test_a_probe_at_the_camera_shows_the_frame(sample: Scene, indirect: Indirect) -> None:
    pose = camera_path.poses(31)[16]
    camera = camera_path.intrinsics(48, 36)
    frame = render_frame(sample, indirect, camera, pose, samples=8)
    panorama = render_probe(sample, indirect, pose[:3, 3], height=112, samples=4)
    directions = camera.rays() @ pose[:3, :3].T.astype(np.float32)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    uv = direction_to_uv(directions)
    seen = panorama[(uv[..., 1] * 112).astype(int), (uv[..., 0] * 224).astype(int)]
    error = np.abs(seen - frame) / (frame + 0.05)
    # Both pixels are 1.2 to 1.6 degrees wide but lie apart by up to half that; a lamp's edge differs, its middle not.
    assert np.median(error) < 0.05
    assert abs(np.log(np.minimum(seen, 1).mean() / np.minimum(frame, 1).mean())) < 0.02


def test_diffuse_points_look_the_same_from_frame_and_probe(sample: Scene, indirect: Indirect) -> None:
    camera = camera_path.intrinsics(32, 24)
    pose = camera_path.poses(31)[0]
    probe = np.array(camera_path.PROBES_M[0], np.float32)
    depth = render_depth(sample, camera, pose)
    points = ((depth[..., None] * camera.rays()).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)

    def toward(origin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        offset = points - origin.astype(np.float32)
        distance = np.linalg.norm(offset, axis=1)
        return np.broadcast_to(origin.astype(np.float32), points.shape), offset / distance[:, None], distance

    eyes, rays, _ = toward(pose[:3, 3])
    probes, back, distance = toward(probe)
    hits = sample.trace(probes, back)
    gloss = np.array([one.gloss for one in sample.materials])
    use = (np.abs(hits.distance_m - distance) < 1e-3) & (gloss[sample.face_material[hits.face]] == 0)
    assert use.sum() > 150
    turn = np.random.default_rng(1).random((len(points), 2))

    def seen(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(2)
        total = [
            radiance(sample, indirect, origins[use], directions[use], turn[use], rng=rng, pass_index=at)
            for at in range(4)
        ]
        return np.mean(total, axis=0)

    error = np.abs(seen(eyes, rays) - seen(probes, back)) / (seen(eyes, rays) + 0.02)
    # The same point by two rays differs by rounding only, except at an edge, where the rays meet two things.
    assert np.median(error) < 1e-3
    assert np.percentile(error, 95) < 0.03


def test_sequence_continues_over_passes_and_stays_in_the_unit_square() -> None:
    turn = np.random.default_rng(0).random((3, 2))
    whole = sequence(0, 8, turn)
    np.testing.assert_array_equal(np.concatenate([sequence(0, 4, turn), sequence(4, 4, turn)], axis=1), whole)
    assert whole.min() >= 0
    assert sequence(0, 4096, np.zeros((1, 2))).mean() == pytest.approx(0.5, abs=1e-3)


def test_an_unknown_material_is_named() -> None:
    with pytest.raises(KeyError, match="marble"):
        Scene.build([sphere(0.2).of("marble")], {"wall": Material()}, lights=(), sky=Sky())
