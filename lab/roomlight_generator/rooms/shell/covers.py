"""Curtains and blinds.

Translucent cloth that covers a whole window has a material of its own, named "daylit-curtain" or "daylit-blind", to
which the lighting gives an emission: the transport has no diffuse transmission. Behind such a cover the hole is closed
at the wall's outer face by the same material, so that gaps beside the cloth glow and no ray leaves the room.
"""

from dataclasses import dataclass, replace

import numpy as np

from roomlight_generator.rooms.finishes import Finishes
from roomlight_generator.rooms.scene import Item, Material
from roomlight_generator.rooms.shapes import grid_faces, smooth_normals
from roomlight_generator.rooms.shell.holes import Cover, Window
from roomlight_generator.rooms.shell.mesh_builder import MeshBuilder, Plane
from roomlight_generator.rooms.shell.polygons import rect

_FOLD_COLUMNS = 7
"""Vertices across one fold."""


def seal_material(cover: Cover, finishes: Finishes) -> Material | None:
    """Return the material that closes a fully covered window, a new object for each; None if it stays open."""
    if not cover.full:
        return None
    if cover.kind == "drawn_curtains":
        return finishes.curtain
    if cover.kind == "roller_down":
        return replace(finishes.translucent_blind, name="daylit-blind")
    return replace(finishes.sheer, name="daylit-curtain")


def cover_items(
    window: Window,
    plane: Plane,
    finishes: Finishes,
    rng: np.random.Generator,
    *,
    near_m: float,
    sealed: Material | None,
    name: str,
) -> list[Item]:
    """Build the curtains or blinds of one window, whose frame begins near_m behind the wall's face."""
    cover = window.cover
    builder = MeshBuilder()
    if sealed is not None:
        builder.back(plane, window.rect, sealed, window.depth_m)
    if cover.kind in ("roller", "roller_down"):
        _roller(window, plane, finishes, near_m, sealed, builder)
    elif cover.kind == "venetian":
        _venetian(window, plane, finishes, near_m, builder)
    elif cover.kind == "vertical":
        _vertical(window, plane, finishes, builder)
    elif cover.curtains:
        _curtains(window, plane, finishes, rng, sealed, builder)
    if not builder:
        return []
    role = "curtain" if cover.curtains else "blind"
    return [Item(f"{role} of {name}", role, builder.mesh())]


def _clearance_m(window: Window) -> float:
    """Return the clearance between a blind and the frame: window handles protrude."""
    return 0.058 if window.design.kind in ("casement", "french") and not window.in_slope else 0.02


def _roller(
    window: Window, plane: Plane, finishes: Finishes, near_m: float, sealed: Material | None, builder: MeshBuilder
) -> None:
    """Build a sheet of cloth in front of the frame, its tube above and a bar at its hem."""
    s0, s1, h0, h1 = window.rect
    cover = window.cover
    cloth = sealed
    if cloth is None and cover.translucent:
        cloth = replace(finishes.translucent_blind, name="daylit-blind")
    cloth = cloth or finishes.blind
    at = near_m - _clearance_m(window)
    low = h1 - cover.share * (h1 - h0 - 0.012)
    builder.panel(plane, rect(s0 + 0.012, s1 - 0.012, low, h1 - 0.03), cloth, depth=at)
    builder.bar(plane, (s0 + 0.006, s1 - 0.006, h1 - 0.045, h1), (at - 0.035, at + 0.012), finishes.frame)
    builder.bar(plane, (s0 + 0.012, s1 - 0.012, low - 0.012, low + 0.012), (at - 0.005, at + 0.005), finishes.frame)


