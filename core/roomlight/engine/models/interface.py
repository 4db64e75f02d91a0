"""What a lighting model does for a session: initial volumes into an SGLV, and a probe's views into panorama and weight.

A `LightingModel` exists before the first frame and holds no state. It begins a `VolumeEstimator` with the first frame's
grid, which in turn begins a `ProbeEstimator` for each probe. Each estimator owns its state and saves it.
"""

from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.surface.mesh import PartialPanorama
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import Far, Sglv

FILL_UPDATE: Final = 0.5
"""Share of a new inference taken over at each frame, so that unobserved directions do not jump from frame to frame.
Against 1, on three path-traced rooms: smoothness 0.48 instead of 0.72 (1e-3) and log-L2 0.0709 instead of 0.0707
with the classical model, 0.33 instead of 0.82 and 0.0676 instead of 0.0672 with the single-view networks."""

Arrays = dict[str, np.ndarray]
"""Arrays of a saved state, by name; shapes and types differ."""


@dataclass(frozen=True)
class Rendered:
    """The SGLV ray traced at a probe.

    Attributes:
        radiance: [H, 2H, 3] linear RGB.
        transmittance: [H, 2H] share of each ray that nothing stopped.
    """

    radiance: Float[np.ndarray, "h w 3"]
    transmittance: Float[np.ndarray, "h w"]


@dataclass(frozen=True)
class Estimate:
    """A model's answer for one probe and frame.

    Attributes:
        hdr: [H, 2H, 3] the HDR panorama, in every direction.
        weight: [H, 2H] the raw blending weight L_M, 0 where the frame's mesh is not visible.
    """

    hdr: Float[np.ndarray, "h w 3"]
    weight: Float[np.ndarray, "h w"]


@runtime_checkable
class ProbeEstimator(Protocol):
    """A model's state of one probe (2D hidden states), and its estimates."""

    def estimate(
        self, panorama: PanoramaState, rendered: Rendered, partial: PartialPanorama, *, depth_max_m: float
    ) -> Estimate:
        """Estimate the light of the probe before this frame's details are blended into its panorama.

        Args:
            panorama: What the probe has accumulated before this frame.
            rendered: The SGLV after this frame, at the probe.
            partial: What the probe sees of the frame's mesh.
            depth_max_m: D_max of the volume.
        """
        ...

    def save(self) -> Arrays:
        """Return copies of the state."""
        ...

    def restore(self, saved: Arrays) -> None:
        """Take over a saved state."""
        ...


@runtime_checkable
class VolumeEstimator(Protocol):
    """A model's state of one session (sums or 3D hidden states), from the first frame on."""

    far: Far
    """What a ray gets where it leaves the volume (see `roomlight.engine.volume.sglv`)."""

    @property
    def volume(self) -> Float[np.ndarray, "5 z y x"]:
        """The buffer for a frame's initial volume (bound to the graphs, no copy)."""
        ...

    @property
    def sglv(self) -> Sglv:
        """The SGLV after the last frame, zeros before the first; the next frame overwrites it."""
        ...

    def update(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Process the volume in the buffer as the next frame.

        Args:
            clipping: What of the volume was clipped (see `roomlight.engine.volume.grid.initial_volume`); None: nothing.
        """
        ...

    def add(self, clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Take the volume in the buffer as that of an earlier frame: the next `update` makes an SGLV of both."""
        ...

    def new_probe(self) -> ProbeEstimator:
        """Begin a probe that has observed nothing."""
        ...

    def save(self) -> Arrays:
        """Return copies of the state between frames, after at least one frame."""
        ...

    def restore(self, saved: Arrays) -> None:
        """Take over a saved state of the same grid."""
        ...


@runtime_checkable
class LightingModel(Protocol):
    """A lighting model before the first frame: stateless, its networks shared between sessions."""

    @property
    def name(self) -> str:
        """The model: classical, single or video."""
        ...

    @property
    def digest(self) -> str:
        """Identity of the networks' weights; empty without networks."""
        ...

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """Voxels along z, y, x."""
        ...

    def begin(self, grid: VolumeGrid) -> VolumeEstimator:
        """Allocate the state of a session for this volume."""
        ...
