"""Places for virtual objects: by position, by pose, or on the surface that a pixel shows.

Object frame: metres, y up, +z is the front (glTF's axes). World: metres, y up. A placement is the rigid transform
between them. The anchor of an object is the point of its bounding box that is put onto the place: the middle of the
bottom face on floors and tables, of the back face on walls, of the top face under ceilings.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from roomlight.camera import check_rigid, transform_points
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.errors import SceneError
from roomlight.frame import MAX_POSITION_M, Frame
from roomlight.placement import depth_pixel, nearest_with_depth

Anchor = Literal["base", "back", "top", "centre", "origin"]
"""Point that is placed: middle of the bounding box's bottom, back or top face, of the box, or (0, 0, 0)."""
SurfaceKind = Literal["floor", "wall", "ceiling", "slope"]

SNAP_DEGREES: Final = 10.0
"""A surface this close to horizontal or vertical counts as exactly so: an object that leans is seen at once. In eight
captures a tenth of the small places on level surfaces was tilted by more than 5 degrees, and 4 % by more than 10."""
LEVEL_ESTIMATED_DEGREES: Final = 50.0
"""Where depth is estimated whole floors come out tilted: a surface this close to horizontal is level, others upright.
What is level faces up below the camera, down above it. At 2,800 pixels of 12 captures 78 % of the floors and 88 % of
the walls are told right; with planes fitted as to a sensor's depth and a `SNAP_DEGREES` of 40, 67 % and 84 %."""
UP_FACING: Final = 0.5
"""World y of the normal above which a surface carries objects, and below whose negative it is a ceiling."""
FIT_RADIUS_M: Final = (0.06, 0.25)
"""Least and largest radius of the patch that a plane is fitted to: the object's footprint, within these. The largest
where depth is estimated."""
ESTIMATED_TOLERANCE: Final = 8.0
"""Points of a plane lie within this many times a sensor's noise where depth is estimated."""
SUPPORT_WITHIN_M: Final = 0.04
SUPPORT_TOLERANCE_M: Final = 0.015
"""An object at a position or pose rests on a surface this near, whose points are this close to a plane."""
SUPPORT_ESTIMATED: Final = 4.0
SUPPORT_ESTIMATED_DEGREES: Final = 30.0
"""Where depth is estimated both are this many times as large, and the surface leans by up to this, not `SNAP_DEGREES`.
Without it pictures on walls lost up to 60 % of their pixels behind their own wall."""
_LEAST_POINTS: Final = 8
_TRIPLES: Final = 96
_MAX_FITTED: Final = 3000


@dataclass(frozen=True)
class Plane:
    """A plane: a point and the unit normal that points away from the solid, world metres."""

    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def height_of(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Return signed distances in metres, positive on the normal's side."""
        return np.asarray((points - self.point.astype(points.dtype)) @ self.normal.astype(points.dtype))


@dataclass(frozen=True)
class Box:
    """Bounding box of an object in its own frame, metres."""

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]

    @property
    def footprint_m(self) -> float:
        """Half the diagonal of the bottom face."""
        size = self.high - self.low
        return float(np.hypot(size[0], size[2]) / 2)

    def anchor(self, anchor: Anchor) -> Float[np.ndarray, "3"]:
        """Return the anchor in the object's frame."""
        point = (self.low.astype(np.float64) + self.high) / 2
        if anchor == "origin":
            return np.zeros(3)
        if anchor == "base":
            point[1] = self.low[1]
        elif anchor == "top":
            point[1] = self.high[1]
        elif anchor == "back":
            point[2] = self.low[2]
        return point


@dataclass(frozen=True)
class Placement:
    """Where an object stands.

    Attributes:
        object_to_world: rigid [4, 4], float64.
        support: plane that the object rests on or hangs at; None if there is none.
        kind: of the supporting surface.
        distance_m: from the camera to the surface at the object's pixel; None for other places.
    """

    object_to_world: Float[np.ndarray, "4 4"]
    support: Plane | None = None
    kind: SurfaceKind | None = None
    distance_m: float | None = None


def place_by_pose(pose: Float[np.ndarray, "4 4"], box: Box, *, anchor: Anchor = "base") -> Placement:
    """Place the anchor at a pose, object axes to world.

    Raises:
        SceneError: the pose is not rigid, or beyond the largest coordinate.
    """
    try:
        rigid = check_rigid(pose)
    except ValueError as error:
        raise SceneError(f"pose: {error}") from error
    check_places(rigid[None, :3, 3], "pose")
    matrix = rigid.copy()
    matrix[:3, 3] -= rigid[:3, :3] @ box.anchor(anchor)
    return Placement(matrix)


