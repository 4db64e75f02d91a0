"""What the frames of a session have shown of the room: it exists from the first frame on.

A camera that leaves the lighting volume is in another room: its frame begins a new volume, with its pose and depth,
from what the keyframes show there. Of a room that was left stay its SGLV and a part of its keyframes (`RoomView`), for
the points in it and for the way back. The volume of a close-up is replaced by that of the first frame that shows a room
around it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.models.choosing import LightingModel, ProbeEstimator
from roomlight.engine.models.interface import Arrays
from roomlight.engine.state.snapshot import LeftRoom
from roomlight.engine.surface.bracket import update_keyframes
from roomlight.engine.surface.keyframes import KeyframeStore
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid, clipping_buffer, initial_volume
from roomlight.engine.volume.sglv import Far, Sglv
from roomlight.frame import Frame

MOST_LEFT: Final = 2
"""Most rooms that are remembered after they were left, the last one and those of which most was seen: 14 MB and
`LEFT_KEYFRAMES` each. A living room is remembered in the kitchen, though the floor of the corridor between was several
rooms to a lowered phone."""
LEFT_KEYFRAMES: Final = 12
"""Most keyframes of a room that was left: they cover a pan around it."""
BACK_MARGIN: Final = 0.25
"""A camera is back in a room that it left if it is at least this deep in its volume, in units of D_max: at its border
it is not."""
_REACHING: Final = 0.25
"""A keyframe belongs to a new room too if this share of its vertices lies in the new volume."""


class Room:
    """The lighting volume, and the meshes of the keyframes and of the last frame.

    Attributes:
        grid: Pose and size of the volume.
        volume: The model's 3D state.
        new_probe: Begins the model's state of a probe.
        keyframes: The kept frames.
    """

    def __init__(self, grid: VolumeGrid, model: LightingModel, *, keyframes: int) -> None:
        """Begin without frames; `keyframes` is the most that are kept."""
        self.grid = grid
        self.volume = model.begin(grid)
        self.new_probe: Callable[[], ProbeEstimator] = model.new_probe
        self.keyframes = KeyframeStore(grid, keyframes)

    @property
    def sglv(self) -> Sglv:
        """The SGLV after the last frame; the next one overwrites it."""
        return self.volume.sglv

    @property
    def far(self) -> Far:
        """What a ray gets where it leaves the volume."""
        return self.volume.far

    @property
    def meshes(self) -> list[tuple[int, FrameMesh]]:
        """Frame index and mesh of every keyframe in order of time, then of the last frame if it is no keyframe."""
        return [(kept.index, kept.mesh) for kept in self.keyframes.with_last()]

    def left(self) -> "RoomView":
        """Return what is remembered of the room when the camera has left it; the SGLV is not copied."""
        kept = self.keyframes.thinned(LEFT_KEYFRAMES)
        return RoomView(self.grid, self.sglv, self.far, self.new_probe, [(key.index, key.mesh) for key in kept])

    def take_over(self, meshes: Sequence[tuple[int, FrameMesh]]) -> None:
        """Fill the empty room with those keyframes of others, in order of time, that show enough of its volume."""
        for index, mesh in meshes:
            vertices = mesh.vertices[mesh.known] @ self.grid.world_to_volume[:3, :3].T.astype(np.float32)
            local = vertices + self.grid.world_to_volume[:3, 3].astype(np.float32)
            inside = ((local >= self.grid.lower_m) & (local <= self.grid.upper_m)).all(axis=1)
            if inside.any() and inside.mean(dtype=np.float64) >= _REACHING and self.keyframes.offer(index, mesh):
                self.volume.add(self.write_volume(_frame_of(index, mesh), far_unknown=False))
            mesh.forget()

    def view(self) -> "RoomView":
        """Return the room as it is, which later frames do not change: the SGLV is copied, 14 MB."""
        sglv = replace(self.sglv, alpha=self.sglv.alpha.copy(), lobes=self.sglv.lobes.copy())
        # a later frame may give a mesh another texture
        meshes = [(index, mesh.passing()) for index, mesh in self.meshes]
        return RoomView(self.grid, sglv, self.far, self.new_probe, meshes)

    def write_volume(self, frame: Frame, *, far_unknown: bool) -> Float[np.ndarray, "2 z y x"] | None:
        """Write the frame's initial volume into the model's buffer; return what of it was clipped (None: nothing)."""
        clipping = clipping_buffer(self.grid, frame)
        initial_volume(self.grid, frame, far_unknown=far_unknown, out=self.volume.volume, clipping=clipping)
        return clipping

    def keep(self, index: int, mesh: FrameMesh, *, turn: int) -> bool:
        """Show the keyframes what the mesh knows better, and offer it as a keyframe; return whether it became one.

        `turn` is the number of the frame in its session: another keyframe comes first each time.
        """
        self.keyframes.drop_contradicted(mesh, turn=turn)
        update_keyframes(mesh, [key.mesh for key in self.keyframes], turn=turn)
        return self.keyframes.offer(index, mesh)

    def restore(self, saved: Arrays, keyframes: dict[int, FrameMesh], last: tuple[int, FrameMesh] | None) -> None:
        """Take over a saved 3D state of the model, and frames (`KeyframeStore.restore`)."""
        self.volume.restore(saved)
        self.keyframes.restore(keyframes, last)


@dataclass(frozen=True, eq=False)
class RoomView:
    """What points need of a room after one frame, as `Room` has it; also what is remembered of a room that was left."""

    grid: VolumeGrid
    sglv: Sglv
    far: Far
    new_probe: Callable[[], ProbeEstimator]
    meshes: list[tuple[int, FrameMesh]]

    @classmethod
    def of_snapshot(
        cls, saved: LeftRoom, kept: Mapping[int, FrameMesh], far: Far, new_probe: Callable[[], ProbeEstimator]
    ) -> "RoomView":
        """Return a room that was left, with its meshes of those in `kept`, by index."""
        sglv = Sglv(saved.grid, saved.sglv["alpha"], saved.sglv["lobes"])
        return cls(saved.grid, sglv, far, new_probe, [(index, kept[index]) for index in saved.frames])

    @property
    def place(self) -> Position:
        """Where the camera was when the room began, world metres."""
        x, y, z = self.grid.volume_to_world[:3, 3].tolist()
        return x, y, z

    def shown_m2(self) -> float:
        """Return about how much surface the keyframes show in the volume."""
        store = KeyframeStore(self.grid)
        cells = np.any([store.cells_of(mesh) for _, mesh in self.meshes], axis=0)
        return float(cells.sum() * np.prod(self.grid.voxel_m) ** (2 / 3))

    def snapshot(self) -> LeftRoom:
        """Return what is saved of a room that was left, whose SGLV does not change."""
        arrays = {"alpha": self.sglv.alpha, "lobes": self.sglv.lobes}
        return LeftRoom(self.grid, arrays, tuple(index for index, _ in self.meshes))

    def view(self) -> "RoomView":
        """Return the room as it is, whose textures later frames do not change."""
        return replace(self, meshes=[(index, mesh.passing()) for index, mesh in self.meshes])


AnyRoom = Room | RoomView


def room_at(position: Position | Float[np.ndarray, "3"], rooms: Sequence[AnyRoom]) -> AnyRoom:
    """Return the room in whose volume a position (world metres) is deepest; the last, present one if it is in none."""
    best = max(reversed(rooms), key=lambda room: room.grid.margin(position))
    return best if best.grid.margin(position) >= 0 else rooms[-1]


def _frame_of(index: int, mesh: FrameMesh) -> Frame:
    """Return the frame of a mesh, with the depth of its vertices alone."""
    texture = mesh.texture
    clipped = np.zeros(texture.image.shape[:2], bool) if texture.clipped is None else texture.clipped
    return Frame(
        index=index,
        image=texture.image,
        clipped=clipped,
        depth_m=mesh.grid_depth_m,
        intrinsics=mesh.image_camera,
        camera_to_world=mesh.camera_to_world,
        guessed=texture.guessed,
    )