def _venetian(window: Window, plane: Plane, finishes: Finishes, near_m: float, builder: MeshBuilder) -> None:
    """Build tilted slats, a head rail, a bottom rail and two cords; the slats of a raised part are stacked."""
    s0, s1, h0, h1 = window.rect
    cover = window.cover
    pitch = max(cover.pitch_m, (h1 - h0) / 90)
    width_m = 1.15 * pitch
    at = near_m - _clearance_m(window) - width_m / 2
    left, right = s0 + 0.012, s1 - 0.012
    head = h1 - 0.035
    low = head - cover.share * (head - h0 - 0.03)
    total = int((head - h0 - 0.03) / pitch)
    hanging = min(int((head - low) / pitch), total)
    packed = total - hanging
    tilt = np.radians(cover.tilt_degrees)
    half_d, half_h = 0.5 * width_m * float(np.cos(tilt)), 0.5 * width_m * float(np.sin(tilt))
    for n in range(hanging):
        h = head - (n + 0.7) * pitch
        if h - abs(half_h) < h0 + 0.01:
            break
        corners = [
            (left, h - half_h, at - half_d),
            (right, h - half_h, at - half_d),
            (right, h + half_h, at + half_d),
            (left, h + half_h, at + half_d),
        ]
        builder.quad(plane, corners, finishes.blind)
    foot = max(head - hanging * pitch - 0.004 * packed - 0.02, h0 + 0.002)
    boxes = [
        [left, right, head, h1, at - 0.5 * width_m, at + 0.5 * width_m],
        [left, right, foot, foot + 0.018 + 0.004 * packed, at - 0.5 * width_m, at + 0.5 * width_m],
    ]
    for share in (0.12, 0.88):
        s = left + share * (right - left)
        boxes.append([s - 0.0015, s + 0.0015, foot, head, at - 0.5 * width_m - 0.001, at - 0.5 * width_m + 0.001])
    builder.bars(plane, np.array(boxes), finishes.blind)


def _vertical(window: Window, plane: Plane, finishes: Finishes, builder: MeshBuilder) -> None:
    """Build vertical strips on a rail in front of the wall."""
    s0, s1, h0, h1 = window.rect
    pitch = window.cover.pitch_m
    tilt = np.radians(window.cover.tilt_degrees)
    along, out = 0.53 * pitch * float(np.cos(tilt)), 0.53 * pitch * float(np.sin(tilt))
    low, high = max(h0 - 0.08, 0.02), h1 + 0.02
    count = int((s1 - s0 + 0.1) / pitch) + 1
    at = -0.03 - 0.5 * pitch
    for n in range(count):
        s = s0 - 0.05 + (n + 0.5) * (s1 - s0 + 0.1) / count
        corners = [(s - along, low, at - out), (s + along, low, at + out)]
        builder.quad(plane, [*corners, (s + along, high, at + out), (s - along, high, at - out)], finishes.blind)
    builder.bar(plane, (s0 - 0.06, s1 + 0.06, high, high + 0.035), (at - 0.02, at + 0.02), finishes.frame)


def _curtains(
    window: Window,
    plane: Plane,
    finishes: Finishes,
    rng: np.random.Generator,
    sealed: Material | None,
    builder: MeshBuilder,
) -> None:
    """Build cloth on a rod: gathered at the sides, half drawn, or drawn; a sheer curtain hangs behind a thick one."""
    s0, s1, _, h1 = window.rect
    cover = window.cover
    low, high = cover.bottom_m, h1 + cover.lift_m
    left, right = s0 - cover.spread_m + 0.01, s1 + cover.spread_m - 0.01
    middle, width = (s0 + s1) / 2, s1 - s0
    gathered = cover.spread_m + min(0.12 * width, 0.25)
    at = -0.085
    thickness_m = finishes.curtain
    if cover.kind == "half_curtains":
        reach = cover.share * (right - left)
        one_side = rng.random() < 0.4
        spans = [
            (left, left + (reach if one_side else reach / 2)),
            (right - (gathered if one_side else reach / 2), right),
        ]
    elif cover.kind in ("open_curtains", "sheer_and_curtains"):
        spans = [(left, left + gathered), (right - gathered, right)]
    elif cover.kind == "drawn_curtains":
        spans = [(left, middle + 0.03), (middle - 0.03, right)]
    else:
        spans = []
    for start, end in spans:
        # Gathered cloth has narrower folds than drawn cloth.
        pitch = cover.pitch_m * (0.62 if end - start < 0.45 * (right - left) else 1.0)
        _add_cloth(_Cloth((start, end), (low, high), at, pitch), plane, thickness_m, rng, builder)
    if sealed is not None and cover.kind != "drawn_curtains":
        behind = at + 0.05 if spans else at
        cloth = _Cloth((left + 0.01, right - 0.01), (low, high), behind, 0.8 * cover.pitch_m, fold_depth_m=0.014)
        _add_cloth(cloth, plane, sealed, rng, builder)
    _rod(plane, left - 0.04, right + 0.04, high + 0.012, at, finishes.handle, builder)


