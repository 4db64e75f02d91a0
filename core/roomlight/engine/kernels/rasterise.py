# pyright: reportMissingParameterType=false
"""Rasterisation of a mesh into a panorama; readable reference: Embree's rays through the pixel centres, in the tests.

A panorama looks from one point, so a mesh of small triangles needs no tree: each triangle is tested at the few pixel
centres inside its bounds, and the nearest hit of a pixel stays. A test is that of a ray and a triangle, exact along
shared edges: no pixel between two neighbouring triangles is missed.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32
from numba import njit

from roomlight.kernels.common import CACHED

WIDE = np.float32(0.5)
"""Triangles that span more azimuth than this, in radians, are bounded by a cone instead of by their corners."""
MARGIN = np.float32(0.02)
"""Added to bounds, in pixels, for rounding."""
_NEAREST_M = np.float32(1e-6)
_QUARTER = np.float32(math.pi / 2)
_A2, _A4, _A6, _A8 = (np.float32(a) for a in (-0.3333314528, 0.1999355085, -0.1420889944, 0.1065626393))
_A10, _A12, _A14, _A16 = (np.float32(a) for a in (-0.0752896400, 0.0429096138, -0.0161657367, 0.0028662257))
_REACH = np.float32(2) * MARGIN
"""Beyond the corners of a quad of at most a pixel: `MARGIN`, and what its edges bulge."""
_WIDEST_CONE = np.float32(0.2)
"""Least cosine of a bounding cone's half angle; wider triangles are tested at every pixel."""


@njit(**CACHED)
def join_quads(depth, ratio, faces, numbers):
    """Write the triangles of a depth grid's quads into `faces` [n, 3], upper ones first; return their number.

    Only triangles whose depths are known and differ by at most `ratio`. `numbers` [2, quads] becomes the number of each
    quad's upper and lower triangle, -1 where it is left out.
    """
    rows, columns = depth.shape
    count = 0
    for lower in range(2):
        for row in range(rows - 1):
            for column in range(columns - 1):
                first = depth[row + 1, column]
                second = depth[row, column + 1]
                third = depth[row + 1, column + 1] if lower else depth[row, column]
                low = min(first, second, third)
                quad = row * (columns - 1) + column
                numbers[lower, quad] = -1
                if low > 0 and max(first, second, third) <= np.float32(ratio) * low:
                    corner = row * columns + column
                    faces[count, 0] = corner + lower
                    faces[count, 1] = corner + columns
                    faces[count, 2] = corner + 1 + lower * columns
                    numbers[lower, quad] = count
                    count += 1
    return count


class Raster(NamedTuple):
    """Nearest triangles by pixel of an H x 2H panorama, row by row.

    Attributes:
        distance: Along the ray in metres; infinite where nothing is hit.
        triangle: Number of the triangle, -1 where nothing is hit.
        weights: Barycentric weights of the triangle's second and third corner.
        front: 1 where the ray meets the side that is counter-clockwise, 0 elsewhere.
    """

    distance: Float32[np.ndarray, " p"]
    triangle: Int32[np.ndarray, " p"]
    weights: Float32[np.ndarray, "p 2"]
    front: Int32[np.ndarray, " p"]


@njit(**CACHED)
def raise_vertices(depth, uv, camera, camera_to_world, vertices):
    """Write the vertices [v, 3] of depth samples [v] at `uv` [v, 2], 0 to 1 in the image, in world metres.

    `depth` is z-depth, `camera` float32 width, height, fx, fy, cx, cy of the image, `camera_to_world` float32 [4, 4].
    """
    width, height, fx, fy, cx, cy = camera
    for i in range(len(depth)):
        x = (uv[i, 0] * width - cx) / fx * depth[i]
        y = -(uv[i, 1] * height - cy) / fy * depth[i]
        for axis in range(3):
            turned = camera_to_world[axis, 0] * x + camera_to_world[axis, 1] * y - camera_to_world[axis, 2] * depth[i]
            vertices[i, axis] = turned + camera_to_world[axis, 3]


