"""The interface of a lighting model: initial volumes into an SGLV, a probe's views into HDR panorama and weight.

Implemented by `classical_backend` (no networks) and `network_backend` (ONNX graphs). A backend holds the state of one
session; loaded graphs are shared between sessions.
"""

from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.surface.mesh import PartialPanorama
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import Far, Sglv


@dataclass(frozen=True)
class Estimate:
    """For one probe and frame: the HDR panorama L. [H, 2H, 3] (everywhere) and the raw weight L_M [H, 2H] (0 where the
    frame's mesh is not seen)."""

    hdr: Float[np.ndarray, "h w 3"]
    weight: Float[np.ndarray, "h w"]


FILL_UPDATE: Final = 0.5
"""Share of a new inference taken over at each frame, so that unobserved directions do not jump from frame to frame.
Against 1, on three path-traced rooms: smoothness 0.48 instead of 0.72 (1e-3) and log-L2 0.0709 instead of 0.0707
with the classical model, 0.33 instead of 0.82 and 0.0676 instead of 0.0672 with the single-view networks."""

Arrays = dict[str, np.ndarray]
"""Arrays of a saved state, by name; shapes and types differ."""
ProbeMemory = object
"""A backend's state of one probe (2D hidden states); opaque to the session."""


@runtime_checkable
class Backend(Protocol):
    """One session's lighting model."""

    name: str
    digest: str
    """Identity of the networks' weights; empty without networks."""
    far: Far
    """What a ray gets where it leaves the volume (see `roomlight.engine.volume.sglv`)."""

    def start(self, grid: VolumeGrid) -> None:
        """Allocate the state for this volume, at the first frame."""
        ...

    def volume_buffer(self) -> Float[np.ndarray, "5 z y x"]:
        """Return the buffer for the frame's initial volume (bound to the graphs, no copy)."""
        ...

    def update(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> Sglv:
        """Process the volume in the buffer as the next frame; return the SGLV after it.

        clipping:  what of the volume was clipped (see `roomlight.engine.volume.grid.initial_volume`); None: nothing.
        """
        ...

    def save(self) -> Arrays:
        """Return copies of the state between frames, after at least one frame."""
        ...

    def restore(self, grid: VolumeGrid, saved: Arrays) -> Sglv:
        """Continue from a saved state instead of `start`; return the SGLV after its last frame."""
        ...

    def new_probe(self) -> ProbeMemory:
        """Return the state of a probe that has observed nothing."""
        ...

    def save_probe(self, memory: ProbeMemory) -> Arrays:
        """Return copies of the state of a probe."""
        ...

    def restore_probe(self, saved: Arrays) -> ProbeMemory:
        """Return the state of a probe from a saved one."""
        ...

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
        """Estimate the light of one probe before this frame's details are blended into `state`.

        rendered, transmittance:  the SGLV ray traced at the probe, [H, 2H, 3] and [H, 2H].
        partial:                  what the probe sees of the frame's mesh.
        """
        ...
