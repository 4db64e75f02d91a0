# pyright: reportMissingParameterType=false
"""Pictures of a shell on which a panorama is projected: each pixel is the mean over its area.

World frame: y up, metres. The panorama is stored with one column more on either side, which wrap around.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8
from numba import njit

from roomlight_generator.transport.kernels.common import ALLOCATING, JIT

MAX_SAMPLES = 40
"""Largest number of samples along a pixel's side."""
SPACING = 0.5
"""Pixels of the panorama between samples. Single bright pixels then keep their energy within 1 %; at 1.0, 5 %."""
POLE = 0.1
"""Share of the panorama's height next to its poles where places are computed for each sample."""


class ShellArrays(NamedTuple):
    """Triangles of a shell, and where its faces keep their light maps.

    Triangle t is corner[t] + a * edge[t, 0] + b * edge[t, 1]. Face f has the frame origin[f], axes[f, 0], axes[f, 1]
    (unit vectors); its light map has shape[f] = (rows along axes 1, columns along axes 0) nodes, spacing_m[f] apart,
    from start[f] in `shade`: factors of the light that the shell reflects.
    """

    corner: Float64[np.ndarray, "t 3"]
    edge: Float64[np.ndarray, "t 2 3"]
    normal: Float64[np.ndarray, "t 3"]
    face: Int32[np.ndarray, " t"]
    origin: Float64[np.ndarray, "f 3"]
    axes: Float64[np.ndarray, "f 2 3"]
    shape: Int32[np.ndarray, "f 2"]
    start: Int32[np.ndarray, " f"]
    spacing_m: Float64[np.ndarray, " f"]


class PanoramaArrays(NamedTuple):
    """A panorama's light and its place.

    Attributes:
        emitted: radiance of its light sources, and `reflected` the rest, [h, w + 2].
        kinds: kind of surface, [h, w].
        centre: where it was taken, world, metres.
    """

    emitted: Float32[np.ndarray, "h w2 3"]
    reflected: Float32[np.ndarray, "h w2 3"]
    kinds: UInt8[np.ndarray, "h w"]
    centre: Float64[np.ndarray, "3"]


class CameraArrays(NamedTuple):
    """A camera: world position, camera-to-world rotation, and its pixels.

    lens is (fx, fy, cx, cy) of a pinhole camera; fx = 0 means an equirectangular panorama in world axes.
    """

    position: Float64[np.ndarray, "3"]
    rotation: Float64[np.ndarray, "3 3"]
    lens: Float64[np.ndarray, "4"]
    height: int
    width: int


@njit(**JIT)
def ray(camera, row, column):
    """Return the unit world direction through a place of the picture."""
    fx = camera.lens[0]
    if fx == 0.0:
        azimuth = (column / camera.width - 0.5) * 2 * math.pi
        polar = row / camera.height * math.pi
        ring = math.sin(polar)
        return ring * math.cos(azimuth), math.cos(polar), ring * math.sin(azimuth)
    x = (column - camera.lens[2]) / fx
    y = -(row - camera.lens[3]) / camera.lens[1]
    length = math.sqrt(x * x + y * y + 1)
    r = camera.rotation
    dx = (r[0, 0] * x + r[0, 1] * y - r[0, 2]) / length
    dy = (r[1, 0] * x + r[1, 1] * y - r[1, 2]) / length
    dz = (r[2, 0] * x + r[2, 1] * y - r[2, 2]) / length
    return dx, dy, dz


