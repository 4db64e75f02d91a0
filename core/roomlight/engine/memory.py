"""How many bytes a session holds, and the most it can come to: counted from shapes, and measured where Embree holds."""

import ctypes
import sys
from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight.engine.graphs import Graph, LightingGraphs
from roomlight.engine.volume import VOLUME_SHAPE

KEYFRAME_BYTES: Final = 5_400_000
"""Resident, of one frame of 320 x 240 with its mesh (measured, see `roomlight.engine.keyframes`)."""
_CLASSICAL_CHANNELS: Final = 21
"""Float32 a voxel: the volume's 5, the sums' 5, the SGLV's 11."""
_STATE_CHANNELS: Final = 5
"""Float32 a pixel of a probe's panorama: radiance, depth, seen."""


@dataclass(frozen=True)
class Footprint:
    """Bytes of a session's parts: the volume with its states, one tracked probe, one keyframe."""

    volume: int
    probe: int
    keyframe: int = KEYFRAME_BYTES

    @classmethod
    def of(cls, graphs: LightingGraphs | None, height: int) -> "Footprint":
        """For these graphs (None: classical) and panoramas of this height."""
        panorama = 4 * _STATE_CHANNELS * 2 * height * height
        if graphs is None:
            return cls(4 * _CLASSICAL_CHANNELS * int(np.prod(VOLUME_SHAPE)), panorama)
        loaded = graphs.graphs
        volume = _floats(loaded["single_sg_encoder"].inputs) + 2 * _floats(loaded["single_sg_decoder"].outputs)
        blend = _floats(loaded["single_blend_encoder"].inputs) + _outputs(loaded["single_blend_encoder"])
        blend += 2 * _outputs(loaded["single_blend_decoder"])  # the weight, and the mask of its size
        volume += _outputs(loaded["single_sg_encoder"])
        if graphs.form == "video":  # hidden states twice over, and the fresh features
            volume += 2 * _outputs(loaded["video_sg_encoder"])
            blend += _floats(loaded["video_blend_encoder"].inputs) + 2 * _outputs(loaded["video_blend_encoder"])
        else:  # the frame's own volume, and the sums over frames
            volume += 2 * _floats(loaded["single_sg_encoder"].inputs)
        return cls(4 * volume, panorama + 4 * blend)

    def held(self, *, keyframes: int, probes: int, started: bool) -> int:
        """Bytes with so many keyframes and probes; nothing is allocated before the first frame."""
        return (self.volume + (keyframes + 1) * self.keyframe) * started + probes * self.probe


def give_back() -> None:
    """Hand freed memory back to the system, where the C library would keep it (glibc).

    After three sessions of 31 frames had ended: 738 MB resident before, 277 after, as before the first of them.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


def _floats(shapes: dict[str, tuple[int, ...]]) -> int:
    return sum(int(np.prod(shape)) for shape in shapes.values())


def _outputs(graph: Graph) -> int:
    return _floats(graph.outputs)