def place_at(
    position: Float[np.ndarray, "3"], box: Box, *, yaw_degrees: float = 0.0, anchor: Anchor = "base"
) -> Placement:
    """Place the anchor at a world position, upright; at yaw 0 the front looks along +z, at 90 along +x.

    Raises:
        SceneError: the position is not finite, or beyond the largest coordinate.
    """
    check_places(np.asarray(position, np.float64)[None], "position")
    pose = np.eye(4)
    pose[:3, :3] = _upright(np.array([0.0, 1, 0]), yaw_degrees)
    pose[:3, 3] = position
    return place_by_pose(pose, box, anchor=anchor)


def place_at_pixel(
    geometry: RoomGeometry, frame: Frame, u: float, v: float, box: Box, *, yaw_degrees: float = 0.0
) -> Placement:
    """Place an object on the surface that a pixel shows.

    Floors and tables carry it upright on its bottom, walls on its back (y up), ceilings on its top; a surface tilted by
    more than `SNAP_DEGREES` carries it at right angles. Yaw turns it about the surface's normal.

    Args:
        geometry: fused surfaces of the session that the frame belongs to.
        frame: its pose and depth are used.
        u: column in the colour image, 0 is the left column; fractions are allowed.
        v: row, 0 is the top row.
        box: the object's bounding box.
        yaw_degrees: see `place_at`; on a wall clockwise as seen from the room is negative.

    Raises:
        SceneError: the pixel is outside the image, or no surface is known behind it.
    """
    plane, kind = surface_at_pixel(geometry, frame, u, v, radius_m=box.footprint_m)
    pose = np.eye(4)
    if kind == "wall":
        pose[:3, :3] = _flush(plane.normal, yaw_degrees)
        anchor: Anchor = "back"
    elif kind == "ceiling":
        pose[:3, :3] = _upright(-plane.normal, yaw_degrees)
        anchor = "top"
    else:
        pose[:3, :3] = _upright(plane.normal, yaw_degrees)
        anchor = "base"
    pose[:3, 3] = plane.point
    distance_m = float(np.linalg.norm(plane.point - frame.camera_to_world[:3, 3]))
    return Placement(place_by_pose(pose, box, anchor=anchor).object_to_world, plane, kind, distance_m)


def check_pixel(frame: Frame, u: float, v: float) -> None:
    """Raise SceneError for a pixel outside the image."""
    height, width = frame.image.shape[:2]
    if not (0 <= u < width and 0 <= v < height):
        raise SceneError(
            f"pixel: must lie in the image of {width} x {height} pixels (columns 0 to {width - 1}, rows 0 to "
            f"{height - 1}); got {u:g},{v:g}"
        )


def surface_at_pixel(
    geometry: RoomGeometry, frame: Frame, u: float, v: float, *, radius_m: float = 0.1
) -> tuple[Plane, SurfaceKind]:
    """Return the plane behind a pixel, fitted within `radius_m` of it; its point lies on the pixel's ray.

    A plane within `SNAP_DEGREES` of horizontal or vertical is made exactly so; where depth is estimated every plane
    (`LEVEL_ESTIMATED_DEGREES`).

    Raises:
        SceneError: the pixel is outside the image, or no surface is known behind it.
    """
    check_pixel(frame, u, v)
    row, column, ray = depth_pixel(frame, u, v)
    direction = frame.camera_to_world[:3, :3] @ (ray / np.linalg.norm(ray))
    origin = frame.camera_to_world[:3, 3]
    distance_m = float(frame.depth_m[row, column]) * float(np.linalg.norm(ray))
    if distance_m <= 0:
        hits = geometry.cast(origin[None].astype(np.float32), direction[None].astype(np.float32))
        distance_m = float(hits.distance_m[0])
    if not np.isfinite(distance_m):
        near = nearest_with_depth(frame, row, column)
        is_masked = frame.seen is not None and not frame.seen[int(v), int(u)]
        reason = (
            "it is masked or transparent"
            if is_masked
            else "the sensor gave no depth there (a window, a lamp, a shiny surface?)"
        )
        raise SceneError(
            f"pixel: no surface is known behind {u:g},{v:g}: {reason} and no other frame showed it; "
            + ("give a position" if near is None else f"the nearest pixel with depth is {near[0]},{near[1]}")
        )
    hit = origin + distance_m * direction
    low, high = FIT_RADIUS_M
    points = _patch(geometry, frame, hit, high if frame.depth_estimated else float(np.clip(radius_m, low, high)))
    tolerance_m = (0.006 + 0.003 * distance_m**2) * (ESTIMATED_TOLERANCE if frame.depth_estimated else 1)
    plane = fit_plane(points, hit, toward=-direction, tolerance_m=tolerance_m)
    if plane is None or abs(plane.normal @ direction) < 0.02:
        plane = Plane(hit, -direction)
    if frame.depth_estimated:
        kind, normal = _roughly_classified(plane.normal, is_below=bool(direction[1] < 0))
    else:
        if direction[1] < 0 and _classified(plane.normal)[1] is plane.normal:
            plane = _level_instead(plane, points, hit, tolerance_m)
        kind, normal = _classified(plane.normal)
    through = float((plane.point - origin) @ normal) / float(direction @ normal)
    if not 0.5 * distance_m < through < 2 * distance_m:  # a plane nearly along the ray
        through = distance_m
    return Plane(origin + through * direction, normal), kind


