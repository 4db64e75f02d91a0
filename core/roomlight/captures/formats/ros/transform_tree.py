"""Frames of reference that move against each other over time, as ROS's tf has them."""

import bisect
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import pose_from_quaternion, rigid_inverse
from roomlight.captures.poses import MAX_STEP_S, pose_at

_MAX_FRAMES: Final = 1000
_MAX_CORRECTION_STEP_S: Final = 2.0
"""Longest step above a frame that moves: what corrects it, as a map does odometry, is slow and changes little."""

_SAME: Final = 1e-6
"""Largest difference, in metres and of quaternions, between poses of what is mounted."""


class TransformTree:
    """Poses of frames in their parents, fixed or by time."""

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}
        self._fixed: set[str] = set()
        self._times: dict[str, list[float]] = {}
        self._poses: dict[str, list[Float[np.ndarray, 7]]] = {}
        self._others: dict[str, str] = {}

    def add(self, parent: str, child: str, pose: Float[np.ndarray, "7"], *, time_s: float, fixed: bool = False) -> None:
        """Add a pose of `child` in `parent`: translation and quaternion (x, y, z, w). A second parent is left out."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if parent == child or len(self._parents) >= _MAX_FRAMES:
            return
        if self._parents.setdefault(child, parent) != parent:
            self._others.setdefault(child, parent)
            return
        if fixed:
            self._fixed.add(child)
        at = bisect.bisect_right(self._times.setdefault(child, []), time_s)
        self._times[child].insert(at, time_s)
        self._poses.setdefault(child, []).insert(at, pose)

    def settle(self) -> set[str]:
        """Let frames whose poses are all the same be fixed, as launch files repeat mounts on /tf; return them."""
        poses = self._poses.items()
        settled = {name for name, own in poses if len(own) > 1 and np.ptp(np.stack(own), axis=0).max() < _SAME}
        settled -= self._fixed
        self._fixed |= settled
        return settled

    def unsettle(self, names: set[str]) -> None:
        """Let frames move again."""
        self._fixed -= names

    def turn_above(self, frame: str) -> None:
        """Turn the links above a frame, all of them fixed, round, so that it is the root."""
        for child, parent in reversed(list(pairwise(self._chain(frame)))):
            del self._parents[child], self._times[child]
            self._others.pop(child, None)
            self._fixed.discard(child)
            pose = self._poses.pop(child)[-1]
            turned = np.concatenate([rigid_inverse(_matrix(pose))[:3, 3], -pose[3:6], pose[6:]])
            self.add(child, parent, turned, time_s=0.0, fixed=True)

    def root(self, frame: str) -> str:
        """Return the frame above all others."""
        return self._chain(frame)[-1]

    def conflicts(self, frame: str) -> list[tuple[str, str, str]]:
        """Return child, parent and second parent, which is left out, of the frames above one and of itself."""
        return [(name, self._parents[name], self._others[name]) for name in self._chain(frame) if name in self._others]

    def moves(self, frame: str) -> bool:
        """Whether a frame moves against its root."""
        return any(name in self._parents and name not in self._fixed for name in self._chain(frame))

    def moving(self) -> list[str]:
        """Return the frames that move against their parents."""
        return [name for name in self._parents if name not in self._fixed]

    def pose(self, frame: str, time_s: float) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a frame in its root.

        Raises:
            ValueError: A frame on the way has no pose near this time.
        """
        total, longest_s = np.eye(4), MAX_STEP_S
        for name in self._chain(frame)[:-1]:
            total = self._at(name, time_s, longest_s) @ total
            if name not in self._fixed:
                longest_s = _MAX_CORRECTION_STEP_S
        return total

    def between(self, target: str, source: str) -> Float[np.ndarray, "4 4"] | None:
        """Return the fixed transform from `source` to `target`; None if they are not fixed to each other."""
        poses: list[Float[np.ndarray, "4 4"]] = []
        ends: list[str] = []
        for frame in (target, source):
            total, (*links, end) = np.eye(4), self._chain(frame)
            for name in links:
                if name not in self._fixed:
                    end = name
                    break
                total = self._at(name, self._times[name][-1]) @ total
            ends.append(end)
            poses.append(total)
        return rigid_inverse(poses[0]) @ poses[1] if ends[0] == ends[1] else None

    def _chain(self, frame: str) -> list[str]:
        chain = [frame.lstrip("/")]
        while chain[-1] in self._parents and self._parents[chain[-1]] not in chain:
            chain.append(self._parents[chain[-1]])
        return chain

    def _at(self, frame: str, time_s: float, longest_s: float = MAX_STEP_S) -> Float[np.ndarray, "4 4"]:
        times, poses = self._times[frame], self._poses[frame]
        if frame in self._fixed:
            return _matrix(poses[-1])
        return pose_at(times, lambda at: _matrix(poses[at]), time_s, f"the pose of {frame[:60]!r}", longest_s)


def _matrix(pose: Float[np.ndarray, "7"]) -> Float[np.ndarray, "4 4"]:
    return pose_from_quaternion(pose[3:], pose[:3])
