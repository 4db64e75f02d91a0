"""Exposure and white balance that drift: a gain for each frame, from the surfaces that it shares with earlier ones.

A phone changes exposure and white balance all the time. Where nothing states the exposure (`Frame.auto_exposed`), a
frame gets the gains of red, green and blue at which it shows surfaces as bright as the session has accumulated them;
light stays in the unit of the first frame. Where the exposure is stated, the gains are relative to green: they change
the balance alone.

Drift changes all surfaces by the same factor; light that is switched on or off does not. Therefore:

- A view counts only if the surfaces' ratios agree (`AGREE`, `SHARE`). Where none counts, the last gain stays.
- A session is left as it is, to the bit, until a frame differs by more than `NOTICED`.

All lights of a room dimmed by the same factor look like drift, where exposure is not stated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.camera import transform_points
from roomlight.engine.surface.mesh import FrameMesh, most_alike
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
"""Earlier frames that a frame is compared with: those with the most similar heading, and the last one."""
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
    if not earlier:
        return None
    chosen = dict.fromkeys([len(earlier) - 1, *most_alike(frame.camera_to_world, earlier, VIEWS)])
    world, logarithm = _points(frame, depth_m)
    total, weight = np.zeros(3), 0.0
    for number in list(chosen)[:VIEWS]:
        ratio = _ratio(world, logarithm, earlier[number])
        if len(ratio) < _LEAST:
            continue
        median = np.partition(ratio, len(ratio) // 2, axis=0)[len(ratio) // 2]
        near = (np.abs(ratio - median) < AGREE).all(axis=1)
        if near.mean() >= SHARE:
            total += ratio[near].sum(axis=0, dtype=np.float64)
            weight += float(near.sum())
    return (total / weight, weight) if weight else None


def _points(
    frame: Frame, depth_m: Float[np.ndarray, "dh dw"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return the frame's surfaces in the world, and the logarithms of their radiance where it can be compared."""
    logarithm, usable = small_logarithm(
        frame.image, frame.clipped if frame.seen is None else frame.clipped | ~frame.seen
    )
    height, width = usable.shape
    small = frame.intrinsics.resized(width, height)
    rows = (np.arange(height) * depth_m.shape[0] + depth_m.shape[0] // 2) // height
    columns = (np.arange(width) * depth_m.shape[1] + depth_m.shape[1] // 2) // width
    depth = depth_m[np.ix_(rows, columns)]
    usable = usable & (depth > 0)
    return transform_points(frame.camera_to_world, (small.rays() * depth[..., None])[usable]), logarithm[usable]


def _ratio(
    world: Float[np.ndarray, "n 3"], logarithm: Float[np.ndarray, "n 3"], mesh: FrameMesh
) -> Float[np.ndarray, "m 3"]:
    """Return the logarithms of the mesh's radiance less those of the points, at the points that it shows."""
    inside, xy, z = mesh.find(world)
    column, row = xy.astype(int).T
    depth = mesh.grid_depth_m[row, column]
    same = (depth > 0) & (np.abs(depth - z) < _NEAR[0] + _NEAR[1] * depth)
    points = logarithm[inside[same]]
    if not len(points):
        return points
    theirs, usable = mesh.texture.small
    scale = np.divide(usable.shape[::-1], mesh.grid_depth_m.shape[::-1])
    x, y = (xy[same] * scale - 0.5).astype(np.float32).T[:, None]
    sampled = cv2.remap(np.dstack([theirs, usable]), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    known = sampled[:, 3] > _KNOWN
    return sampled[known, :3] - points[known]
