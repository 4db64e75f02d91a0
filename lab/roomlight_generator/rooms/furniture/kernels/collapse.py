# pyright: reportMissingParameterType=false
"""Edge collapses of a triangle mesh by quadric error (Garland and Heckbert 1997), one round of them at a time.

A collapse moves vertex u onto its neighbour v, so it creates no new positions or texture coordinates. Corners carry a
`wedge` (index of their texture coordinate): u's wedges become those that v has in the triangles that vanish; a collapse
across a seam, where v has none, is rejected.
"""

import numpy as np
from numba import njit

from roomlight.kernels.common import CACHED

_BORDER_WEIGHT = 8.0
"""Weight of the planes that preserve open borders, seams and edges between materials."""

_MIN_NORMAL_COSINE = 0.3
"""Minimum cosine between a triangle's normals before and after: a collapse must not fold a surface over."""


@njit(**CACHED)
def incidence(faces, vertex_count):
    """Return the triangles around each vertex: those of v are `around[starts[v] : starts[v + 1]]`."""
    starts = np.zeros(vertex_count + 1, np.int64)
    for face in range(len(faces)):
        for corner in range(3):
            starts[faces[face, corner] + 1] += 1
    for vertex in range(vertex_count):
        starts[vertex + 1] += starts[vertex]
    fill = starts[:-1].copy()
    around = np.empty(3 * len(faces), np.int64)
    for face in range(len(faces)):
        for corner in range(3):
            vertex = faces[face, corner]
            around[fill[vertex]] = face
            fill[vertex] += 1
    return starts, around


@njit(**CACHED)
def _add_plane(quadric, nx, ny, nz, d, weight):
    plane = (nx, ny, nz, d)
    k = 0
    for i in range(4):
        for j in range(i, 4):
            quadric[k] += weight * plane[i] * plane[j]
            k += 1


@njit(**CACHED)
def _error(quadric, p):
    x, y, z = p[0], p[1], p[2]
    return (
        quadric[0] * x * x
        + quadric[4] * y * y
        + quadric[7] * z * z
        + 2 * (quadric[1] * x * y + quadric[2] * x * z + quadric[5] * y * z)
        + 2 * (quadric[3] * x + quadric[6] * y + quadric[8] * z)
        + quadric[9]
    )


@njit(**CACHED)
def quadrics(points, faces, wedges, materials):
    """Return the quadric of every vertex: planes of its triangles weighted by area, and of the borders they end at."""
    result = np.zeros((len(points), 10))
    starts, around = incidence(faces, len(points))
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        normal = np.cross(points[b] - points[a], points[c] - points[a])
        length = np.sqrt(np.sum(normal * normal))
        if length <= 0:
            continue
        normal = normal / length
        d = -np.sum(normal * points[a])
        for corner in range(3):
            _add_plane(result[faces[face, corner]], normal[0], normal[1], normal[2], d, length / 2)
        for corner in range(3):
            u, v = faces[face, corner], faces[face, (corner + 1) % 3]
            sharers = 0
            joined = False
            for k in range(starts[u], starts[u + 1]):
                other = around[k]
                at_u, at_v = -1, -1
                for place in range(3):
                    if faces[other, place] == u:
                        at_u = place
                    if faces[other, place] == v:
                        at_v = place
                if at_v < 0:
                    continue
                sharers += 1
                if (
                    other != face
                    and materials[other] == materials[face]
                    and wedges[other, at_u] == wedges[face, corner]
                    and wedges[other, at_v] == wedges[face, (corner + 1) % 3]
                ):
                    joined = True
            if joined and sharers == 2:
                continue
            edge = points[v] - points[u]
            side = np.cross(edge, normal)
            size = np.sqrt(np.sum(side * side))
            if size <= 0:
                continue
            side = side / size
            weight = _BORDER_WEIGHT * size * size
            offset = -np.sum(side * points[u])
            _add_plane(result[u], side[0], side[1], side[2], offset, weight)
            _add_plane(result[v], side[0], side[1], side[2], offset, weight)
    return result


@njit(**CACHED)
def _wedge_of_target(faces, wedges, starts, around, u, v, wedge):
    """Return the wedge of v that replaces `wedge` of u; -2 if the two share no triangle with it."""
    for k in range(starts[u], starts[u + 1]):
        face = around[k]
        at_u, at_v = -1, -1
        for place in range(3):
            if faces[face, place] == u:
                at_u = place
            if faces[face, place] == v:
                at_v = place
        if at_v >= 0 and wedges[face, at_u] == wedge:
            return wedges[face, at_v]
    return -2