@njit(**JIT)
def nearest(shell, ox, oy, oz, dx, dy, dz):
    """Return the distance to the nearest triangle along a ray, and its number (-1: none)."""
    best, triangle = 1e30, -1
    for t in range(len(shell.face)):
        n = shell.normal[t]
        facing = n[0] * dx + n[1] * dy + n[2] * dz
        if facing > -1e-12:  # triangles face the room
            continue
        c = shell.corner[t]
        px, py, pz = ox - c[0], oy - c[1], oz - c[2]
        distance = -(n[0] * px + n[1] * py + n[2] * pz) / facing
        if distance <= 1e-6 or distance >= best:
            continue
        px, py, pz = px + distance * dx, py + distance * dy, pz + distance * dz
        e = shell.edge[t]
        aa = e[0, 0] * e[0, 0] + e[0, 1] * e[0, 1] + e[0, 2] * e[0, 2]
        ab = e[0, 0] * e[1, 0] + e[0, 1] * e[1, 1] + e[0, 2] * e[1, 2]
        bb = e[1, 0] * e[1, 0] + e[1, 1] * e[1, 1] + e[1, 2] * e[1, 2]
        pa = px * e[0, 0] + py * e[0, 1] + pz * e[0, 2]
        pb = px * e[1, 0] + py * e[1, 1] + pz * e[1, 2]
        determinant = aa * bb - ab * ab
        a, b = bb * pa - ab * pb, aa * pb - ab * pa
        slack = 1e-9 * determinant  # rays through shared edges meet both triangles
        if a >= -slack and b >= -slack and a + b <= determinant + slack:
            best, triangle = distance, t
    return best, triangle


@njit(**JIT)
def plane_distance(shell, t, ox, oy, oz, dx, dy, dz):
    """Return the distance along a ray, in lengths of its direction, to the plane of a triangle."""
    n, c = shell.normal[t], shell.corner[t]
    facing = n[0] * dx + n[1] * dy + n[2] * dz
    return -(n[0] * (ox - c[0]) + n[1] * (oy - c[1]) + n[2] * (oz - c[2])) / min(facing, -1e-9)


@njit(**JIT)
def place(panorama, x, y, z):
    """Return (column, row) in the panorama's pixels, at which a point appears from its centre; centres at halves."""
    x, y, z = x - panorama.centre[0], y - panorama.centre[1], z - panorama.centre[2]
    height, width = panorama.kinds.shape
    length = math.sqrt(x * x + y * y + z * z)
    column = (0.5 + math.atan2(z, x) / (2 * math.pi)) * width
    row = math.acos(min(1.0, max(-1.0, y / length))) / math.pi * height
    return column, row


