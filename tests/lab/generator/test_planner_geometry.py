"""The planner's boxes and its free-floor grid, checked against independent computations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planner_rooms import box_catalogue, model, shell

from roomlight_generator.rooms.plan import Gap, Placement
from roomlight_generator.rooms.planner import free_floor
from roomlight_generator.rooms.planner.arrangement import Arrangement
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.wall_space import free_wall_spans

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]
place = st.floats(-2, 2)
size = st.floats(0.1, 2)
turn = st.floats(-360, 360)


@given(place, place, turn, size, size, turn, size, size)
@settings(max_examples=60, deadline=None)
def test_overlap_agrees_with_sampling(
    x: float, z: float, degrees: float, width: float, depth: float, own: float, own_width: float, own_depth: float
) -> None:
    body = Body.of(0.0, 0.0, own, width=own_width, depth=own_depth, high=1.0)
    other = Body.of(x, z, degrees, width=width, depth=depth, high=1.0)
    grid = np.linspace(-0.999, 0.999, 17)
    hit = False
    for a in grid:
        for b in grid:
            right, front = other.to_local(*body.to_plan(float(a) * body.half_width, float(b) * body.half_depth))
            hit |= abs(right) < other.half_width and abs(front) < other.half_depth
    assert body.overlaps(other) == other.overlaps(body)
    if hit and not body.overlaps(other):
        # Samples may lie within the slack of one millimetre.
        assert not body.overlaps(other, slack_m=0.0) or body.overlaps(other, slack_m=-0.002)
    if not body.overlaps(other, slack_m=0.0):
        assert not hit


def test_stacked_boxes_do_not_overlap() -> None:
    low = Body.of(0.0, 0.0, 0.0, width=1.0, depth=1.0, high=0.5)
    high = Body.of(0.0, 0.0, 30.0, width=1.0, depth=1.0, low=0.5, high=1.0)
    assert not low.overlaps(high)
    assert low.overlaps(Body.of(0.0, 0.0, 0.0, width=1.0, depth=1.0, low=0.4, high=1.0))


def test_crosses_ignores_a_wall_that_only_touches() -> None:
    body = Body.of(0.0, 0.0, 0.0, width=1.0, depth=1.0, high=1.0)
    assert body.crosses([(-2.0, 0.0, 2.0, 0.0)])
    assert body.crosses([(0.0, 0.0, 0.1, 0.1)])
    assert not body.crosses([(-2.0, 0.5, 2.0, 0.5)])
    assert not body.crosses([(0.9, -2.0, 0.9, 2.0)])


def is_free(floor, x: float, z: float) -> bool:
    """Whether the cell nearest to the plan point is free; False outside the grid."""
    return bool((np.abs(floor.points() - (x, z)) <= floor.cell_m / 2).all(axis=1).any())


def test_the_empty_floor_is_free_except_for_the_margin() -> None:
    floor = free_floor(shell(SQUARE, {}), (), radius_m=0.25)
    assert floor.area_m2() == pytest.approx(3.5 * 2.5, rel=0.08)
    assert is_free(floor, 2.0, 1.5)
    assert not is_free(floor, 0.1, 1.5)
    assert not is_free(floor, 9.0, 9.0)
    assert floor.swept_m2(0.25) == pytest.approx(12.0, rel=0.12)
    points = floor.points()
    assert len(points) == floor.free.sum()
    assert points.min() >= 0.25 - 1e-9


def test_free_cells_keep_their_distance_from_furniture() -> None:
    piece = Placement(model("sofa", (1.0, 0.8, 0.6)), 2.0, 0.0, 1.5, 30.0)
    empty = shell(SQUARE, {})
    free = free_floor(empty, (piece,), radius_m=0.3, cell_m=0.05)
    body = Body.placed(piece)
    for x, z in free.points():
        right, front = body.to_local(float(x), float(z))
        assert math.hypot(max(abs(right) - 0.5, 0), max(abs(front) - 0.3, 0)) >= 0.3 - 1e-9
    assert free.area_m2() < free_floor(empty, (), radius_m=0.3, cell_m=0.05).area_m2() - 1.0


@pytest.mark.parametrize(("role", "y", "blocks"), [("rug", 0.0, False), ("picture", 2.0, False), ("sofa", 0.0, True)])
def test_only_bodies_at_a_persons_height_are_obstacles(role: str, y: float, blocks: bool) -> None:
    height = 0.02 if role == "rug" else 0.6
    piece = Placement(model(role, (1.0, height, 1.0)), 2.0, y, 1.5, 0.0)
    assert is_free(free_floor(shell(SQUARE, {}), (piece,), radius_m=0.25), 2.0, 1.5) != blocks


def test_the_largest_region_excludes_cut_off_floor() -> None:
    barrier = Placement(model("wardrobe", (0.3, 2.0, 3.0)), 2.8, 0.0, 1.5, 0.0)
    floor = free_floor(shell(SQUARE, {}), (barrier,), radius_m=0.25)
    assert is_free(floor, 3.5, 1.5)
    assert not is_free(floor.largest(), 3.5, 1.5)
    assert is_free(floor.largest(), 1.0, 1.5)


def test_floor_under_low_slopes_is_not_free() -> None:
    slopes = ((np.array([-1.0, 1.0, 0.0]), 1.0),)
    floor = free_floor(shell(SQUARE, {}, slopes=slopes, wall_heights={3: 1.0}), (), radius_m=0.25)
    assert not is_free(floor, 0.5, 1.5)
    assert is_free(floor, 1.5, 1.5)


def test_free_wall_spans_exclude_gaps_and_furniture() -> None:
    gaps = {0: (Gap("window", 1.0, 2.0, 0.9, 2.0),)}
    arrangement = Arrangement(shell(SQUARE, gaps), box_catalogue(), np.random.default_rng(0), "train")
    assert [
        (span.start_m, span.end_m) for span in free_wall_spans(arrangement, 0.4, low=0.0, high=0.8, walls=(0,))
    ] == [(0.0, 4.0)]
    tall = free_wall_spans(arrangement, 0.4, low=0.0, high=1.8, walls=(0,))
    assert [(span.start_m, span.end_m) for span in tall] == [(0.0, 1.0), (2.0, 4.0)]
    arrangement.place(model("dresser", (0.5, 0.8, 0.4)), 3.0, 0.22, 0.0)
    low = free_wall_spans(arrangement, 0.4, low=0.0, high=0.8, walls=(0,))
    assert [(span.start_m, span.end_m) for span in low] == [(0.0, pytest.approx(2.75)), (pytest.approx(3.25), 4.0)]


def test_a_piece_that_would_cut_off_a_door_is_refused() -> None:
    gaps = {3: (Gap("door", 1.0, 1.9, 0.0, 2.0, keep_clear_m=0.6),)}
    arrangement = Arrangement(shell(SQUARE, gaps), box_catalogue(), np.random.default_rng(0), "train")
    before = len(arrangement.pieces)
    assert arrangement.place(model("wardrobe", (0.3, 2.0, 2.9)), 1.0, 1.5, 0.0) is None
    assert len(arrangement.pieces) == before
    assert arrangement.walkable()
    assert arrangement.place(model("wardrobe", (0.5, 2.0, 1.0)), 2.0, 1.5, 0.0) is not None
