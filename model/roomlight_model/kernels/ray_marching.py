# pyright: reportMissingParameterType=false
"""SGLV ray marching and its gradient, in one forward and one backward pass along each ray.

Twin: `roomlight_model.ray_marching_reference.render_rays` under autograd. The backward pass computes the forward values
again: 128 samples of 11 channels a ray would take 5.6 kB, the ray itself takes 24 bytes.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

SAMPLES = 256
"""Largest number of samples on a ray."""


class VolumeArrays(NamedTuple):
    """One volume, float32: alpha [z, y, x], lobes [z, y, x, 10], its lower corner and voxel edges [3] in metres."""

    alpha: NDArray[np.float32]
    lobes: NDArray[np.float32]
    lower: NDArray[np.float32]
    voxel: NDArray[np.float32]


class RayArrays(NamedTuple):
    """Origins and unit directions [n, 3], float32, in the volume's frame (metres)."""

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]


class VolumeGradient(NamedTuple):
    """Gradients of `VolumeArrays.alpha` and `.lobes`, added to in place."""

    alpha: NDArray[np.float32]
    lobes: NDArray[np.float32]


@njit(nogil=True, cache=True, inline="always")
def _corner(at, axis_count):
    low = min(max(int(at), 0), max(axis_count - 2, 0))
    return low, at - np.float32(low)


@njit(nogil=True, cache=True, fastmath=True)
def march_forward_backward(volume, rays, samples, boundary, g_radiance, radiance, gradient, with_gradient):
    """March the rays of one volume (`VolumeArrays`, `RayArrays`), one mean voxel edge a step.

    Fills `radiance` [n, 3], or, `with_gradient`, adds to `gradient` (`VolumeGradient`) for `g_radiance` [n, 3].
    """
    alpha, lobes, lower, voxel = volume
    origins, directions = rays
    g_alpha, g_lobes = gradient
    step = (voxel[0] + voxel[1] + voxel[2]) / np.float32(3)
    nz, ny, nx = alpha.shape
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    top = np.array([nx - 1, ny - 1, nz - 1], np.float32)
    placed = np.empty((SAMPLES + 1, 3), np.float32)
    opacity = np.empty(SAMPLES + 1, np.float32)
    before = np.empty(SAMPLES + 1, np.float32)
    value = np.empty((SAMPLES + 1, 10), np.float32)
    total = np.empty(10, np.float32)
    g_total = np.empty(10, np.float32)
    start, slope = np.empty(3, np.float32), np.empty(3, np.float32)
    for ray in range(len(directions)):
        enter, leave = zero, np.float32(1e30)
        hit = True
        for axis in range(3):
            start[axis] = (origins[ray, axis] - lower[axis]) / voxel[axis] - half
            slope[axis] = directions[ray, axis] / voxel[axis]
            if abs(slope[axis]) < np.float32(1e-9):
                if start[axis] < -half or start[axis] > top[axis] + half:
                    hit = False
            else:
                first = (-half - start[axis]) / slope[axis]
                second = (top[axis] + half - start[axis]) / slope[axis]
                enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
        if not hit or leave <= enter:
            if not with_gradient:
                radiance[ray, :] = zero
            continue
        inside = min(samples, int(np.ceil((leave - enter) / step - half)))
        count = inside + 1 if boundary else inside
        total[:] = zero
        left = one
        used = 0
        for n in range(count):
            t = enter + (np.float32(n) + half) * step if n < inside else leave
            for axis in range(3):
                placed[n, axis] = min(max(start[axis] + t * slope[axis], zero), top[axis])
            i, fx = _corner(placed[n, 0], nx)
            j, fy = _corner(placed[n, 1], ny)
            k, fz = _corner(placed[n, 2], nz)
            i1, j1, k1 = min(i + 1, nx - 1), min(j + 1, ny - 1), min(k + 1, nz - 1)
            gx, gy, gz = one - fx, one - fy, one - fz
            own = one
            if n < inside:
                own = gz * (
                    gy * (gx * alpha[k, j, i] + fx * alpha[k, j, i1])
                    + fy * (gx * alpha[k, j1, i] + fx * alpha[k, j1, i1])
                ) + fz * (
                    gy * (gx * alpha[k1, j, i] + fx * alpha[k1, j, i1])
                    + fy * (gx * alpha[k1, j1, i] + fx * alpha[k1, j1, i1])
                )
            opacity[n], before[n] = own, left
            for c in range(10):
                mixed = gz * (
                    gy * (gx * lobes[k, j, i, c] + fx * lobes[k, j, i1, c])
                    + fy * (gx * lobes[k, j1, i, c] + fx * lobes[k, j1, i1, c])
                ) + fz * (
                    gy * (gx * lobes[k1, j, i, c] + fx * lobes[k1, j, i1, c])
                    + fy * (gx * lobes[k1, j1, i, c] + fx * lobes[k1, j1, i1, c])
                )
                value[n, c] = mixed
                total[c] += left * own * mixed
            left *= one - own
            used = n + 1
            # a wall's gradient depends on what is behind it: only a pass without gradient may stop early
            if left < np.float32(1e-5) and not with_gradient:
                break
        cosine = zero
        for axis in range(3):
            cosine += directions[ray, axis] * total[7 + axis]
        lobe = np.exp(total[6] * (cosine - one))
        if not with_gradient:
            for c in range(3):
                radiance[ray, c] = total[c] + total[3 + c] * lobe
            continue
        # eq. 2 backwards
        g_lobe = zero
        for c in range(3):
            g_total[c] = g_radiance[ray, c]
            g_total[3 + c] = g_radiance[ray, c] * lobe
            g_lobe += g_radiance[ray, c] * total[3 + c]
        g_lobe *= lobe
        g_total[6] = g_lobe * (cosine - one)
        for axis in range(3):
            g_total[7 + axis] = g_lobe * total[6] * directions[ray, axis]
        # eq. 1 backwards: R_n = alpha_n v_n + (1 - alpha_n) R_{n+1}; dL/d alpha_n = T_n (v_n - R_{n+1})
        behind = zero
        for back in range(used):
            n = used - 1 - back
            v = zero
            for c in range(10):
                v += g_total[c] * value[n, c]
            own = opacity[n]
            g_own = before[n] * (v - behind) if n < inside else zero
            behind = own * v + (one - own) * behind
            weight = before[n] * own
            i, fx = _corner(placed[n, 0], nx)
            j, fy = _corner(placed[n, 1], ny)
            k, fz = _corner(placed[n, 2], nz)
            for corner in range(8):
                w = (
                    (fx if corner & 1 else one - fx)
                    * (fy if corner & 2 else one - fy)
                    * (fz if corner & 4 else one - fz)
                )
                if w == zero:
                    continue
                x = i + (corner & 1)
                y = j + ((corner >> 1) & 1)
                z = k + ((corner >> 2) & 1)
                g_alpha[z, y, x] += w * g_own
                scale = w * weight
                for c in range(10):
                    g_lobes[z, y, x, c] += scale * g_total[c]
