"""What the lighting models have in common: initial volumes into an SGLV, and a probe's views into panorama and weight.

A model exists before the first frame and holds no state: sessions share its networks. With the first frame's grid it
begins a volume (sums or 3D hidden states), and each probe (2D hidden states). Each owns its state and saves it, as
copies, between frames.

A frame's initial volume is written to the buffer `volume`, which is bound to the graphs. `update` takes it as the next
frame, and `sglv` is the SGLV after it: zeros before the first frame, overwritten by the next. `add` takes it as an
earlier frame: the next `update` makes an SGLV of both. `clipping` is what of it was clipped
(`roomlight.engine.volume.grid.initial_volume`). `far` is what a ray gets where it leaves the volume. `estimate` comes
before the frame's details are blended into the panorama, with the SGLV after the frame and its depth_max_m, D_max.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

FILL_UPDATE: Final = 0.5
"""Share of a new inference taken over at each frame, so that unobserved directions do not jump from frame to frame.
Against 1, on three path-traced rooms: smoothness 0.48 instead of 0.72 (1e-3) and log-L2 0.0709 instead of 0.0707
with the classical model, 0.33 instead of 0.82 and 0.0676 instead of 0.0672 with the single-view networks."""

Arrays = dict[str, np.ndarray]
"""Arrays of a saved state, by name; shapes and types differ."""


@dataclass(frozen=True)
class Rendered:
    """The SGLV ray traced at a probe: linear RGB, and the share of each ray that nothing stopped."""

    radiance: Float[np.ndarray, "h w 3"]
    transmittance: Float[np.ndarray, "h w"]


@dataclass(frozen=True)
class Estimate:
    """A model's HDR panorama for one probe and frame, and raw blending weight L_M, 0 where the mesh is not visible."""

    hdr: Float[np.ndarray, "h w 3"]
    weight: Float[np.ndarray, "h w"]
