"""A bounded store of keyframes, chosen for coverage: the light at a position requested later is computed from them.

Coverage is counted in cells of the volume (2 x 2 x 2 voxels) that hold a vertex of the frame's mesh; a vertex
outside the volume counts in the nearest cell of its outer layer.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.engine.surface.change import contradicts, not_seen_through
from roomlight.engine.surface.mesh import FrameMesh, most_alike
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.errors import OptionError

DEFAULT_KEYFRAMES: Final = 24
"""A keyframe of 320 x 240 pixels takes at most 1.5 MB (`roomlight.engine.memory`), so 24 take 36 MB a session; they
cover two pans around a room at 58 degrees of view."""
MIN_NEW_SHARE: Final = 0.04
"""A frame is kept if at least this share of its cells is in no keyframe yet: 4 % is a pan of about 2.5 degrees."""
_COMPARED: Final = 5
"""Keyframes that frames are compared with in turn, in order of time: those with the most similar heading. In the order
of their similarity a pan, whose every frame becomes a keyframe, would come to every fifth one only."""
_MOST_LOST: Final = 0.1
"""A keyframe can be dropped if this share of its cells, at most, is then in no keyframe and not in the frame, apart
from cells of what the frame sees through: a pan with a person who walks along would lose the room."""
_CELL: Final = 2


@dataclass(frozen=True)
class Keyframe:
    """A kept frame: its mesh and the cells that it covers."""

    index: int
    mesh: FrameMesh
    cells: Bool[np.ndarray, " cells"]


class KeyframeStore:
    """At most `capacity` keyframes in order of time; when full, the one with the fewest cells of its own is dropped."""

    def __init__(self, grid: VolumeGrid, capacity: int = DEFAULT_KEYFRAMES) -> None:
        """Make an empty store for frames of this volume.

        Raises:
            OptionError: `capacity` is below 1.
        """
        if capacity < 1:
            raise OptionError(f"capacity of a keyframe store must be 1 or more, got {capacity}")
        self._grid = grid
        self.capacity = capacity
        self._counts = np.zeros(int(np.prod([-(-n // _CELL) for n in grid.shape])), np.int32)
        self._keyframes: list[Keyframe] = []
        self._last: Keyframe | None = None  # if it is no keyframe

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[Keyframe]:
        """Iterate in order of time over the keyframes as they are now; offers during the iteration do not change it."""
        return iter(tuple(self._keyframes))

    @property
    def last(self) -> Keyframe | None:
        """The last frame, if it is no keyframe; it is kept until the next one."""
        return self._last

    def with_last(self) -> list[Keyframe]:
        """Return the keyframes in order of time, then the last frame if it is no keyframe."""
        return self._keyframes + ([] if self._last is None else [self._last])

    def offer(self, index: int, mesh: FrameMesh) -> bool:
        """Keep the frame if it shows enough new cells; return whether it was kept."""
        offered = self._keyframe(index, mesh)
        self._last = offered
        total = int(offered.cells.sum())
        if total == 0 or int((offered.cells & (self._counts == 0)).sum()) < MIN_NEW_SHARE * total:
            return False
        self._append(offered)
        if len(self._keyframes) > self.capacity:
            alone = [int((key.cells & (self._counts == 1)).sum()) for key in self._keyframes]
            dropped = self._keyframes.pop(int(np.argmin(alone)))
            self._counts -= dropped.cells
            if dropped is offered:
                return False
        self._last = None
        return True

    def drop_contradicted(self, mesh: FrameMesh, *, turn: int) -> None:
        """Drop a keyframe that this frame and the one before it contradict, or mark it if it shows much else.

        Each turn compares another one of the keyframes most alike.
        """
        if not self._keyframes:
            return
        alike = sorted(most_alike(mesh.camera_to_world, [key.mesh for key in self._keyframes], _COMPARED))
        number = alike[turn % len(alike)]
        keyframe, last = self._keyframes[number], self.with_last()[-1]
        if contradicts(mesh, keyframe.mesh) and contradicts(last.mesh, keyframe.mesh):
            there = self._cells_of(not_seen_through(mesh, keyframe.mesh))
            lost = there & (self._counts == 1) & ~self.cells_of(mesh)
            if lost.sum() <= _MOST_LOST * keyframe.cells.sum():
                self._counts -= keyframe.cells
                del self._keyframes[number]
            else:
                keyframe.mesh.contradicted = True

    def thinned(self, count: int) -> list[Keyframe]:
        """Return at most `count` keyframes in order of time, without those that have the fewest cells of their own."""
        chosen, counts = list(self._keyframes), self._counts.copy()
        while len(chosen) > count:
            alone = [int((key.cells & (counts == 1)).sum()) for key in chosen]
            counts -= chosen.pop(int(np.argmin(alone))).cells
        return chosen

    def restore(self, keyframes: Mapping[int, FrameMesh], last: tuple[int, FrameMesh] | None) -> None:
        """Take over the frames of a saved state.

        Args:
            keyframes: Their meshes by frame index, in order of time.
            last: Index and mesh of the last frame if it is no keyframe.
        """
        for index, mesh in keyframes.items():
            self._append(self._restored(index, mesh))
        self._last = None if last is None else self._restored(*last)

    def _restored(self, index: int, mesh: FrameMesh) -> Keyframe:
        keyframe = self._keyframe(index, mesh)
        mesh.forget()
        return keyframe

    def _keyframe(self, index: int, mesh: FrameMesh) -> Keyframe:
        return Keyframe(index, mesh, self.cells_of(mesh))

    def _append(self, keyframe: Keyframe) -> None:
        self._keyframes.append(keyframe)
        self._keyframes.sort(key=lambda kept: kept.index)  # two rooms' frames interleave where a walk goes to and fro
        self._counts += keyframe.cells

    def cells_of(self, mesh: FrameMesh) -> Bool[np.ndarray, " cells"]:
        """Return which cells of the volume the mesh covers."""
        return self._cells_of(mesh.vertices[mesh.known])

    def _cells_of(self, vertices: Float[np.ndarray, "v 3"]) -> Bool[np.ndarray, " cells"]:
        grid = self._grid
        local = vertices @ grid.world_to_volume[:3, :3].T + grid.world_to_volume[:3, 3]
        shape = [-(-n // _CELL) for n in grid.shape]
        # Vertices outside count in the nearest cell: a session that begins with a close-up has a small volume, and
        # keyframes of the room around it must still be kept.
        cells = (local - grid.lower_m) / (grid.voxel_m * _CELL)
        x, y, z = np.clip(cells, 0, np.array(shape[::-1]) - 1).astype(np.int64).T
        covered = np.zeros(len(self._counts), bool)
        covered[(z * shape[1] + y) * shape[2] + x] = True
        return covered
