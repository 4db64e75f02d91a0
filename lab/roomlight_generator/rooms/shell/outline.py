"""The floor outline and the ceiling over it: rectangles and L shapes with alcoves, bays, cut corners, chimney breasts,
and slopes.

Plan coordinates (x, z), metres. Outlines run clockwise seen from above (x to the right, z down the page), which is
counter-clockwise in (x, z) coordinates: z grows to the left of a side's direction.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.shell.mesh_builder import Plane
from roomlight_generator.rooms.shell.polygons import OVERLAP, Point, area, clip_half_plane
from roomlight_generator.rooms.shell.style import ShellStyle, uniform

_UP: Final = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Slope:
    """A slanted ceiling: n . (x, y, z) = d with n upward; in its plane h is up the slope from the knee wall's top."""

    normal: Float[np.ndarray, "3"]
    offset: float
    plane: Plane
    length_m: float
    rise_m: float
    """Height from the knee wall's top up the slope to the flat ceiling."""

    def height_at(self, x: float, z: float) -> float:
        """Return its height over a plan point."""
        return float((self.offset - self.normal[0] * x - self.normal[2] * z) / self.normal[1])


@dataclass(frozen=True, eq=False)
class Side:
    """A straight side of the outline as a wall plane: s from its start, h over the floor."""

    plane: Plane
    length_m: float
    outline: tuple[Point, ...]
    """(s, h) of its corners, cut by the slopes, without overlaps."""
    turn_before: float
    turn_after: float
    """Cotangent of half the inner angle at its start and end: 1 in a right-angled corner, -1 around an outer one."""

    def footprint(self, s0: float, s1: float, near: float, far: float, *, flare: float = 0.0) -> list[Point]:
        """Return a plan rectangle along it from s0 to s1, between two depths behind it (negative: in the room),
        wider at each end by `flare` metres on its far side."""
        ends = [(s0, near), (s0 - flare, far), (s1 + flare, far), (s1, near)]
        points = self.plane.points(np.array([(s, 0.0, depth) for s, depth in ends]))
        return [(float(x), float(z)) for x, _, z in points]

    def height_at(self, s: float) -> float:
        """Return the ceiling height above the wall at s."""
        best = np.inf
        for i, (s0, h0) in enumerate(self.outline):
            s1, h1 = self.outline[(i + 1) % len(self.outline)]
            if s1 < s0 - 1e-9 and s1 - 1e-9 <= s <= s0 + 1e-9:
                best = min(best, h0 + (s - s0) * (h1 - h0) / (s1 - s0))
        return float(best)

    @property
    def least_height_m(self) -> float:
        """Minimum height of its top edge."""
        return float(min(h for _, h in self.outline if h > 1e-6))


@dataclass(frozen=True, eq=False)
class Envelope:
    """Outline and ceiling of a room, from which its walls, floor and ceiling are derived."""

    corners: tuple[Point, ...]
    height_m: float
    slopes: tuple[Slope, ...]
    sides: tuple[Side, ...]

    def ceiling_at(self, x: float, z: float) -> float:
        """Return the ceiling height over a plan point."""
        return min([self.height_m, *(slope.height_at(x, z) for slope in self.slopes)])


def choose_outline(style: ShellStyle, rng: np.random.Generator) -> list[Point]:
    """Choose an outline with an area in the style's range, the centre of its bounding rectangle at the origin.

    Features have sizes of their own, so the main rectangle is chosen to compensate for their area; a feature that does
    not fit in a small room is left out.
    """
    target = uniform(rng, style.area_m2)
    aspect = uniform(rng, style.aspect)
    wants_l = rng.random() < style.l_shape
    wants = {name: rng.random() < getattr(style, name) for name in ("alcove", "bay", "chamfer", "chimney_breast")}
    cut = (uniform(rng, (0.3, 0.55)), uniform(rng, (0.25, 0.5)))
    share = 1 - cut[0] * cut[1] if wants_l else 1.0
    short = float(np.sqrt(target / share / aspect))
    if min(short * (1 - cut[1]), short * aspect * (1 - cut[0])) < max(style.least_width_m, 1.5):
        wants_l, share = False, 1.0
    features = _choose_features(wants, short * aspect, short, rng)
    extra = sum(feature.area_m2 for feature in features)
    base = (target - extra) / share
    aspect = min(aspect, base / style.least_width_m**2)
    depth = float(np.sqrt(base / aspect))
    width = base / depth
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)]
    if wants_l:
        x, z = width * (1 - cut[0]), depth * (1 - cut[1])
        corners = [(0.0, 0.0), (width, 0.0), (width, z), (x, z), (x, depth), (0.0, depth)]
    corners = _with_features(corners, features, width)
    return _randomly_oriented(corners, rng)


