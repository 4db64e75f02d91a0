"""Exposure and white balance that drift: a gain for each frame, from the surfaces that it shares with earlier ones.

A phone changes exposure and white balance all the time. Where nothing states the exposure (`Frame.auto_exposed`), a
frame gets the gains of red, green and blue at which it shows surfaces as bright as the session has accumulated them;
light stays in the unit of the first frame. Where the exposure is stated, the gains are relative to green: they change
the balance alone.

Drift changes all surfaces by the same factor; light that is switched on or off does not. Therefore:

- A view counts only if the surfaces' ratios agree (`AGREE`, `SHARE`). Where none counts, the last gain stays.
- A session is left as it is, to the bit, until a frame differs by more than `NOTICED`; drift slower than that between
  the oldest and the newest frames that show the same is not followed.

All lights of a room dimmed by the same factor look like drift, where exposure is not stated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import transform_points
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.surface.texture import small_logarithm
from roomlight.frame import Frame

Gain = tuple[float, float, float]
NO_GAIN: Final[Gain] = (1.0, 1.0, 1.0)

AGREE: Final = 0.12
"""Two surfaces agree if the logarithms of their ratios differ by no more than this."""
SHARE: Final = 0.6
"""Least share of the surfaces of a view that agree with its median."""
NOTICED: Final = 0.08
"""A gain beyond e^0.08 = 8 % is drift; noise, vignetting and reflections stay below."""
MOST: Final = (3.0, 0.5)
"""Largest logarithm of the gains' mean, 4.3 stops, and of a gain against that mean."""
VIEWS: Final = 3
"""Earlier frames that a frame is compared with: the oldest ones that show the same. Beside the newest ones, slow drift
would stay below `NOTICED`, and errors would add up."""
_ALIKE: Final = 0.88
"""Least cosine between the headings of two frames that are compared, 28 degrees: half of a usual view."""
_REACH: Final = 0.4
"""Longest way between their cameras, in median depths."""
_TRIED: Final = 8
"""Frames that are looked into, at most; 0.1 ms each."""
_RIDGE: Final = 0.003
"""Variance of `_Points.outwards` at which half of the vignetting is corrected."""
_MOST_DARK: Final = 0.4
"""Largest share of light that a lens is believed to take at the corners."""
_LEAST: Final = 20
"""Least number of shared points of a view, of the 1,200 of a frame."""
_LAST: Final = 8.0
"""Weight of the last frame's gain, in points."""
_KNOWN: Final = 0.999
"""Interpolated share of an image that can be compared, from which on all of it can."""
_NEAR: Final = (0.03, 0.03)
"""Two depths are of one surface within 3 cm and 3 %."""


@dataclass(frozen=True)
class Drift:
    """The gain of the last frame.

    Attributes:
        log_gain: Natural logarithms, for red, green and blue.
        noticed: Whether any frame so far has drifted.
    """

    log_gain: Gain = (0.0, 0.0, 0.0)
    noticed: bool = False

    @property
    def gain(self) -> Gain | None:
        """Factors of red, green and blue; None as long as nothing has drifted."""
        if not self.noticed:
            return None
        red, green, blue = np.exp(self.log_gain).tolist()
        return red, green, blue

    def after(self, frame: Frame, depth_m: Float[np.ndarray, "dh dw"], earlier: Sequence[FrameMesh]) -> "Drift":
        """Return the gain of the next frame, as measured, by the meshes of the keyframes and of the last frame.

        The gains of the meshes have been applied; `depth_m` is the frame's completed depth.
        """
        last, measured = np.array(self.log_gain), _measured(frame, depth_m, earlier)
        log_gain, points = (last, 0.0) if measured is None else measured
        if not frame.auto_exposed:
            log_gain, last = log_gain - log_gain[1], last - last[1]
        if not self.noticed and np.abs(log_gain).max() <= NOTICED:
            return self
        mixed = (points * log_gain + _LAST * last) / (points + _LAST)
        mean = mixed.mean()
        red, green, blue = (np.clip(mean, -MOST[0], MOST[0]) + np.clip(mixed - mean, -MOST[1], MOST[1])).tolist()
        return Drift((red, green, blue), noticed=True)

    def corrected(self, frame: Frame) -> Frame:
        """Return the frame with its gain; the frame itself as long as nothing has drifted."""
        return frame if self.gain is None else replace(frame, image=with_gain(frame.image, self.gain))


def with_gain(image: Float[np.ndarray, "h w 3"], gain: Gain) -> Float[np.ndarray, "h w 3"]:
    """Return the image times the gains of red, green and blue."""
    return image * np.array(gain, np.float32)


