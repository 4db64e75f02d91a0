"""Flat geometry: convex outlines in a plane, holes cut into them, bars and swept profiles, collected into one mesh.

A `Plane` is a wall or a slope: s to the right and h up as seen from inside the room, depth away from the room (behind
the wall); its normal faces the room. Metres.

Watertight by overlap: a panel extends past the panels it meets by `OVERLAP`, so that the two cross instead of touching,
and no ray slips through a seam by rounding. Half a millimetre is a hundred times float32's steps at 50 m and a fifth of
a pixel's footprint 1 m from the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shell.polygons import OVERLAP, Outline, Point, Rect, rect


@dataclass(frozen=True, eq=False)
class Plane:
    """An origin and two orthogonal unit vectors; the normal u x v faces the room."""

    origin: Float[np.ndarray, "3"]
    u: Float[np.ndarray, "3"]
    v: Float[np.ndarray, "3"]

    @property
    def normal(self) -> Float[np.ndarray, "3"]:
        """Unit normal into the room."""
        return np.cross(self.u, self.v)

    def at(self, s: float, h: float, depth: float = 0.0) -> Float[np.ndarray, "3"]:
        """Return the world point of (s, h, depth)."""
        return self.origin + s * self.u + h * self.v - depth * self.normal

    def points(self, local: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return the world points of (s, h, depth)."""
        return self.origin + local @ np.stack([self.u, self.v, -self.normal])

    def directions(self, local: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return the world directions of (s, h, depth) directions."""
        return local @ np.stack([self.u, self.v, -self.normal])


class MeshBuilder:
    """Collects flat-shaded faces of any materials; `mesh` joins them into one mesh."""

    def __init__(self) -> None:
        self._vertices: list[np.ndarray] = []
        self._normals: list[np.ndarray] = []
        self._faces: list[np.ndarray] = []
        self._owners: list[np.ndarray] = []
        self._materials: dict[int, tuple[int, Material]] = {}
        self._count = 0

    def __bool__(self) -> bool:
        return self._count > 0

    def add(
        self,
        vertices: Float[np.ndarray, "v 3"],
        normals: Float[np.ndarray, "v 3"],
        faces: np.ndarray,
        material: Material,
    ) -> None:
        """Add triangles in world coordinates."""
        place, _ = self._materials.setdefault(id(material), (len(self._materials), material))
        self._vertices.append(vertices)
        self._normals.append(normals)
        self._faces.append(faces + self._count)
        self._owners.append(np.full(len(faces), place, np.int32))
        self._count += len(vertices)

    def panel(self, plane: Plane, outline: Outline, material: Material, *, depth: float = 0.0) -> None:
        """Add a convex flat piece that faces the room."""
        local = np.empty((len(outline), 3))
        local[:, :2] = outline
        local[:, 2] = depth
        corner = np.arange(1, len(outline) - 1)
        faces = np.stack([np.zeros_like(corner), corner, corner + 1], 1)
        normals = np.broadcast_to(plane.normal, local.shape)
        self.add(plane.points(local), normals, faces, material)

    def back(self, plane: Plane, hole: Rect, material: Material, depth: float) -> None:
        """Close a rectangular hole at a depth, a little beyond its edges."""
        s0, s1, h0, h1 = hole
        edge = 2 * OVERLAP
        self.panel(plane, rect(s0 - edge, s1 + edge, h0 - edge, h1 + edge), material, depth=depth)

    def quad(self, plane: Plane, corners: Sequence[tuple[float, float, float]], material: Material) -> None:
        """Add a quadrilateral of corners (s, h, depth), counter-clockwise from its front."""
        world = plane.points(np.array(corners, np.float64))
        normal = np.cross(world[1] - world[0], world[3] - world[0])
        size = float(np.linalg.norm(normal))
        if size >= 1e-10:
            self.add(world, np.broadcast_to(normal / size, (4, 3)), np.array([[0, 1, 2], [0, 2, 3]]), material)

    def tube(
        self,
        plane: Plane,
        hole: Outline,
        depths: tuple[float, float],
        material: Material,
        *,
        others: dict[int, Material] | None = None,
    ) -> None:
        """Add the sides of a hole through the plane, facing its middle.

        Args:
            depths: The two depths between which the sides lie, overlaps included.
            others: Materials of single edges of the outline that differ: a sill, a threshold.
        """
        near, far = depths
        for i, (a, b) in enumerate(zip(hole, [*hole[1:], hole[0]], strict=True)):
            along = np.array(b) - np.array(a)
            along *= OVERLAP / max(float(np.linalg.norm(along)), 1e-9)
            (s0, h0), (s1, h1) = np.array(a) - along, np.array(b) + along
            chosen = (others or {}).get(i, material)
            corners = [(s0, h0, near), (s1, h1, near), (s1, h1, far), (s0, h0, far)]
            self.quad(plane, [(float(s), float(h), float(d)) for s, h, d in corners], chosen)

    def bar(
        self, plane: Plane, where: Rect, depths: tuple[float, float], material: Material, *, back: bool = True
    ) -> None:
        """Add a box: s and h from `where`, between two depths (the lesser nearer the room)."""
        s0, s1, h0, h1 = where
        self.bars(plane, np.array([[s0, s1, h0, h1, *depths]], np.float64), material, back=back)

    def bars(self, plane: Plane, sizes: Float[np.ndarray, "n 6"], material: Material, *, back: bool = True) -> None:
        """Add many boxes at once, each (s0, s1, h0, h1, depth0, depth1)."""
        pick = _BOX_CORNERS if back else _BOX_CORNERS[:20]
        local = sizes[:, pick]  # [n, 24, 3]
        count = len(pick)
        normals = plane.directions(np.tile(_BOX_NORMALS[:count], (len(sizes), 1)))
        quads = np.arange(0, count * len(sizes), 4)[:, None]
        faces = np.concatenate([quads + np.array([0, 1, 2]), quads + np.array([0, 2, 3])])
        self.add(plane.points(local.reshape(-1, 3)), normals, faces, material)

    def swept(
        self,
        plane: Plane,
        profile: Sequence[Point],
        span: tuple[float, float],
        mitres: tuple[float | None, float | None],
        material: Material,
    ) -> None:
        """Sweep a profile along the wall.

        Args:
            profile: Points (distance from the wall, h), bottom to top.
            mitres: How far each end moves inward for each metre off the wall: 1 in a right-angled corner of the room,
                -1 around an outer corner; None is a free end, closed by a cap.
        """
        away = np.array([point[0] for point in profile])
        start = span[0] + (mitres[0] or 0.0) * away
        end = span[1] - (mitres[1] or 0.0) * away
        for k, ((a0, h0), (a1, h1)) in enumerate(pairwise(profile)):
            corners = [(start[k], h0, -a0), (end[k], h0, -a0), (end[k + 1], h1, -a1), (start[k + 1], h1, -a1)]
            self.quad(plane, [(float(s), float(h), float(d)) for s, h, d in corners], material)
        for place, mitre, sign in ((span[0], mitres[0], -1), (span[1], mitres[1], 1)):
            if mitre is not None:
                continue
            # Triangle fans from the corner between the wall and the floor or ceiling, from which the whole profile is
            # visible.
            foot = profile[0][1] if profile[0][0] > 0 else profile[-1][1]
            local = np.array([[place, h, -a] for a, h in [(0.0, foot), *profile]])
            corner = np.arange(1, len(local) - 1)
            faces = np.stack([np.zeros_like(corner), corner, corner + 1], 1)
            faces = faces if sign < 0 else faces[:, ::-1]
            normals = np.broadcast_to(sign * plane.u, local.shape)
            self.add(plane.points(local), normals, faces, material)

    def mesh(self) -> Mesh:
        """Join everything that was added into one mesh.

        Raises:
            ValueError: nothing was added.
        """
        if not self:
            raise ValueError("nothing was added to the mesh")
        return Mesh(
            np.concatenate(self._vertices).astype(np.float32),
            np.concatenate(self._normals).astype(np.float32),
            np.zeros((self._count, 2), np.float32),
            np.concatenate(self._faces).astype(np.int32),
            np.concatenate(self._owners),
            tuple(material for _, material in self._materials.values()),
        )


def _box_corners() -> tuple[np.ndarray, np.ndarray]:
    """Return which of (s0, s1, h0, h1, d0, d1) each coordinate of 6 faces x 4 corners is (back last); the normals."""
    front = [(0, 2, 4), (1, 2, 4), (1, 3, 4), (0, 3, 4)]
    left = [(0, 2, 5), (0, 2, 4), (0, 3, 4), (0, 3, 5)]
    right = [(1, 2, 4), (1, 2, 5), (1, 3, 5), (1, 3, 4)]
    bottom = [(0, 2, 5), (1, 2, 5), (1, 2, 4), (0, 2, 4)]
    top = [(0, 3, 4), (1, 3, 4), (1, 3, 5), (0, 3, 5)]
    back = [(1, 2, 5), (0, 2, 5), (0, 3, 5), (1, 3, 5)]
    normals = [(0, 0, -1), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, 1)]
    corners = np.array([*front, *left, *right, *bottom, *top, *back])
    return corners, np.repeat(np.array(normals, np.float64), 4, axis=0)


_BOX_CORNERS, _BOX_NORMALS = _box_corners()
