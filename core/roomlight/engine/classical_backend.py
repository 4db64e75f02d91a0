"""Lighting without networks: the baseline, and the model that runs without trained weights.

SGLV: the initial volumes of all frames, averaged voxel by voxel over the frames that observed the voxel (as surface or
as empty). Blending: the mesh's radiance replaces the rest, under the paper's conservative rule. Directions that neither
shows are filled from their surroundings by push-pull. Pixels brighter than white contribute white to the fill, because
windows and lamps end at their frames while walls go on.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.engine.backend import FILL_UPDATE, Arrays, Estimate, ProbeMemory
from roomlight.engine.panorama.blend import PanoramaState, latest_detail
from roomlight.engine.panorama.fill import at_most_white, push_pull
from roomlight.engine.surface.mesh import PartialPanorama
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import Far, Sglv

VOLUME_WEIGHT: Final = 0.01
"""Weight of the SGLV's rendering against the mesh's in the fill: its voxels are 10 to 25 cm wide, and the band of
five voxels behind each surface is seen edge-on by a probe. Mean log-L2 over three path-traced rooms: 0.072 at 0.3,
0.071 at 0.1, 0.068 at 0.01. Where only the SGLV reaches, it is better than none."""


@dataclass
class _Memory:
    """Number of frames blended into a probe."""

    frames: int = 0


class ClassicalBackend:
    """The classical model of one session; see the module docstring."""

    name = "classical"
    digest = ""
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
        self._fused.add(self._volume, clipping)
        return self._mean(self._volume[3] > 0)

    def _mean(self, touched: Bool[np.ndarray, "z y x"]) -> Sglv:
        """Write the means into the SGLV; colour only where `touched`, because the rest has not changed."""
        fused = self._fused
        np.divide(fused.opacity, fused.count, out=self._sglv.alpha, where=fused.count > 0)
        self._sglv.lobes[touched, :3] = fused.colour[touched] / fused.opacity[touched, None]
        return self._sglv

    def save(self) -> Arrays:
        """Return copies of the sums over frames; the SGLV follows from them."""
        return self._fused.save()

    def restore(self, grid: VolumeGrid, saved: Arrays) -> Sglv:
        """Continue from saved sums."""
        self.start(grid)
        self._fused.restore(saved)
        return self._mean(self._fused.opacity > 0)

    def new_probe(self) -> ProbeMemory:
        """Return the state of a probe besides its panorama."""
        return _Memory()

    def save_probe(self, memory: ProbeMemory) -> Arrays:
        """Return the number of frames of a probe."""
        assert isinstance(memory, _Memory)
        return {"frames": np.array(memory.frames)}

    def restore_probe(self, saved: Arrays) -> ProbeMemory:
        """Return the state of a probe from a saved one."""
        return _Memory(int(saved["frames"]))

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
        assert isinstance(memory, _Memory)
        detail, known = latest_detail(state, partial.radiance, partial.depth_m, mask=partial.mask)
        opaque = 1 - transmittance
        # The edges of the volume's band are half transparent and misleading: hence the fourth power.
        volume_weight = (1 - known) * VOLUME_WEIGHT * opaque**4
        weight = known + volume_weight
        volume = at_most_white(rendered / np.maximum(opaque, 1e-3)[..., None])
        mixed = known[..., None] * at_most_white(detail) + volume_weight[..., None] * volume
        hdr = push_pull(mixed / np.maximum(weight, 1e-6)[..., None], weight)
        if memory.frames > 0:
            hdr = state.radiance + np.float32(FILL_UPDATE) * (hdr - state.radiance)
        memory.frames += 1
        return Estimate(hdr, partial.mask.astype(np.float32))
