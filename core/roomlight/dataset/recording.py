"""A generated sequence, as it is stored, read back and trained on."""

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from roomlight.camera import Intrinsics

Split = Literal["train", "test"]

ORDINARY: Final = 0
GLASS: Final = 1
MIRROR: Final = 2
LIGHT: Final = 3
"""What a pixel's surface is to a depth sensor: `LIGHT` is the visible source itself."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames, exact depth, poses and ground-truth panoramas of one camera walk through one room.

    World frame: y up, metres; poses camera-to-world, OpenGL axes. colour is what the phone's camera gives (sRGB 8 bit,
    exposed, clipped, noisy). depth_mm is exact z-depth in millimetres, 0 where nothing is hit (open sky); a window's
    pane, a mirror and a lamp count as surfaces where they stand. surface says which (`ORDINARY`, `GLASS`, `MIRROR`,
    `LIGHT`). exposure is relative to the first frame's, so exposure[0] = 1, and the panoramas are in the first frame's
    units: 1.0 is what the first frame shows as white. facts hold what is reported and nothing that is needed: room
    type, seeds, light sources, kilocandela per square metre for 1.0, attributions.
    """

    name: str
    colour: UInt8[np.ndarray, "f h w 3"]
    depth_mm: UInt16[np.ndarray, "f h w"]
    surface: UInt8[np.ndarray, "f h w"]
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "f 4 4"]
    exposure: Float[np.ndarray, " f"]
    timestamp_s: Float[np.ndarray, " f"]
    probe_positions: Float[np.ndarray, "p 3"]
    probe_panoramas: Float[np.ndarray, "p ph pw 3"]
    facts: dict[str, Any]
