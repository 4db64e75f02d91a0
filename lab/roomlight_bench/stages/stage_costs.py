"""FLOPs and bytes of every stage, by formula: the work that every implementation has to do.

A multiply-add is two FLOPs; comparisons, conversions and index arithmetic are not counted. Bytes are what must be
read or written once with perfect caches, float32 throughout. Where the work depends on the scene (samples per ray,
voxels in view), it is counted in the scene.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.engine.kernels.march import OPAQUE
from roomlight.engine.volume.sglv import LOBE_CHANNELS, Sglv
from roomlight_bench.stages.roofline import Cost
from roomlight_model.config import BlendConfig, SGConfig

Size = tuple[int, ...]
_FLOAT: Final = 4.0

_PROJECT: Final = 26.0
"""A voxel's camera coordinates (3 x 6), division and lens (8)."""
_DEPTH_LOOKUP: Final = 21
"""Bilinear weights (8), sum and share (13)."""
_BAND: Final = 8 + 3 * 8 + 6
"""Weights, three bilinear colours and alpha, for voxels near a surface."""
_SAMPLE: Final = 6 + 15 + 16 + 3
"""Position (6), eight trilinear weights (15), alpha (16), transmittance (3)."""
_LOBES: Final = LOBE_CHANNELS * (2 * 8 + 2)
"""Trilinear lookup of all channels: eight corners, and the weighting of the sum."""
_RAY: Final = 30.0
"""Box entry and exit (18), and equation 2 (12)."""
_BOX_TEST: Final = 18.0
_TRIANGLE_TEST: Final = 40
_BLEND_PIXEL: Final = 3 * 7 + 5.0


@dataclass(frozen=True)
class Layer:
    """One convolution: edge of its kernel, channels in and out, sizes in and out (z, y, x or rows, columns)."""

    kernel: int
    inputs: int
    outputs: int
    size_in: Size
    size_out: Size

    def cost(self) -> Cost:
        """Return the multiply-adds of every output, and the bytes of input, output and weights."""
        weights = self.kernel ** len(self.size_out) * self.inputs * self.outputs
        values = self.inputs * math.prod(self.size_in) + self.outputs * math.prod(self.size_out) + weights
        return Cost(2.0 * weights * math.prod(self.size_out), _FLOAT * values)


def network_cost(layers: Iterable[Layer]) -> Cost:
    """Add up the cost of all layers."""
    return sum((layer.cost() for layer in layers), Cost(0.0, 0.0))


def sg_layers(config: SGConfig, *, recurrent: bool) -> list[Layer]:
    """List the layers of SGEncoder and SGDecoder.

    The heads are one 1 x 1 x 1 convolution, with V_u among them in the recurrent form.
    """
    w, full = config.channels, config.full_channels
    size = config.volume_shape
    half, quarter, eighth = (_halved(size, times) for times in (1, 2, 3))
    heads = (11 if config.spherical_gaussians else 4) + recurrent
    return [
        Layer(4, 5, w, size, half),
        Layer(3, w, w, half, half),
        Layer(4, w, 2 * w, half, quarter),
        Layer(3, 2 * w, 2 * w, quarter, quarter),
        Layer(4, 2 * w, 4 * w, quarter, eighth),
        Layer(3, 4 * w, 4 * w, eighth, eighth),
        Layer(3, 4 * w, 4 * w, eighth, eighth),
        Layer(3, 4 * w, 2 * w, eighth, eighth),
        Layer(3, 2 * w, 2 * w, quarter, quarter),
        Layer(3, 2 * w, 2 * w, quarter, quarter),
        Layer(3, 3 * w, w, half, half),
        Layer(3, w, full, half, half),
        *(Layer(3, full, full, size, size) for _ in range(config.full_layers)),
        Layer(1, full, heads, size, size),
        *([Layer(1, 8 if config.filled else 5, heads, size, size)] if config.direct else []),
    ]


def sg_gru_layers(config: SGConfig) -> list[Layer]:
    """List the layers of SGGRU_0 and SGGRU_1: gates 2C -> 2C and candidate 2C -> C on each level."""
    w, half, eighth = config.channels, _halved(config.volume_shape, 1), _halved(config.volume_shape, 3)
    return [
        Layer(config.fine_gate_kernel, 2 * w, 2 * w, half, half),
        Layer(3, 2 * w, w, half, half),
        Layer(3, 8 * w, 8 * w, eighth, eighth),
        Layer(3, 8 * w, 4 * w, eighth, eighth),
    ]


