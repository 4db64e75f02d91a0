# pyright: reportMissingParameterType=false
"""SGLV ray marching; readable twin: `roomlight.sglv.render_rays_reference`."""

import numpy as np
from numba import njit

OPAQUE = np.float32(1e-3)
"""A ray stops when less than this of it is left: below 8-bit visibility, and the residue is handed to the
last sample."""


@njit(nogil=True, cache=True, fastmath=True)
def march_rays(
    alpha,
    lobes,
    origin,
    directions,
    lower,
    voxel,
    step,
    samples,
    boundary,
    radiance,
    transmittance,
    start,
    stop,
):
    """Render rays start..stop; `origin` and `directions` in the volume frame, metres. See
    `roomlight.sglv`."""
    nz, ny, nx = alpha.shape
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    last_x, last_y, last_z = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, plane = nx, nx * ny
    flat_alpha = alpha.reshape(-1)
    flat_lobes = lobes.reshape(-1, 10)
    # index space: voxel centres at integers
    ox = (origin[0] - lower[0]) / voxel[0] - half
    oy = (origin[1] - lower[1]) / voxel[1] - half
    oz = (origin[2] - lower[2]) / voxel[2] - half
    total = np.zeros(10, np.float32)
    for ray in range(start, stop):
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        sx, sy, sz = dx / voxel[0], dy / voxel[1], dz / voxel[2]
        enter, leave = zero, np.float32(1e30)
        hit = True
        for axis in range(3):
            o = ox if axis == 0 else (oy if axis == 1 else oz)
            s = sx if axis == 0 else (sy if axis == 1 else sz)
            top = (last_x if axis == 0 else (last_y if axis == 1 else last_z)) + half
            if abs(s) < np.float32(1e-9):
                if o < -half or o > top:
                    hit = False
            else:
                first, second = (-half - o) / s, (top - o) / s
                if first > second:
                    first, second = second, first
                enter, leave = max(enter, first), min(leave, second)
        radiance[ray, 0] = zero
        radiance[ray, 1] = zero
        radiance[ray, 2] = zero
        transmittance[ray] = one
        if not hit or leave <= enter:
            continue
        total[:] = zero
        left = one
        for sample in range(samples + 1):
            t = enter + (np.float32(sample) + half) * step
            at_boundary = sample == samples or t >= leave
            if at_boundary:
                if not boundary or left < OPAQUE:
                    break
                t = leave
            x = min(max(ox + t * sx, zero), last_x)
            y = min(max(oy + t * sy, zero), last_y)
            z = min(max(oz + t * sz, zero), last_z)
            i, j, k = int(x), int(y), int(z)
            fx, fy, fz = x - np.float32(i), y - np.float32(j), z - np.float32(k)
            at = k * plane + j * row + i
            right = 1 if i < nx - 1 else 0
            up = row if j < ny - 1 else 0
            back = plane if k < nz - 1 else 0
            gx, gy, gz = one - fx, one - fy, one - fz
            w0, w1, w2, w3 = gz * gy * gx, gz * gy * fx, gz * fy * gx, gz * fy * fx
            w4, w5, w6, w7 = fz * gy * gx, fz * gy * fx, fz * fy * gx, fz * fy * fx
            a0, a1, a2, a3 = at, at + right, at + up, at + up + right
            a4, a5, a6, a7 = a0 + back, a1 + back, a2 + back, a3 + back
            weight = left
            if not at_boundary:
                opacity = (
                    w0 * flat_alpha[a0] + w1 * flat_alpha[a1] + w2 * flat_alpha[a2] + w3 * flat_alpha[a3]
                )
                opacity += (
                    w4 * flat_alpha[a4] + w5 * flat_alpha[a5] + w6 * flat_alpha[a6] + w7 * flat_alpha[a7]
                )
                if opacity <= zero:
                    continue
                weight = left * opacity
            w0 *= weight
            w1 *= weight
            w2 *= weight
            w3 *= weight
            w4 *= weight
            w5 *= weight
            w6 *= weight
            w7 *= weight
            for c in range(10):
                total[c] += (
                    w0 * flat_lobes[a0, c]
                    + w1 * flat_lobes[a1, c]
                    + w2 * flat_lobes[a2, c]
                    + w3 * flat_lobes[a3, c]
                    + w4 * flat_lobes[a4, c]
                    + w5 * flat_lobes[a5, c]
                    + w6 * flat_lobes[a6, c]
                    + w7 * flat_lobes[a7, c]
                )
            if at_boundary:
                break
            left -= weight
            if left < OPAQUE:
                break
        cosine = dx * total[7] + dy * total[8] + dz * total[9]
        lobe = np.exp(total[6] * (cosine - one))
        radiance[ray, 0] = total[0] + total[3] * lobe
        radiance[ray, 1] = total[1] + total[4] * lobe
        radiance[ray, 2] = total[2] + total[5] * lobe
        transmittance[ray] = left
