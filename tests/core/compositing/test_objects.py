"""Meshes, objects and the shapes made from formulas."""

from collections.abc import Callable

import numpy as np
import pytest

from present import present
from roomlight.compositing.objects.materials import mirror
from roomlight.compositing.objects.primitives import chair, cube, plane, sphere, vase
from roomlight.compositing.objects.teapot import teapot
from roomlight.compositing.objects.virtual_object import TriangleMesh, VirtualObject
from roomlight.errors import ObjectError

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
FACE = np.array([[0, 1, 2]])


def _volume(one: VirtualObject) -> float:
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh, _ in one.parts]).astype(float)
    return float(np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


@pytest.mark.parametrize("one", [sphere(0.5), cube(1.0), vase(), chair(), teapot(), plane(1.0, 2.0)])
def test_faces_and_normals_point_outward_together(one: VirtualObject) -> None:
    for mesh, _ in one.parts:
        a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
        flat = np.cross(b - a, c - a)
        agree = np.einsum("fi,fi->f", flat, mesh.normals[mesh.faces].mean(axis=1)) > 0
        assert agree.mean() > 0.99
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_the_teapot_has_the_proportions_of_its_control_points() -> None:
    pot = teapot(3.15, parts=16)
    low, high = pot.bounds()
    np.testing.assert_allclose(low, [-3.0, 0, -2.0], atol=0.02)
    np.testing.assert_allclose(high, [3.434, 3.15, 2.0], atol=0.02)
    ((mesh, _),) = pot.parts
    beside = np.abs(mesh.vertices[:, 2]) < 1e-6
    body = mesh.vertices[beside & (np.abs(mesh.vertices[:, 1] - 0.9) < 1e-5)]
    assert body[:, 0].max() == pytest.approx(2.0, abs=1e-5)
    spout_and_handle = (np.abs(mesh.vertices[:, 0]) > 2.3) & (np.abs(mesh.vertices[:, 2]) > 0.1)
    spout_and_handle &= mesh.vertices[:, 1] < 2.0  # above is the inside of the spout's lip
    assert (mesh.normals[:, 2] * mesh.vertices[:, 2])[spout_and_handle].min() > 0
    radial = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 2])
    outside = (radial > 1.9) & (np.abs(mesh.vertices[:, 0]) < 1.0)
    assert (np.einsum("ni,ni->n", mesh.normals, mesh.vertices * [1, 0, 1])[outside] > 0).all()


@pytest.mark.parametrize("one", [sphere(0.5), vase()])
def test_textures_go_round_without_a_fold(one: VirtualObject) -> None:
    ((mesh, _),) = one.parts
    u = mesh.uvs[mesh.faces][..., 0]
    assert np.ptp(u, axis=1).max() < 0.13  # faces at a pole span an eighth
    np.testing.assert_allclose([u.min(), u.max()], [0, 1], atol=1e-6)


@pytest.mark.parametrize("one", [vase(0.4), chair(0.9), teapot(0.9)])
def test_furnishings_stand_on_the_ground(one: VirtualObject) -> None:
    low, high = one.bounds()
    assert low[1] == pytest.approx(0, abs=1e-6)
    assert high[1] == pytest.approx(0.4 if one.name == "vase" else 0.9, rel=0.01)


@pytest.mark.parametrize(
    "make", [sphere, cube, vase, chair, teapot, lambda size: plane(size, 1.0), lambda size: plane(1.0, size)]
)
def test_shapes_without_a_size_are_refused(make: Callable[[float], VirtualObject]) -> None:
    for size in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ObjectError, match="_m must be a positive number"):
            make(size)
        with pytest.raises(ObjectError, match="size_m"):
            cube(1.0).scaled_to(size)
    dot = VirtualObject("dot", ((TriangleMesh.build(np.zeros((3, 3)), FACE), mirror()),))
    with pytest.raises(ObjectError, match="no extent"):
        dot.scaled_to(1.0)
    for parts in (1, 65):
        with pytest.raises(ObjectError, match="parts must be 2 to 64"):
            teapot(parts=parts)


