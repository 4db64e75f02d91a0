"""Two baselines without learning, with the two calls of a session: `push(frame)` and `light_at(position)`.

World frame, metres, linear radiance; panoramas are [height, 2 height, 3] float32, world-aligned.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

from roomlight.camera import transform_points
from roomlight.conventions import Position, direction_to_uv
from roomlight.engine.panorama.fill import push_pull
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.volume.sglv import check_position
from roomlight.frame import Frame

SUPERSAMPLING = 2
"""Points are splatted into a z-buffer this many times finer, then averaged, against aliasing.

In a path-traced living room it reduces log-L2 from 0.117 to 0.115, so the baseline is stronger with it."""


class MeanColour:
    """One colour in all directions: the mean linear radiance of every pixel of every frame so far."""

    name = "mean colour"

    def __init__(self, height: int = 120) -> None:
        """Make an estimator of panoramas with `height` rows and twice as many columns."""
        self.height = height
        self._sum = np.zeros(3, np.float64)
        self._pixels = 0

    def push(self, frame: Frame) -> None:
        """Add a frame's pixels to the mean."""
        self._sum += frame.image.sum(axis=(0, 1), dtype=np.float64)
        self._pixels += frame.image.shape[0] * frame.image.shape[1]

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """Return the mean in every direction, the same at every position; black before the first frame.

        Raises:
            ProbeError: the position is not usable.
        """
        check_position(position)
        colour = self._sum / max(1, self._pixels)
        return np.broadcast_to(colour.astype(np.float32), (self.height, 2 * self.height, 3)).copy()


@dataclass
class _View:
    """The z-buffer of one position: nearest distance (inf = no point), its colour, and the count of frames splatted."""

    distance_m: Float[np.ndarray, " n"]
    colour: Float[np.ndarray, "n 3"]
    frames: int = 0


_Points = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]
"""The pixels with depth of one frame: their positions in the world, metres, and colours."""


class WarpAndFill:
    """Every pixel with depth, of every frame, forward-warped to the probe; the rest is filled by push-pull.

    Points are splatted into a z-buffer of `SUPERSAMPLING` times the panorama's resolution: a cell keeps
    its nearest point, at equal distance that of the newest frame. The cells with points are averaged to the panorama,
    and its pixels without any are filled smoothly from the others (`push_pull`). Pixels without depth are not warped,
    so windows are lost: that is the weakness of this baseline. Frames are reduced as the engine's are, and kept as
    points, at most 1.8 MB each, so that a position requested late still gets every frame.
    """

    name = "warp and fill"

    def __init__(self, height: int = 120) -> None:
        """Make an estimator of panoramas with `height` rows and twice as many columns."""
        self.height = height
        self._frames: list[_Points] = []
        self._views: dict[Position, _View] = {}

    def push(self, frame: Frame) -> None:
        """Add a frame's pixels with depth; a smaller depth map is enlarged by nearest neighbour."""
        self._frames.append(_unproject(frame.resized(*WORKING_SIZE)))

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """Return the panorama at `position` (world metres); black before the first frame with depth.

        Raises:
            ProbeError: the position is not usable.
        """
        return push_pull(*self.warped(position))

    def warped(self, position: Position) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
        """Return the panorama before filling [H, 2H, 3], and its mask [H, 2H] (1 = has points).

        Raises:
            ProbeError: the position is not usable.
        """
        check_position(position)
        cells = 2 * (SUPERSAMPLING * self.height) ** 2
        view = self._views.get(position)
        if view is None:
            view = _View(np.full(cells, np.inf, np.float32), np.zeros((cells, 3), np.float32))
            self._views[position] = view
        for points in self._frames[view.frames :]:
            _splat(view, points, position, rows=SUPERSAMPLING * self.height)
        view.frames = len(self._frames)
        blocks = (self.height, SUPERSAMPLING, 2 * self.height, SUPERSAMPLING)
        seen = np.isfinite(view.distance_m).reshape(blocks).sum(axis=(1, 3), dtype=np.float32)
        colour = view.colour.reshape(*blocks, 3).sum(axis=(1, 3))  # cells without points are black and do not count
        return colour / np.maximum(seen, 1)[..., None], (seen > 0).astype(np.float32)


def _unproject(frame: Frame) -> _Points:
    height, width = frame.image.shape[:2]
    depth = frame.depth_m
    if depth.shape != (height, width):
        depth = cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
    known = depth > 0
    points = frame.intrinsics.rays()[known] * depth[known][:, None]
    return transform_points(frame.camera_to_world, points), frame.image[known]


def _splat(view: _View, points: _Points, position: Position, *, rows: int) -> None:
    positions_m, colours = points
    offset = positions_m - np.asarray(position, np.float32)
    distance = np.linalg.norm(offset, axis=-1)
    usable = distance > 1e-4  # a point on the probe has no direction
    distance = distance[usable]
    cell = _cells(offset[usable] / distance[:, None], rows)
    far_to_near = np.argsort(-distance, kind="stable")  # NumPy's fancy assignment keeps the last write
    cell, distance = cell[far_to_near], distance[far_to_near]
    nearest = np.full_like(view.distance_m, np.inf)
    colour = np.zeros_like(view.colour)
    nearest[cell] = distance
    colour[cell] = colours[usable][far_to_near]
    wins = np.isfinite(nearest) & (nearest <= view.distance_m)
    view.distance_m[wins] = nearest[wins]
    view.colour[wins] = colour[wins]


def _cells(direction: Float[np.ndarray, "n 3"], rows: int) -> Int[np.ndarray, " n"]:
    uv = direction_to_uv(direction)
    row = np.minimum((uv[:, 1] * rows).astype(np.int64), rows - 1)
    column = np.minimum((uv[:, 0] * (2 * rows)).astype(np.int64), 2 * rows - 1)
    return row * (2 * rows) + column
