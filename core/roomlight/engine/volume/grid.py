"""The lighting volume's frame, and its initialisation from one RGB-D frame (paper, 4.1 and its volume table).

Frame: the volume's axes are the first camera's (x right, y up, z backward), its origin is that camera's
centre. Arrays are [z, y, x]; voxel (k, j, i) has its centre at `lower + (index + 0.5) * voxel`. Units:
metres.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.camera import rigid_inverse, transform_points
from roomlight.conventions import Position
from roomlight.engine.kernels.volume_init import GridArrays, ViewArrays, initialise_slices
from roomlight.errors import FrameError
from roomlight.frame import Frame
from roomlight.threads import parallel_for

VOLUME_SHAPE: Final = (64, 60, 84)
"""Voxels along z, y, x (the paper's table)."""
VOLUME_RANGE: Final = np.array([[-1.1, 1.1], [-0.8, 0.8], [-1.2, 0.5]])
"""Extent along x, y, z in units of the first frame's greatest depth (the paper's table)."""
DEPTH_MAX_QUANTILE: Final = 0.995
"""D_max is this quantile of the known depth: one stray pixel must not enlarge the whole volume."""
DEPTH_MAX_FLOOR_M: Final = 0.5
"""Least D_max: a session that begins with a hand before the lens gets a volume 1.1 m wide."""
NARROW: Final = 2.5
"""A close-up's volume is too narrow for a frame most of which is farther away than this, in units of D_max."""
CLOSE_UP_M: Final = 1.5
"""Largest D_max of a close-up: of a floor, a table, a hand. A room keeps its volume: the camera may look out of it."""


@dataclass(frozen=True)
class VolumeGrid:
    """Pose and size of the volume: of the first frame in a room, until it is too narrow or the camera leaves it."""

    volume_to_world: Float[np.ndarray, "4 4"]
    depth_max_m: float
    shape: tuple[int, int, int] = VOLUME_SHAPE

    @classmethod
    def from_frame(cls, frame: Frame, *, shape: tuple[int, int, int] = VOLUME_SHAPE) -> "VolumeGrid":
        """Make the volume of a session that begins with this frame.

        Raises:
            FrameError: no depth is known, or nothing is seen.
        """
        known = frame.depth_m[frame.depth_m > 0]
        if known.size == 0:
            nothing = frame.seen is not None and not frame.seen.any()
            reason = "its image is black, or masked" if nothing else "no pixel has a depth"
            raise FrameError(
                f"{frame.source or f'frame {frame.index}'}: {reason}, so the size of the volume is unknown; begin with "
                "a frame that shows something, and whose depth is known"
            )
        depth_max_m = max(DEPTH_MAX_FLOOR_M, float(np.quantile(known, DEPTH_MAX_QUANTILE)))
        return cls(frame.camera_to_world, depth_max_m, shape)

    @cached_property
    def lower_m(self) -> Float[np.ndarray, "3"]:
        """Lower corner (x, y, z) in the volume frame."""
        return VOLUME_RANGE[:, 0] * self.depth_max_m

    @cached_property
    def upper_m(self) -> Float[np.ndarray, "3"]:
        """Upper corner (x, y, z) in the volume frame."""
        return VOLUME_RANGE[:, 1] * self.depth_max_m

    @cached_property
    def voxel_m(self) -> Float[np.ndarray, "3"]:
        """A voxel's edges along x, y, z; the table's ranges make them equal within 2 %."""
        return (self.upper_m - self.lower_m) / np.array(self.shape[::-1])

    @cached_property
    def edge_m(self) -> float:
        """The voxel's side length v of the equations: the mean of the three edges."""
        return float(self.voxel_m.mean())

    @cached_property
    def world_to_volume(self) -> Float[np.ndarray, "4 4"]:
        """Rigid transform from world to volume frame."""
        return rigid_inverse(self.volume_to_world)

    def centres_m(self) -> Float[np.ndarray, "z y x 3"]:
        """Return the voxel centres (x, y, z) in the volume frame, float64."""
        axes = [
            low + (np.arange(count) + 0.5) * edge
            for low, edge, count in zip(self.lower_m, self.voxel_m, self.shape[::-1], strict=True)
        ]
        z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
        return np.stack([x, y, z], axis=-1)

    def contains(self, position_world: tuple[float, float, float]) -> bool:
        """Return whether a world position (metres) lies inside the volume."""
        return self.margin(position_world) >= 0

    def margin(self, position_world: tuple[float, float, float] | Float[np.ndarray, "3"]) -> float:
        """Return how far a world position (metres) is from the nearest face, in units of D_max; below 0 outside."""
        local = self.world_to_volume[:3, :3] @ np.asarray(position_world) + self.world_to_volume[:3, 3]
        return float(min((local - self.lower_m).min(), (self.upper_m - local).min())) / self.depth_max_m

    def is_narrow(self, frame: Frame) -> bool:
        """Return whether most of the frame's surfaces are far outside: the volume was that of a close-up.

        A view through a door or a window, which fills less of the image, does not make the room's volume too narrow.
        """
        if self.depth_max_m > CLOSE_UP_M:
            return False
        known = np.count_nonzero(frame.depth_m)
        far = np.count_nonzero(frame.depth_m > NARROW * self.depth_max_m)
        return bool(2 * known > frame.depth_m.size and 2 * far > known)

    def nearest_inside(self, position_world: Position) -> Position:
        """Return a world position (metres) if it is in the volume, else the nearest one a voxel from the faces."""
        if self.contains(position_world):
            return position_world
        local = transform_points(self.world_to_volume, np.array(position_world, np.float64))
        inside = np.clip(local, self.lower_m + self.edge_m, self.upper_m - self.edge_m)
        x, y, z = transform_points(self.volume_to_world, inside).tolist()
        return x, y, z


def initial_volume(
    grid: VolumeGrid,
    frame: Frame,
    *,
    far_unknown: bool = True,
    out: Float[np.ndarray, "5 z y x"] | None = None,
    clipping: Float[np.ndarray, "2 z y x"] | None = None,
) -> Float[np.ndarray, "5 z y x"]:
    """Compute the initial volume of one frame: colour c (3), opacity alpha, emptiness e (paper, section 4.1), float32.

    With v the voxel's side, z its depth in this camera and D the depth map at its projection (bilinear):
    alpha = clip(4((z - D)/v + 1), 0, 1) in front of the surface and clip(4((D - z)/v + 5), 0, 1) behind it,
    c = alpha C, e = -1 where (D - z)/v > 3. Outside the frustum everything is 0.

    Pixels without depth (windows, far walls) get D = where their ray leaves the volume, less one voxel, and mark no
    voxel as empty (e = 0): they are mostly the brightest light of the room. `far_unknown=False` drops them, for
    comparison. `out` is written in place if given (the session's bound buffer).

    `clipping` (from `clipping_buffer`), if given, is written too: alpha times the share of clipped pixels, and alpha
    times the luminance that was estimated for them.
    """
    volume = np.empty((5, *grid.shape), np.float32) if out is None else out
    camera_from_volume = rigid_inverse(frame.camera_to_world) @ grid.volume_to_world
    k = frame.intrinsics
    lens = np.array([k.fx / k.width, k.fy / k.height, k.cx / k.width, k.cy / k.height], np.float32)
    camera_in_volume = rigid_inverse(camera_from_volume)[:3, 3].astype(np.float32)
    from_volume = camera_from_volume.astype(np.float32)
    planes = np.zeros((0, 0, 2), np.float32) if clipping is None else _clipping_planes(frame)
    view = ViewArrays(frame.image, frame.depth_m, lens, from_volume, camera_in_volume, planes)
    clipped = np.zeros((2, 0, 0, 0), np.float32) if clipping is None else clipping
    arrays = GridArrays(grid.lower_m.astype(np.float32), grid.voxel_m.astype(np.float32), np.float32(grid.edge_m))

    def slices(start: int, stop: int) -> None:
        initialise_slices(view, arrays, far_unknown, volume, clipped, start, stop)

    parallel_for(slices, grid.shape[0])
    return volume


def clipping_buffer(grid: VolumeGrid, frame: Frame) -> Float[np.ndarray, "2 z y x"] | None:
    """Return the array for `initial_volume`'s `clipping`; None if the frame has no clipped pixel."""
    return np.empty((2, *grid.shape), np.float32) if frame.clipped.any() else None


def _clipping_planes(frame: Frame) -> Float[np.ndarray, "h w 2"]:
    guessed = np.zeros(frame.clipped.shape, np.float32) if frame.guessed is None else frame.guessed
    return np.stack([frame.clipped, guessed], axis=-1).astype(np.float32)
