"""Lighting without networks: the baseline, and the model that runs without trained weights.

SGLV: the initial volumes of all frames, averaged voxel by voxel over the frames that observed the voxel (as surface or
as empty). Blending: the mesh's radiance replaces the rest, under the paper's conservative rule. Directions that neither
shows are filled from their surroundings by push-pull. Pixels brighter than white contribute white to the fill, because
windows and lamps end at their frames while walls go on.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.engine.backend import FILL_UPDATE, Estimate, ProbeMemory
from roomlight.engine.blend import PanoramaState, latest_detail
from roomlight.engine.fill import at_most_white, push_pull
from roomlight.engine.fusion import FusedVolume
from roomlight.engine.mesh import PartialPanorama
from roomlight.engine.sglv import Far, Sglv
from roomlight.engine.volume import VolumeGrid

VOLUME_WEIGHT: Final = 0.01
"""Weight of the SGLV's rendering against the mesh's in the fill: its voxels are 10 to 25 cm wide, and the band of
five voxels behind each surface is seen edge-on by a probe. Mean log-L2 over three path-traced rooms: 0.072 at 0.3,
0.071 at 0.1, 0.068 at 0.01. Where only the SGLV reaches, it is better than none."""


@dataclass
class _Memory:
    """Number of frames blended into a probe."""

    frames: int = 0


@dataclass(frozen=True)
class Observed:
    """What the frames have shown a probe; [H, 2H].

    Attributes:
        detail: radiance, where observed.
        known: share observed, 0 to 1.
        clipped: share of it that was clipped.
        depth_m: distance, where observed.
        fill: radiance everywhere, spread from the observed.
    """

    detail: Float[np.ndarray, "h w 3"]
    known: Float[np.ndarray, "h w"]
    clipped: Float[np.ndarray, "h w"]
    depth_m: Float[np.ndarray, "h w"]
    fill: Float[np.ndarray, "h w 3"]


class ClassicalBackend:
    """The classical model of one session; see the module docstring."""

    name = "classical"
    far: Far = "none"

    def __init__(self) -> None:
        self._grid: VolumeGrid | None = None

    def start(self, grid: VolumeGrid) -> None:
        """Allocate the sums over frames for this volume."""
        self._grid = grid
        self._volume = np.zeros((5, *grid.shape), np.float32)
        self._fused = FusedVolume.fresh(grid.shape)
        self._sglv = Sglv.empty(grid)

    def volume_buffer(self) -> Float[np.ndarray, "5 z y x"]:
        """Return the buffer for the frame's initial volume."""
        return self._volume

    def update(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> Sglv:
        """Add the volume to the average: alpha over the frames that observed a voxel, colour weighted by alpha."""
        fused = self._fused
        fused.add(self._volume, clipping)
        np.divide(fused.opacity, fused.count, out=self._sglv.alpha, where=fused.count > 0)
        touched = self._volume[3] > 0
        self._sglv.lobes[touched, :3] = fused.colour[touched] / fused.opacity[touched, None]
        return self._sglv

    def new_probe(self) -> ProbeMemory:
        """Return the state of a probe besides its panorama."""
        return _Memory()

    def estimate(
        self,
        memory: ProbeMemory,
        state: PanoramaState,
        *,
        rendered: Float[np.ndarray, "h w 3"],
        transmittance: Float[np.ndarray, "h w"],
        partial: PartialPanorama,
        depth_max_m: float,
    ) -> Estimate:
        """Estimate the HDR panorama: observed radiance and, with little weight, the SGLV, spread by push-pull."""
        del depth_max_m
        seen = self.observe(state, rendered=rendered, transmittance=transmittance, partial=partial)
        hdr = seen.fill
        if self.is_later_frame(memory):
            hdr = state.radiance + np.float32(FILL_UPDATE) * (hdr - state.radiance)
        return Estimate(hdr, partial.mask.astype(np.float32))

    def observe(
        self,
        state: PanoramaState,
        *,
        rendered: Float[np.ndarray, "h w 3"],
        transmittance: Float[np.ndarray, "h w"],
        partial: PartialPanorama,
    ) -> "Observed":
        """Return what the stream has shown a probe up to this frame, and the fill of the rest."""
        detail, known = latest_detail(state, partial.radiance, partial.depth_m, mask=partial.mask)
        fresh = partial.mask & state.is_closer(partial.depth_m)
        clipped = state.clipped if partial.clipped is None else np.where(fresh, partial.clipped, state.clipped)
        opaque = 1 - transmittance
        # The edges of the volume's band are half transparent and misleading: hence the fourth power.
        volume_weight = (1 - known) * VOLUME_WEIGHT * opaque**4
        weight = known + volume_weight
        volume = at_most_white(rendered / np.maximum(opaque, 1e-3)[..., None])
        mixed = known[..., None] * at_most_white(detail) + volume_weight[..., None] * volume
        fill = push_pull(mixed / np.maximum(weight, 1e-6)[..., None], weight)
        return Observed(detail, known, clipped, np.where(fresh, partial.depth_m, state.depth_m), fill)

    def is_later_frame(self, memory: ProbeMemory) -> bool:
        """Count a frame of a probe; return whether it had one before."""
        assert isinstance(memory, _Memory)
        memory.frames += 1
        return memory.frames > 1
