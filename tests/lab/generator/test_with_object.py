"""Rooms with a real object: where it can stand, and what it changes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from present import present
from roomlight.camera import Intrinsics
from roomlight_generator.rooms.scene import Item, Material, Scene, Sky
from roomlight_generator.rooms.shapes import bare_mesh, grid_faces, with_material
from roomlight_generator.sequences.with_object import (
    find_resting_place,
    height_above_surface,
    render_pair,
)
from roomlight_generator.transport import RoomLight, Tracer

GREY, LAMP = Material("grey", (0.5, 0.5, 0.5)), Material("lamp", (0.0, 0.0, 0.0), emission=(10.0, 10.0, 10.0))
CAMERA = Intrinsics(50.0, 50.0, 40.0, 30.0, 80, 60)
SIZE = (4.0, 2.5, 4.0)


def cuboid(size, centre, material):
    """A box of triangles of ten centimetres, as the walls of generated rooms have them: light is kept by patches."""
    vertices, normals, faces = [], [], []
    for side in range(6):
        axis, sign = side // 2, 1 - 2 * (side % 2)
        first, second = (axis + 1) % 3, (axis + 2) % 3
        rows, columns = (max(1, round(size[along] / 0.1)) for along in (second, first))
        points = np.empty((rows + 1, columns + 1, 3))
        points[..., axis] = sign / 2
        points[..., second], points[..., first] = np.mgrid[
            -0.5 : 0.5 : (rows + 1) * 1j, -0.5 : 0.5 : (columns + 1) * 1j
        ]
        faces.append(grid_faces(rows, columns)[:, ::sign] + sum(len(part) for part in vertices))
        vertices.append(points.reshape(-1, 3) * size + centre)
        normals.append(np.tile(sign * np.eye(3)[axis], (len(vertices[-1]), 1)))
    mesh = bare_mesh(np.concatenate(vertices), np.concatenate(normals), np.concatenate(faces))
    return with_material(mesh, material)


def room():
    """A closed room, floor at 0, with a lamp under the ceiling."""
    items = (
        Item("shell", "wall", cuboid(SIZE, (0, SIZE[1] / 2, 0), GREY)),
        Item("lamp", "lamp", cuboid((0.4, 0.02, 0.4), (0, 2.4, 0), LAMP)),
    )
    return Scene(items, (), Sky(np.zeros((32, 64, 3), np.float32)))


def looking_down():
    """A pose at 1.5 m, 1.5 m from the middle, that looks at the middle of the floor."""
    pose, c = np.eye(4), np.sqrt(0.5)
    pose[:3, :3] = [[1, 0, 0], [0, c, c], [0, -c, c]]
    pose[:3, 3] = 0, 1.5, 1.5
    return pose


def cube_of(material, centre=(0, 0.2, 0)):
    return cuboid((0.4, 0.4, 0.4), centre, material)


@pytest.mark.slow
@pytest.mark.parametrize("material", [Material("matte", (0.1, 0.1, 0.1)), Material("mirror", mirror=1.0)])
def test_an_object_covers_pixels_and_shades_the_floor(material):
    made, covered, before = render_pair(room(), cube_of(material), CAMERA, looking_down(), seed=0)
    nearer = made.depth_m < before.depth_m - 0.02
    assert covered.sum() > 100
    assert (nearer == covered).mean() > 0.98
    ratio = made.radiance.mean(axis=-1) / before.radiance.mean(axis=-1)
    beside = (np.roll(covered, 2, axis=1) | np.roll(covered, -2, axis=1)) & ~covered
    beside[: covered.nonzero()[0].max() - 4] = False  # at the object's foot
    assert ratio[beside].mean() < 0.95
    far = np.zeros_like(covered)
    far[:, :8] = True
    assert ratio[far].mean() == pytest.approx(1, abs=0.05)


def lamp_behind_a_screen():
    """A room whose light comes from a small bright patch of the wall."""
    shade = Item("screen", "wall", cuboid((0.02, 0.5, 0.5), (-1.75, 1.2, 0), GREY))
    lamp = Item("lamp", "lamp", cuboid((0.04, 0.2, 0.2), (-1.9, 1.2, 0), LAMP))
    return Scene((room().items[0], shade, lamp), (), room().sky)


def difference(first, second):
    """Mean absolute difference of two pictures, in logarithms of light smoothed over pixels."""
    smooth = [np.log(cv2.blur(picture.mean(axis=-1), (5, 5))) for picture in (first, second)]
    return float(np.abs(smooth[0] - smooth[1]).mean())


@pytest.mark.slow
def test_precise_views_have_no_blotches():
    scene = lamp_behind_a_screen()

    def blotches(*, precise):
        views = [
            RoomLight.solve(Tracer(scene), seed, precise=precise).frame(CAMERA, looking_down(), seed=seed)
            for seed in (0, 1)
        ]
        return difference(*(view.radiance for view in views))

    assert blotches(precise=True) < 0.75 * blotches(precise=False)  # 0.62: the patches' own light has noise too


@pytest.mark.slow
def test_a_pair_shares_its_noise():
    """An object out of sight behind the camera hardly changes the light: what differs is noise."""
    scene, mesh = lamp_behind_a_screen(), cube_of(GREY, centre=(1.7, 0.1, 1.7))
    made, covered, bare = render_pair(scene, mesh, CAMERA, looking_down(), seed=0)
    assert not covered.any()
    other = RoomLight.solve(Tracer(scene), 1, precise=True).frame(CAMERA, looking_down(), seed=1)
    assert difference(made.radiance, bare.radiance) < 0.75 * difference(other.radiance, bare.radiance)  # 0.61


def test_resting_places_are_level_and_free():
    scene, rng = room(), np.random.default_rng(0)
    tracer = Tracer(scene)
    place = present(find_resting_place(tracer, CAMERA, looking_down(), rng, radius_m=0.15, height_m=0.2))
    assert place.point[1] == pytest.approx(0, abs=1e-4)
    ray = np.array([(place.u + 0.5 - CAMERA.cx) / CAMERA.fx, -(place.v + 0.5 - CAMERA.cy) / CAMERA.fy, -1])
    hit = looking_down()[:3, :3] @ ray
    hit = looking_down()[:3, 3] - hit * 1.5 / hit[1]
    assert hit == pytest.approx(place.point, abs=1e-3)
    assert height_above_surface(tracer, np.add(place.point, [0, 0.02, 0])) == pytest.approx(0.02, abs=1e-4)


@pytest.mark.slow
def test_an_object_without_room_has_no_place():
    crowded = [cube_of(GREY, (x, 0.2, z)) for x in np.arange(-1.75, 1.8, 0.5) for z in np.arange(-1.75, 1.8, 0.5)]
    scene = replace(room(), items=(*room().items, *(Item("cube", "cube", mesh) for mesh in crowded)))
    rng = np.random.default_rng(0)
    assert find_resting_place(Tracer(scene), CAMERA, looking_down(), rng, radius_m=0.3, height_m=0.2) is None
