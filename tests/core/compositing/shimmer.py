"""Shimmer of composites: how much changes over time that should not."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.compositing.kernels.reproject import accumulate_image


def rest_variance(images: Sequence[UInt8[np.ndarray, "h w 3"]], mask: Bool[np.ndarray, "h w"] | None = None) -> float:
    """Return the mean variance over time of encoded values in [0, 1], where camera and objects rest.

    Args:
        mask: pixels that count; default all.
    """
    stack = np.stack(images).astype(np.float32) / np.float32(255)
    variance = stack.var(axis=0).mean(axis=-1)
    chosen = variance if mask is None else variance[mask]
    return float(chosen.mean()) if chosen.size else 0.0


def warped_variance(
    layers: Sequence[Float[np.ndarray, "h w 3"]],
    depths_m: Sequence[Float[np.ndarray, "h w"]],
    cameras: Sequence[Intrinsics],
    poses: Sequence[Float[np.ndarray, "4 4"]],
) -> float:
    """Return the mean squared change of each layer against the one before, warped by depth and camera motion, over 2.

    Equal to the variance for independent noise. Layers: any image in [0, 1] on surfaces of known depth; pixels without
    depth, or hidden in one of the two, do not count.
    """
    total, count = 0.0, 0
    for number in range(1, len(layers)):
        known = depths_m[number] > 0
        points = cameras[number].rays() * depths_m[number][..., None]
        rotation, origin = poses[number][:3, :3].astype(np.float32), poses[number][:3, 3].astype(np.float32)
        world = np.ascontiguousarray(points @ rotation.T + origin)
        k = cameras[number - 1]
        before = np.concatenate([layers[number - 1], depths_m[number - 1][..., None]], axis=-1).astype(np.float32)
        warped = np.full(before[..., :3].shape, np.float32(-10))
        accumulate_image(
            warped,
            warped.copy(),
            known,
            world,
            rigid_inverse(poses[number - 1])[:3].astype(np.float32),
            np.array([k.fx, k.fy, k.cx, k.cy], np.float32),
            before,
            depths_m[number - 1] > 0,
            np.float32(0),
            np.float32(1e6),
            0,
            len(known),
        )
        seen = known & (warped[..., 0] > -5)
        total += float(((warped - layers[number])[seen] ** 2).sum() / 2)
        count += 3 * int(seen.sum())
    return total / max(count, 1)
