"""Memory of a session, now and at most: counted from array shapes."""

import ctypes
import sys
from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight.engine.networks.graph import Graph
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.room import LEFT_KEYFRAMES
from roomlight.engine.volume.grid import VOLUME_SHAPE
from roomlight.engine.volume.sglv import LOBE_CHANNELS

KEYFRAME_BYTES: Final = 320 * 240 * (3 * 4 + 1 + 1 + 4) + 160 * 120 * (4 + 1) + 40 * 30 * (3 * 4 + 1)
"""Memory of a kept frame: its image, which pixels the sensor clipped and which still are, what was estimated for them;
depth at the mesh's vertices, and where it was measured; a small image to compare exposures with. Triangles and pyramids
are made when they are wanted."""
_SUM_CHANNELS: Final = 7
"""Float32 a voxel of the sums over frames: colour, opacity, count, clipping."""
_CLASSICAL_CHANNELS: Final = 5 + _SUM_CHANNELS + 11
"""Float32 a voxel: the volume, the sums, the SGLV."""
_STATE_CHANNELS: Final = 12
"""Float32 a pixel of a probe's panorama: radiance, depth, seen, clipped, guessed, changed, viewed_from, measured."""


@dataclass(frozen=True)
class Footprint:
    """Bytes of a session's parts: the volume with its states, one probe, one keyframe, one room that was left."""

    volume: int
    probe: int
    keyframe: int = KEYFRAME_BYTES
    left: int = 4 * (1 + LOBE_CHANNELS) * int(np.prod(VOLUME_SHAPE)) + LEFT_KEYFRAMES * KEYFRAME_BYTES

    @classmethod
    def of(cls, graphs: LightingGraphs | None, height: int) -> "Footprint":
        """Count for these graphs (None: classical) and panoramas of `height` rows."""
        panorama = 4 * _STATE_CHANNELS * 2 * height * height
        if graphs is None:
            return cls(4 * _CLASSICAL_CHANNELS * int(np.prod(VOLUME_SHAPE)), panorama)
        loaded = graphs.graphs
        volume = _floats(loaded["single_sg_encoder"].inputs) + 2 * _floats(loaded["single_sg_decoder"].outputs)
        blend = _floats(loaded["single_blend_encoder"].inputs) + _outputs(loaded["single_blend_encoder"])
        blend += 2 * _outputs(loaded["single_blend_decoder"])  # the weight, and a mask of the same size
        volume += _outputs(loaded["single_sg_encoder"])
        if graphs.form == "video":  # hidden states in two buffers, and the new features
            volume += 2 * _outputs(loaded["video_sg_encoder"]) + 3  # and the unit of colour
            blend += _floats(loaded["video_blend_encoder"].inputs) + 2 * _outputs(loaded["video_blend_encoder"])
        else:  # the frame's own volume, and the sums over frames
            volume += _floats(loaded["single_sg_encoder"].inputs)
            volume += _SUM_CHANNELS * int(np.prod(graphs.volume_shape))
        return cls(4 * volume, panorama + 4 * blend)

    def total(self, *, keyframes: int, probes: int, started: bool, left: int = 0) -> int:
        """Return the bytes of a session with these numbers of keyframes, of probes, and of rooms that were left.

        `started`: whether the first frame was processed; before it, only probes take memory.
        """
        room = self.volume + (keyframes + 1) * self.keyframe + left * self.left
        return room * started + probes * self.probe


def release_free_memory() -> None:
    """Return freed memory to the operating system, where the C library (glibc) would keep it.

    After three sessions of 31 frames had ended: 738 MB resident before the call, 277 after it, as before the first one.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


def _floats(shapes: dict[str, tuple[int, ...]]) -> int:
    return sum(int(np.prod(shape)) for shape in shapes.values())


def _outputs(graph: Graph) -> int:
    return _floats(graph.outputs)