@njit(**CACHED, error_model="numpy")
def leave_out_shown(vertices, wanted, other, relative, least_m):
    """Clear `wanted` [v] for those of the vertices [v, 3], world metres, whose surface `other` (`DepthView`) shows too.

    One of the four samples around, or what lies between them, may be `relative` times the depth away, and `least_m`
    metres more.
    """
    m, lens, depth, half = other.world_to_camera, other.lens, other.depth, np.float32(0.5)
    rows, columns = depth.shape
    for i in range(len(vertices)):
        if not wanted[i]:
            continue
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        away = -(m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
        column = lens[2] - half + lens[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / away
        row = lens[3] - half - lens[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / away
        if not (away > 0 and 0 <= column < columns - 1 and 0 <= row < rows - 1):
            continue
        left, top = int(column), int(row)
        a, b, c, d = depth[top, left], depth[top, left + 1], depth[top + 1, left], depth[top + 1, left + 1]
        across, down = column - np.float32(left), row - np.float32(top)
        between = a + across * (b - a) + down * (c - a + across * (a - b - c + d))
        beside = min(min(abs(a - away), abs(b - away)), min(abs(c - away), abs(d - away)))
        wanted[i] = min(abs(between - away), beside) > np.float32(relative) * away + np.float32(least_m)


@njit(**CACHED, error_model="numpy", fastmath={"nsz", "contract"})
def place_vertices(vertices, position, height, offsets, places):
    """Write the offsets of vertices [n, 3] from `position` [3, n], and their columns and rows in the panorama [2, n].

    Centres of pixels are at halves. A vertex at the position itself has NaN for a place. Places are exact to 1e-4
    pixels, far within `MARGIN`; the second loop has no branches, so that the processor places 16 vertices at a time.
    """
    for i in range(len(vertices)):
        for axis in range(3):
            offsets[axis, i] = np.float32(vertices[i, axis] - position[axis])
    xs, ys, zs, columns, rows = offsets[0], offsets[1], offsets[2], places[0], places[1]
    per_radian, middle = np.float32(height / math.pi), np.float32(height)
    for i in range(len(vertices)):
        x, y, z = xs[i], ys[i], zs[i]
        flat = x * x + z * z
        nowhere = np.float32(0) if flat + y * y >= _NEAREST_M * _NEAREST_M else np.float32(np.nan)
        columns[i] = middle + per_radian * _angle(z, x) + nowhere
        rows[i] = per_radian * _angle(np.sqrt(flat), y) + nowhere


@njit(**CACHED, error_model="numpy", fastmath={"nsz", "contract"})
def _angle(y, x):
    """Return atan2(y, x), by 4.4.49 of Abramowitz and Stegun."""
    across, along = abs(y), abs(x)
    ratio = min(across, along) / max(max(across, along), np.float32(1e-30))
    s = ratio * ratio
    series = (((_A16 * s + _A14) * s + _A12) * s + _A10) * s + _A8
    angle = (((series * s + _A6) * s + _A4) * s + _A2) * s * ratio + ratio
    angle = _QUARTER - angle if across > along else angle
    angle = np.float32(math.pi) - angle if x < 0 else angle
    return -angle if y < 0 else angle


@njit(**CACHED)
def near_centres(places, shape, numbers, flags, chosen):
    """Write the numbers of the triangles that may hold the centre of a pixel into `chosen`; return how many.

    A frame's triangles are small: most quads of the grid lie between centres.

    Args:
        places: columns and rows of the vertices, [2, v].
        shape: rows and columns of the grid.
        numbers: of the triangles of each quad, [2, quads]; these and `chosen` ascend.
        flags: a buffer, [quads].
        chosen: output.
    """
    rows, columns = shape
    after, before, widest = np.float32(1.5) + _REACH, np.float32(1.5) - _REACH, np.float32(1)
    for row in range(rows - 1):
        start, stop = row * columns, (row + 1) * columns
        u0, v0 = places[0, start:stop], places[1, start:stop]
        u1, v1 = places[0, stop : stop + columns], places[1, stop : stop + columns]
        out = flags[row * (columns - 1) : (row + 1) * (columns - 1)]
        for i in range(columns - 1):  # without branches, as in `place_vertices`
            a, b, c, d = u0[i], u0[i + 1], u1[i], u1[i + 1]
            e, f, g, h = v0[i], v0[i + 1], v1[i], v1[i + 1]
            left, right = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
            top, bottom = min(min(e, f), min(g, h)), max(max(e, f), max(g, h))
            beside = np.int32(left + before) == np.int32(right + after)
            between = np.int32(top + before) == np.int32(bottom + after)
            # a wider one bulges between its corners, or crosses the edge; NaN is at the position
            small = (right - left < widest) & (a + b + c + d + e + f + g + h < np.float32(np.inf))
            out[i] = not (small & (beside | between))
    count = 0
    for half in range(2):
        for quad in range(len(flags)):
            if flags[quad] and numbers[half, quad] >= 0:
                chosen[count] = numbers[half, quad]
                count += 1
    return count


@njit(**CACHED)
def rasterise(faces, numbers, offsets, places, rays, height, raster):
    """Rasterise triangles of `faces` [n, 3], those of these ascending numbers, into `raster`.

    `rays` [p, 3] are the pixels' directions.

    Returns:
        The first row that may have changed, and the row after the last.
    """
    width = 2 * height
    rows = np.float32(height)
    first_changed, after_changed = height, 0
    for signed in numbers:
        number = np.uint64(signed)  # numba wraps signed indices: a select for each look-up
        i, j, k = np.uint64(faces[number, 0]), np.uint64(faces[number, 1]), np.uint64(faces[number, 2])
        # 1. Bounds in pixels
        left, right, top, bottom = _corner_bounds(places, i, j, k, height)
        if not (right - left) * np.float32(math.pi / height) < WIDE:  # also where a place is NaN
            left, right, top, bottom = _cone_bounds(offsets, i, j, k, height)
        first_row = max(math.ceil(top - np.float32(0.5)), 0)
        last_row = min(math.floor(bottom - np.float32(0.5)), height - 1)
        first_column = math.ceil(left - np.float32(0.5))
        last_column = math.floor(right - np.float32(0.5))
        if first_row > last_row or first_column > last_column or top > rows:
            continue
        # 2. Planes through the origin and two corners: a ray inside the triangle is on one side of all three
        ax, ay, az = offsets[0, i], offsets[1, i], offsets[2, i]
        bx, by, bz = offsets[0, j], offsets[1, j], offsets[2, j]
        cx, cy, cz = offsets[0, k], offsets[1, k], offsets[2, k]
        px, py, pz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        qx, qy, qz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        rx, ry, rz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        # and the triangle's plane, from differences: small triangles far away keep their distance's precision
        ex, ey, ez, fx, fy, fz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
        volume, area = nx * ax + ny * ay + nz * az, nx * nx + ny * ny + nz * nz
        if volume == 0:
            continue
        first_changed, after_changed = min(first_changed, first_row), max(after_changed, last_row + 1)
        sign = np.float32(1) if volume > 0 else np.float32(-1)
        # 3. Pixel centres inside, and the nearest triangle of each
        for row in range(first_row, last_row + 1):
            for unwrapped in range(first_column, last_column + 1):
                beyond = width if unwrapped < 0 else (-width if unwrapped >= width else 0)
                pixel = np.uint64(row * width + unwrapped + beyond)
                x, y, z = rays[pixel, 0], rays[pixel, 1], rays[pixel, 2]
                a = sign * (x * px + y * py + z * pz)
                b = sign * (x * qx + y * qy + z * qz)
                c = sign * (x * rx + y * ry + z * rz)
                if a < 0 or b < 0 or c < 0:
                    continue
                slope = sign * (x * nx + y * ny + z * nz)
                if slope <= 0:
                    continue
                distance = sign * volume / slope
                if distance < raster.distance[pixel]:
                    raster.distance[pixel] = distance
                    raster.triangle[pixel] = signed
                    raster.front[pixel] = np.int32(volume < 0)
                    hx, hy, hz = distance * x - ax, distance * y - ay, distance * z - az
                    mx, my, mz = hy * fz - hz * fy, hz * fx - hx * fz, hx * fy - hy * fx
                    raster.weights[pixel, 0] = (mx * nx + my * ny + mz * nz) / area
                    mx, my, mz = ey * hz - ez * hy, ez * hx - ex * hz, ex * hy - ey * hx
                    raster.weights[pixel, 1] = (mx * nx + my * ny + mz * nz) / area
    return min(first_changed, after_changed), after_changed


@njit(**CACHED)
def _corner_bounds(places, i, j, k, height):
    """Return (left, right, top, bottom) of a narrow triangle, in pixels; columns may lie beyond the edges."""
    width, middle = np.float32(2 * height), np.float32(height)
    u, v, w = places[0, i], places[0, j], places[0, k]
    left, right = min(u, v, w), max(u, v, w)
    if right - left > middle:  # it crosses the edge
        u, v, w = _unwrapped(u, middle, width), _unwrapped(v, middle, width), _unwrapped(w, middle, width)
        left, right = min(u, v, w), max(u, v, w)
    u, v, w = places[1, i], places[1, j], places[1, k]
    # An edge is an arc that bulges to the pole: by sin cos (d phi)^2 / 8 radians, at most half of that square
    per_pixel = np.float32(math.pi / height)
    bulge = (right - left) * (right - left) * per_pixel / np.float32(16)
    margin = MARGIN + bulge
    return left - MARGIN, right + MARGIN, min(u, v, w) - margin, max(u, v, w) + margin


@njit(**CACHED)
def _unwrapped(column, middle, width):
    return column + width if column < middle else column


@njit(**CACHED)
def _cone_bounds(offsets, i, j, k, height):
    """Return (left, right, top, bottom) of the cone about a triangle's corners, in pixels."""
    width, rows = np.float32(2 * height), np.float32(height)
    per_radian = np.float32(height / math.pi)
    axis = np.zeros(3, np.float32)
    for corner in (i, j, k):
        x, y, z = offsets[0, corner], offsets[1, corner], offsets[2, corner]
        length = math.sqrt(x * x + y * y + z * z)
        if length < _NEAREST_M:
            return np.float32(0), width, np.float32(0), rows
        axis += offsets[:, corner] / np.float32(length)
    length = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    if length < _NEAREST_M:
        return np.float32(0), width, np.float32(0), rows
    axis /= np.float32(length)
    cosine = np.float32(1)
    for corner in (i, j, k):
        x, y, z = offsets[0, corner], offsets[1, corner], offsets[2, corner]
        dot = (axis[0] * x + axis[1] * y + axis[2] * z) / math.sqrt(x * x + y * y + z * z)
        cosine = min(cosine, np.float32(dot))
    if cosine < _WIDEST_CONE:
        return np.float32(0), width, np.float32(0), rows
    half = math.acos(min(cosine, np.float32(1)))
    polar = math.acos(min(max(axis[1], np.float32(-1)), np.float32(1)))
    top, bottom = np.float32((polar - half) * per_radian) - MARGIN, np.float32((polar + half) * per_radian) + MARGIN
    if top <= 0 or bottom >= rows:  # a pole is inside
        return np.float32(0), width, top, bottom
    azimuth = np.float32(height + per_radian * math.atan2(axis[2], axis[0]))
    reach = np.float32(per_radian * math.asin(min(math.sin(half) / math.sin(polar), 1.0))) + MARGIN
    return azimuth - reach, azimuth + reach, top, bottom


class Surface(NamedTuple):
    """What the corners of triangles know of the image that the mesh was made from.

    Attributes:
        faces: [n, 3] vertices.
        pixels: [v, 2] (column, row) of a vertex in the image, centres at whole numbers.
        depth_m: [v] z-depth.
        measured: [v] whether the sensor measured it; elsewhere it is completed.
    """

    faces: Int32[np.ndarray, "n 3"]
    pixels: Float32[np.ndarray, "v 2"]
    depth_m: Float32[np.ndarray, " v"]
    measured: Bool[np.ndarray, " v"]


@njit(**CACHED)
def _place_in_image(raster, surface, pixel, per_pixel, place):
    """Write the (column, row) in the image that a pixel sees; return its pyramid level."""
    one, number = np.float32(1), raster.triangle[pixel]
    i, j, k = surface.faces[number, 0], surface.faces[number, 1], surface.faces[number, 2]
    v, w = raster.weights[pixel, 0], raster.weights[pixel, 1]
    u = one - v - w
    for axis in range(2):
        place[axis] = u * surface.pixels[i, axis] + v * surface.pixels[j, axis] + w * surface.pixels[k, axis]
    # a tent twice as wide as a box of 2^k has the variance of a box of sqrt(3) 2^k
    span, limit = per_pixel * raster.distance[pixel] / surface.depth_m[i], np.float32(math.sqrt(3.0) * math.sqrt(2.0))
    level = 0
    while span > limit and level < 15:
        level += 1
        limit *= np.float32(2)
    return level


class Nearest(NamedTuple):
    """The surfaces that a point sees of several meshes, by pixel of its panorama.

    Attributes:
        distance: metres along the ray, infinite where nothing is seen.
        limit: the distance at which another mesh's surface replaces it.
        mesh: its mesh's number, -1 where nothing is seen.
        measured: whether its depth was measured; False where nothing is seen.
    """

    distance: Float32[np.ndarray, " p"]
    limit: Float32[np.ndarray, " p"]
    mesh: Int32[np.ndarray, " p"]
    measured: Bool[np.ndarray, " p"]


@njit(**CACHED)
def take_nearer(raster, start, stop, surface, per_pixel, number, closer_m, nearest, seen, maps, levels):
    """Take the pixels start..stop of a mesh that are nearer by `closer_m`, and clear the raster there.

    Depth that was measured replaces what was completed, and is not replaced by it.

    Args:
        raster: nearest triangles [p].
        surface: the mesh's corners.
        per_pixel: image pixels that a panorama pixel spans at a distance equal to the z-depth: focal length x radians.
        number: of the mesh.
        nearest: updated (`Nearest`).
        seen: output [p]: the pixels' numbers, ascending.
        maps: output [p, 2]: (column, row) in the image of each that it took.
        levels: output [p]: k for a box of 2^k pixels, of each that it took.

    Returns:
        How many pixels it took.
    """
    count = 0
    for pixel in range(start, stop):
        if raster.triangle[pixel] >= 0:
            distance, faces = raster.distance[pixel], surface.faces[raster.triangle[pixel]]
            measured = surface.measured[faces[0]] and surface.measured[faces[1]] and surface.measured[faces[2]]
            known = nearest.measured[pixel]
            if raster.front[pixel] and (measured > known or (measured == known and distance <= nearest.limit[pixel])):
                nearest.measured[pixel] = measured
                nearest.distance[pixel], nearest.limit[pixel] = distance, distance - closer_m
                nearest.mesh[pixel] = number
                seen[count], levels[count] = pixel, _place_in_image(raster, surface, pixel, per_pixel, maps[count])
                count += 1
            raster.triangle[pixel], raster.distance[pixel] = -1, np.float32(np.inf)
    return count


@njit(**CACHED)
def sample_level(image, shape, seen, maps, levels, level, last, out):
    """Sample one pyramid level [h, w, c] bilinearly into `out` [p, c], at the pixels of this level.

    Args:
        image: the level.
        shape: rows and columns of the finest level, in whose pixels `maps` is.
        seen: numbers of pixels, [n].
        maps: (column, row) of each of them, [n, 2].
        levels: level wanted by each of them.
        level: number of this level.
        last: whether it is the coarsest, which serves all coarser wishes.
        out: output; other pixels are not touched.
    """
    rows, columns, channels = image.shape
    scale_row, scale_column = np.float32(rows / shape[0]), np.float32(columns / shape[1])
    half, one = np.float32(0.5), np.float32(1)
    for number in range(len(seen)):
        if levels[number] != level and not (last and levels[number] > level):
            continue
        x = min(max((maps[number, 0] + half) * scale_column - half, np.float32(0)), np.float32(columns - 1))
        y = min(max((maps[number, 1] + half) * scale_row - half, np.float32(0)), np.float32(rows - 1))
        left, top = np.uint64(x), np.uint64(y)
        right, bottom = np.uint64(min(int(x) + 1, columns - 1)), np.uint64(min(int(y) + 1, rows - 1))
        across, down = x - np.float32(int(x)), y - np.float32(int(y))
        for channel in range(channels):
            above = image[top, left, channel] * (one - across) + image[top, right, channel] * across
            below = image[bottom, left, channel] * (one - across) + image[bottom, right, channel] * across
            out[seen[number], channel] = above * (one - down) + below * down