def test_scaling_sets_the_longest_side() -> None:
    low, high = plane(2.0, 8.0).scaled_to(0.5).bounds()
    np.testing.assert_allclose(high - low, [0.125, 0, 0.5], atol=1e-6)


def test_closed_shapes_have_their_volume_in_a_mirror_image_too() -> None:
    assert _volume(sphere(1.0)) == pytest.approx(4 / 3 * np.pi, rel=0.003)
    assert _volume(cube(2.0)) == pytest.approx(8, rel=1e-5)
    assert 0 < _volume(vase(1.0)) < np.pi * 0.3**2
    assert _volume(vase(1.0).transformed(np.diag([-1.0, 1, 1, 1]))) == pytest.approx(_volume(vase(1.0)), rel=1e-4)


def test_normals_follow_the_inverse_transpose() -> None:
    ((mesh, _),) = sphere(1.0).transformed(np.diag([1.0, 0.25, 1, 1])).parts
    expected = mesh.vertices / np.array([1, 0.0625, 1])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(mesh.normals, expected, atol=1e-4)


@pytest.mark.parametrize(
    ("transform", "message"),
    [(np.diag([1.0, 0, 1, 1]), "flattens"), (np.diag([1.0, 1, 1, 2]), "last row"), (np.full((4, 4), np.nan), "NaN")],
)
def test_unusable_transforms_are_refused(transform: np.ndarray, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        cube(1.0).transformed(transform)


@pytest.mark.parametrize(
    ("points", "faces", "message"),
    [
        (POINTS, np.zeros((0, 3), int), "one triangle at least"),
        (POINTS, np.array([[0, 1, 3]]), "point at vertices"),
        (POINTS, np.array([[0, -1, 2]]), "point at vertices"),
        (POINTS * np.nan, FACE, "finite"),
        (POINTS * 1e9, FACE, "check the unit"),
    ],
)
def test_broken_meshes_are_refused(points: np.ndarray, faces: np.ndarray, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        TriangleMesh.build(points, faces)


def test_object_without_a_part_is_refused() -> None:
    with pytest.raises(ObjectError, match="no surface"):
        VirtualObject("nothing", ())


def test_tangents_follow_growing_u() -> None:
    ((mesh, _),) = plane(1.0, 1.0).parts
    tangents = present(mesh.with_tangents().tangents)
    np.testing.assert_allclose(tangents[:, :3], [[1, 0, 0]] * 4, atol=1e-6)
    # glTF: the bitangent cross(n, t) w points up the image, toward -z here
    bitangent = np.cross(mesh.normals, tangents[:, :3]) * tangents[:, 3:]
    np.testing.assert_allclose(bitangent, [[0, 0, -1]] * 4, atol=1e-6)


def test_tangents_do_not_cross_the_seam_of_a_mirrored_texture() -> None:
    points = np.array([[x, y, 0.0] for y in (0, 1) for x in (-1, 0, 1)])
    uvs = np.array([[abs(x), 1 - y] for x, y, _ in points])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    mesh = TriangleMesh.build(points, faces, uvs=uvs).with_tangents()
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], points[faces])
    tangents = present(mesh.tangents)[mesh.faces]
    # u grows away from the seam on both sides; the image's top is at +y of both
    np.testing.assert_allclose(tangents[:2], np.tile([-1.0, 0, 0, -1], (2, 3, 1)), atol=1e-6)
    np.testing.assert_allclose(tangents[2:], np.tile([1.0, 0, 0, 1], (2, 3, 1)), atol=1e-6)


def test_material_replaces_those_of_all_parts() -> None:
    shiny = mirror()
    assert all(material is shiny for _, material in chair().with_material(shiny).parts)
