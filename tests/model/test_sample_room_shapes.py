"""The sample room's meshes: wound outward, closed where they are solid, of the size asked for."""

import numpy as np
import pytest

from roomlight_model.sample_room import furniture
from roomlight_model.sample_room.shapes import (
    Mesh,
    box,
    cushion,
    faces_look_along_normals,
    lathe,
    rectangle,
    rod,
    sheet,
    sphere,
)


def volume_m3(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    return float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


SOLIDS = {
    "box": box(0.6, 0.4, 0.3, radius=0.02),
    "plank": box(1.0, 0.002, 0.3, radius=0.01),
    "cushion": cushion(0.45, 0.16, 0.4, plump=0.8),
    "rod": rod((0.1, 0.0, 0.2), (0.4, 0.5, -0.1), 0.02, 0.03),
    "ball": sphere(0.2),
    "vase": furniture.vase(0.3, (1.0, 1.0, 1.0))[0],
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_are_wound_outward(name: str) -> None:
    mesh = SOLIDS[name]
    assert faces_look_along_normals(mesh).all()
    assert volume_m3(mesh) > 0
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)


def test_volumes() -> None:
    assert volume_m3(sphere(0.2)) == pytest.approx(4 / 3 * np.pi * 0.2**3, rel=0.03)
    assert volume_m3(box(0.6, 0.4, 0.3, radius=0.002)) == pytest.approx(0.072, rel=0.01)
    assert volume_m3(rod((0, 0, 0), (0, 0, 0.5), 0.02)) == pytest.approx(np.pi * 0.02**2 * 0.5, rel=0.05)
    assert volume_m3(cushion(0.4, 0.16, 0.4, plump=0.8)) < 0.8 * volume_m3(box(0.4, 0.16, 0.4))


@pytest.mark.parametrize("name", ["box", "cushion"])
def test_boxes_are_closed(name: str) -> None:
    """Welded by position, every edge is walked once each way."""
    mesh = SOLIDS[name]
    _, place = np.unique(np.rint(mesh.vertices * 1e5).astype(int), axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    there, counts = np.unique(edges, axis=0, return_counts=True)
    back, counts_back = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    np.testing.assert_array_equal(there, back)
    np.testing.assert_array_equal(counts, counts_back)


def test_a_box_has_its_size_and_stands_on_the_ground() -> None:
    mesh = box(0.6, 0.4, 0.3, radius=0.02)
    np.testing.assert_allclose(mesh.vertices.min(0), [-0.3, 0.0, -0.15], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices.max(0), [0.3, 0.4, 0.15], atol=1e-6)


def test_a_hole_takes_its_area_and_nothing_else() -> None:
    def area(mesh: Mesh) -> float:
        corners = mesh.vertices[mesh.faces]
        return float(
            np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
        )

    wall = rectangle((0, 0, 0), (3, 0, 0), (0, 2, 0), step=0.17, hole=(0.55, 1.3, 0.4, 1.6))
    assert area(wall) == pytest.approx(6 - 0.75 * 1.2, rel=1e-5)
    np.testing.assert_allclose(wall.normals, [[0, 0, 1]] * len(wall.normals), atol=1e-6)
    assert faces_look_along_normals(wall).all()


def test_turning_keeps_shape_and_follows_the_right_hand() -> None:
    mesh = box(0.6, 0.4, 0.3)
    turned = mesh.turned(90).moved(1, 0, 0)
    assert volume_m3(turned) == pytest.approx(volume_m3(mesh), rel=1e-4)
    front = Mesh(np.array([[0, 0, 1]], np.float32), np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((0, 3), int))
    np.testing.assert_allclose(front.turned(90).vertices, [[1, 0, 0]], atol=1e-6)


def test_a_sheet_has_two_sides() -> None:
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 2, 4), [0.0], indexing="xy"), -1)[:, :, 0]
    leaf = sheet(grid.astype(np.float32), thickness=0.01)
    assert faces_look_along_normals(leaf).all()
    assert set(np.rint(leaf.normals[:, 2])) == {-1.0, 1.0}
    assert np.ptp(leaf.vertices[:, 2]) == pytest.approx(0.01, rel=1e-4)


def test_a_lathed_wall_is_a_cylinder() -> None:
    pipe = lathe([[(0.5, 0.0), (0.5, 0.5), (0.5, 1.0)]])
    np.testing.assert_allclose(pipe.normals[:, 1], 0, atol=1e-6)
    assert ((pipe.vertices * pipe.normals).sum(1) > 0.49).all()
