"""The planner over many rooms: no overlaps, everything inside, doors clear, people can walk."""

import math
from collections import Counter
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from planner_rooms import box_catalogue, random_shell, shell

from roomlight_generator.rooms.furniture import Catalogue
from roomlight_generator.rooms.plan import Gap, Placement, Shell
from roomlight_generator.rooms.planner import ROOM_TYPES, RoomType, free_floor, furnish
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.planner.shell_bodies import shell_bodies
from roomlight_generator.rooms.roles import CEILING_ROLES, ROLES, TOP_ROLES
from roomlight_generator.rooms.scene import Item, Mesh
from roomlight_generator.rooms.shapes import block

SEATS = {"chair", "office_chair", "stool"}
TABLES = {"dining_table", "desk", "side_table"}
NAMES = sorted(ROOM_TYPES)
MAX_TUCK_M = 0.15  # a seat is lower than its table's top, so their boxes may overlap


def make(name: str, seed: int, catalogue: Catalogue | None = None) -> tuple[Shell, tuple[Placement, ...]]:
    room_type = ROOM_TYPES[name]
    rng = np.random.default_rng([seed, NAMES.index(name)])
    kind = "attic" if room_type.p_attic > 0.9 else ("l" if rng.random() < 0.3 else "rectangle")
    empty = random_shell(rng, float(rng.uniform(*room_type.area_m2)), float(rng.uniform(*room_type.aspect)), kind=kind)
    return empty, furnish(empty, room_type, catalogue or box_catalogue(), rng, split=room_type.split)


@cache
def room(name: str, seed: int) -> tuple[Shell, tuple[Placement, ...]]:
    return make(name, seed)


def rooms(*names: str, seeds: int = 3) -> list[tuple[Shell, tuple[Placement, ...]]]:
    return [room(name, seed) for name in names or NAMES for seed in range(seeds)]


def corners(placement: Placement) -> np.ndarray:
    """Return the footprint's corners by the definition of `Mesh.placed`, independent of the planner's boxes."""
    turn = math.radians(placement.degrees)
    c, s = math.cos(turn), math.sin(turn)
    half = np.array([placement.model.width_m, placement.model.depth_m]) / 2
    local = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    turned = np.stack([c * local[:, 0] + s * local[:, 1], c * local[:, 1] - s * local[:, 0]], 1)
    return turned + np.array([placement.x, placement.z])


def depth_of_overlap(first: Placement, second: Placement) -> float:
    """Return the penetration depth of two boxes in metres; 0 if they do not overlap."""
    depth = min(first.y + first.model.height_m, second.y + second.model.height_m) - max(first.y, second.y)
    a, b = corners(first), corners(second)
    for shape in (a, b):
        for edge in (shape[1] - shape[0], shape[2] - shape[1]):
            axis = edge / np.linalg.norm(edge)
            depth = min(depth, (a @ axis).max() - (b @ axis).min(), (b @ axis).max() - (a @ axis).min())
    return max(float(depth), 0.0)


def stands_on(thing: Placement, support: Placement) -> bool:
    top = support.model.top_m
    return thing.model.role in TOP_ROLES and top is not None and abs(thing.y - support.y - top) < 1e-6


def in_second_room(empty: Shell, placement: Placement) -> bool:
    return any(math.hypot(placement.x - x, placement.z - z) < 0.01 for x, z, _ in empty.spots)


@pytest.mark.parametrize("name", NAMES[:4])
def test_bodies_do_not_overlap(name: str) -> None:
    for _, placements in rooms(name):
        solid = [placement for placement in placements if placement.model.role != "rug"]
        reaches = [math.hypot(placement.model.width_m, placement.model.depth_m) / 2 for placement in solid]
        for (placement, reach), (other, across) in combinations(zip(solid, reaches, strict=True), 2):
            if math.hypot(placement.x - other.x, placement.z - other.z) > reach + across:
                continue
            if stands_on(placement, other) or stands_on(other, placement):
                continue
            roles = {placement.model.role, other.model.role}
            allowed = MAX_TUCK_M + 1e-6 if roles & SEATS and roles & TABLES else 0.0011
            assert depth_of_overlap(placement, other) <= allowed, (placement, other)
        for placement, other in combinations(
            [placement for placement in placements if placement.model.role == "rug"], 2
        ):
            assert depth_of_overlap(placement, other) <= 0.0011


