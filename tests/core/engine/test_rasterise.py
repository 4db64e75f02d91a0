"""Rasterised panoramas: what Embree's rays through the pixel centres meet."""

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from roomlight.conventions import panorama_rays
from roomlight.engine.kernels.rasterise import MARGIN, Raster, place_vertices, rasterise
from roomlight.engine.surface.mesh import FrameMesh, empty_raster
from rooms import BoxRoom, camera_at

HEIGHT = 60
ROOM = BoxRoom(block=((-0.6, 0.0, -1.6), (0.5, 1.3, -1.0)))


def rasterised(vertices, faces, position, height=HEIGHT):
    pixels = 2 * height * height
    raster = Raster(
        np.full(pixels, np.inf, np.float32),
        np.full(pixels, -1, np.int32),
        np.zeros((pixels, 2), np.float32),
        np.zeros(pixels, np.int32),
    )
    offsets, places = np.empty((3, len(vertices)), np.float32), np.empty((2, len(vertices)), np.float32)
    place_vertices(vertices, np.asarray(position, float), height, offsets, places)
    numbers = np.arange(len(faces), dtype=np.int32)
    rasterise(faces, numbers, offsets, places, panorama_rays(height), height, raster)
    return raster


def traced(vertices, faces, position, height=HEIGHT):
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, vertices, faces)
    rays = panorama_rays(height)
    origins = np.broadcast_to(np.asarray(position, np.float32), rays.shape).copy()
    return scene.run(origins, rays.copy(), output=1), rays


def assert_same(vertices, faces, position, *, edge_share=0.0, height=HEIGHT):
    """Hits, distances and sides are Embree's; at most `edge_share` of the pixels lie on edges."""
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces, np.int32)
    raster = rasterised(vertices, faces, position, height)
    hits, rays = traced(vertices, faces, position, height)
    ours, theirs = raster.triangle >= 0, hits["primID"] >= 0
    assert (ours != theirs).mean() <= edge_share
    both = ours & theirs
    distance, expected = raster.distance[both], hits["tfar"][both]
    assert (abs(distance / expected - 1) > 1e-3).mean() <= edge_share
    front = (hits["Ng"][both] * rays[both]).sum(axis=-1) < 0
    assert ((raster.front[both] == 1) != front).mean() <= edge_share
    corners = vertices[faces[raster.triangle[both]]]
    v, w = raster.weights[both, :1], raster.weights[both, 1:]
    points = (1 - v - w) * corners[:, 0] + v * corners[:, 1] + w * corners[:, 2]
    along = np.asarray(position, np.float32) + rays[both] * distance[:, None]
    np.testing.assert_allclose(points, along, atol=2e-4 * max(1, abs(points).max()))


@pytest.mark.parametrize("position", [(0.3, 1.5, 1.2), (-0.4, 1.1, -0.6), (0.0, 0.2, -2.2)])
def test_a_frames_mesh_as_embree_traces_it(position):
    mesh = FrameMesh(ROOM.frame(camera_at((0.3, 1.5, 1.2), 8, -6)))
    assert_same(mesh.vertices, mesh.faces, position, edge_share=2e-4, height=120)


@pytest.mark.parametrize("height", [16, 120, 500])
def test_vertices_are_placed_where_their_directions_are(height):
    rng = np.random.default_rng(5)
    vertices = np.concatenate([rng.normal(size=(3000, 3)), 1e-4 * np.eye(3), -1e-4 * np.eye(3)]).astype(np.float32) + 0
    offsets, places = np.empty((3, len(vertices)), np.float32), np.empty((2, len(vertices)), np.float32)
    place_vertices(vertices, np.zeros(3), height, offsets, places)
    x, y, z = vertices.T.astype(float)
    np.testing.assert_allclose(places[0], height * (1 + np.arctan2(z, x) / np.pi), atol=0.1 * float(MARGIN))
    np.testing.assert_allclose(places[1], height / np.pi * np.arctan2(np.hypot(x, z), y), atol=0.1 * float(MARGIN))


@pytest.mark.parametrize("height", [16, 60, 120])
@pytest.mark.parametrize("position", [(0.3, 1.5, 1.2), (0.1, 0.6, -0.6), (0.3, 2.4, 0.9), (0.2, 0.1, 1.1)])
def test_quads_between_pixel_centres_are_left_out_and_no_other(position, height):
    mesh = FrameMesh(ROOM.frame(camera_at((0.3, 1.5, 1.2), 8, -6)))
    every = rasterised(mesh.vertices, mesh.faces, position, height)
    raster, hit = empty_raster(2 * height * height), every.triangle >= 0
    first, after = mesh.rasterise(np.array(position), height, raster)
    for seen, wanted in zip(raster, every, strict=True):
        np.testing.assert_array_equal(seen[hit], wanted[hit])
    np.testing.assert_array_equal(raster.triangle, every.triangle)
    rows = np.flatnonzero(hit.reshape(height, -1).any(axis=1))
    assert first <= rows[0]
    assert rows[-1] < after <= height


def test_quads_at_the_position_are_tested():
    mesh = FrameMesh(ROOM.frame(camera_at((0.3, 1.5, 1.2), 8, -6)))
    vertex = mesh.vertices[len(mesh.vertices) // 2].astype(float)
    seen, every = empty_raster(2 * 60 * 60), rasterised(mesh.vertices, mesh.faces, vertex, 60)
    mesh.rasterise(vertex, 60, seen)
    np.testing.assert_array_equal(seen.triangle, every.triangle)


def test_triangles_of_all_sizes_in_all_directions():
    rng = np.random.default_rng(3)
    centres = rng.normal(size=(300, 1, 3)) * 2
    corners = centres + rng.normal(size=(300, 3, 3)) * rng.choice([0.02, 0.2, 2.0], size=(300, 1, 1))
    assert_same(corners.reshape(-1, 3), np.arange(900).reshape(-1, 3), (0.1, -0.2, 0.3), edge_share=1e-3)


@pytest.mark.parametrize("height_m", [1.0, -1.0])
def test_triangles_over_the_poles_and_across_the_panoramas_edge(height_m):
    small = [(0.3, height_m, 0.2), (-0.2, height_m, 0.3), (0.0, height_m, -0.3)]
    large = [(30.0, 2 * height_m, 20.0), (-20.0, 2 * height_m, 30.0), (0.0, 2 * height_m, -30.0)]
    edge = [(-2.0, -0.3, 0.2), (-2.0, -0.2, -0.3), (-2.0, 0.4, 0.1)]  # -x is at both ends of a row
    assert_same(small + large, [[0, 1, 2], [3, 5, 4]], (0.0, 0.0, 0.0), edge_share=1e-3)
    assert_same(edge, [[0, 1, 2]], (0.0, 0.0, 0.0), edge_share=1e-3)


def test_a_closed_mesh_has_no_holes():
    box = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    for position in ((0.0, 0.0, 0.0), (0.3, -0.7, 0.2)):
        assert (rasterised(box, faces, position).triangle >= 0).all()


def test_a_vertex_at_the_position_and_flat_triangles_are_harmless():
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 0, 1), (2, 1, 0), (2, 2, 0), (2, 3, 0)], np.float32)
    raster = rasterised(vertices, np.array([[0, 1, 2], [3, 4, 5]], np.int32), (0.0, 0.0, 0.0))
    assert np.isfinite(raster.distance[raster.triangle >= 0]).all()