def nearby_support(geometry: RoomGeometry, placement: Placement, box: Box, *, depth_estimated: bool) -> Plane | None:
    """Return the surface that a placed object stands on, hangs at by its back, or hangs under; the first of these.

    Args:
        geometry: fused surfaces of the session.
        placement: of the object.
        box: the object's bounding box.
        depth_estimated: the session's depth is, so surfaces may be farther off and lean more.

    Returns:
        The plane through the bottom, back or top of the box, at right angles to the object's axis; None if no surface
        within `SUPPORT_WITHIN_M` of it faces that way.
    """
    low, high = FIT_RADIUS_M
    radius_m = float(np.clip(box.footprint_m, low, high))
    within_m, tolerance_m, degrees = SUPPORT_WITHIN_M, SUPPORT_TOLERANCE_M, SNAP_DEGREES
    if depth_estimated:
        within_m, tolerance_m = SUPPORT_ESTIMATED * within_m, SUPPORT_ESTIMATED * tolerance_m
        degrees, radius_m = SUPPORT_ESTIMATED_DEGREES, high
    matrix, points = placement.object_to_world, geometry.points()
    sides: list[Anchor] = ["base", "back", "top"]
    for anchor, inward in zip(sides, (matrix[:3, 1], matrix[:3, 2], -matrix[:3, 1]), strict=True):
        side = transform_points(matrix, box.anchor(anchor))
        origin = side + 2 * within_m * inward
        distance_m = geometry.cast(origin[None].astype(np.float32), -inward[None].astype(np.float32)).distance_m[0]
        if not abs(float(distance_m) - 2 * within_m) <= within_m:
            continue
        hit = origin - float(distance_m) * inward
        near = np.linalg.norm(points - hit.astype(np.float32), axis=1) < radius_m
        plane = fit_plane(points[near], hit, toward=inward, tolerance_m=tolerance_m)
        if plane is not None and plane.normal @ inward >= np.cos(np.radians(degrees)):
            return Plane(side, inward.copy())
    return None


def fit_plane(
    points: Float[np.ndarray, "n 3"],
    hit: Float[np.ndarray, "3"],
    *,
    toward: Float[np.ndarray, "3"],
    tolerance_m: float,
) -> Plane | None:
    """Fit the plane near `hit` to a patch that may hold other surfaces too; None if the points make no plane.

    A consensus of random triples (fixed seed), then least squares over the inliers. `toward` chooses the normal's side.
    """
    if len(points) < _LEAST_POINTS:
        return None
    rng = np.random.default_rng(7)
    if len(points) > _MAX_FITTED:
        points = points[rng.choice(len(points), _MAX_FITTED, replace=False)]
    local = points.astype(np.float64) - hit
    chosen = rng.integers(0, len(local), (_TRIPLES, 3))
    nearest = np.argsort((local**2).sum(axis=1))[:16]
    chosen[:, 0] = nearest[rng.integers(0, len(nearest), _TRIPLES)]
    triples = local[chosen]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    good = length > 1e-9
    normals, offsets = normals[good] / length[good, None], triples[good, 0]
    if not len(normals):
        return None
    offset = (normals * offsets).sum(axis=1)
    apart = np.abs(local @ normals.T - offset)
    # Of two surfaces that meet near the pixel, its own passes through the hit and has the points around it. Votes are
    # soft, because a plane between the two has many points near it, but few on it.
    away = np.linalg.norm(local, axis=1)
    near = np.exp(-((away / (0.4 * max(float(away.max()), 1e-9))) ** 2))
    votes = near @ np.exp(-((2 * apart / tolerance_m) ** 2)) * np.exp(-((2 * offset / tolerance_m) ** 2))
    best = apart[:, int(votes.argmax())]
    if (best < tolerance_m).sum() < _LEAST_POINTS or votes.max() < 1:
        return None
    centre, normal = np.zeros(3), np.zeros(3)
    for _ in range(3):
        weight = np.exp(-((2 * best / tolerance_m) ** 2))
        centre = weight @ local / weight.sum()
        _, spread, axes = np.linalg.svd((local - centre) * np.sqrt(weight)[:, None], full_matrices=False)
        if spread[1] < 0.05 * spread[0]:
            return None
        normal = axes[2]
        best = np.abs((local - centre) @ normal)
    return Plane(hit + centre, normal if normal @ toward >= 0 else -normal)


