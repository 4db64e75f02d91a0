# pyright: reportMissingParameterType=false
"""GGX reflection with Smith's separable shadowing. Vectors are local: z along the normal; alpha = roughness^2."""

import math

from numba import njit

from roomlight.kernels.common import JIT, KERNEL, normalised

MIRROR_ROUGHNESS = 0.02
"""Below this a lobe is a mirror: it is 0.05 degrees wide, a tenth of a panorama's pixel."""
LEAST_SHEEN_ALPHA = 0.0049
"""A roughness of 0.07, as in three.js: below, the distribution outgrows its visibility."""


@njit(**JIT)
def distribution(cosine, alpha):
    """GGX density of microfacets whose normal has this cosine."""
    a = alpha * alpha
    b = cosine * cosine * (a - 1) + 1
    return a / (math.pi * b * b)


@njit(**JIT)
def masking(cosine, alpha):
    """Smith's G1: the share of microfacets seen from this cosine."""
    a = alpha * alpha
    return 2 * cosine / (cosine + math.sqrt(a + (1 - a) * cosine * cosine))


@njit(**JIT)
def visible_normal(vx, vy, vz, alpha, u, v):
    """Draw a microfacet normal as seen from (vx, vy, vz) (Heitz 2018)."""
    sx, sy, sz = normalised(alpha * vx, alpha * vy, vz)
    length = sx * sx + sy * sy
    if length > 1e-14:
        scale = 1 / math.sqrt(length)
        ax, ay = -sy * scale, sx * scale
    else:
        ax, ay = 1.0, 0.0
    bx, by, bz = -sz * ay, sz * ax, sx * ay - sy * ax
    radius, angle = math.sqrt(u), 2 * math.pi * v
    t1, t2 = radius * math.cos(angle), radius * math.sin(angle)
    s = 0.5 * (1 + sz)
    t2 = (1 - s) * math.sqrt(max(1 - t1 * t1, 0.0)) + s * t2
    t3 = math.sqrt(max(1 - t1 * t1 - t2 * t2, 0.0))
    nx, ny, nz = t1 * ax + t2 * bx + t3 * sx, t1 * ay + t2 * by + t3 * sy, t2 * bz + t3 * sz
    return normalised(alpha * nx, alpha * ny, max(nz, 1e-7))


@njit(**JIT)
def schlick(cosine):
    """Schlick's weight of the reflectance at grazing incidence."""
    m = min(max(1 - cosine, 0.0), 1.0)
    return m * m * m * m * m


@njit(**JIT)
def dielectric(cosine, ratio):
    """Return Fresnel's unpolarised reflectance and the refracted cosine; ratio is ior beyond / ior here."""
    sine2 = (1 - cosine * cosine) / (ratio * ratio)
    if sine2 >= 1:
        return 1.0, 0.0
    refracted = math.sqrt(1 - sine2)
    parallel = (ratio * cosine - refracted) / (ratio * cosine + refracted)
    across = (cosine - ratio * refracted) / (cosine + ratio * refracted)
    return 0.5 * (parallel * parallel + across * across), refracted


@njit(**JIT)
def _read(table, cosine, roughness, column):
    """Read a column of `lobe_table` between its entries."""
    x = min(max(cosine, 0.0), 1.0) * (table.shape[0] - 1)
    y = min(max(roughness, 0.0), 1.0) * (table.shape[1] - 1)
    i, j = min(int(x), table.shape[0] - 2), min(int(y), table.shape[1] - 2)
    u, v = x - i, y - j
    near = (1 - u) * table[i, j, column] + u * table[i + 1, j, column]
    return (1 - v) * near + v * ((1 - u) * table[i, j + 1, column] + u * table[i + 1, j + 1, column])


@njit(**JIT)
def lobe_share(table, cosine, roughness):
    """Read A and B of `lobe_table`; exact for a mirror."""
    if roughness < MIRROR_ROUGHNESS:
        weight = schlick(cosine)
        return 1 - weight, weight
    return _read(table, cosine, roughness, 0), _read(table, cosine, roughness, 1)


@njit(**JIT)
def sheen_share(table, cosine, roughness):
    """Read the share of even light that white sheen reflects."""
    return _read(table, cosine, roughness, 2)


@njit(**JIT)
def _sheen_reflected(cosine, alpha, samples):
    """Integrate white sheen over even light: distribution by Estevez and Kulla (2017), visibility by Neubelt."""
    vx = math.sqrt(1 - cosine * cosine)
    power = 1 / alpha
    total = 0.0
    for k in range(samples):
        lz = (k + 0.5) / samples
        angle = 2 * math.pi * ((k * 0.6180339887498949) % 1.0)
        side = math.sqrt(1 - lz * lz)
        _, _, hz = normalised(vx + side * math.cos(angle), side * math.sin(angle), cosine + lz)
        density = (2 + power) * math.sqrt(max(1 - hz * hz, 0.0)) ** power / (2 * math.pi)
        total += density * lz / (4 * (lz + cosine - lz * cosine))
    return min(2 * math.pi * total / samples, 1.0)


@njit(**KERNEL)
def fill_lobe_table(table, samples):
    """Integrate the lobe's reflected share of F0 (column 0), of F90 (1), and sheen (2), by cosine and roughness."""
    for i in range(table.shape[0]):
        cosine = max(i / (table.shape[0] - 1), 0.002)
        vx = math.sqrt(1 - cosine * cosine)
        for j in range(table.shape[1]):
            roughness = max(j / (table.shape[1] - 1), MIRROR_ROUGHNESS)
            alpha = roughness * roughness
            base, edge = 0.0, 0.0
            for k in range(samples):
                u = (k + 0.5) / samples
                v = (k * 0.6180339887498949) % 1.0
                hx, _, hz = visible_normal(vx, 0.0, cosine, alpha, u, v)
                v_h = vx * hx + cosine * hz
                lz = 2 * v_h * hz - cosine
                if lz <= 0 or v_h <= 0:
                    continue
                seen, weight = masking(lz, alpha), schlick(v_h)
                base += seen * (1 - weight)
                edge += seen * weight
            table[i, j, 0], table[i, j, 1] = base / samples, edge / samples
            table[i, j, 2] = _sheen_reflected(cosine, max(alpha, LEAST_SHEEN_ALPHA), samples)
