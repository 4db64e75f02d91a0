# pyright: reportMissingParameterType=false
"""Surface points at rays' hits: position, normals, reflectance, emission; textures averaged over the footprint.

Frames: world, y up, metres; emission in kcd/m2.
"""

import math

import numpy as np
from numba import njit

from roomlight_generator.transport.kernels.common import JIT

OFFSET = 1e-4  # `tracer.OFFSET_M`


@njit(**JIT)
def texel(atlas, texture, level, u, v):
    """Interpolate one level of a texture bilinearly, wrapped; u and v in repeats, v down the rows."""
    width, height = atlas.width[texture, level], atlas.height[texture, level]
    x, y = u * width - 0.5, v * height - 0.5
    fx, fy = np.floor(x), np.floor(y)
    c0, r0 = np.int64(fx) % width, np.int64(fy) % height
    fx, fy = x - fx, y - fy
    c1 = c0 + 1 if c0 + 1 < width else 0
    r1 = r0 + 1 if r0 + 1 < height else 0
    start = atlas.start[texture, level]
    a, b = start + r0 * width + c0, start + r0 * width + c1
    c, d = start + r1 * width + c0, start + r1 * width + c1
    wa, wb, wc, wd = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    t = atlas.texels
    return (
        (wa * t[a, 0] + wb * t[b, 0] + wc * t[c, 0] + wd * t[d, 0]) / 65535,
        (wa * t[a, 1] + wb * t[b, 1] + wc * t[c, 1] + wd * t[d, 1]) / 65535,
        (wa * t[a, 2] + wb * t[b, 2] + wc * t[c, 2] + wd * t[d, 2]) / 65535,
    )


@njit(**JIT)
def texture_mean(atlas, texture, u, v, au, av, bu, bv):
    """Average a texture over the parallelogram about (u, v) with sides a and b (in repeats).

    Up to 8 x 8 taps of a level whose texels are half the parallelogram's shorter side.
    """
    width, height = atlas.width[texture, 0], atlas.height[texture, 0]
    long_a = math.sqrt((au * width) ** 2 + (av * height) ** 2)
    long_b = math.sqrt((bu * width) ** 2 + (bv * height) ** 2)
    step = max(min(long_a, long_b) / 2, max(long_a, long_b) / 8)
    level = 0
    if step > 1:
        level = min(np.int64(math.log2(step) + 0.5), atlas.start.shape[1] - 1)
    size = 1.0 * (1 << level)
    count_a = min(max(np.int64(long_a / size + 0.5), 1), 8)
    count_b = min(max(np.int64(long_b / size + 0.5), 1), 8)
    red, green, blue = 0.0, 0.0, 0.0
    for i in range(count_a):
        s = (i + 0.5) / count_a - 0.5
        for j in range(count_b):
            t = (j + 0.5) / count_b - 0.5
            r, g, b = texel(atlas, texture, level, u + s * au + t * bu, v + s * av + t * bv)
            red, green, blue = red + r, green + g, blue + b
    share = 1.0 / (count_a * count_b)
    return red * share, green * share, blue * share


@njit(**JIT)
def uv_of(geometry, face, u, v):
    """Return the texture coordinates at a hit."""
    w = 1 - u - v
    at = geometry.uvs[face]
    return w * at[0, 0] + u * at[1, 0] + v * at[2, 0], w * at[0, 1] + u * at[1, 1] + v * at[2, 1]


@njit(**JIT)
def texture_at(scene, texture, face, u, v, direction, geometric_normal, foot):
    """Average a texture over the footprint on a face of a ray of that direction and width (`foot`)."""
    dx, dy, dz = direction
    gx, gy, gz = geometric_normal
    geometry = scene.geometry
    uv = geometry.uvs[face]
    corner = geometry.corners[face]
    s, t = uv_of(geometry, face, u, v)
    e1x, e1y, e1z = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2]
    e2x, e2y, e2z = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2]
    g11, g12, g22 = (
        e1x * e1x + e1y * e1y + e1z * e1z,
        e1x * e2x + e1y * e2y + e1z * e2z,
        e2x * e2x + e2y * e2y + e2z * e2z,
    )
    det = g11 * g22 - g12 * g12
    inverse = 1.0 / det if det > 1e-24 else 0.0
    cosine = dx * gx + dy * gy + dz * gz
    ax, ay, az = dx - cosine * gx, dy - cosine * gy, dz - cosine * gz
    length = math.sqrt(ax * ax + ay * ay + az * az)
    if length < 1e-4:
        ax, ay, az = e1x, e1y, e1z
        length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    bx, by, bz = gy * az - gz * ay, gz * ax - gx * az, gx * ay - gy * ax
    along = foot / max(abs(cosine), 0.08)
    p1, p2 = ax * e1x + ay * e1y + az * e1z, ax * e2x + ay * e2y + az * e2z
    sa, ta = (p1 * g22 - p2 * g12) * inverse * along, (p2 * g11 - p1 * g12) * inverse * along
    p1, p2 = bx * e1x + by * e1y + bz * e1z, bx * e2x + by * e2y + bz * e2z
    sb, tb = (p1 * g22 - p2 * g12) * inverse * foot, (p2 * g11 - p1 * g12) * inverse * foot
    u1, v1 = uv[1, 0] - uv[0, 0], uv[1, 1] - uv[0, 1]
    u2, v2 = uv[2, 0] - uv[0, 0], uv[2, 1] - uv[0, 1]
    return texture_mean(
        scene.atlas, texture, s, t, sa * u1 + ta * u2, sa * v1 + ta * v2, sb * u1 + tb * u2, sb * v1 + tb * v2
    )