@njit(**CACHED)
def _may_collapse(points, faces, wedges, starts, around, u, v, strict):
    survivors = 0
    for k in range(starts[u], starts[u + 1]):
        face = around[k]
        at_u = -1
        vanishes = False
        for place in range(3):
            if faces[face, place] == u:
                at_u = place
            if faces[face, place] == v:
                vanishes = True
        if vanishes:
            continue
        survivors += 1
        if strict and _wedge_of_target(faces, wedges, starts, around, u, v, wedges[face, at_u]) == -2:
            return False
        b, c = points[faces[face, (at_u + 1) % 3]], points[faces[face, (at_u + 2) % 3]]
        before = np.cross(b - points[u], c - points[u])
        after = np.cross(b - points[v], c - points[v])
        product = np.sum(before * after)
        size = np.sqrt(np.sum(before * before) * np.sum(after * after))
        if product <= _MIN_NORMAL_COSINE * size:
            return False
    # A collapse that leaves no triangle would delete a leaf's tip or a whole small part.
    return survivors > 0


@njit(**CACHED)
def collapse_round(points, faces, wedges, quadric, target, strict):
    """Collapse the cheapest edges that do not touch each other; returns the mask of remaining faces.

    Args:
        points: Vertex positions, [v, 3].
        faces: Vertices of the faces, [f, 3]; changed in place.
        wedges: Texture coordinates of the faces' corners, [f, 3]; changed in place.
        quadric: Quadric of each vertex (`quadrics`), [v, 10]; changed in place.
        target: Number of faces to reach.
        strict: False: edges across seams collapse too, with slight texture distortion.
    """
    # 1. Compute the cost of each edge, in its cheaper direction.
    count = len(faces)
    starts, around = incidence(faces, len(points))
    edges = np.empty((3 * count, 2), np.int64)
    costs = np.empty(3 * count)
    for face in range(count):
        for corner in range(3):
            u, v = faces[face, corner], faces[face, (corner + 1) % 3]
            both = quadric[u] + quadric[v]
            length = np.sum((points[u] - points[v]) ** 2)
            forward, backward = _error(both, points[v]), _error(both, points[u])
            row = 3 * face + corner
            if forward <= backward:
                edges[row, 0], edges[row, 1] = u, v
            else:
                edges[row, 0], edges[row, 1] = v, u
            costs[row] = max(min(forward, backward), 0.0) + 1e-9 * length
    # 2. Collapse edges in the order of their costs.
    order = np.argsort(costs)
    keep = np.ones(count, np.bool_)
    locked = np.zeros(len(points), np.bool_)
    left = count
    # Edges much costlier than the last needed edge wait for the next round, which may have cheaper edges.
    needed = min(3 * (count - target), len(order) - 1)
    limit = 1.5 * costs[order[needed]] + 1e-12
    for row in order:
        if left <= target or costs[row] > limit:
            break
        for way in range(2):
            u, v = edges[row, way], edges[row, 1 - way]
            if locked[u] or locked[v]:
                break
            if way == 1 and _error(quadric[u] + quadric[v], points[v]) > limit:
                break
            if not _may_collapse(points, faces, wedges, starts, around, u, v, strict):
                continue
            # 3. Lock the neighbours of both vertices: their costs and triangles change.
            for k in range(starts[u], starts[u + 1]):
                for place in range(3):
                    locked[faces[around[k], place]] = True
            for k in range(starts[v], starts[v + 1]):
                for place in range(3):
                    locked[faces[around[k], place]] = True
            quadric[v] += quadric[u]
            # 4. Find the texture coordinates that u's corners get at v.
            moved = np.empty(starts[u + 1] - starts[u], np.int64)
            for k in range(starts[u], starts[u + 1]):
                moved[k - starts[u]] = -1
                face = around[k]
                for place in range(3):
                    if faces[face, place] == u:
                        wedge = _wedge_of_target(faces, wedges, starts, around, u, v, wedges[face, place])
                        # Across a seam the corner keeps its own coordinates.
                        moved[k - starts[u]] = wedges[face, place] if wedge == -2 else wedge
            # 5. Remove the triangles between u and v; attach the others to v.
            for k in range(starts[u], starts[u + 1]):
                face = around[k]
                vanishes = False
                for place in range(3):
                    if faces[face, place] == v:
                        vanishes = True
                if vanishes:
                    if keep[face]:
                        keep[face] = False
                        left -= 1
                    continue
                for place in range(3):
                    if faces[face, place] == u:
                        faces[face, place] = v
                        wedges[face, place] = moved[k - starts[u]]
            break
    return keep