@dataclass(frozen=True)
class _Cloth:
    """A length of cloth: span along the wall, heights, depth behind its face, width and depth of folds; metres."""

    span: tuple[float, float]
    heights: tuple[float, float]
    depth_m: float
    pitch_m: float
    fold_depth_m: float = 0.032


def _add_cloth(cloth: _Cloth, plane: Plane, material: Material, rng: np.random.Generator, builder: MeshBuilder) -> None:
    """Build one length of cloth with folds about its depth, a single layer that faces the room.

    Folds are no deeper than seven vertices across each can represent; their position and depth vary; the top, with its
    pleats, is narrower than the hem.
    """
    span, heights = cloth.span, cloth.heights
    count = max(2, round((span[1] - span[0]) / cloth.pitch_m))
    pitch = (span[1] - span[0]) / count
    depth_m = min(cloth.fold_depth_m, 0.3 * pitch)
    columns = _FOLD_COLUMNS * count + 1
    t = np.linspace(0.0, 1.0, columns)
    rows = np.array([0.0, 0.06, 0.4, 0.75, 1.0])
    wander = np.cumsum(rng.normal(0, 1, count + 1))
    wander -= np.linspace(wander[0], wander[-1], count + 1)
    phase = 2 * np.pi * count * t + 0.5 * np.interp(t * count, np.arange(count + 1), wander)
    depth = np.interp(t * count, np.arange(count + 1), rng.uniform(0.6, 1.2, count + 1))
    swell = np.array([1.15, 1.1, 1.0, 0.85, 0.6])[:, None]
    drift = (
        0.25 * np.linspace(1, 0, len(rows))[:, None] * np.sin(np.linspace(0, 2.3 * np.pi, columns) + rng.uniform(0, 6))
    )
    sideways = 0.07 * pitch * np.sin(2 * phase)
    local = np.empty((len(rows), columns, 3))
    # The ends are fixed: the cloth must stay within its span.
    ends = np.sin(np.pi * t) ** 0.2
    local[..., 0] = np.clip(span[0] + t * (span[1] - span[0]) + sideways * ends, *span)
    local[..., 1] = (heights[0] + rows * (heights[1] - heights[0]))[:, None]
    local[..., 2] = np.minimum(cloth.depth_m - depth_m * depth * swell * np.sin(phase + drift), -0.004)
    faces = grid_faces(len(rows) - 1, columns - 1)
    world = plane.points(local.reshape(-1, 3))
    normals = smooth_normals(world.astype(np.float32), faces)
    builder.add(world, normals, faces, material)


def _rod(plane: Plane, start: float, end: float, h: float, at: float, metal: Material, builder: MeshBuilder) -> None:
    """Build a round rod with two brackets and end knobs."""
    for low, high, radius in ((start, end, 0.012), (start - 0.03, start, 0.02), (end, end + 0.03, 0.02)):
        angle = np.linspace(0, 2 * np.pi, 9)
        ring = np.stack([np.zeros(9), np.cos(angle), np.sin(angle)], 1)
        local = np.concatenate([radius * ring + [low, h, at], radius * ring + [high, h, at]])
        normals = plane.directions(np.concatenate([ring, ring]))
        k = np.arange(8)
        # (s, h, depth) is left-handed, so the vertex order is reversed to make the faces point outward.
        faces = np.concatenate([np.stack([k, k + 10, k + 1], 1), np.stack([k, k + 9, k + 10], 1)])
        builder.add(plane.points(local), normals, faces, metal)
        for place, sign in ((low, -1.0), (high, 1.0)):
            disc = np.concatenate([[[place, h, at]], radius * ring + [place, h, at]])
            fan = np.stack([np.zeros(8, np.int64), k + 1, k + 2], 1)
            fan = fan if sign < 0 else fan[:, ::-1]
            facing = np.broadcast_to(sign * plane.u, disc.shape)
            builder.add(plane.points(disc), facing, fan, metal)
    for s in (start + 0.05, end - 0.05):
        builder.bar(plane, (s - 0.006, s + 0.006, h - 0.01, h + 0.01), (at, 0.001), metal)
