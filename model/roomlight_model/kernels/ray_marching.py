# pyright: reportMissingParameterType=false
"""SGLV ray marching and its gradient, in one forward and one backward pass along each ray.

Twin: `roomlight_model.ray_marching_reference.render_rays` under autograd. The backward pass computes the forward values
again: 128 samples of 12 channels a ray would take 6 kB, the ray itself takes 24 bytes. A voxel's channels are 12 floats
next to each other, read and written as vectors of 8 and 4, for the reasons in `roomlight.engine.kernels.march`.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from roomlight.kernels.common import CACHED

SAMPLES = 256
"""Largest number of samples on a ray."""
CHANNELS: Final = 12
"""Of a voxel: c (3), w (3), lambda, s (3), alpha, and one that is not used."""
_ALPHA = 10
_FLAGS: Final = ("contract", "reassoc")
"""Fuse to multiply-adds, in any order."""


class VolumeArrays(NamedTuple):
    """One volume, float32: its channels [z, y, x, 12], its lower corner and voxel edges [3] in metres."""

    channels: NDArray[np.float32]
    lower: NDArray[np.float32]
    voxel: NDArray[np.float32]


class RayArrays(NamedTuple):
    """Origins and unit directions [n, 3], float32, in the volume's frame (metres)."""

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]


@njit(**CACHED, inline="always")
def _corner(at, axis_count):
    low = min(max(int(at), 0), max(axis_count - 2, 0))
    return low, at - np.float32(low)


@njit(**CACHED, inline="always")
def _corners(i, j, k, nx, ny, right, up, deep):
    """Return where the channels of a cell's eight voxels begin."""
    first = CHANNELS * ((k * ny + j) * nx + i)
    above, behind = first + up, first + deep
    return first, first + right, above, above + right, behind, behind + right, behind + up, behind + up + right


@njit(**CACHED, inline="always")
def _weights(fx, fy, fz):
    """Return the trilinear weights of these voxels."""
    gx, gy, gz = np.float32(1) - fx, np.float32(1) - fy, np.float32(1) - fz
    near_low, near_high, far_low, far_high = gz * gy, gz * fy, fz * gy, fz * fy
    return (
        near_low * gx, near_low * fx, near_high * gx, near_high * fx,
        far_low * gx, far_low * fx, far_high * gx, far_high * fx,
    )  # fmt: skip


def _vectors(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Yield for both parts of a voxel: the address in `value`, functions for one in `flat` and for a vector."""
    one, many = (context.make_array(signature.args[n])(context, builder, arguments[n]).data for n in range(2))
    lane = ir.IntType(32)
    for channel, width in ((0, 8), (8, 4)):
        vector, first = ir.VectorType(ir.FloatType(), width), ir.Constant(ir.IntType(64), channel)

        def address(pointer: Any, vector: Any = vector) -> Any:
            return builder.bitcast(pointer, vector.as_pointer())

        def voxel(at: Any, first: Any = first, address: Any = address) -> Any:
            return address(builder.gep(many, [builder.add(at, first)]))

        def splat(value: Any, vector: Any = vector, width: int = width) -> Any:
            undefined = ir.Constant(vector, ir.Undefined)
            single = builder.insert_element(undefined, value, ir.Constant(lane, 0))
            return builder.shuffle_vector(single, undefined, ir.Constant(ir.VectorType(lane, width), [0] * width))

        yield address(builder.gep(one, [first])), voxel, splat


def _typed_mix(_typing_context, value, flat, at, weights):
    """value[c] = sum_n weights[n] * flat[at[n] + c] for the channels c."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for place, voxel, splat in _vectors(context, builder, signature, arguments):
            mixed = None
            for n in range(8):
                channels = builder.load(voxel(builder.extract_value(arguments[2], n)), align=4)
                term = builder.fmul(channels, splat(builder.extract_value(arguments[3], n)), flags=_FLAGS)
                mixed = term if mixed is None else builder.fadd(mixed, term, flags=_FLAGS)
            builder.store(mixed, place, align=4)
        return context.get_dummy_value()

    return types.void(value, flat, at, weights), generate


def _typed_spread(_typing_context, value, flat, at, weights):
    """flat[at[n] + c] += weights[n] * value[c] for the channels c and the eight n; where two are one, both count."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for place, voxel, splat in _vectors(context, builder, signature, arguments):
            channels = builder.load(place, align=4)
            for n in range(8):
                target = voxel(builder.extract_value(arguments[2], n))
                term = builder.fmul(channels, splat(builder.extract_value(arguments[3], n)), flags=_FLAGS)
                builder.store(builder.fadd(builder.load(target, align=4), term, flags=_FLAGS), target, align=4)
        return context.get_dummy_value()

    return types.void(value, flat, at, weights), generate


_mix: Any = intrinsic(_typed_mix)
_spread: Any = intrinsic(_typed_spread)


@njit(**CACHED, fastmath=True)
def march_forward_backward(volume, rays, samples, boundary, radiance, gradient, with_gradient):
    """March the rays of one volume (`VolumeArrays`, `RayArrays`), one mean voxel edge a step.

    Fills `radiance` [n, 3], or, `with_gradient`, reads it as an outer gradient and adds to `gradient`, which is as
    `VolumeArrays.channels`.
    """
    channels, lower, voxel = volume
    origins, directions = rays
    nz, ny, nx = channels.shape[:3]
    flat, g_flat = channels.reshape(-1), gradient.reshape(-1)
    right = CHANNELS if nx > 1 else 0
    up = nx * CHANNELS if ny > 1 else 0
    deep = ny * nx * CHANNELS if nz > 1 else 0
    step = (voxel[0] + voxel[1] + voxel[2]) / np.float32(3)
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    top = np.array([nx - 1, ny - 1, nz - 1], np.float32)
    placed = np.empty((SAMPLES + 1, 3), np.float32)
    opacity = np.empty(SAMPLES + 1, np.float32)
    before = np.empty(SAMPLES + 1, np.float32)
    value = np.empty((SAMPLES + 1, CHANNELS), np.float32)
    g_value = np.zeros(CHANNELS, np.float32)
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
            _mix(value[n], flat, _corners(i, j, k, nx, ny, right, up, deep), _weights(fx, fy, fz))
            own = value[n, _ALPHA] if n < inside else one
            opacity[n], before[n] = own, left
            for c in range(10):
                total[c] += left * own * value[n, c]
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
            g_total[c] = radiance[ray, c]
            g_total[3 + c] = radiance[ray, c] * lobe
            g_lobe += radiance[ray, c] * total[3 + c]
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
            for c in range(10):
                g_value[c] = weight * g_total[c]
            g_value[_ALPHA] = g_own
            _spread(g_value, g_flat, _corners(i, j, k, nx, ny, right, up, deep), _weights(fx, fy, fz))
