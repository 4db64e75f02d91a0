"""Primitive shapes: outward faces, closed if solid, of the requested size."""

from collections.abc import Callable
from typing import Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_shapes import faces_match_normals, volume_m3

from roomlight_generator.rooms.scene import Mesh
from roomlight_generator.rooms.shapes import block, smooth_normals, sphere

SOLIDS: Final[dict[str, Callable[[], Mesh]]] = {
    "plank": lambda: block(1.0, 0.002, 0.3),
    "block": lambda: block(0.6, 0.4, 0.3),
    "sphere": lambda: sphere(0.2),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_faces_of_solids_point_outward(name: str) -> None:
    mesh = SOLIDS[name]()
    assert faces_match_normals(mesh).all()
    assert volume_m3(mesh.vertices, mesh.faces) > 0
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)


def test_solids_have_their_analytic_volume() -> None:
    globe, box = sphere(0.2), block(0.6, 0.4, 0.3)
    assert volume_m3(globe.vertices, globe.faces) == pytest.approx(4 / 3 * np.pi * 0.2**3, rel=0.03)
    assert volume_m3(box.vertices, box.faces) == pytest.approx(0.072, rel=1e-5)


def test_blocks_are_closed() -> None:
    """After welding by position, every edge occurs once in each direction."""
    mesh = SOLIDS["block"]()
    _, place = np.unique(np.rint(mesh.vertices * 1e5).astype(int), axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    there, counts = np.unique(edges, axis=0, return_counts=True)
    back, counts_back = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    np.testing.assert_array_equal(there, back)
    np.testing.assert_array_equal(counts, counts_back)


@settings(max_examples=25, deadline=None)
@given(size=st.tuples(*[st.floats(0.005, 3.0)] * 3))
def test_a_block_has_its_size_and_stands_on_the_ground(size: tuple[float, float, float]) -> None:
    mesh = block(*size)
    np.testing.assert_allclose(
        mesh.bounds(), [[-size[0] / 2, 0, -size[2] / 2], [size[0] / 2, size[1], size[2] / 2]], atol=1e-5
    )
    assert faces_match_normals(mesh).all()


def test_smooth_normals_agree_across_a_seam() -> None:
    """A sphere's first and last meridians are different vertices at the same positions, also far from the origin."""
    globe = sphere(0.2).placed(3.0, 1.0, -4.0)
    normals = smooth_normals(globe.vertices, globe.faces)
    outward = globe.vertices - np.array([3.0, 1.0, -4.0], np.float32)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    middle = np.abs(outward[:, 1]) < 0.99
    assert ((normals * outward).sum(1)[middle] > 0.99).all()
