"""Prepare library geometry for ray tracing: weld vertices, remove duplicates, simplify, compute smooth normals.

Works on a `TriangleSoup`: triangles whose corners have a position and a texture coordinate each, separately indexed.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.compositing.objects.polygons import face_normals
from roomlight_generator.rooms.furniture.kernels.collapse import collapse_round, quadrics

_WELD: Final = 1e-5
"""Vertices closer than this share of the model's size are merged."""

_ROUNDS: Final = 80


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """Triangles before they become a Mesh; uv_faces index uvs, material ids are the caller's."""

    points: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "t 2"]
    faces: Int[np.ndarray, "f 3"]
    uv_faces: Int[np.ndarray, "f 3"]
    materials: Int[np.ndarray, " f"]

    def select(self, chosen: Bool[np.ndarray, " f"] | Int[np.ndarray, " k"]) -> "TriangleSoup":
        """Return the selected faces, in the given order."""
        return replace(self, faces=self.faces[chosen], uv_faces=self.uv_faces[chosen], materials=self.materials[chosen])


def welded(soup: TriangleSoup) -> TriangleSoup:
    """Weld vertices, remove degenerate triangles, and of coincident triangles keep the triangle that faces outward."""
    size = float(np.ptp(soup.points[np.unique(soup.faces)], axis=0).max())
    places = np.rint(soup.points / max(size * _WELD, 1e-12)).astype(np.int64)
    _, first, index = np.unique(places, axis=0, return_index=True, return_inverse=True)
    uvs, uv_index = np.unique(np.round(soup.uvs, 5), axis=0, return_inverse=True)
    soup = TriangleSoup(
        points=soup.points[first],
        uvs=uvs,
        faces=index.reshape(-1)[soup.faces],
        uv_faces=uv_index.reshape(-1)[soup.uv_faces],
        materials=soup.materials,
    )
    soup = soup.select(2 * _areas(soup) > 1e-10 * size * size)
    if not len(soup.faces):
        return soup
    middle = (soup.points.min(0) + soup.points.max(0)) / 2
    away = soup.points[soup.faces].mean(1) - middle
    outward = (face_normals(soup.points, soup.faces) * away).sum(1) >= 0
    order = np.argsort(~outward, kind="stable")
    _, kept = np.unique(np.sort(soup.faces[order], axis=1), axis=0, return_index=True)
    return soup.select(np.sort(order[kept]))


def simplified(soup: TriangleSoup, target: int) -> TriangleSoup:
    """Reduce to about `target` triangles, preserving materials and seams.

    Models made of separate leaves run out of collapsible edges; then a regular sample of the leaves is kept, each
    enlarged so that the total area is unchanged.
    """
    if len(soup.faces) <= target:
        return soup
    size = float(np.ptp(soup.points, axis=0).max())
    points = (soup.points - soup.points.mean(0)) / size
    part = connected_parts(soup.faces, len(points))
    area = np.bincount(part[soup.faces[:, 0]], _areas(soup), minlength=len(points))
    faces, wedges = soup.faces.astype(np.int64), soup.uv_faces.astype(np.int64)
    materials = soup.materials.astype(np.int64)
    quadric = quadrics(points, faces, wedges, materials)
    for strict in (True, False):
        for _ in range(_ROUNDS):
            before = len(faces)
            if before <= (target if strict else 1.3 * target):
                break
            keep = collapse_round(points, faces, wedges, quadric, target, strict)
            keep &= (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
            faces, wedges, materials = faces[keep], wedges[keep], materials[keep]
            if before - len(faces) < max(4, before // 2000):
                break
    return _thin_parts(replace(soup, faces=faces, uv_faces=wedges, materials=materials), part, area, target)


def connected_parts(faces: Int[np.ndarray, "f 3"], count: int) -> Int[np.ndarray, " count"]:
    """Return, for each of `count` vertices, the least vertex of its connected part."""
    label = np.arange(count)
    while True:
        least = label[faces].min(1)
        before = label.copy()
        for corner in range(3):
            np.minimum.at(label, faces[:, corner], least)
        label = label[label]
        if (label == before).all():
            return label


def _areas(soup: TriangleSoup) -> Float[np.ndarray, " f"]:
    return np.linalg.norm(face_normals(soup.points, soup.faces), axis=1) / 2


def _thin_parts(
    soup: TriangleSoup, part_of_vertex: Int[np.ndarray, " v"], area: Float[np.ndarray, " v"], target: int
) -> TriangleSoup:
    """Keep a regular sample of small parts if there are too many triangles, enlarged to the original total `area`."""
    part = part_of_vertex[soup.faces[:, 0]]
    counts = np.bincount(part, minlength=len(area))
    small = counts[part] <= 12
    spare, rest = int(small.sum()), int((~small).sum())
    share = min(1.0, max(target - rest, target // 3) / max(spare, 1))
    # A golden-ratio sequence samples evenly among parts, which follow each other along the branches.
    order = np.cumsum(counts > 0)
    picked = (order * 0.6180339887) % 1 < share
    keep = ~small | picked[part]
    soup, part, small = soup.select(keep), part[keep], small[keep]
    left = np.bincount(part, _areas(soup), minlength=len(area))
    growth = np.sqrt(np.clip(area / np.maximum(left, 1e-12) / share, 1, 5))
    corners = soup.points[soup.faces[small]]
    total = np.zeros((len(area), 3))
    np.add.at(total, part[small], corners.mean(1))
    middle = (total / np.maximum(np.bincount(part[small], minlength=len(area)), 1)[:, None])[part[small]][:, None]
    grown = middle + (corners - middle) * growth[part[small]][:, None, None]
    points = soup.points.copy()
    # Corners of one vertex belong to one part, so each is assigned one value.
    lowest, highest = soup.points.min(0), soup.points.max(0)
    points[soup.faces[small].ravel()] = np.clip(grown.reshape(-1, 3), lowest, highest)
    return replace(soup, points=points)