@pytest.mark.parametrize("name", NAMES)
def test_everything_is_inside_and_under_the_ceiling(name: str) -> None:
    for empty, placements in rooms(name):
        for placement in placements:
            if in_second_room(empty, placement):
                continue
            for x, z in 0.998 * (corners(placement) - (placement.x, placement.z)) + (placement.x, placement.z):
                assert empty.contains(float(x), float(z)), placement
                assert placement.y + placement.model.height_m <= empty.ceiling_at(float(x), float(z)) + 0.002
            assert placement.model.role in ROLES
            assert placement.y >= 0


@pytest.mark.parametrize("name", NAMES)
def test_doors_and_windows_stay_clear(name: str) -> None:
    for empty, placements in rooms(name):
        for wall in empty.walls:
            direction = (wall.end - wall.start) / wall.length_m
            for gap in wall.gaps:
                clear = gap.keep_clear_m if gap.kind == "door" else 0.3
                for placement in placements:
                    points = corners(placement) - wall.start
                    along, away = points @ direction, points @ wall.inward
                    before = along.max() > gap.start_m + 0.002 and along.min() < gap.end_m - 0.002
                    # The corners of boxes rotated against the wall overestimate their reach: 3 cm of tolerance.
                    near = away.min() < clear - 0.03 and away.max() > 0.002
                    high = placement.y + placement.model.height_m
                    if not (before and near and high > gap.bottom_m + 0.002 and placement.y < gap.top_m):
                        continue
                    body = Body.placed(placement)
                    middle = wall.at((gap.start_m + gap.end_m) / 2, clear / 2 - 0.01)
                    zone = Body.of(
                        float(middle[0]),
                        float(middle[1]),
                        wall.facing_degrees(),
                        width=gap.end_m - gap.start_m,
                        depth=clear - 0.02,
                        low=gap.bottom_m,
                        high=gap.top_m,
                    )
                    allowed = (
                        gap.kind == "window" and not gap.covered and placement.model.role in TOP_ROLES + CEILING_ROLES
                    )
                    assert allowed or not body.overlaps(zone), (gap, placement)


@pytest.mark.parametrize("name", NAMES)
def test_objects_on_top_stand_inside_their_support(name: str) -> None:
    on_top = 0
    for _, placements in rooms(name):
        for thing in placements:
            if thing.model.role not in TOP_ROLES:
                continue
            on_top += 1
            inside = False
            for support in placements:
                if stands_on(thing, support):
                    local = [Body.placed(support).to_local(float(x), float(z)) for x, z in corners(thing)]
                    inside |= all(
                        abs(x) <= support.model.width_m / 2 - 0.005 and abs(z) <= support.model.depth_m / 2 - 0.005
                        for x, z in local
                    )
            assert inside, thing
    assert on_top > 2


@pytest.mark.parametrize("name", NAMES)
def test_people_can_walk(name: str) -> None:
    for empty, placements in rooms(name):
        x, z = empty.polygon.T
        area = abs(float(x @ np.roll(z, -1) - z @ np.roll(x, -1))) / 2
        region = free_floor(empty, placements, radius_m=0.25).largest()
        assert region.swept_m2(0.25) >= 0.3 * area
        for wall in empty.walls:
            for gap in wall.gaps:
                if gap.kind == "door":
                    x0, z0 = wall.at((gap.start_m + gap.end_m) / 2, 0.4)
                    near = np.hypot(*(region.points() - (x0, z0)).T).min()
                    assert near < 0.25


def test_sofas_face_televisions() -> None:
    pairs = 0
    for _, placements in rooms("living_room", "studio"):
        screens = [placement for placement in placements if placement.model.role in ("television", "wall_television")]
        sofas = [placement for placement in placements if placement.model.role == "sofa"]
        if not screens or not sofas:
            continue
        pairs += 1
        screen = screens[0]
        seen = []
        for sofa in sofas:
            toward = math.degrees(math.atan2(screen.x - sofa.x, screen.z - sofa.z))
            off = abs((toward - sofa.degrees + 180) % 360 - 180)
            back = abs((toward + 180 - screen.degrees + 180) % 360 - 180)
            distance = math.hypot(screen.x - sofa.x, screen.z - sofa.z)
            seen.append(off < 15 and back < 15 and 1.7 < distance < 4.4)
        assert any(seen)
    assert pairs >= 2