@njit(**JIT)
def shade_at(shell, shade, face, x, y, z):
    """Interpolate a face's light map at a point of the face: the factor of reflected light of each channel."""
    rows, columns = shell.shape[face, 0], shell.shape[face, 1]
    o, axes = shell.origin[face], shell.axes[face]
    x, y, z = x - o[0], y - o[1], z - o[2]
    column = (x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]) / shell.spacing_m[face]
    row = (x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) / shell.spacing_m[face]
    column = min(max(column, 0.0), columns - 1.001)
    row = min(max(row, 0.0), rows - 1.001)
    i, j = int(row), int(column)
    a, b = row - i, column - j
    first = shell.start[face] + i * columns + j
    below = first + columns
    w00, w01, w10, w11 = (1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b
    return (
        w00 * shade[first, 0] + w01 * shade[first + 1, 0] + w10 * shade[below, 0] + w11 * shade[below + 1, 0],
        w00 * shade[first, 1] + w01 * shade[first + 1, 1] + w10 * shade[below, 1] + w11 * shade[below + 1, 1],
        w00 * shade[first, 2] + w01 * shade[first + 1, 2] + w10 * shade[below, 2] + w11 * shade[below + 1, 2],
    )


@njit(**JIT)
def radiance_at(shell, shade, panorama, face, column, row, x, y, z):
    """Return the radiance of a point of the shell: bilinear at a place of the panorama, its reflected part shaded."""
    height, width = panorama.kinds.shape
    column = column - width if column > width + 0.5 else column
    column, row = column + 0.5, min(max(row - 0.5, 0.0), height - 1.001)
    i, j = int(row), min(int(column), width)
    a, b = row - i, column - j
    w00, w01, w10, w11 = (1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b
    e = panorama.emitted
    lr = w00 * e[i, j, 0] + w01 * e[i, j + 1, 0] + w10 * e[i + 1, j, 0] + w11 * e[i + 1, j + 1, 0]
    lg = w00 * e[i, j, 1] + w01 * e[i, j + 1, 1] + w10 * e[i + 1, j, 1] + w11 * e[i + 1, j + 1, 1]
    lb = w00 * e[i, j, 2] + w01 * e[i, j + 1, 2] + w10 * e[i + 1, j, 2] + w11 * e[i + 1, j + 1, 2]
    if len(shade):
        r, g, blue = shade_at(shell, shade, face, x, y, z)
        f = panorama.reflected
        lr += r * (w00 * f[i, j, 0] + w01 * f[i, j + 1, 0] + w10 * f[i + 1, j, 0] + w11 * f[i + 1, j + 1, 0])
        lg += g * (w00 * f[i, j, 1] + w01 * f[i, j + 1, 1] + w10 * f[i + 1, j, 1] + w11 * f[i + 1, j + 1, 1])
        lb += blue * (w00 * f[i, j, 2] + w01 * f[i, j + 1, 2] + w10 * f[i + 1, j, 2] + w11 * f[i + 1, j + 1, 2])
    return lr, lg, lb


@njit(**JIT)
def trace_corners(shell, panorama, camera, triangle, corner):
    """Trace rays through the corners of all pixels.

    Args:
        triangle: Receives the triangle at each corner, [h + 1, w + 1].
        corner: Receives direction, point and the point's place (column, row) in the panorama, [h + 1, w + 1, 8].
    """
    ox, oy, oz = camera.position
    for i in range(camera.height + 1):
        for j in range(camera.width + 1):
            dx, dy, dz = ray(camera, float(i), float(j))
            t, triangle[i, j] = nearest(shell, ox, oy, oz, dx, dy, dz)
            x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
            record = corner[i, j]
            record[0], record[1], record[2], record[3], record[4], record[5] = dx, dy, dz, x, y, z
            record[6], record[7] = place(panorama, x, y, z)


@njit(**JIT)
def apart(corner, other, size):
    """Return the number of the panorama's pixels between two corners of a pixel; size is (height, width)."""
    across = abs(corner[6] - other[6])
    across = min(across, size[1] - across) * math.sin(0.5 * (corner[7] + other[7]) / size[0] * math.pi)
    return max(across, abs(corner[7] - other[7]))


@njit(**JIT)
def samples(length):
    """Return the number of samples along a side that is `length` of the panorama's pixels long."""
    return min(MAX_SAMPLES, max(1, math.ceil(length / SPACING)))


@njit(**JIT)
def mixed4(corner, i, j, k, w00, w01, w10, w11):
    """Interpolate an entry between a pixel's corners."""
    return w00 * corner[i, j, k] + w01 * corner[i, j + 1, k] + w10 * corner[i + 1, j, k] + w11 * corner[i + 1, j + 1, k]


@njit(**JIT)
def unwrapped(corner, i, j, width):
    """Return the columns of a pixel's corners in the panorama without the jump from its last to its first column."""
    first = corner[i, j, 6]
    b, c, d = corner[i, j + 1, 6], corner[i + 1, j, 6], corner[i + 1, j + 1, 6]
    b += width * ((b < first - width / 2) - (b > first + width / 2))
    c += width * ((c < first - width / 2) - (c > first + width / 2))
    d += width * ((d < first - width / 2) - (d > first + width / 2))
    return first, b, c, d


@njit(**JIT)
def pixel_radiance(shell, shade, panorama, camera, triangle, corner, i, j):
    """Return the mean radiance of a pixel, from samples half of the panorama's pixels apart or closer.

    In pixels within one face, away from the panorama's poles, the place in the panorama is interpolated between the
    corners: its error is a thirtieth of a pixel of the panorama at most.
    """
    size = panorama.kinds.shape
    height, width = size
    aa, ab, ba, bb = corner[i, j], corner[i, j + 1], corner[i + 1, j], corner[i + 1, j + 1]
    columns = samples(max(apart(aa, ab, size), apart(ba, bb, size)))
    rows = samples(max(apart(aa, ba, size), apart(ab, bb, size)))
    face = shell.face[triangle[i, j]]
    flat = (
        shell.face[triangle[i, j + 1]] == face
        and shell.face[triangle[i + 1, j]] == face
        and shell.face[triangle[i + 1, j + 1]] == face
    )
    polar = min(min(aa[7], ab[7]), min(ba[7], bb[7])), max(max(aa[7], ab[7]), max(ba[7], bb[7]))
    smooth = flat and polar[0] > POLE * height and polar[1] < (1 - POLE) * height
    u00, u01, u10, u11 = unwrapped(corner, i, j, width)
    sphere = camera.lens[0] == 0.0
    red, green, blue, total = 0.0, 0.0, 0.0, 0.0
    for m in range(rows):
        a = (m + 0.5) / rows
        weight = math.sin((i + a) / camera.height * math.pi) if sphere else 1.0
        for n in range(columns):
            b = (n + 0.5) / columns
            w00, w01, w10, w11 = (1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b
            if smooth:
                u = w00 * u00 + w01 * u01 + w10 * u10 + w11 * u11
                u = u + width if u < 0 else (u - width if u >= width else u)
                v = mixed4(corner, i, j, 7, w00, w01, w10, w11)
                x = mixed4(corner, i, j, 3, w00, w01, w10, w11)
                y = mixed4(corner, i, j, 4, w00, w01, w10, w11)
                z = mixed4(corner, i, j, 5, w00, w01, w10, w11)
            else:
                dx = mixed4(corner, i, j, 0, w00, w01, w10, w11)
                dy = mixed4(corner, i, j, 1, w00, w01, w10, w11)
                dz = mixed4(corner, i, j, 2, w00, w01, w10, w11)
                x, y, z = camera.position
                if flat:
                    t = plane_distance(shell, triangle[i, j], x, y, z, dx, dy, dz)
                else:
                    t, hit = nearest(shell, x, y, z, dx, dy, dz)
                    face = shell.face[hit]
                x, y, z = x + t * dx, y + t * dy, z + t * dz
                u, v = place(panorama, x, y, z)
            lr, lg, lb = radiance_at(shell, shade, panorama, face, u, v, x, y, z)
            red, green, blue, total = red + weight * lr, green + weight * lg, blue + weight * lb, total + weight
    return red / total, green / total, blue / total


@njit(**ALLOCATING)
def picture(shell, shade, panorama, camera, image):
    """Write the mean radiance of each pixel's area, [h, w, 3], from the shell alone."""
    triangle = np.empty((camera.height + 1, camera.width + 1), np.int32)
    corner = np.empty((camera.height + 1, camera.width + 1, 8))
    trace_corners(shell, panorama, camera, triangle, corner)
    for i in range(camera.height):
        for j in range(camera.width):
            image[i, j, 0], image[i, j, 1], image[i, j, 2] = pixel_radiance(
                shell, shade, panorama, camera, triangle, corner, i, j
            )


@njit(**JIT)
def centres(shell, panorama, camera, distance, kinds):
    """Write the distance along the ray of each pixel's centre, and the kind of surface there."""
    ox, oy, oz = camera.position
    height, width = panorama.kinds.shape
    for row in range(camera.height):
        for column in range(camera.width):
            dx, dy, dz = ray(camera, row + 0.5, column + 0.5)
            t, _ = nearest(shell, ox, oy, oz, dx, dy, dz)
            u, v = place(panorama, ox + t * dx, oy + t * dy, oz + t * dz)
            kinds[row, column] = panorama.kinds[min(int(v), height - 1), min(int(u), width - 1)]
            distance[row, column] = t


@njit(**JIT)
def directions(camera, out):
    """Write the unit directions through the centres of all pixels, row by row."""
    for row in range(camera.height):
        for column in range(camera.width):
            at = row * camera.width + column
            out[at, 0], out[at, 1], out[at, 2] = ray(camera, row + 0.5, column + 0.5)


@njit(**JIT)
def distances(shell, origins, directions, out):
    """Write the distance along each ray to the shell; 1e30 where it meets nothing."""
    for k in range(len(origins)):
        o, d = origins[k], directions[k]
        out[k], _ = nearest(shell, float(o[0]), float(o[1]), float(o[2]), float(d[0]), float(d[1]), float(d[2]))
