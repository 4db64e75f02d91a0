"""Welding, simplification and shading of library geometry, and heights of supporting surfaces."""

import numpy as np
import pytest
from furniture_files import BOX_FACES, sphere_obj
from plain_shapes import area_m2

from roomlight.compositing.objects.polygons import corner_normals, face_normals
from roomlight_generator.rooms.furniture.files.obj import parse_obj
from roomlight_generator.rooms.furniture.simplify import TriangleSoup, simplified, welded
from roomlight_generator.rooms.furniture.support_height import measure_top_m
from roomlight_generator.rooms.scene import Mesh
from roomlight_generator.rooms.shapes import block, lathe


def soup_of(points, faces, *, uvs=None, uv_faces=None, materials=None):
    faces = np.asarray(faces, np.int64).reshape(-1, 3)
    return TriangleSoup(
        np.asarray(points, np.float64),
        np.zeros((1, 2)) if uvs is None else np.asarray(uvs, np.float64),
        faces,
        np.zeros_like(faces) if uv_faces is None else uv_faces,
        np.zeros(len(faces), np.int64) if materials is None else np.asarray(materials, np.int64),
    )


def grid(n, *, seam=False, split=False):
    """Return a flat square of n x n quads, textured by its x and z, optionally with a seam along the middle."""
    x, z = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    points = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], 1)
    at = np.arange(x.size).reshape(n + 1, n + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, 1:].ravel(), at[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])
    right = points[faces].mean(1)[:, 0] > 0.5
    uvs = np.concatenate([points[:, [0, 2]], points[:, [0, 2]] + [5, 0]])
    uv_faces = faces + len(points) * right[:, None] if seam else faces
    return soup_of(points, faces, uvs=uvs, uv_faces=uv_faces, materials=right if split else None)


def area(soup):
    return area_m2(soup.points, soup.faces).sum()


def sphere_soup(rings=60, segments=90):
    obj = parse_obj(sphere_obj(rings, segments).encode(), "sphere")
    return welded(soup_of(obj.positions, obj.faces))


def test_of_coincident_triangles_the_outer_one_is_kept():
    quad = np.array(BOX_FACES) - 1
    corners = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)], float)
    outward = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    points = np.concatenate([corners, corners + 1e-8])  # the same positions with other indices
    both = np.concatenate([outward[:, ::-1] + 8, outward, [[0, 0, 1], [2, 2, 2]]])
    clean = welded(soup_of(points, both))
    assert len(clean.points) == 8
    assert len(clean.faces) == 12
    facing = face_normals(clean.points, clean.faces)
    assert ((clean.points[clean.faces].mean(1) - 0.5) * facing).sum(1).min() > 0


def test_a_sphere_keeps_its_shape_with_a_tenth_of_triangles():
    soup = sphere_soup()
    fewer = simplified(soup, 1000)
    assert len(soup.faces) > 10_000
    assert 800 < len(fewer.faces) <= 1000
    # Vertices are a subset; a chord of a sphere with 1,000 triangles sags by less than 2 %.
    np.testing.assert_allclose(np.linalg.norm(fewer.points[np.unique(fewer.faces)], axis=1), 1, atol=1e-5)
    assert area(fewer) == pytest.approx(area(soup), rel=0.02)
    normals = corner_normals(fewer.points, fewer.faces).reshape(-1, 3, 3)
    assert (fewer.points[fewer.faces] * normals).sum(2).min() > 0.95
    flat = face_normals(fewer.points, fewer.faces)
    assert (fewer.points[fewer.faces].mean(1) * flat).sum(1).min() > 0


@pytest.mark.parametrize("kind", ["seam", "split"])
def test_seams_and_material_borders_are_preserved(kind):
    fewer = simplified(grid(40, **{kind: True}), 200)
    corners = fewer.points[fewer.faces]
    assert len(fewer.faces) <= 200
    assert area(fewer) == pytest.approx(1.0, abs=1e-9)
    left, right = corners[..., 0].min(1) < 0.5 - 1e-9, corners[..., 0].max(1) > 0.5 + 1e-9
    assert not (left & right).any()
    if kind == "split":
        np.testing.assert_array_equal(fewer.materials.astype(bool), right)
    else:
        shift = np.where(right, 5, 0)[:, None]
        np.testing.assert_allclose(fewer.uvs[fewer.uv_faces][..., 0] - shift, corners[..., 0], atol=1e-9)
        np.testing.assert_allclose(fewer.uvs[fewer.uv_faces][..., 1], corners[..., 2], atol=1e-9)


def test_foliage_is_thinned_at_constant_area():
    rng = np.random.default_rng(3)
    count = 6000
    base = rng.uniform(-1, 1, (count, 1, 3))
    quad = rng.normal(0, 0.02, (count, 2, 3))
    leaves = np.concatenate([base, base + quad[:, :1], base + quad[:, :1] + quad[:, 1:], base + quad[:, 1:]], 1)
    first = 4 * np.arange(count)[:, None]
    faces = np.concatenate([np.add(first, [0, 1, 2]), np.add(first, [0, 2, 3])])
    soup = soup_of(leaves.reshape(-1, 3), faces)
    fewer = simplified(soup, 2000)
    assert 1000 < len(fewer.faces) <= 2600
    assert area(fewer) == pytest.approx(area(soup), rel=0.2)
    assert (fewer.points.min(0) >= soup.points.min(0)).all()
    assert (fewer.points.max(0) <= soup.points.max(0)).all()


def test_a_table_has_a_supporting_surface_and_a_cone_has_none():
    assert measure_top_m(block(1, 0.75, 0.6), listed_m=None) == pytest.approx(0.75, abs=0.001)
    assert measure_top_m(lathe([[(0.3, 0.0), (0.001, 1.0)]]), listed_m=1.0) is None


def test_a_listed_height_is_used_if_a_surface_is_there():
    low, ridge = block(1, 0.5, 1), block(1, 0.9, 0.04).placed(0.0, 0.0, -0.48)
    mesh = Mesh.joined([low, ridge])
    assert measure_top_m(mesh, listed_m=0.5) == pytest.approx(0.5)
    assert measure_top_m(mesh, listed_m=0.3) == pytest.approx(0.5, abs=0.01)
    hutch = Mesh.joined([low, block(1, 0.9, 0.4).placed(0.0, 0.0, -0.3)])
    assert measure_top_m(hutch, listed_m=0.5) is None
