# pyright: reportMissingParameterType=false
"""SGLV ray marching; readable twin: `reference.render_rays_reference`.

One thread, 28,800 rays of 38 samples through a volume that a network could have made (alpha about 0.03
everywhere): 35 ms as a plain loop over samples and channels, 17 ms in this form; through the sparse classical
volume 11.7 and 7 ms. The gains, in this order (`roomlight bench stages` times the result):

- The ten channels of a voxel are added as a vector of 8 and one of 2 (35 to 26 ms). LLVM unrolls a loop over ten
  channels to scalars, and one of unknown length has alias checks, so the vectors are written out.
- Positions of samples are computed for `BLOCK` of them at once, in a loop of arithmetic only: LLVM vectorises it, but
  not a loop with look-ups (26 to 17 ms). Blocks of 16 and 64 are no faster.
- Tiles of neighbouring rays instead of rows, and one masked vector of 16 instead of 8 + 2, were tried: no gain.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from roomlight.kernels.common import CACHED

OPAQUE = np.float32(1e-4)
"""A ray stops when its transmittance is below this; the remainder is dropped. With a window of twice white the
reference differs by 1.2e-3 at a threshold of 1e-3 and by 1.2e-4 at this one, which costs 4 % more time."""
BLOCK = 32
"""Samples positioned at once: most rays of a panorama from within a room (38 samples on the mean) take one or two."""


class MarchVolume(NamedTuple):
    """The SGLV in the volume frame, metres: lower corner and voxel edges are (x, y, z)."""

    alpha: Float32[np.ndarray, "z y x"]
    lobes: Float32[np.ndarray, "z y x 10"]
    lower: Float32[np.ndarray, "3"]
    voxel: Float32[np.ndarray, "3"]


class MarchRays(NamedTuple):
    """Rays from one origin in the volume frame, metres; `boundary`: the remainder takes the values at the exit."""

    origin: Float32[np.ndarray, "3"]
    directions: Float32[np.ndarray, "n 3"]
    step: np.float32
    samples: int
    boundary: bool


@njit(**CACHED, fastmath=True)
def march_rays(volume, rays, radiance, transmittance, start, stop):
    """Render rays start..stop into radiance [n, 3] and transmittance [n]; see `roomlight.engine.volume.sglv`."""
    alpha, lobes, lower, voxel = volume.alpha, volume.lobes, volume.lower, volume.voxel
    origin, directions = rays.origin, rays.directions
    step, samples, boundary = rays.step, rays.samples, rays.boundary
    nz, ny, nx = alpha.shape
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    last_x, last_y, last_z = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    # The lower corner is at most the last but one, where the fraction may be 1: its neighbours always exist.
    near_x, near_y, near_z = np.int32(max(nx - 2, 0)), np.int32(max(ny - 2, 0)), np.int32(max(nz - 2, 0))
    row, plane = np.int32(nx), np.int32(nx * ny)
    right = np.uint64(1 if nx > 1 else 0)  # unsigned: numba wraps signed indices, a select for each look-up
    up = np.uint64(nx if ny > 1 else 0)
    back = np.uint64(nx * ny if nz > 1 else 0)
    flat_alpha, flat_lobes = alpha.reshape(-1), lobes.reshape(-1)
    # index space: voxel centres at integers
    ox = (origin[0] - lower[0]) / voxel[0] - half
    oy = (origin[1] - lower[1]) / voxel[1] - half
    oz = (origin[2] - lower[2]) / voxel[2] - half
    total = np.zeros(10, np.float32)
    at = np.empty(BLOCK, np.int32)
    fraction_x, fraction_y, fraction_z = (
        np.empty(BLOCK, np.float32),
        np.empty(BLOCK, np.float32),
        np.empty(BLOCK, np.float32),
    )
    for ray in range(start, stop):
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        # 1. Where the ray enters and leaves the volume: slabs, in index space.
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
        # 2. Samples with t < leave, then the exit point.
        total[:] = zero
        left = one
        inside = int(min(np.float32(samples), np.ceil((leave - enter) / step - half)))
        count = inside + 1 if boundary else inside
        done = 0
        while done < count and left >= OPAQUE:
            # 2a. Voxels and fractions of a block of samples, without branches on what they hold.
            for b in range(BLOCK):
                t = enter + (np.float32(done + b) + half) * step
                if done + b >= inside:
                    t = leave
                x = min(max(ox + t * sx, zero), last_x)
                y = min(max(oy + t * sy, zero), last_y)
                z = min(max(oz + t * sz, zero), last_z)
                # clamped as integers too: a ray of NaN must not read outside the arrays
                i = min(max(np.int32(x), np.int32(0)), near_x)
                j = min(max(np.int32(y), np.int32(0)), near_y)
                k = min(max(np.int32(z), np.int32(0)), near_z)
                at[b] = k * plane + j * row + i
                fraction_x[b] = x - np.float32(i)
                fraction_y[b] = y - np.float32(j)
                fraction_z[b] = z - np.float32(k)
            # 2b. Opacity at each sample, and the lobes weighted by what the ray still sees.
            for b in range(min(BLOCK, count - done)):
                fx, fy, fz = fraction_x[b], fraction_y[b], fraction_z[b]
                gx, gy, gz = one - fx, one - fy, one - fz
                w0, w1, w2, w3 = gz * gy * gx, gz * gy * fx, gz * fy * gx, gz * fy * fx
                w4, w5, w6, w7 = fz * gy * gx, fz * gy * fx, fz * fy * gx, fz * fy * fx
                a0 = np.uint64(at[b])
                a1, a2, a4 = a0 + right, a0 + up, a0 + back
                a3, a5, a6 = a2 + right, a4 + right, a4 + up
                a7 = a6 + right
                weight = left
                if done + b < inside:
                    opacity = w0 * flat_alpha[a0] + w1 * flat_alpha[a1] + w2 * flat_alpha[a2] + w3 * flat_alpha[a3]
                    opacity += w4 * flat_alpha[a4] + w5 * flat_alpha[a5] + w6 * flat_alpha[a6] + w7 * flat_alpha[a7]
                    if opacity <= zero:
                        continue
                    weight = left * opacity
                    left -= weight
                _add_voxels(
                    total,
                    flat_lobes,
                    (a0, a1, a2, a3, a4, a5, a6, a7),
                    (w0, w1, w2, w3, w4, w5, w6, w7),
                    weight,
                )
                if left < OPAQUE:
                    break
            done += BLOCK
        # 3. The mean lobe toward the ray.
        cosine = dx * total[7] + dy * total[8] + dz * total[9]
        lobe = np.exp(total[6] * (cosine - one))
        radiance[ray, 0] = total[0] + total[3] * lobe
        radiance[ray, 1] = total[1] + total[4] * lobe
        radiance[ray, 2] = total[2] + total[5] * lobe
        transmittance[ray] = left


def _typed_add_voxels(_typing_context, total, flat_lobes, at, weights, scale):
    """total[c] += scale * sum_n weights[n] * flat_lobes[10 * at[n] + c] for the ten channels c, in vectors of 8 + 2.

    Here rather than in a module of its own because numba's cache looks at one source file a kernel.
    """

    def generate(context, builder, signature, arguments):
        """LLVM for one call: for each part a chain of multiply-adds, then one addition to `total`."""
        base, lobes = (context.make_array(signature.args[n])(context, builder, arguments[n]).data for n in range(2))
        index, lane = ir.IntType(64), ir.IntType(32)
        corners = range(len(at))
        firsts = [builder.mul(builder.extract_value(arguments[2], n), ir.Constant(index, 10)) for n in corners]
        factors = [builder.extract_value(arguments[3], n) for n in corners]
        flags = ("contract", "reassoc")  # fuse to multiply-adds, in any order

        for channel, width in ((0, 8), (8, 2)):
            vector = ir.VectorType(ir.FloatType(), width)

            def address(pointer, offset, vector=vector):
                return builder.bitcast(builder.gep(pointer, [offset]), vector.as_pointer())

            def splat(value, vector=vector, width=width):
                undefined = ir.Constant(vector, ir.Undefined)
                one = builder.insert_element(undefined, value, ir.Constant(lane, 0))
                zeros = ir.Constant(ir.VectorType(lane, width), [0] * width)
                return builder.shuffle_vector(one, undefined, zeros)

            offset = ir.Constant(index, channel)
            mixed = None
            for first, factor in zip(firsts, factors, strict=True):
                voxel = builder.load(address(lobes, builder.add(first, offset)), align=4)
                term = builder.fmul(voxel, splat(factor), flags=flags)
                mixed = term if mixed is None else builder.fadd(mixed, term, flags=flags)
            place = address(base, offset)
            scaled = builder.fmul(mixed, splat(arguments[4]), flags=flags)
            builder.store(builder.fadd(builder.load(place, align=4), scaled, flags=flags), place, align=4)
        return context.get_dummy_value()

    return types.void(total, flat_lobes, at, weights, scale), generate


_add_voxels: Any = intrinsic(_typed_add_voxels)
