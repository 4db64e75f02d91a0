from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plain_shapes import faces_match_normals

from roomlight.rays import RayTree
from roomlight_generator.rooms.finishes import Finishes, RoomFinishes
from roomlight_generator.rooms.plan import Gap, Shell
from roomlight_generator.rooms.scene import Item, Material, Mesh
from roomlight_generator.rooms.shell import STYLES, CoverKind, ShellStyle, build_shell

ROLES = {
    "wall", "floor", "ceiling", "frame", "sill", "pane", "door_leaf", "skirting", "beam", "curtain", "blind",
    "moulding", "second_room",
}  # fmt: skip

EVERYTHING = ShellStyle(
    area_m2=(10.0, 40.0), l_shape=0.4, alcove=0.4, bay=0.3, chamfer=0.3, chimney_breast=0.3, niche=0.6, slanted=0.3,
    beams=0.4, windows=(2, 5), doors=(0, 3), open_door=0.5, passage=0.5, crown_moulding=0.6, lower_wall_chance=0.5,
    covers=(
        ("none", 0.3), ("open_curtains", 0.26), ("half_curtains", 0.08), ("drawn_curtains", 0.04), ("sheer", 0.06),
        ("sheer_and_curtains", 0.06), ("roller", 0.09), ("roller_down", 0.03), ("venetian", 0.08),
    ),
)  # fmt: skip
"""A style with every feature at a high probability."""

CASES = [(name, seed) for name in [*STYLES, "everything"] for seed in range(6 if name == "everything" else 1)]


def finishes() -> Finishes:
    surfaces = ("wall", "floor", "ceiling", "skirting")
    things = (
        "frame", "door", "door_frame", "handle", "moulding", "beam", "curtain", "blind", "sheer", "translucent_blind",
    )  # fmt: skip
    return Finishes(
        room=RoomFinishes(*map(Material, (*surfaces, "accent", "lower"))),
        second=RoomFinishes(*(Material(f"{name} 2") for name in surfaces)),
        **{name: Material(name) for name in things},
    )


@cache
def shell_of(name: str, seed: int) -> Shell:
    return build_shell(STYLES.get(name, EVERYTHING), finishes(), np.random.default_rng(seed))