def _level_instead(
    leaning: Plane, points: Float[np.ndarray, "n 3"], hit: Float[np.ndarray, "3"], tolerance_m: float
) -> Plane:
    """Return the level plane at the height of `hit` if it has more of the points: the rim of a table is no slope."""
    heights = np.sort(points[np.abs(points[:, 1] - hit[1]) < 3 * tolerance_m, 1])
    if not len(heights):
        return leaning
    counts = np.searchsorted(heights, heights + 2 * tolerance_m, side="right") - np.arange(len(heights))
    first = int(counts.argmax())
    if counts[first] <= (np.abs(leaning.height_of(points)) < tolerance_m).sum():
        return leaning
    height = float(heights[first : first + counts[first]].mean())
    return Plane(np.array([hit[0], height, hit[2]], np.float64), np.array([0.0, 1, 0]))


def _classified(normal: Float[np.ndarray, "3"]) -> tuple[SurfaceKind, Float[np.ndarray, "3"]]:
    """Return the kind of surface, and its normal made exactly vertical or horizontal if it nearly is."""
    level, near = float(normal[1]), np.radians(SNAP_DEGREES)
    if abs(level) > np.cos(near):
        return ("floor" if level > 0 else "ceiling"), np.array([0.0, np.sign(level), 0.0])
    if abs(level) < np.sin(near):
        return "wall", _horizontal(normal)
    if level > UP_FACING:
        return "slope", normal
    return ("ceiling" if level < -UP_FACING else "wall"), normal


def _roughly_classified(
    normal: Float[np.ndarray, "3"], *, is_below: bool
) -> tuple[SurfaceKind, Float[np.ndarray, "3"]]:
    """Return kind and exact normal of a surface below or above the camera whose depth is estimated."""
    up = 1.0 if is_below else -1.0
    if up * float(normal[1]) > np.cos(np.radians(LEVEL_ESTIMATED_DEGREES)):
        return ("floor" if is_below else "ceiling"), np.array([0.0, up, 0.0])
    return "wall", _horizontal(normal)


def _horizontal(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    flat = np.array([normal[0], 0.0, normal[2]])
    return flat / np.linalg.norm(flat)


def _upright(up: Float[np.ndarray, "3"], yaw_degrees: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation that takes the object's y axis to `up`, and its front to +z turned by the yaw."""
    yaw = np.radians(yaw_degrees)
    forward = np.array([np.sin(yaw), 0.0, np.cos(yaw)])
    if abs(forward @ up) > 0.99:  # `up` is never far from vertical here, but a pose's plane may be anything
        forward = np.array([0.0, 1.0, 0.0])
    right = np.cross(up, forward)
    right /= np.linalg.norm(right)
    return np.stack([right, up, np.cross(right, up)], axis=1)


def _flush(normal: Float[np.ndarray, "3"], yaw_degrees: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation that takes the object's front to the wall's normal and keeps its y axis as near up as it can,
    then turns it about the normal."""
    up = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    yaw = np.radians(yaw_degrees)
    turned = np.cos(yaw) * right + np.sin(yaw) * up
    return np.stack([turned, np.cross(normal, turned), normal], axis=1)


def _patch(
    geometry: RoomGeometry, frame: Frame, hit: Float[np.ndarray, "3"], radius_m: float
) -> Float[np.ndarray, "n 3"]:
    """Return the known surface points within a radius of a point: the fused mesh's and the frame's own."""
    rows, columns = frame.depth_m.shape
    rays = frame.intrinsics.resized(columns, rows).rays()
    own = transform_points(frame.camera_to_world, (rays * frame.depth_m[..., None])[frame.depth_m > 0])
    centre = hit.astype(np.float32)
    fused = geometry.points()
    return np.concatenate([part[np.linalg.norm(part - centre, axis=1) < radius_m] for part in (fused, own)])


def check_places(positions: Float[np.ndarray, "n 3"], field: str) -> None:
    """Raise SceneError if a coordinate is not finite or too large."""
    farthest = positions[np.abs(positions).max(axis=1).argmax()]
    if not np.abs(farthest).max() <= MAX_POSITION_M:
        raise SceneError(
            f"{field}: coordinates must be finite and within {MAX_POSITION_M:.0f} m; got {farthest.tolist()}"
        )
