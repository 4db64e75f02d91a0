"""Estimated radiance of clipped pixels. The camera's value says "at least white"; the depth map says more.

Three kinds are distinguished by depth: pixels without depth are windows and lamps; clipped pixels on surfaces that face
up are mostly glare, which the camera sees and a probe does not; the rest are bright walls, curtains and shades. Gains
are in units of white. Mean log-L2 of the classical model over 31 frames of three path-traced
rooms: all 1: 0.086; all 2: 0.080; up-facing 1: 0.076; windows 4 as well: 0.069; up-facing 0.7: 0.068. Windows at 6
would give 0.066, but three rooms are too few to fit a number to.
"""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float

from roomlight.frame import Frame

WINDOW_GAIN: Final = 4.0
"""Where depth is unknown: windows by day and lamps lie between 2 and 60 times white."""
GLARE_GAIN: Final = 0.7
"""On surfaces that face up (floors, tables): most of the glare does not reach the probe."""
BRIGHT_GAIN: Final = 2.0
"""On all other surfaces."""
UP_FACING: Final = 0.8
"""A surface faces up if its normal's y is above this: within 37 degrees of the zenith, so that noisy depth
passes."""


def restore_clipped(frame: Frame, depth_m: Float[np.ndarray, "dh dw"]) -> Frame:
    """Multiply the clipped pixels of a frame by the gain of their kind; the returned frame has the depth `depth_m`.

    `frame.depth_m` is the sensor's depth (0 = unknown), `depth_m` the completed one.
    """
    size = frame.clipped.shape[1], frame.clipped.shape[0]
    unknown = _resize(frame.depth_m <= 0, size)
    up = _resize(_normals_y(replace(frame, depth_m=depth_m)) > UP_FACING, size)
    gain = np.where(unknown, WINDOW_GAIN, np.where(up, GLARE_GAIN, BRIGHT_GAIN))
    gain = np.where(frame.clipped, gain, 1.0).astype(np.float32)
    return replace(frame, image=frame.image * gain[..., None], depth_m=depth_m)


def _normals_y(frame: Frame) -> Float[np.ndarray, "dh dw"]:
    """Return world y of the unit surface normals, by central differences of points averaged over 3 x 3 pixels; 0 at
    the image border."""
    depth = frame.depth_m
    lens = frame.intrinsics.resized(depth.shape[1], depth.shape[0])
    rotation = frame.camera_to_world[:3, :3].astype(np.float32)
    points = cv2.blur((lens.rays() * depth[..., None]) @ rotation.T, (3, 3))
    right, up = points[1:-1, 2:] - points[1:-1, :-2], points[:-2, 1:-1] - points[2:, 1:-1]
    normal = np.cross(right, up)
    result = np.zeros(depth.shape, np.float32)
    result[1:-1, 1:-1] = normal[..., 1] / np.maximum(np.linalg.norm(normal, axis=-1), 1e-12)
    return result


def _resize(mask: Bool[np.ndarray, "h w"], size: tuple[int, int]) -> Bool[np.ndarray, "h2 w2"]:
    return cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