def distance_m(items: list[Item], origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    mesh = Mesh.joined([item.mesh for item in items])
    return RayTree(mesh.vertices, mesh.faces, robust=False).trace(origins, directions).distance_m


def inside(shell: Shell, count: int, rng: np.random.Generator) -> np.ndarray:
    points: list[list[float]] = []
    while len(points) < count:
        x, z = (float(v) for v in rng.uniform(shell.polygon.min(0), shell.polygon.max(0)))
        if shell.contains(x, z, 0.02):
            points.append([x, float(rng.uniform(0.02, shell.ceiling_at(x, z) - 0.02)), z])
    return np.array([*points, *([x, 1.5, z] for x, z, _ in shell.spots)])


def through_openings(shell: Shell, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    through = np.zeros(len(origins), bool)
    for opening in shell.openings:
        u, v = opening.edge_u.astype(np.float64), opening.edge_v.astype(np.float64)
        normal = np.cross(u, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (opening.corner - origins) @ normal / (directions @ normal)
        point = origins + directions * t[:, None] - opening.corner
        along, up = point @ u / (u @ u), point @ v / (v @ v)
        # Tolerance of 0.1 % for rounding of the ray's crossing near the hole's edge.
        through |= (t > 0) & (np.abs(along - 0.5) < 0.501) & (np.abs(up - 0.5) < 0.501)
    return through


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), CASES)
def test_light_leaves_through_openings_only(name: str, seed: int) -> None:
    shell = shell_of(name, seed)
    rng = np.random.default_rng(seed)
    opaque = [item for item in shell.items if not all(material.glass for material in item.mesh.materials)]
    origins = np.repeat(inside(shell, 40, rng), 200, axis=0)
    directions = rng.normal(size=origins.shape)
    # Half of the rays are aimed at corners and edges, where panels meet.
    seams = np.concatenate([item.mesh.vertices for item in opaque])
    half = len(origins) // 2
    aimed = seams[rng.integers(len(seams), size=half)] + rng.normal(0, 1e-4, (half, 3))
    directions[:half] = aimed - origins[:half]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    out = np.isinf(distance_m(opaque, origins, directions))
    assert not (out & ~through_openings(shell, origins, directions)).any()
    if shell.openings and name == "everything":
        assert out.any()


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_item_meshes_are_valid(name: str, seed: int) -> None:
    shell = shell_of(name, seed)
    for item in shell.items:
        mesh = item.mesh
        assert item.role in ROLES
        assert np.isfinite(mesh.vertices).all()
        assert np.isfinite(mesh.uvs).all()
        assert mesh.faces.max() < len(mesh.vertices)
        assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1, abs=1e-4)
        assert faces_match_normals(mesh).all(), item.name
    # 10k with folded curtains and blinds.
    assert sum(len(item.mesh.faces) for item in shell.items) < 12000
    assert sum(len(item.mesh.faces) for item in shell.items if item.role not in ("curtain", "blind")) < 6000
    named = [item for item in shell.items if item.role == "wall" and item.name.startswith("wall ")]
    assert [int(item.name.split(",")[0].split()[1]) for item in named] == list(range(len(shell.walls)))


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_walls_follow_the_polygon_clockwise(name: str, seed: int) -> None:
    shell = shell_of(name, seed)
    x, z = shell.polygon.T
    area = 0.5 * float(x @ np.roll(z, -1) - z @ np.roll(x, -1))
    low, high = STYLES.get(name, EVERYTHING).area_m2
    assert low - 1e-6 <= area <= high + 1e-6
    assert len(shell.walls) == len(shell.polygon)
    for i, wall in enumerate(shell.walls):
        assert wall.start == pytest.approx(shell.polygon[i], abs=1e-9)
        assert wall.end == pytest.approx(shell.polygon[(i + 1) % len(shell.polygon)], abs=1e-9)
        direction = (wall.end - wall.start) / wall.length_m
        assert direction == pytest.approx([wall.inward[1], -wall.inward[0]], abs=1e-9)
        assert shell.contains(*(float(v) for v in wall.at(wall.length_m / 2, 0.02)))
        assert 0.2 < wall.height_m <= shell.height_m + 1e-9


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_gaps_lie_in_their_walls_apart_and_clear(name: str, seed: int) -> None:
    shell = shell_of(name, seed)
    for wall in shell.walls:
        last = 0.0
        for gap in wall.gaps:
            assert last - 1e-9 <= gap.start_m < gap.end_m <= wall.length_m
            assert 0 <= gap.bottom_m < gap.top_m
            last = gap.end_m
            for along in (gap.start_m, gap.end_m):
                above = wall.at(along, 0.001)
                assert gap.top_m < shell.ceiling_at(float(above[0]), float(above[1]))
                for away in (0.01, gap.keep_clear_m):
                    x, z = wall.at(along, max(away, 0.01))
                    toward = 0.001 if along == gap.start_m else -0.001
                    x, z = np.array([x, z]) + toward * np.array([wall.inward[1], -wall.inward[0]])
                    assert shell.contains(float(x), float(z))


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_ceiling_meshes_agree_with_ceiling_at(name: str, seed: int) -> None:
    shell = shell_of(name, seed)
    rng = np.random.default_rng(seed)
    points = inside(shell, 60, rng)[:60]
    points[:, 1] = 0.01
    ceilings = [item for item in shell.items if item.name == "ceiling"]
    up = distance_m(ceilings, points, np.tile([0.0, 1.0, 0.0], (len(points), 1))) + 0.01
    known = np.array([shell.ceiling_at(float(x), float(z)) for x, _, z in points])
    # A ray up through a skylight hits nothing.
    hit = np.isfinite(up)
    assert hit.mean() > 0.6
    assert np.abs(up - known)[hit].max() < 0.002


@pytest.mark.parametrize(("name", "seed"), CASES[::4])
def test_spots_are_free_and_outside_the_room(name: str, seed: int) -> None:
    shell = shell_of(name, seed)
    second = [item for item in shell.items if item.role == "second_room"]
    for x, z, radius in shell.spots:
        assert not shell.contains(x, z)
        angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        directions = np.stack([np.cos(angle), np.zeros(16), np.sin(angle)], 1)
        assert distance_m(second, np.tile([x, 0.3, z], (16, 1)), directions).min() > radius


