import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_shapes import faces_match_normals, volume_m3

from roomlight_generator.rooms.scene import Material
from roomlight_generator.rooms.shell.mesh_builder import MeshBuilder, Plane
from roomlight_generator.rooms.shell.outline import choose_outline, envelope, offset_outline
from roomlight_generator.rooms.shell.polygons import OVERLAP, area, difference, intersection, rect, triangles
from roomlight_generator.rooms.shell.style import ShellStyle

WALL = Plane(np.array([1.0, 0.0, 2.0]), np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0]))
GREY = Material("grey")

spans = st.tuples(st.floats(0.0, 3.0), st.floats(0.2, 3.0)).map(lambda pair: (pair[0], pair[0] + pair[1]))


@given(spans, spans, spans, spans)
@settings(max_examples=60, deadline=None)
def test_difference_and_intersection_add_up_to_the_piece(
    a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]
) -> None:
    piece, hole = rect(*a, *b), rect(*c, *d)
    common = intersection(piece, hole)
    left = sum(area(part) for part in difference([piece], hole))
    taken = area(common) if common else 0.0
    # Pieces overlap the hole and each other by at most OVERLAP along the lines of the hole's four edges.
    assert -1e-6 <= left - (area(piece) - taken) < 4 * OVERLAP * 6.3 + 1e-6


@pytest.mark.parametrize("seed", range(40))
def test_triangulation_preserves_area(seed: int) -> None:
    style = ShellStyle(l_shape=0.5, alcove=0.4, bay=0.3, chimney_breast=0.4, chamfer=0.4)
    corners = choose_outline(style, np.random.default_rng(seed))
    pieces = triangles(corners)
    assert sum(area(piece) for piece in pieces) == pytest.approx(area(corners))
    assert style.area_m2[0] - 1e-6 <= area(corners) <= style.area_m2[1] + 1e-6
    assert all(area(piece) > 0 for piece in pieces)
    assert len(pieces) == len(corners) - 2
    assert area(offset_outline(tuple(corners), 0.01)) > area(corners)
    size = np.ptp(np.array(corners), axis=0)
    assert np.abs(np.array(corners).max(0) - size / 2).max() < 1e-9


def test_self_crossing_and_clockwise_outlines_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot be triangulated"):
        triangles([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)])
    with pytest.raises(ValueError, match="clockwise"):
        envelope([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)], 2.5, ())


def test_bars_are_closed_and_face_outward() -> None:
    builder = MeshBuilder()
    builder.bar(WALL, (0.0, 0.5, 1.0, 1.2), (-0.1, 0.2), GREY)
    mesh = builder.mesh()
    assert volume_m3(mesh.vertices, mesh.faces) == pytest.approx(0.5 * 0.2 * 0.3, rel=1e-4)
    assert faces_match_normals(mesh).all()


def test_the_sides_of_a_hole_face_its_middle() -> None:
    builder = MeshBuilder()
    builder.tube(WALL, rect(1.0, 2.0, 0.5, 1.5), (0.0, 0.3), GREY)
    mesh = builder.mesh()
    toward = WALL.at(1.5, 1.0, 0.15) - mesh.vertices[mesh.faces].mean(1)
    assert (np.einsum("fi,fi->f", toward, mesh.normals[mesh.faces[:, 0]]) > 0).all()
    assert faces_match_normals(mesh).all()


@pytest.mark.parametrize(("mitre", "length"), [(1.0, 1.96), (-1.0, 2.04), (None, 2.0)])
def test_swept_profiles_are_mitred_or_capped(mitre: float | None, length: float) -> None:
    builder = MeshBuilder()
    builder.swept(WALL, [(0.02, 0.0), (0.02, 0.1), (0.0, 0.1)], (0.0, 2.0), (mitre, mitre), GREY)
    mesh = builder.mesh()
    along = (mesh.vertices - WALL.origin) @ WALL.u
    front = (mesh.vertices - WALL.origin) @ WALL.normal > 0.019
    assert np.ptp(along[front]) == pytest.approx(length, abs=1e-4)
    assert faces_match_normals(mesh).all()


def test_empty_meshes_and_impossible_styles_are_refused() -> None:
    with pytest.raises(ValueError, match="nothing was added"):
        MeshBuilder().mesh()
    with pytest.raises(ValueError, match="area_m2"):
        ShellStyle(area_m2=(9.0, 4.0))
    with pytest.raises(ValueError, match="height"):
        ShellStyle(height_m=(1.5, 3.0))
