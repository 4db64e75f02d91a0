"""Realistic inputs for verifying graphs: the volume of a box room, a probe's panoramas over time, planes of light.

Random noise would not test e, the clearing and most of the tensors' range. Volumes are [channel, z, y, x] in the
paper's volume range; panoramas are [channel, H, 2H]. The same seed gives the same inputs.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.engine.panorama.blend import UNSEEN_DEPTH
from roomlight.engine.volume.grid import VOLUME_RANGE
from roomlight_export.graphs import Graph

_RANGE: Final = VOLUME_RANGE[::-1]
"""Along z, y, x."""


def room_volume(shape: tuple[int, int, int], *, frame: int, seed: int = 0) -> Float[np.ndarray, "1 5 z y x"]:
    """Compute the initial volume (c, alpha, e) of a textured box room with lamps of 20 x white; the view pans."""
    z, y, x = np.meshgrid(
        *(
            low + (np.arange(count) + 0.5) * (high - low) / count
            for (low, high), count in zip(_RANGE, shape, strict=True)
        ),
        indexing="ij",
    )
    edge = float(np.mean((_RANGE[:, 1] - _RANGE[:, 0]) / np.array(shape)))
    distance = np.maximum(-z, 1e-3)
    column, row = x / distance, y / distance
    seen = (z < 0) & (np.abs(column) < 0.67) & (np.abs(row) < 0.5)
    pan = 0.03 * frame
    ripple = 0.02 * np.sin(9 * (column + pan) + seed) * np.cos(7 * row)
    surface = np.minimum(0.95, 0.5 / np.maximum(np.abs(column + pan), 1e-3))
    surface = np.minimum(surface, 0.4 / np.maximum(np.abs(row), 1e-3)) + ripple
    ahead = (surface - distance) / edge  # voxels in front of the surface
    alpha = np.clip(np.where(ahead > 0, 4 * (1 - ahead), 4 * (ahead + 5)), 0, 1) * seen
    empty = np.where(seen & (ahead > 3), -1.0, 0.0)
    texture = np.stack([0.5 + 0.45 * np.sin(k * (column + pan) + 5 * row + seed + k) for k in (11, 13, 17)])
    lamps = np.hypot(np.mod(column + pan, 0.5) - 0.25, row - 0.35) < 0.06
    colour = np.where(lamps, 20.0, texture) * alpha
    return np.concatenate([colour, alpha[None], empty[None]])[None].astype(np.float32)


@dataclass(frozen=True)
class ProbeFrame:
    """The network inputs at a probe for one frame; depth in units of D_max."""

    single_panels: Float[np.ndarray, "1 8 h w"]
    video_panels: Float[np.ndarray, "1 13 h w"]
    mask: Float[np.ndarray, "1 1 h w"]


def probe_frames(height: int, *, frames: int) -> list[ProbeFrame]:
    """Compute panoramas of a probe over time: the visible part rotates, depth varies, detail accumulates."""
    random = np.random.default_rng(0)
    hdr = np.exp(2 * _smooth(random, height, 3))
    detail = np.clip(hdr * np.exp(0.3 * _smooth(random, height, 3, grid=24)), 0, 1)
    depth = 0.5 + 0.3 * np.tanh(_smooth(random, height, 1))
    visible = _smooth(random, height, 1)
    previous, accumulated = hdr, np.full((1, height, 2 * height), UNSEEN_DEPTH)
    result: list[ProbeFrame] = []
    for frame in range(frames):
        mask = (np.roll(visible, frame * max(1, height // 16), axis=-1) > 0).astype(np.float64)
        wobble = depth + 0.02 * np.sin(frame + depth * 40)
        ldr, now = detail * mask, hdr * (1 + 0.02 * np.sin(frame))
        single = np.concatenate([now, ldr, mask, 1 - mask])
        video = np.concatenate([previous, now, ldr, mask, 1 - mask, wobble * mask, accumulated])
        result.append(ProbeFrame(*(planes[None].astype(np.float32) for planes in (single, video, mask))))
        previous = mask * ldr + (1 - mask) * previous
        accumulated = mask * np.minimum(wobble, accumulated) + (1 - mask) * accumulated
    return result


def random_planes(graph: Graph, *, seed: int) -> dict[str, Float[np.ndarray, "1 c h w"]]:
    """Draw an input of a small network: shares within [0, 1]; panels of a panorama with radiance up to 30 x white."""
    rng = np.random.default_rng(seed)
    ((name, shape),) = graph.inputs.items()
    values = rng.random(shape).astype(np.float32)
    if name == "panels":
        radiance = [0, 1, 2, *range(6, shape[1])]
        values[:, radiance] = np.exp(rng.normal(-1, 1.5, (1, len(radiance), *shape[2:]))).clip(0, 30)
    return {name: values}


def _smooth(
    random: np.random.Generator, height: int, channels: int, *, grid: int = 6
) -> Float[np.ndarray, "{channels} {height} 2*{height}"]:
    coarse = random.standard_normal((channels, grid, 2 * grid)).astype(np.float32)
    size = (2 * height, height)
    return np.stack([cv2.resize(channel, size, interpolation=cv2.INTER_LINEAR) for channel in coarse]).astype(
        np.float64
    )
