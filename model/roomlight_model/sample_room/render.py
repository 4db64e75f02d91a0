"""Frames and probes of a scene: many jittered rays a pixel, in fixed chunks, so that threads change nothing.

Frames: camera x right, y up, z backward; world y up; z-depth in metres; panoramas world-aligned (see
`roomlight.conventions`). Radiance is linear and relative.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.camera import Intrinsics
from roomlight.conventions import linear_to_srgb8, uv_to_direction
from roomlight.threads import shard
from roomlight_model.sample_room.scene import Scene
from roomlight_model.sample_room.transport import CHUNK, Indirect, radiance, sequence

Rays = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 3"]]


def render_frame(
    scene: Scene,
    indirect: Indirect,
    camera: Intrinsics,
    camera_to_world: Float[np.ndarray, "4 4"],
    *,
    samples: int = 4,
    seed: int = 0,
    limit: float = np.inf,
) -> Float[np.ndarray, "h w 3"]:
    """Linear radiance of a pinhole frame: the mean over each pixel's square.

    `limit` holds every single ray's radiance; above 1 it changes only pixels that hold something brighter than white.
    Without it, a 30-fold lamp that fills a thirtieth of a pixel whitens it, and edges against lamps are staircases.
    """
    rotation = camera_to_world[:3, :3].astype(np.float32)

    def rays(xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        x = (xy[:, 0] - camera.cx) / camera.fx
        y = -(xy[:, 1] - camera.cy) / camera.fy
        local = np.stack([x, y, np.full_like(x, -1.0)], 1).astype(np.float32)
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        return local @ rotation.T

    shape = camera.height, camera.width
    return _render(scene, indirect, camera_to_world[:3, 3], rays, shape, samples=samples, seed=seed, limit=limit)


def render_depth(
    scene: Scene, camera: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "h w"]:
    """z-depth at the pixel centres in metres; 0 where the ray leaves through the window, as a sensor gives none."""
    local = camera.rays().reshape(-1, 3)
    length = np.linalg.norm(local, axis=1)
    rotation = camera_to_world[:3, :3].astype(np.float32)
    directions = (local / length[:, None]) @ rotation.T
    origins = np.broadcast_to(camera_to_world[:3, 3].astype(np.float32), directions.shape)
    hits = scene.trace(origins, directions)
    depth = np.where(hits.face >= 0, hits.distance_m / length, 0)
    return depth.reshape(camera.height, camera.width).astype(np.float32)


def render_probe(
    scene: Scene,
    indirect: Indirect,
    position_m: Float[np.ndarray, "3"],
    *,
    height: int = 120,
    samples: int = 64,
    seed: int = 0,
) -> Float[np.ndarray, "{height} 2*{height} 3"]:
    """HDR panorama at a point, the mean over each pixel's rectangle in (u, v)."""

    def rays(xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        return uv_to_direction(xy / np.array([2 * height, height], np.float32)).astype(np.float32)

    return _render(scene, indirect, position_m, rays, (height, 2 * height), samples=samples, seed=seed)


def _render(
    scene: Scene,
    indirect: Indirect,
    origin_m: Float[np.ndarray, "3"],
    rays: Rays,
    shape: tuple[int, int],
    *,
    samples: int,
    seed: int,
    limit: float = np.inf,
) -> Float[np.ndarray, "h w 3"]:
    height, width = shape
    image = np.zeros((height * width, 3), np.float32)
    block = CHUNK

    def work(start: int, stop: int) -> None:
        for chunk in range(start, stop):
            index = np.arange(chunk * block, min((chunk + 1) * block, height * width))
            corner = np.stack([index % width, index // width], 1).astype(np.float32)
            rng = np.random.default_rng([seed, 4, chunk])
            turn = rng.random((len(index), 2))
            jitter = sequence(0, samples, turn)
            origins = np.broadcast_to(np.asarray(origin_m, np.float32), (len(index), 3))
            for at in range(samples):
                directions = rays(corner + jitter[:, at])
                seen = radiance(scene, indirect, origins, directions, turn, rng=rng, pass_index=at)
                image[index] += np.minimum(seen, np.float32(limit))

    shard(work, (height * width + block - 1) // block, pieces_per_thread=8)
    return (image / np.float32(samples)).reshape(height, width, 3)


def expose(
    image: Float[np.ndarray, "h w 3"], *, rng: np.random.Generator, noise: float = 0.006
) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit sRGB as a phone would store it: clipped at 1, with shot noise that grows with the root of the signal."""
    grain = rng.standard_normal(image.shape, np.float32) * np.sqrt(np.maximum(image, 0) + 0.004)
    return linear_to_srgb8(np.clip(image + np.float32(noise) * grain, 0, 1))
