"""What the frames of a session have shown of the room: it exists from the first frame on."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roomlight.depth import UnknownDepth
from roomlight.engine.models.interface import Arrays, LightingModel, ProbeEstimator
from roomlight.engine.preparation import PreparedFrame
from roomlight.engine.surface.bracket import update_keyframes
from roomlight.engine.surface.keyframes import KeyframeStore
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid, clipping_buffer, initial_volume
from roomlight.engine.volume.sglv import Far, Sglv


class Room:
    """The lighting volume, and the meshes of the keyframes and of the last frame.

    Attributes:
        grid: Pose and size of the volume.
        volume: The model's 3D state.
        keyframes: The kept frames.
    """

    def __init__(self, grid: VolumeGrid, model: LightingModel, *, keyframes: int) -> None:
        """Begin without frames; `keyframes` is the most that are kept."""
        self.grid = grid
        self.volume = model.begin(grid)
        self.keyframes = KeyframeStore(grid, keyframes)

    @property
    def sglv(self) -> Sglv:
        """The SGLV after the last frame; the next one overwrites it."""
        return self.volume.sglv

    @property
    def far(self) -> Far:
        """What a ray gets where it leaves the volume."""
        return self.volume.far

    def new_probe(self) -> ProbeEstimator:
        """Begin the model's state of a probe."""
        return self.volume.new_probe()

    @property
    def meshes(self) -> list[tuple[int, FrameMesh]]:
        """Frame index and mesh of every keyframe in order of time, then of the last frame if it is no keyframe."""
        return [(kept.index, kept.mesh) for kept in self.keyframes.with_last()]

    def view(self) -> "RoomView":
        """Return the room as it is, which later frames do not change: the SGLV is copied, 14 MB."""
        sglv = replace(self.sglv, alpha=self.sglv.alpha.copy(), lobes=self.sglv.lobes.copy())
        # a later frame may give a mesh another texture
        meshes = [(index, mesh.passing()) for index, mesh in self.meshes]
        return RoomView(self.grid, sglv, self.far, self.new_probe, meshes)

    def write_volume(self, prepared: PreparedFrame, unknown_depth: UnknownDepth) -> Float[np.ndarray, "2 z y x"] | None:
        """Write the frame's initial volume into the model's buffer; return what of it was clipped (None: nothing)."""
        frame = prepared.frame
        # after completion ("rim") only pixels that the frame's mask leaves out are without depth
        far = unknown_depth == "far" or (unknown_depth == "rim" and frame.seen is None)
        clipping = clipping_buffer(self.grid, frame)
        initial_volume(self.grid, frame, far_unknown=far, out=self.volume.volume, clipping=clipping)
        return clipping

    def keep(self, index: int, mesh: FrameMesh) -> bool:
        """Show the keyframes what the mesh knows better, and offer it as a keyframe; return whether it became one."""
        update_keyframes(mesh, [key.mesh for key in self.keyframes])
        return self.keyframes.offer(index, mesh)

    def restore(self, saved: Arrays, keyframes: dict[int, FrameMesh], last: tuple[int, FrameMesh] | None) -> None:
        """Take over a saved state.

        Args:
            saved: The model's 3D state.
            keyframes: Their meshes by frame index, in order of time.
            last: Index and mesh of the last frame if it is no keyframe.
        """
        self.volume.restore(saved)
        self.keyframes.restore(keyframes, last)


@dataclass(frozen=True)
class RoomView:
    """What points need of a room after one frame, as `Room` has it."""

    grid: VolumeGrid
    sglv: Sglv
    far: Far
    new_probe: Callable[[], ProbeEstimator]
    meshes: list[tuple[int, FrameMesh]]
