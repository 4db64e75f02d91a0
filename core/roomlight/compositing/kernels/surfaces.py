# pyright: reportMissingParameterType=false
"""What a ray finds on a surface: its place and normals, and the material's values there."""

import math

from numba import njit

from roomlight.kernels.common import JIT, normalised

BASE_COLOUR, METALLIC_ROUGHNESS, NORMAL, EMISSIVE, COAT, COAT_ROUGHNESS, SHEEN, SHEEN_ROUGHNESS = range(8)
"""Columns of `MaterialArrays.texture`."""
_ROUNDING = 1e-6
"""Of what is read from a texture."""
_LEAST_COSINE = 0.01
"""Between the viewer and a shading normal that leans away from it."""


@njit(**JIT)
def _texels_at(coordinate, size, is_clamped):
    """Return the two texels around a coordinate and the share of the second."""
    whole = 0.0 if is_clamped else math.floor(coordinate)
    x = min(max(coordinate - whole, 0.0), 1.0) * size - 0.5
    first = math.floor(x)
    share, first = x - first, int(first)
    if is_clamped:
        return max(first, 0), min(first + 1, size - 1), share
    return first % size, (first + 1) % size, share


@njit(**JIT)
def read_texture(textures, index, u, v):
    """Read a texture bilinearly, repeated or clamped; returns linear RGBA."""
    first, width, height = textures.first[index], textures.width[index], textures.height[index]
    left, right, p = _texels_at(u, width, textures.clamped[index, 0])
    top, bottom, q = _texels_at(v, height, textures.clamped[index, 1])
    texels = textures.texels
    i, j = first + top * width, first + bottom * width
    a, b, c, d = (1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q
    scale = 1.0 / 65535.0
    a, b, c, d = a * scale, b * scale, c * scale, d * scale
    return (
        a * texels[i + left, 0] + b * texels[i + right, 0] + c * texels[j + left, 0] + d * texels[j + right, 0],
        a * texels[i + left, 1] + b * texels[i + right, 1] + c * texels[j + left, 1] + d * texels[j + right, 1],
        a * texels[i + left, 2] + b * texels[i + right, 2] + c * texels[j + left, 2] + d * texels[j + right, 2],
        a * texels[i + left, 3] + b * texels[i + right, 3] + c * texels[j + left, 3] + d * texels[j + right, 3],
    )


@njit(**JIT)
def texture_coordinates(surfaces, face, b, c):
    """Return u and v at the barycentrics (b, c) of a face."""
    a, uv = 1 - b - c, surfaces.uvs
    return (
        a * uv[face, 0, 0] + b * uv[face, 1, 0] + c * uv[face, 2, 0],
        a * uv[face, 0, 1] + b * uv[face, 1, 1] + c * uv[face, 2, 1],
    )


@njit(**JIT)
def colours(world, face, b, c, side):
    """Return (base r, g, b), (metallic, roughness, opacity) and (emissive r, g, b); `side` is -1 for a face's back."""
    materials, textures = world.materials, world.textures
    m = world.surfaces.material[face]
    red, green, blue = materials.base[m, 0], materials.base[m, 1], materials.base[m, 2]
    metallic, roughness, opacity = materials.metallic[m], materials.roughness[m], materials.opacity[m]
    glow = (materials.emissive[m, 0], materials.emissive[m, 1], materials.emissive[m, 2])
    base_texture = materials.texture[m, BASE_COLOUR]
    rough_texture = materials.texture[m, METALLIC_ROUGHNESS]
    glow_texture = materials.texture[m, EMISSIVE]
    base, shares = (red * 1.0, green * 1.0, blue * 1.0), (metallic * 1.0, roughness * 1.0, opacity * 1.0)
    emitted = (glow[0] * 1.0, glow[1] * 1.0, glow[2] * 1.0)
    if base_texture >= 0 or rough_texture >= 0 or glow_texture >= 0:
        u, v = texture_coordinates(world.surfaces, face, b, c)
        if base_texture >= 0:
            r, g, h, alpha = read_texture(textures, base_texture, u, v)
            base = (red * r, green * g, blue * h)
            shares = (shares[0], shares[1], opacity * alpha)
        if rough_texture >= 0:
            _, g, h, _ = read_texture(textures, rough_texture, u, v)
            shares = (metallic * h, roughness * g, shares[2])
        if glow_texture >= 0:
            r, g, h, _ = read_texture(textures, glow_texture, u, v)
            emitted = (glow[0] * r, glow[1] * g, glow[2] * h)
    cutoff = materials.cutoff[m]
    if cutoff >= 0:
        shares = (shares[0], shares[1], 1.0 if shares[2] >= cutoff - _ROUNDING else 0.0)
    if side < 0 and materials.one_sided[m]:
        shares = (shares[0], shares[1], 0.0)
    return base, shares, emitted


@njit(**JIT)
def ior_beyond(world, material, side):
    """Return the index of refraction beyond glass / on the viewer's side, and whether the glass is a thin wall."""
    ior, is_thin = world.materials.ior[material] * 1.0, world.materials.is_thin[material]
    return ior if side > 0 or is_thin else 1 / ior, is_thin


@njit(**JIT)
def clear_coat(world, face, b, c):
    """Return strength and roughness of the clear coat; strength 0 is none."""
    materials, m = world.materials, world.surfaces.material[face]
    strength, roughness = materials.clearcoat[m] * 1.0, materials.clearcoat_roughness[m] * 1.0
    if strength > 0:
        u, v = texture_coordinates(world.surfaces, face, b, c)
        if materials.texture[m, COAT] >= 0:
            strength *= read_texture(world.textures, materials.texture[m, COAT], u, v)[0]
        if materials.texture[m, COAT_ROUGHNESS] >= 0:
            roughness *= read_texture(world.textures, materials.texture[m, COAT_ROUGHNESS], u, v)[1]
    return strength, roughness


@njit(**JIT)
def cloth_sheen(world, face, b, c):
    """Return colour and roughness of the sheen; black is none."""
    materials, m = world.materials, world.surfaces.material[face]
    colour = (materials.sheen[m, 0] * 1.0, materials.sheen[m, 1] * 1.0, materials.sheen[m, 2] * 1.0)
    roughness = materials.sheen_roughness[m] * 1.0
    if colour[0] + colour[1] + colour[2] > 0:
        u, v = texture_coordinates(world.surfaces, face, b, c)
        if materials.texture[m, SHEEN] >= 0:
            r, g, h, _ = read_texture(world.textures, materials.texture[m, SHEEN], u, v)
            colour = (colour[0] * r, colour[1] * g, colour[2] * h)
        if materials.texture[m, SHEEN_ROUGHNESS] >= 0:
            roughness *= read_texture(world.textures, materials.texture[m, SHEEN_ROUGHNESS], u, v)[3]
    return colour, roughness


@njit(**JIT)
def geometric_normal(surfaces, face):
    """Return the unit normal of a triangle's counter-clockwise side."""
    p = surfaces.corners
    ax, ay, az = p[face, 1, 0] - p[face, 0, 0], p[face, 1, 1] - p[face, 0, 1], p[face, 1, 2] - p[face, 0, 2]
    bx, by, bz = p[face, 2, 0] - p[face, 0, 0], p[face, 2, 1] - p[face, 0, 1], p[face, 2, 2] - p[face, 0, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    scale = 1 / math.sqrt(max(x * x + y * y + z * z, 1e-38))
    return x * scale, y * scale, z * scale


@njit(**JIT)
def _mean(values, face, a, b, c):
    """Interpolate a corner vector of a face."""
    return (
        a * values[face, 0, 0] + b * values[face, 1, 0] + c * values[face, 2, 0],
        a * values[face, 0, 1] + b * values[face, 1, 1] + c * values[face, 2, 1],
        a * values[face, 0, 2] + b * values[face, 1, 2] + c * values[face, 2, 2],
    )


@njit(**JIT)
def _bent_normal(world, face, b, c, normal):
    """Apply the normal texture to the interpolated normal (counter-clockwise side)."""
    m = world.surfaces.material[face]
    u, v = texture_coordinates(world.surfaces, face, b, c)
    r, g, h, _ = read_texture(world.textures, world.materials.texture[m, NORMAL], u, v)
    scale = world.materials.normal_scale[m]
    x, y, z = (2 * r - 1) * scale, (2 * g - 1) * scale, max(2 * h - 1, 0.05)
    a, frames = 1 - b - c, world.surfaces.tangents
    tx, ty, tz = _mean(frames, face, a, b, c)
    along = tx * normal[0] + ty * normal[1] + tz * normal[2]
    tx, ty, tz = normalised(tx - along * normal[0], ty - along * normal[1], tz - along * normal[2])
    sign = frames[face, 0, 3]
    bx = (normal[1] * tz - normal[2] * ty) * sign
    by = (normal[2] * tx - normal[0] * tz) * sign
    bz = (normal[0] * ty - normal[1] * tx) * sign
    return normalised(x * tx + y * bx + z * normal[0], x * ty + y * by + z * normal[1], x * tz + y * bz + z * normal[2])


@njit(**JIT)
def shading_normal(world, face, b, c, direction, side, textured):
    """Return the unit normal for shading on the viewer's side; side is -1 where the ray meets the back."""
    normals = world.surfaces.normals
    x, y, z = _mean(normals, face, 1 - b - c, b, c)
    normal = normalised(x, y, z)
    if textured and world.materials.texture[world.surfaces.material[face], NORMAL] >= 0:
        normal = _bent_normal(world, face, b, c, normal)
    x, y, z = normal[0] * side, normal[1] * side, normal[2] * side
    cosine = -(x * direction[0] + y * direction[1] + z * direction[2])
    if cosine < _LEAST_COSINE:
        lean = _LEAST_COSINE - cosine
        return normalised(x - lean * direction[0], y - lean * direction[1], z - lean * direction[2])
    return x, y, z


@njit(**JIT)
def points(surfaces, face, b, c, side):
    """Return the point on the triangle, and the point on the smooth surface that its normals suggest.

    The second is the mean of the first's projections onto the corners' tangent planes, where those lie outside (Hanika
    2021, "Hacking the shadow terminator"): rays from there clear the flat triangles of a round surface.
    """
    a = 1 - b - c
    x, y, z = _mean(surfaces.corners, face, a, b, c)
    ox, oy, oz = 0.0, 0.0, 0.0
    for corner in range(3):
        nx, ny, nz = (
            surfaces.normals[face, corner, 0] * side,
            surfaces.normals[face, corner, 1] * side,
            surfaces.normals[face, corner, 2] * side,
        )
        height = (
            (x - surfaces.corners[face, corner, 0]) * nx
            + (y - surfaces.corners[face, corner, 1]) * ny
            + (z - surfaces.corners[face, corner, 2]) * nz
        )
        weight = a if corner == 0 else (b if corner == 1 else c)
        if height < 0:
            ox, oy, oz = ox - weight * height * nx, oy - weight * height * ny, oz - weight * height * nz
    return (x, y, z), (x + ox, y + oy, z + oz)