def _measured(
    frame: Frame, depth_m: Float[np.ndarray, "dh dw"], earlier: Sequence[FrameMesh]
) -> tuple[Float[np.ndarray, "3"], float] | None:
    """Return the logarithm of the gain, and the number of points that it was measured at; None: no view counts."""
    points, total, weight, views = _points(frame, depth_m), np.zeros(3), 0.0, 0
    for mesh in _overlapping(frame, depth_m, earlier):
        ratio, outwards = _ratio(points, mesh)
        if len(ratio) < _LEAST:
            continue
        median = np.partition(ratio, len(ratio) // 2, axis=0)[len(ratio) // 2]
        near = (np.abs(ratio - median) < AGREE).all(axis=1)
        if near.mean() >= SHARE:
            count = float(near.sum())
            total += count * _without_vignetting(ratio[near], outwards[near])
            weight, views = weight + count, views + 1
            if views == VIEWS:
                break
    return (total / weight, weight) if weight else None


def _overlapping(frame: Frame, depth_m: Float[np.ndarray, "dh dw"], earlier: Sequence[FrameMesh]) -> list[FrameMesh]:
    """Return earlier frames that may show much of what the frame shows, the oldest first, and the last one."""
    known_m = depth_m[depth_m > 0]
    if not earlier or not known_m.size:
        return list(earlier[-1:])
    pose = frame.camera_to_world
    poses = np.array([mesh.camera_to_world for mesh in earlier])
    alike = poses[:, :3, 2] @ pose[:3, 2] > _ALIKE
    close = np.linalg.norm(poses[:, :3, 3] - pose[:3, 3], axis=1) < _REACH * float(np.median(known_m))
    oldest = (alike & close).nonzero()[0][:_TRIED]
    return [earlier[number] for number in dict.fromkeys([*oldest, len(earlier) - 1])]


def _without_vignetting(ratio: Float[np.ndarray, "n 3"], outwards: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3"]:
    """Return the mean of the ratios at points that are as far from the centre in both images.

    Lenses darken by about 1 - k r^2, and all points move outwards when the camera walks ahead: without this a walk
    would get brighter and brighter. k is the slope of the ratios over how far each point moved outwards.
    """
    mean, middle = ratio.mean(axis=0, dtype=np.float64), float(outwards.mean())
    off = outwards - middle
    slope = float(off @ ratio.mean(axis=1)) / (float(off @ off) + _RIDGE * len(off))
    return mean - np.clip(slope, 0, _MOST_DARK) * middle


class _Points(NamedTuple):
    """Surfaces that a frame shows."""

    world: Float[np.ndarray, "n 3"]
    logarithm: Float[np.ndarray, "n 3"]
    """Of their radiance."""
    outwards: Float[np.ndarray, " n"]
    """Square of their distance from the centre of the image; 1 at its corners."""


def _points(frame: Frame, depth_m: Float[np.ndarray, "dh dw"]) -> _Points:
    """Return the frame's surfaces where they can be compared."""
    logarithm, usable = small_logarithm(
        frame.image, frame.clipped if frame.seen is None else frame.clipped | ~frame.seen
    )
    height, width = usable.shape
    small = frame.intrinsics.resized(width, height)
    rows = (np.arange(height) * depth_m.shape[0] + depth_m.shape[0] // 2) // height
    columns = (np.arange(width) * depth_m.shape[1] + depth_m.shape[1] // 2) // width
    depth = depth_m[np.ix_(rows, columns)]
    usable = usable & (depth > 0)
    world = transform_points(frame.camera_to_world, (small.rays() * depth[..., None])[usable])
    row, column = usable.nonzero()
    return _Points(world, logarithm[usable], _outwards(column + 0.5, row + 0.5, width, height))


def _outwards(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], width: int, height: int
) -> Float[np.ndarray, " n"]:
    return ((2 * x - width) ** 2 + (2 * y - height) ** 2) / (width**2 + height**2)


def _ratio(points: _Points, mesh: FrameMesh) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Return the logarithms of the mesh's radiance less those of the points that it shows; how far these moved out."""
    inside, xy, z = mesh.find(points.world)
    column, row = xy.astype(int).T
    depth = mesh.grid_depth_m[row, column]
    same = (depth > 0) & (np.abs(depth - z) < _NEAR[0] + _NEAR[1] * depth)
    xy, inside = xy[same], inside[same]
    if not len(inside):
        return points.logarithm[inside], points.outwards[inside]
    theirs, usable = mesh.texture.small
    scale = np.divide(usable.shape[::-1], mesh.grid_depth_m.shape[::-1])
    x, y = (xy * scale - 0.5).astype(np.float32).T[:, None]
    sampled = cv2.remap(np.dstack([theirs, usable]), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    known = sampled[:, 3] > _KNOWN
    height, width = mesh.grid_depth_m.shape
    outwards = points.outwards[inside] - _outwards(xy[:, 0], xy[:, 1], width, height)
    return sampled[known, :3] - points.logarithm[inside[known]], outwards[known]
