"""Poses between those that are stored."""

import bisect
from collections.abc import Callable, Sequence
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.captures.times import nearest

MAX_STEP_S: Final = 0.5
"""Longest time between two poses of a camera that are interpolated."""
MAX_GAP_S: Final = 0.05
"""Longest time to the nearest pose where none is interpolated."""
_SAME_S: Final = 1e-4


def pose_at(
    times: Sequence[float],
    stored: Callable[[int], Float[np.ndarray, "4 4"]],
    time_s: float,
    what: str,
    longest_s: float = MAX_STEP_S,
) -> Float[np.ndarray, "4 4"]:
    """Return the pose at a time, interpolated between those before and after it, or the nearest beside a longer step.

    Args:
        times: Of the poses, increasing.
        stored: Returns a pose by its index, local to world.
        time_s: The time.
        what: The pose in messages.
        longest_s: Longest time between two poses that are interpolated.

    Raises:
        ValueError: The nearest pose is too far in time, or `stored` raises it.
    """
    near, after = nearest(times, time_s), bisect.bisect_left(times, time_s)
    gap_s = abs(times[near] - time_s)
    if gap_s > _SAME_S and 0 < after < len(times) and (step_s := times[after] - times[after - 1]) <= longest_s:
        share = (time_s - times[after - 1]) / step_s
        a, b = stored(after - 1), stored(after)
        turn, _ = cv2.Rodrigues(a[:3, :3].T @ b[:3, :3])
        pose = a + share * (b - a)
        pose[:3, :3] = a[:3, :3] @ cv2.Rodrigues(share * turn)[0]
        return pose
    if gap_s > MAX_GAP_S:
        raise ValueError(f"{what} nearest in time is {gap_s:.3f} s away; at most {MAX_GAP_S} s is allowed")
    return stored(near)
