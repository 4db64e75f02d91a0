"""Points to light: where an object can be placed in view of a camera."""

import numpy as np

from roomlight.conventions import Position
from roomlight.errors import ProbeError
from roomlight.frame import Frame


def point_in_view(frame: Frame) -> Position:
    """A point in free space that the first camera looks at: on the optical axis, at 60 % of the median depth."""
    known = frame.depth_m[frame.depth_m > 0]
    if known.size == 0:
        raise ProbeError(f"{frame.source}: no depth to place a probe by; give --probe X,Y,Z")
    point = frame.camera_to_world @ np.array([0, 0, -0.6 * float(np.median(known)), 1.0])
    x, y, z = (round(value, 3) for value in point[:3].tolist())
    return x, y, z
