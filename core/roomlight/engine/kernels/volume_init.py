# pyright: reportMissingParameterType=false
"""Volume initialisation, slice by slice along z; readable twin: `reference.initial_volume_reference`."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32
from numba import njit

from roomlight.kernels.common import CACHED


class ViewArrays(NamedTuple):
    """A frame and its camera: `lens` is (fx/w, fy/h, cx/w, cy/h), `camera` the camera's centre in the volume frame.

    `clipping` is 1 where the image is clipped, and the estimated luminance; of no size if nothing is clipped.
    """

    image: Float32[np.ndarray, "h w 3"]
    depth_m: Float32[np.ndarray, "dh dw"]
    lens: Float32[np.ndarray, "4"]
    camera_from_volume: Float32[np.ndarray, "4 4"]
    camera: Float32[np.ndarray, "3"]
    clipping: Float32[np.ndarray, "ch cw 2"]


class GridArrays(NamedTuple):
    """The grid in the volume frame, metres: lower corner and voxel edges (x, y, z), and the mean edge."""

    lower: Float32[np.ndarray, "3"]
    voxel: Float32[np.ndarray, "3"]
    edge: np.float32


@njit(**CACHED, fastmath=True)
def initialise_slices(view, grid, far_unknown, volume, clipping, start, stop):
    """Fill volume[:, start:stop], [5, z, y, x]; see `roomlight.engine.volume.grid.initial_volume`.

    `clipping` [2, z, y, x] gets alpha times `view.clipping`; neither is used if `view.clipping` has no size.
    """
    any_clipped = view.clipping.shape[0] > 0
    image, depth_m, lens, camera = view.image, view.depth_m, view.lens, view.camera
    camera_from_volume = view.camera_from_volume
    lower, voxel, edge = grid.lower, grid.voxel, grid.edge
    height, width = image.shape[0], image.shape[1]
    depth_height, depth_width = depth_m.shape
    rows, columns = volume.shape[2], volume.shape[3]
    m = camera_from_volume
    upper_x = lower[0] + voxel[0] * columns
    upper_y = lower[1] + voxel[1] * rows
    upper_z = lower[2] + voxel[2] * volume.shape[1]
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    inverse_edge = one / edge
    for k in range(start, stop):
        volume[:, k] = zero
        if any_clipped:
            clipping[:, k] = zero
        pz = lower[2] + (np.float32(k) + half) * voxel[2]
        for j in range(rows):
            py = lower[1] + (np.float32(j) + half) * voxel[1]
            for i in range(columns):
                px = lower[0] + (np.float32(i) + half) * voxel[0]
                # 1. Project the voxel into the image: depth z, and (u, v) as shares of its width and height.
                z = -(m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3])
                if z <= zero:
                    continue
                u = lens[2] + lens[0] * (m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3]) / z
                if u < zero or u >= one:
                    continue
                v = lens[3] - lens[1] * (m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3]) / z
                if v < zero or v >= one:
                    continue
                # 2. Depth of the surface there, bilinear over the pixels with known depth.
                column = min(max(u * depth_width - half, zero), np.float32(depth_width - 1))
                row = min(max(v * depth_height - half, zero), np.float32(depth_height - 1))
                i0, j0 = int(column), int(row)
                i1, j1 = min(i0 + 1, depth_width - 1), min(j0 + 1, depth_height - 1)
                fi, fj = column - np.float32(i0), row - np.float32(j0)
                d00, d01, d10, d11 = depth_m[j0, i0], depth_m[j0, i1], depth_m[j1, i0], depth_m[j1, i1]
                w00, w01, w10, w11 = (one - fj) * (one - fi), (one - fj) * fi, fj * (one - fi), fj * fi
                surface = w00 * d00 + w01 * d01 + w10 * d10 + w11 * d11
                share = zero
                if d00 > zero:
                    share += w00
                if d01 > zero:
                    share += w01
                if d10 > zero:
                    share += w10
                if d11 > zero:
                    share += w11
                unknown = share < half
                if unknown:
                    if not far_unknown:
                        continue
                    # the volume's far side along the ray
                    dx, dy, dz = px - camera[0], py - camera[1], pz - camera[2]
                    reach = np.float32(1e30)
                    if abs(dx) > np.float32(1e-9):
                        reach = min(reach, ((upper_x if dx > zero else lower[0]) - camera[0]) / dx)
                    if abs(dy) > np.float32(1e-9):
                        reach = min(reach, ((upper_y if dy > zero else lower[1]) - camera[1]) / dy)
                    if abs(dz) > np.float32(1e-9):
                        reach = min(reach, ((upper_z if dz > zero else lower[2]) - camera[2]) / dz)
                    surface = z * reach - edge
                else:
                    surface /= share
                # 3. Opacity by the distance to the surface, in voxels.
                offset = (surface - z) * inverse_edge
                if not unknown and offset > np.float32(3):
                    volume[4, k, j, i] = -one
                # paper, section 4.1: a ramp over a quarter voxel in front of the surface and behind it
                ramp = one - offset if offset > zero else offset + np.float32(5)
                alpha = min(max(np.float32(4) * ramp, zero), one)
                if alpha <= zero:
                    continue
                # 4. Colour there, bilinear, times opacity; clipped light likewise.
                column = min(max(u * width - half, zero), np.float32(width - 1))
                row = min(max(v * height - half, zero), np.float32(height - 1))
                i0, j0 = int(column), int(row)
                i1, j1 = min(i0 + 1, width - 1), min(j0 + 1, height - 1)
                fi, fj = column - np.float32(i0), row - np.float32(j0)
                w00, w01, w10, w11 = (one - fj) * (one - fi), (one - fj) * fi, fj * (one - fi), fj * fi
                for c in range(3):
                    colour = w00 * image[j0, i0, c] + w01 * image[j0, i1, c]
                    colour += w10 * image[j1, i0, c] + w11 * image[j1, i1, c]
                    volume[c, k, j, i] = alpha * colour
                volume[3, k, j, i] = alpha
                if any_clipped:
                    for c in range(2):
                        value = w00 * view.clipping[j0, i0, c] + w01 * view.clipping[j0, i1, c]
                        value += w10 * view.clipping[j1, i0, c] + w11 * view.clipping[j1, i1, c]
                        clipping[c, k, j, i] = alpha * value