def test_chairs_face_the_tables_they_stand_at() -> None:
    chairs = 0
    for _, placements in rooms("dining_room", "cafe", "home_office", "open_office"):
        for placement in placements:
            if placement.model.role not in ("chair", "office_chair"):
                continue
            turn = math.radians(placement.degrees)
            reach = placement.model.depth_m / 2 + 0.42
            x, z = placement.x + reach * math.sin(turn), placement.z + reach * math.cos(turn)
            tables = [Body.placed(table) for table in placements if table.model.role in TABLES]
            local = [(table, table.to_local(x, z)) for table in tables]
            at_table = any(abs(a) < t.half_width and abs(b) < t.half_depth for t, (a, b) in local)
            chairs += 1
            assert at_table or not tables or placement.model.role == "chair", placement
    assert chairs > 20


@pytest.mark.slow
def test_beds_and_storage_have_their_backs_to_a_wall() -> None:
    counts: Counter[str] = Counter()
    for empty, placements in rooms("bedroom", "living_room", "children_room", "attic_room", seeds=7):
        for placement in placements:
            if placement.model.role not in ("bed", "child_bed", "wardrobe", "sideboard", "tv_stand"):
                continue
            if in_second_room(empty, placement):
                continue
            counts[placement.model.role] += 1
            turn = math.radians(placement.degrees)
            back = np.array(
                [
                    placement.x - math.sin(turn) * placement.model.depth_m / 2,
                    placement.z - math.cos(turn) * placement.model.depth_m / 2,
                ]
            )
            gaps = [
                float((back - wall.start) @ wall.inward)
                for wall in empty.walls
                if abs((placement.degrees - wall.facing_degrees() + 180) % 360 - 180) < 3
            ]
            low = placement.model.height_m > min(wall.height_m for wall in empty.walls)
            assert min(abs(gap) for gap in gaps) < (0.68 if low else 0.08), placement
    assert min(counts[role] for role in ("bed", "wardrobe", "sideboard", "tv_stand")) >= 3


def test_rooms_hold_the_furniture_of_their_type() -> None:
    needed = {
        "bedroom": {"bed"}, "kitchen": {"kitchen_unit"}, "dining_room": {"dining_table", "chair"},
        "bathroom": {"washbasin", "toilet", "bathtub", "shower"}, "home_office": {"desk", "office_chair"},
        "children_room": {"child_bed"}, "open_office": {"desk", "office_chair"}, "library": {"bookcase"},
        "cafe": {"dining_table", "chair"}, "living_room": {"sofa"}, "studio": {"bed", "kitchen_unit"},
    }  # fmt: skip
    for name, roles in needed.items():
        having = sum(bool(roles & {placement.model.role for placement in placements}) for _, placements in rooms(name))
        assert having >= 2, name


def test_lamps_hang_from_the_ceiling() -> None:
    lamps = 0
    for empty, placements in rooms():
        for placement in placements:
            if placement.model.role in CEILING_ROLES:
                lamps += 1
                lowest = min(empty.ceiling_at(float(x), float(z)) for x, z in corners(placement))
                assert 0 <= lowest - placement.y - placement.model.height_m < 0.02
                over = [
                    Body.placed(table).to_local(placement.x, placement.z)
                    for table in placements
                    if table.model.role in TABLES
                ]
                assert placement.y >= 1.9 or any(abs(x) < 1.2 and abs(z) < 0.7 for x, z in over), placement
    assert lamps > 35


def test_models_follow_the_split_and_types_are_reserved() -> None:
    rng = np.random.default_rng(0)
    empty = random_shell(rng, 20.0, 1.3)
    placements = furnish(empty, ROOM_TYPES["living_room"], box_catalogue(), rng, split="test")
    assert {placement.model.split for placement in placements} == {"test"}
    with pytest.raises(ValueError, match="library is reserved for the test split"):
        furnish(empty, ROOM_TYPES["library"], box_catalogue(), rng, split="train")