@dataclass(frozen=True)
class _OutlineFeature:
    """A feature on the first side (z = 0): the corners that replace part of it, and the floor area they add."""

    kind: str
    width_m: float
    depth_m: float
    place: float

    @property
    def area_m2(self) -> float:
        sign = {"alcove": 1.0, "bay": 1.0, "chimney_breast": -1.0, "chamfer": -0.5}[self.kind]
        inset = min(self.depth_m, self.width_m / 4) if self.kind == "bay" else 0.0
        return sign * (self.width_m - inset) * self.depth_m


def _choose_features(
    wants: dict[str, bool], width: float, depth: float, rng: np.random.Generator
) -> list[_OutlineFeature]:
    """Choose at most one feature on the first side, and a cut corner at its end."""
    features: list[_OutlineFeature] = []
    place = float(rng.random())
    if wants["bay"] and width > 3.0 and depth > 2.6:
        features.append(
            _OutlineFeature("bay", uniform(rng, (1.9, min(3.0, width - 0.9))), uniform(rng, (0.5, 0.9)), 0.5)
        )
    elif wants["chimney_breast"] and width > 3.0 and depth > 2.8:
        features.append(_OutlineFeature("chimney_breast", uniform(rng, (1.1, 1.6)), uniform(rng, (0.25, 0.5)), place))
    elif wants["alcove"] and width > 2.0:
        features.append(
            _OutlineFeature("alcove", uniform(rng, (0.8, min(2.4, 0.62 * width))), uniform(rng, (0.35, 0.9)), place)
        )
    elif wants["chamfer"] and min(width, depth) > 2.4:
        size = uniform(rng, (0.7, 1.2))
        features.append(_OutlineFeature("chamfer", size, size, 1.0))
    return features


def _with_features(corners: list[Point], features: list[_OutlineFeature], width: float) -> list[Point]:
    for feature in features:
        low = 0.35
        start = low + feature.place * max(width - feature.width_m - 2 * low, 0.0)
        end, depth_m = start + feature.width_m, feature.depth_m
        if feature.kind == "chamfer":
            return [corners[0], (width - depth_m, 0.0), (width, depth_m), *corners[2:]]
        if feature.kind == "bay":
            start = (width - feature.width_m) / 2
            end, inset = start + feature.width_m, min(depth_m, feature.width_m / 4)
            cut = [(start, 0.0), (start + inset, -depth_m), (end - inset, -depth_m), (end, 0.0)]
        else:
            z = -depth_m if feature.kind == "alcove" else depth_m
            cut = [(start, 0.0), (start, z), (end, z), (end, 0.0)]
        corners = [corners[0], *cut, *corners[1:]]
    return corners


def _randomly_oriented(corners: list[Point], rng: np.random.Generator) -> list[Point]:
    """Rotate by a multiple of 90 degrees, mirror with probability one half, and centre on the origin."""
    points = np.array(corners)
    if rng.random() < 0.5:
        points = points[::-1] * np.array([-1.0, 1.0])
    for _ in range(int(rng.integers(4))):
        points = np.stack([-points[:, 1], points[:, 0]], 1)
    points = points - (points.max(0) + points.min(0)) / 2
    return [(float(x), float(z)) for x, z in points]


def choose_envelope(style: ShellStyle, rng: np.random.Generator) -> Envelope:
    """Choose outline, height and slopes."""
    corners = choose_outline(style, rng)
    height = uniform(rng, style.height_m)
    slanted, both = rng.random() < style.slanted, rng.random() < style.two_slopes
    slopes = _choose_slopes(corners, height, both, rng) if slanted else []
    return envelope(corners, height, tuple(slopes))


