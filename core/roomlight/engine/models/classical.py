"""Lighting without networks: the baseline, and the model that runs without trained weights.

SGLV: the initial volumes of all frames, averaged voxel by voxel over the frames that observed the voxel (as surface or
as empty). Blending: the mesh's radiance replaces the rest, under the paper's conservative rule. Directions that neither
shows are filled from their surroundings by push-pull. Pixels brighter than white contribute white to the fill, because
windows and lamps end at their frames while walls go on.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.engine.models.interface import FILL_UPDATE, Arrays, Estimate, Rendered
from roomlight.engine.panorama.blend import PanoramaState, PartialPanorama, latest_detail
from roomlight.engine.panorama.fill import at_most_white, push_pull
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import VOLUME_SHAPE, VolumeGrid
from roomlight.engine.volume.sglv import Far, Sglv

VOLUME_WEIGHT: Final = 0.01
"""Weight of the SGLV's rendering against the mesh's in the fill: its voxels are 10 to 25 cm wide, and the band of
five voxels behind each surface is seen edge-on by a probe. Mean log-L2 over three path-traced rooms: 0.072 at 0.3,
0.071 at 0.1, 0.068 at 0.01. Where only the SGLV reaches, it is better than none."""


class ClassicalModel:
    """The classical model; see the module docstring."""

    name = "classical"
    digest = ""
    volume_shape = VOLUME_SHAPE

    def begin(self, grid: VolumeGrid) -> "ClassicalVolume":
        """Allocate the sums over frames for this volume."""
        return ClassicalVolume(grid)

    def new_probe(self) -> "ClassicalProbe":
        """Begin a probe that has observed nothing."""
        return ClassicalProbe()


class ClassicalVolume:
    """Sums over the frames of a session, and their means as SGLV."""

    far: Far = "none"

    def __init__(self, grid: VolumeGrid) -> None:
        """Begin without frames."""
        self.volume = np.zeros((5, *grid.shape), np.float32)
        self.sglv = Sglv.empty(grid)
        self._fused = FusedVolume.fresh(grid.shape)
        self._whole = False  # whether other voxels than those of the volume in the buffer have changed

    def update(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Add the volume to the average: alpha over the frames that observed a voxel, colour weighted by alpha."""
        self._fused.add(self.volume, clipping)
        self._fused.write_surfaces(self.sglv, None if self._whole else self.volume)
        self._whole = False

    def add(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Add the volume to the sums; the next `update` writes their means."""
        self._fused.add(self.volume, clipping)
        self._whole = True

    def save(self) -> Arrays:
        """Return copies of the sums over frames; the SGLV follows from them."""
        return self._fused.save()

    def restore(self, saved: Arrays) -> None:
        """Take over saved sums."""
        self._fused.restore(saved)
        self._fused.write_surfaces(self.sglv, None)


class ClassicalProbe:
    """The estimates of one probe, and the number of frames so far."""

    def __init__(self) -> None:
        self.frames = 0

    def estimate(
        self, panorama: PanoramaState, rendered: Rendered, partial: PartialPanorama, *, depth_max_m: float
    ) -> Estimate:
        """Estimate the HDR panorama: observed radiance and, with little weight, the SGLV, spread by push-pull."""
        del depth_max_m
        detail, known = latest_detail(panorama, partial)
        opaque = 1 - rendered.transmittance
        # The edges of the volume's band are half transparent and misleading: hence the fourth power.
        volume_weight = (1 - known) * VOLUME_WEIGHT * opaque**4
        weight = known + volume_weight
        volume = at_most_white(rendered.radiance / np.maximum(opaque, 1e-3)[..., None])
        mixed = known[..., None] * at_most_white(detail) + volume_weight[..., None] * volume
        hdr = push_pull(mixed / np.maximum(weight, 1e-6)[..., None], weight)
        if self.frames > 0:
            hdr = panorama.radiance + np.float32(FILL_UPDATE) * (hdr - panorama.radiance)
        self.frames += 1
        return Estimate(hdr, partial.mask.astype(np.float32))

    def save(self) -> Arrays:
        """Return the number of frames."""
        return {"frames": np.array(self.frames)}

    def restore(self, saved: Arrays) -> None:
        """Take over a saved state."""
        self.frames = int(saved["frames"])