def blend_layers(config: BlendConfig, *, panels: int) -> list[Layer]:
    """List the layers of BlendEncoder and BlendDecoder."""
    w, full = config.channels, config.full_channels
    size = (config.height, 2 * config.height)
    half, quarter, eighth = (_halved(size, times) for times in (1, 2, 3))
    return [
        Layer(4, panels, w, size, half),
        Layer(3, w, w, half, half),
        Layer(4, w, 2 * w, half, quarter),
        Layer(3, 2 * w, 2 * w, quarter, quarter),
        Layer(4, 2 * w, 4 * w, quarter, eighth),
        Layer(3, 4 * w, 4 * w, eighth, eighth),
        Layer(3, 4 * w, 2 * w, eighth, eighth),
        Layer(3, 2 * w, 2 * w, quarter, quarter),
        Layer(3, 3 * w, w, half, half),
        Layer(3, w, full, half, half),
        Layer(3, full, full, size, size),
        Layer(1, full + 1, 1, size, size),
    ]


def blend_gru_layers(config: BlendConfig) -> list[Layer]:
    """List the layers of BlendGRU_0 and BlendGRU_1."""
    w, size = config.channels, (config.height, 2 * config.height)
    half, eighth = _halved(size, 1), _halved(size, 3)
    return [
        Layer(3, 2 * w, 2 * w, half, half),
        Layer(3, 2 * w, w, half, half),
        Layer(3, 8 * w, 8 * w, eighth, eighth),
        Layer(3, 8 * w, 4 * w, eighth, eighth),
    ]


def volume_cost(volume: Float[np.ndarray, "5 z y x"], *, in_view: int, pixels: int, depth_pixels: int) -> Cost:
    """Return the cost of initialisation: project every voxel, look up depth for those in view, colour for the band."""
    band = int((volume[3] > 0).sum())
    flops = _PROJECT * volume[3].size + _DEPTH_LOOKUP * in_view + _BAND * band
    return Cost(flops, _FLOAT * (volume.size + 3 * pixels + depth_pixels))


def march_cost(sglv: Sglv, left: Float[np.ndarray, " n"], inside: Float[np.ndarray, " n"], *, boundary: bool) -> Cost:
    """Return the cost of ray tracing through the volume.

    Rays that become opaque are counted to their end, which overestimates by a few percent at most. Lobes are fetched
    where alpha > 0: for that share of the samples and of the voxels.

    Args:
        sglv: The volume.
        left: Transmittance of each ray at its end.
        inside: Samples of each ray that lie inside the volume.
        boundary: Whether the volume's boundary gives the light beyond it.
    """
    occupied = float((sglv.alpha > 0).mean())
    samples = float(inside.sum())
    fetches = samples * occupied + (float((left >= OPAQUE).sum()) if boundary else 0.0)
    flops = _RAY * len(left) + _SAMPLE * samples + _LOBES * fetches
    voxels = sglv.alpha.size * (1 + LOBE_CHANNELS * (1.0 if boundary else occupied))
    return Cost(flops, _FLOAT * (voxels + (3 + 3 + 1) * len(left)))


def mesh_cost(vertices: int, faces: int) -> Cost:
    """Return the cost of placing vertices (12 FLOPs) and building a binary tree: a box (6) per face and level."""
    levels = max(1.0, math.log2(max(faces, 2)))
    return Cost(12 * vertices + 6 * faces * levels, _FLOAT * (vertices * 4 + faces * 3 + faces * 12))


def panorama_cost(rays: int, faces: int, seen: int, pixels: int) -> Cost:
    """Return the cost of rendering a mesh: each ray tests two boxes per level of a binary tree and one triangle.

    Rays that hit a triangle (`seen`) also look up its colour.
    """
    levels = max(1.0, math.log2(max(faces, 2)))
    flops = rays * (2 * levels * _BOX_TEST + _TRIANGLE_TEST) + seen * (8 + 24)
    return Cost(flops, _FLOAT * (rays * (3 + 3 + 1 + 1 + 1) + faces * 12 + 3 * pixels))


def accumulate_cost(pixels: int) -> Cost:
    """Return the cost of accumulation: reads L, HDR, detail (9), depths, weights (4); writes L, depth, weight (5)."""
    return Cost(_BLEND_PIXEL * pixels, _FLOAT * (9 + 4 + 5) * pixels)


def fill_cost(pixels: int) -> Cost:
    """Return the cost of push-pull filling: reads radiance and its weight (4), writes radiance (3).

    Over four channels: downwards, a tent of four taps in each of two directions at every pixel of the coarser level;
    upwards, four taps. All levels together are 4/3 of the first.
    """
    return Cost(4 / 3 * 4 * (8 / 4 + 4) * 2 * pixels, _FLOAT * (4 + 3) * pixels)


def _halved(size: Size, times: int) -> Size:
    return tuple(edge >> times for edge in size)  # each strided convolution rounds down
