"""What a lighting model does for a session: volumes into an SGLV, a probe's views into HDR and weight.

Two kinds stand behind it: `classical` (no networks) and `networks` (ONNX graphs). A backend holds one
session's state; what sessions share (loaded graphs) lives outside it.
"""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from jaxtyping import Float

from roomlight.engine.blend import PanoramaState
from roomlight.engine.mesh import PartialPanorama
from roomlight.engine.sglv import Far, Sglv
from roomlight.engine.volume import VolumeGrid


@dataclass(frozen=True)
class Estimate:
    """For one probe and frame: the HDR panorama L. (everywhere) and the raw weight L_M (0 where unseen)."""

    hdr: Float[np.ndarray, "h w 3"]
    weight: Float[np.ndarray, "h w"]


FILL_UPDATE: Final = 0.5
"""Share of a new inference taken over at each frame: what was never seen need not jump when a frame shows a little
more. Against 1, on three path-traced rooms: smoothness 0.48 instead of 0.72 (1e-3) and log-L2 0.0709 instead of 0.0707
with the classical model, 0.33 instead of 0.82 and 0.0676 instead of 0.0672 with the single-view networks."""

ProbeMemory = object
"""A backend's own memory of one probe (2D hidden states); opaque to the session."""


class Backend(Protocol):
    """One session's lighting model."""

    name: str
    far: Far
    """How rays that leave the volume end (see `roomlight.engine.sglv`)."""

    def start(self, grid: VolumeGrid) -> None:
        """The volume's frame is known: make the state."""
        ...

    def volume_buffer(self) -> Float[np.ndarray, "5 z y x"]:
        """Where the frame's initial volume is to be written (bound to the graphs, no copy)."""
        ...

    def update(self) -> Sglv:
        """Take the volume in the buffer as the next frame's; return the SGLV after it."""
        ...

    def new_probe(self) -> ProbeMemory:
        """Memory for a probe that has seen nothing."""
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
        """Light of one probe before this frame's details are blended into `state`."""
        ...