@pytest.mark.parametrize(
    "lacking",
    [{"sofa"}, {"television", "wall_television"}, {"chair", "office_chair"}, {"kitchen_unit"}, set(ROLES)],
    ids=lambda roles: min(roles),
)
def test_roles_that_the_catalogue_lacks_are_left_out(lacking: set[str]) -> None:
    catalogue = box_catalogue(lacking)
    for name in ("living_room", "kitchen", "home_office", "bathroom", "library"):
        _, placements = make(name, 1, catalogue)
        assert not lacking & {placement.model.role for placement in placements}


def test_radiators_stand_below_sills() -> None:
    window = Gap("window", 1.0, 2.4, 0.9, 2.1)
    empty = shell(
        [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)], {0: (window,), 2: (Gap("door", 1.0, 1.9, 0.0, 2.0, 0.9),)}
    )
    room_type = RoomType("bare", (), radiators=1.0)
    radiators = 0
    for seed in range(6):
        placements = furnish(empty, room_type, box_catalogue(), np.random.default_rng(seed), split="train")
        for placement in placements:
            if placement.model.role == "radiator":
                radiators += 1
                assert placement.y + placement.model.height_m < 0.9
                assert 1.2 < placement.x < 2.2
                assert placement.z < 0.15
    assert radiators >= 3


def test_pieces_stand_on_the_spots_of_the_second_room() -> None:
    empty = shell([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)], {}, spots=((-1.5, 2.0, 0.5), (-1.5, 3.2, 0.3)))
    outside = 0
    for seed in range(6):
        placements = furnish(empty, ROOM_TYPES["bedroom"], box_catalogue(), np.random.default_rng(seed), split="train")
        for placement in placements:
            if in_second_room(empty, placement):
                outside += 1
                radius = 0.5 if abs(placement.z - 2.0) < 0.01 else 0.3
                assert math.hypot(placement.model.width_m, placement.model.depth_m) / 2 <= radius + 0.001
            else:
                assert empty.contains(placement.x, placement.z)
    assert outside >= 4


def test_furniture_avoids_curtains_beams_and_open_doors() -> None:
    curtain = block(0.08, 2.3, 1.2).placed(0.2, 0.0, 2.0)
    leaf = block(0.8, 2.0, 0.04).placed(3.4, 0.0, 0.5, degrees=40.0)
    beam = block(4.0, 0.2, 0.2).placed(2.0, 2.4, 2.0)
    skirting = block(4.0, 0.1, 0.02).placed(2.0, 0.0, 0.01)
    items = tuple(
        Item(name=role, role=role, mesh=mesh)
        for role, mesh in (("curtain", curtain), ("door_leaf", leaf), ("beam", beam), ("skirting", skirting))
    )
    bare = shell([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)], {}, height=2.6)
    empty = replace(bare, items=items)
    bodies = shell_bodies(empty)
    assert len(bodies) == 3
    assert max(body.half_width * body.half_depth for body in bodies) < 0.25
    lamps = 0
    for seed in range(5):
        placements = furnish(
            empty, ROOM_TYPES["living_room"], box_catalogue(), np.random.default_rng(seed), split="train"
        )
        for placement in placements:
            assert not any(Body.placed(placement).overlaps(body) for body in bodies), placement
            lamps += placement.model.role in CEILING_ROLES
    assert lamps >= 1


def test_a_rafter_is_cut_into_low_boxes() -> None:
    rafter = Mesh.joined([block(0.1, 0.15, 0.1).placed(0.0, 0.0, z) for z in np.arange(-0.95, 1, 0.1).tolist()])
    turn = np.array([[1, 0, 0], [0, np.cos(0.8), -np.sin(0.8)], [0, np.sin(0.8), np.cos(0.8)]], np.float32)
    mesh = rafter.transformed(turn, np.array([2.0, 1.8, 1.5], np.float32))
    bare = shell([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)], {})
    bodies = shell_bodies(replace(bare, items=(Item(name="rafter", role="beam", mesh=mesh),)))
    assert len(bodies) > 4
    assert max(body.high - body.low for body in bodies) < 0.7