def _covered(kind: CoverKind, seed: int) -> Shell:
    style = ShellStyle(windows=(2, 3), covers=((kind, 1.0),), slanted=0.0, bay=0.0, chamfer=0.0, second_window=0.0)
    return build_shell(style, finishes(), np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("kind", "material"),
    [("sheer", "daylit-curtain"), ("sheer_and_curtains", "daylit-curtain"), ("roller_down", "daylit-blind")],
)
def test_a_fully_covered_window_emits_and_has_no_opening(kind: CoverKind, material: str) -> None:
    for seed in range(6):
        shell = _covered(kind, seed)
        windows = [item for item in shell.items if item.role == "pane"]
        glowing = [m for i in shell.items for m in i.mesh.materials if i.role != "pane" and m.name == material]
        whole = len(windows) - len(shell.openings)
        # A half-lowered translucent blind emits too, and its window keeps its opening.
        assert len(glowing) == (len(windows) if kind == "roller_down" else whole)
        assert whole > 0 or seed > 0
        assert len({id(m) for m in glowing}) == len(glowing)


@pytest.mark.parametrize("kind", ["none", "open_curtains", "half_curtains", "roller", "venetian", "vertical"])
def test_a_partly_covered_window_keeps_its_whole_opening(kind: CoverKind) -> None:
    shell = _covered(kind, 3)
    panes = {item.name for item in shell.items if item.role == "pane"}
    assert len(panes) == len(shell.openings) > 0
    gaps = [gap for wall in shell.walls for gap in wall.gaps if gap.kind == "window"]
    assert any(gap.covered for gap in gaps) == (kind != "none")


def test_daylight_comes_in_through_the_second_rooms_window() -> None:
    """The opening lies beyond the second room, and a ray from outside reaches the second room's floor through it."""
    style = ShellStyle(windows=(0, 0), open_door=0.0, passage=1.0, second_window=1.0, slanted=0.0, skylights=0.0)
    shells = [build_shell(style, finishes(), np.random.default_rng(seed)) for seed in range(8)]
    daylit = [(shell, opening) for shell in shells for opening in shell.openings]
    assert len(daylit) >= 4
    for shell, opening in daylit:
        centre = opening.corner + (opening.edge_u + opening.edge_v) / 2
        assert not shell.contains(float(centre[0]), float(centre[2]))
        second = np.concatenate([item.mesh.vertices for item in shell.items if item.role == "second_room"])
        assert (centre >= second.min(0) - 0.01).all()
        assert (centre <= second.max(0) + 0.01).all()
        glass = [m for i in shell.items if i.role == "second_room" for m in i.mesh.materials if m.glass]
        assert glass


def test_rooms_without_windows_have_a_door() -> None:
    style = replace(STYLES["bathroom"], windows=(0, 0), doors=(0, 0), open_door=0.0, slanted=1.0)
    kinds: set[str] = set()
    for seed in range(10):
        shell = build_shell(style, finishes(), np.random.default_rng(seed))
        assert not shell.openings
        gaps: list[Gap] = [gap for wall in shell.walls for gap in wall.gaps]
        kinds |= {gap.kind for gap in gaps}
        assert sum(gap.kind == "door" for gap in gaps) <= 1
    assert "door" in kinds
    assert "window" not in kinds


def test_every_feature_appears_at_high_probability() -> None:
    seen: set[str] = set()
    kinds: set[str] = set()
    for seed in range(12):
        shell = shell_of("everything", seed)
        seen |= {item.role for item in shell.items} | {m.name for item in shell.items for m in item.mesh.materials}
        kinds |= {gap.kind for wall in shell.walls for gap in wall.gaps}
        seen |= {"slope" for _ in shell.slopes} | {"spot" for _ in shell.spots} | {f"{len(shell.walls)} walls"}
    assert kinds == {"window", "door", "passage", "niche"}
    assert seen > {*ROLES, "slope", "spot", "accent", "lower", "handle", "glass", "4 walls", "6 walls", "8 walls"}