def envelope(corners: list[Point], height: float, slopes: tuple[Slope, ...]) -> Envelope:
    """Derive the walls from an outline and a ceiling.

    Raises:
        ValueError: the outline runs counter-clockwise seen from above.
    """
    if area(corners) <= 0:
        raise ValueError(f"the outline has an area of {area(corners):.2f} m2: it must run clockwise seen from above")
    points = np.array(corners)
    sides: list[Side] = []
    for i in range(len(points)):
        start, end = points[i], points[(i + 1) % len(points)]
        before, after = points[i - 1], points[(i + 2) % len(points)]
        length = float(np.linalg.norm(end - start))
        u = np.array([(end - start)[0], 0.0, (end - start)[1]]) / length
        plane = Plane(np.array([start[0], 0.0, start[1]]), u, _UP)
        outline = [(0.0, 0.0), (length, 0.0), (length, height), (0.0, height)]
        for slope in slopes:
            outline = clip_half_plane(outline, *wall_cut(slope, plane))
        sides.append(
            Side(plane, length, tuple(outline), _half_cotangent(before, start, end), _half_cotangent(start, end, after))
        )
    return Envelope(tuple(corners), height, slopes, tuple(sides))


def wall_cut(slope: Slope, plane: Plane, slack: float = 0.0) -> tuple[float, float, float]:
    """Return (a, b, c): in a wall's plane, a s + b h <= c is below the slope (up to slack metres above it allowed)."""
    along = float(slope.normal @ plane.u)
    up = float(slope.normal[1])
    return along / up, 1.0, (slope.offset - float(slope.normal @ plane.origin)) / up + slack


def _half_cotangent(
    before: Float[np.ndarray, "2"], corner: Float[np.ndarray, "2"], after: Float[np.ndarray, "2"]
) -> float:
    """Return the cotangent of half the inner angle at a corner."""
    a, b = corner - before, after - corner
    turn = float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))
    return float(np.tan(turn / 2))


def _choose_slopes(corners: list[Point], height: float, both: bool, rng: np.random.Generator) -> list[Slope]:
    """Choose one slope over a side that spans a whole side of the bounding rectangle, or two over opposite sides."""
    points = np.array(corners)
    size = points.max(0) - points.min(0)
    whole: list[int] = []
    for i in range(len(points)):
        step = points[(i + 1) % len(points)] - points[i]
        axis = int(np.argmax(np.abs(step)))
        edge = points[i][1 - axis]
        on_edge = edge in (points[:, 1 - axis].min(), points[:, 1 - axis].max())
        if abs(step[axis]) > size[axis] - 1e-6 and on_edge:
            whole.append(i)
    if not whole:
        return []
    # Roofs mostly slope down toward the long sides.
    weights = np.array([float(np.linalg.norm(points[(i + 1) % len(points)] - points[i])) ** 2 for i in whole])
    first = int(rng.choice(whole, p=weights / weights.sum()))
    direction = points[(first + 1) % len(points)] - points[first]
    opposite = [i for i in whole if float((points[(i + 1) % len(points)] - points[i]) @ direction) < 0 and i != first]
    pitch, knee = uniform(rng, (30.0, 52.0)), uniform(rng, (0.5, 1.5))
    chosen = [first, opposite[0]] if both and opposite else [first]
    return [
        _slope_over(points, i, height, pitch, knee, (0.44 if len(chosen) == 2 else 0.72) * float(size.min()))
        for i in chosen
    ]


def _slope_over(
    points: Float[np.ndarray, "n 2"], i: int, height: float, pitch: float, knee: float, run_m: float
) -> Slope:
    """Return the slope from the knee wall on side i to the ceiling; the knee is raised if it would run too far."""
    start, end = points[i], points[(i + 1) % len(points)]
    length = float(np.linalg.norm(end - start))
    u = np.array([end[0] - start[0], 0.0, end[1] - start[1]]) / length
    inward = np.array([-u[2], 0.0, u[0]])
    c, s = float(np.cos(np.radians(pitch))), float(np.sin(np.radians(pitch)))
    knee = max(knee, height - run_m * s / c)
    origin = np.array([start[0], knee, start[1]])
    normal = c * _UP - s * inward
    plane = Plane(origin, u, c * inward + s * _UP)
    return Slope(normal, float(normal @ origin), plane, length, (height - knee) / s)


def offset_outline(corners: tuple[Point, ...], by_m: float) -> list[Point]:
    """Move every side of the outline outward."""
    points = np.array(corners)
    moved_points: list[Point] = []
    for i, corner in enumerate(points):
        a, b = corner - points[i - 1], points[(i + 1) % len(points)] - corner
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
        out_a, out_b = np.array([a[1], -a[0]]), np.array([b[1], -b[0]])
        moved = corner + by_m * (out_a + out_b) / (1 + float(out_a @ out_b))
        moved_points.append((float(moved[0]), float(moved[1])))
    return moved_points


OUTER_MARGIN_M: Final = 2 * OVERLAP
"""How far floors and ceilings extend below and over the walls."""