@njit(**JIT)
def face_normal(corner, dx, dy, dz):
    """Return the unit normal of a triangle on the side that a ray of that direction meets."""
    e1x, e1y, e1z = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2]
    e2x, e2y, e2z = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2]
    x, y, z = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
    scale = 1 / max(math.sqrt(x * x + y * y + z * z), 1e-30)
    if x * dx + y * dy + z * dz > 0:
        scale = -scale
    return x * scale, y * scale, z * scale


@njit(**JIT)
def shading_normal(normals, u, v, gx, gy, gz):
    """Interpolate the corners' normals, on the side of the geometric normal, which replaces a result of length 0."""
    w = 1 - u - v
    x = w * normals[0, 0] + u * normals[1, 0] + v * normals[2, 0]
    y = w * normals[0, 1] + u * normals[1, 1] + v * normals[2, 1]
    z = w * normals[0, 2] + u * normals[1, 2] + v * normals[2, 2]
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 1e-6:
        return gx, gy, gz
    scale = 1 / length
    if x * gx + y * gy + z * gz < 0:
        scale = -scale
    return x * scale, y * scale, z * scale


@njit(**JIT)
def hit_at(geometry, ends, i):
    """Return where a ray (`RayEnds`) hit a face, and the face's geometric and shading normal on the ray's side."""
    f, u, v = ends.face[i], ends.u[i], ends.v[i]
    corner, w = geometry.corners[f], 1 - u - v
    g = face_normal(corner, ends.direction[i, 0], ends.direction[i, 1], ends.direction[i, 2])
    x = w * corner[0, 0] + u * corner[1, 0] + v * corner[2, 0]
    y = w * corner[0, 1] + u * corner[1, 1] + v * corner[2, 1]
    z = w * corner[0, 2] + u * corner[1, 2] + v * corner[2, 2]
    return (x, y, z), g, shading_normal(geometry.normals[f], u, v, g[0], g[1], g[2])


@njit(**JIT)
def surface_points(scene, ends, foot, out):
    """Write the surface points (`SurfacePoints`) at rays' ends, all of which have a face.

    foot is the width of each ray there. Positions stand off the surface, toward the ray.
    """
    materials, direction = scene.materials, ends.direction
    position, normal, geometric_normal, albedo, emission = out
    for i in range(len(ends.face)):
        (x, y, z), (gx, gy, gz), (nx, ny, nz) = hit_at(scene.geometry, ends, i)
        position[i, 0], position[i, 1], position[i, 2] = x + OFFSET * gx, y + OFFSET * gy, z + OFFSET * gz
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        geometric_normal[i, 0], geometric_normal[i, 1], geometric_normal[i, 2] = gx, gy, gz
        m = scene.geometry.material[ends.face[i]]
        r, g, b = 1.0, 1.0, 1.0
        if materials.texture[m] >= 0:
            along = direction[i, 0], direction[i, 1], direction[i, 2]
            r, g, b = texture_at(
                scene, materials.texture[m], ends.face[i], ends.u[i], ends.v[i], along, (gx, gy, gz), foot[i]
            )
        albedo[i, 0] = materials.albedo[m, 0] * r
        albedo[i, 1] = materials.albedo[m, 1] * g
        albedo[i, 2] = materials.albedo[m, 2] * b
        emission[i, 0] = materials.emission[m, 0]
        emission[i, 1] = materials.emission[m, 1]
        emission[i, 2] = materials.emission[m, 2]
