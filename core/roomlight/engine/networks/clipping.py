"""Estimated radiance of clipped pixels: the camera's value says "at least white", the rest of the frame says more.

A small network estimates it from the frame, its depth and its pose (`ClippingModel`; `roomlight_model` trains it on
frames whose true radiance is known). Radiance is in units of the frame's own white.

Cost of `ClippingModel.restore` for a frame of 320 x 240 pixels that has clipped ones: 16 to 18 ms of processor time, 6
to 7 times the stage `volume` (2.5 ms); the planes are 4 ms of it, the network 11 ms, which two cores share. It is part
of the stage `prepare` of `FrameReport.stage_ms`.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32

from roomlight.conventions import luminance
from roomlight.engine.kernels.blend import HIGHER
from roomlight.engine.networks.graph import Graph
from roomlight.engine.networks.graphs import SHIPPED, PartFiles, load_part
from roomlight.engine.networks.providers import Provider
from roomlight.frame import Frame

SIDE: Final = 160
"""Side of the network's square input: a frame of the working size is halved."""
CHANNELS: Final = 11
"""Planes of the input, see `clipping_planes`."""


@dataclass(frozen=True)
class Placement:
    """Where a frame lies in the network's square: the size and the upper left corner of the reduced frame."""

    width: int
    height: int
    left: int
    top: int

    @classmethod
    def of(cls, width: int, height: int) -> "Placement":
        """Place a frame of this size: the longer side fills the square, the frame is centred, in even numbers."""
        scale = SIDE / max(width, height)
        reduced = [max(2, 2 * round(size * scale / 2)) for size in (width, height)]
        return cls(*reduced, *((SIDE - size) // 4 * 2 for size in reduced))

    def inside(self, plane: Float32[np.ndarray, "s s *c"], *, halved: bool = False) -> Float32[np.ndarray, "h w *c"]:
        """Return the view of the frame's part of a square plane, or of one at half the resolution."""
        by = 2 if halved else 1
        rows = slice(self.top // by, (self.top + self.height) // by)
        return plane[rows, self.left // by : (self.left + self.width) // by]


class ClippingModel:
    """The network, loaded once and shared by all sessions; a call uses buffers of its own."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.digest = graph.digest

    def restore(self, frame: Frame, depth_m: Float[np.ndarray, "dh dw"], *, own_white: float | None = None) -> Frame:
        """Estimate the radiance of the clipped pixels of a frame, and state in `guessed` what the estimate added.

        Channels that did not saturate keep their value. An estimate is never below the measured value, which is a lower
        bound. A frame without clipped pixels is returned as it is.

        Args:
            frame: With the sensor's depth (0 = unknown).
            depth_m: Its completed depth.
            own_white: Where the frame's own exposure saturates, if other frames have changed clipped pixels: those up
                to it are estimated from it, others from the white of most; default: that of most.
        """
        if not frame.clipped.any():
            return frame
        most = white_of(frame)
        own = most if own_white is None else min(own_white, most)
        where = np.flatnonzero(frame.clipped)
        measured = frame.image.reshape(-1, 3)[where]
        top = measured.max(axis=1, keepdims=True)
        white = np.where(top < HIGHER * np.float32(own), np.float32(own), np.float32(most))
        estimate = np.exp(self.log_radiance(frame, depth_m).reshape(-1, 3)[where]) * white
        saturated = measured >= np.float32(_SATURATED) * white
        image = frame.image.copy()
        image.reshape(-1, 3)[where] = np.where(saturated, np.maximum(estimate, measured), measured)
        return replace(frame, image=image, guessed=luminance(image - frame.image))

    def log_radiance(self, frame: Frame, depth_m: Float[np.ndarray, "dh dw"]) -> Float32[np.ndarray, "h w 3"]:
        """Estimate the logarithm of each pixel's radiance in units of the frame's white, if it is clipped.

        `frame` has the sensor's depth (0 = unknown), `depth_m` is that depth completed.
        """
        planes = clipping_planes(frame, depth_m)
        outputs = self._graph.new_outputs()
        self._graph.bind({"planes": planes[None]}, outputs).run()
        height, width = frame.clipped.shape
        square = np.ascontiguousarray(np.moveaxis(outputs["log_radiance"][0], 0, -1))
        part = Placement.of(width, height).inside(square, halved=True)
        return cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR)


@cache
def shipped_clipping(
    provider: Provider = "auto",
    folder: Path = SHIPPED / "clipping",
    files: PartFiles = (),  # noqa: ARG001 - of the cache's key
) -> ClippingModel:
    """Load the network inside the package, or of another folder, once as long as its `files` are these.

    Raises:
        ModelError: the weights are missing or damaged.
    """
    return ClippingModel(load_part(folder, "clipping", provider=provider))


_SATURATED: Final = 0.95
"""A channel of a clipped pixel is saturated from this share of white: sRGB 250 of 255 is 0.956."""


def white_of(frame: Frame) -> float:
    """Return the radiance at which a frame with clipped pixels saturates: 1 at the session's own exposure."""
    red, green, blue = frame.image[frame.clipped].T
    return max(float(np.median(np.maximum(np.maximum(red, green), blue))), 1e-6)


def clipping_planes(frame: Frame, depth_m: Float[np.ndarray, "dh dw"]) -> Float32[np.ndarray, "11 side side"]:
    """Compute the network's input, 0 outside the frame.

    Planes: linear RGB in units of the frame's white (3), share of clipped pixels, 1 inside the frame, depth known,
    log(1 + depth), surface normal (3) with y up and z against the camera's heading, y of the pixel's ray.
    """
    height, width = frame.clipped.shape
    place = Placement.of(width, height)
    size = (place.width, place.height)
    white = white_of(frame) if frame.clipped.any() else 1.0
    heading = _heading(frame.camera_to_world)
    reduced_m = cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST)
    rays = frame.intrinsics.resized(*size).rays()
    rays /= np.sqrt(np.einsum("ijk,ijk->ij", rays, rays))[..., None]
    planes = np.zeros((CHANNELS, SIDE, SIDE), np.float32)
    view = place.inside(np.moveaxis(planes, 0, -1))
    view[..., :3] = _area(np.minimum(frame.image / np.float32(white), 1), size)
    view[..., 3] = _area(frame.clipped.astype(np.float32), size)
    view[..., 4] = 1
    view[..., 5] = _area((frame.depth_m > 0).astype(np.float32), size)
    view[..., 6] = np.log1p(reduced_m)
    view[..., 7:10] = surface_normals(frame, reduced_m) @ heading
    view[..., 10] = rays @ frame.camera_to_world[1, :3]
    return planes


def surface_normals(frame: Frame, depth: Float[np.ndarray, "dh dw"]) -> Float[np.ndarray, "dh dw 3"]:
    """Compute unit surface normals in the world, by central differences of points averaged over 3 x 3 pixels; 0 at the
    image border. `depth` is the frame's, of any size."""
    lens = frame.intrinsics.resized(depth.shape[1], depth.shape[0])
    rotation = frame.camera_to_world[:3, :3].astype(np.float32)
    points = cv2.blur((lens.rays() * depth[..., None]) @ rotation.T, (3, 3))
    right, up = points[1:-1, 2:] - points[1:-1, :-2], points[:-2, 1:-1] - points[2:, 1:-1]
    normal = np.cross(right, up)
    result = np.zeros((*depth.shape, 3), np.float32)
    length = np.sqrt(np.einsum("ijk,ijk->ij", normal, normal))
    result[1:-1, 1:-1] = normal / np.maximum(length, 1e-12)[..., None]
    return result


def _heading(camera_to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation, as columns in the world, of a frame with y up and z against the camera's heading."""
    back = camera_to_world[:3, 2] * np.array([1.0, 0.0, 1.0])
    if np.linalg.norm(back) < 1e-6:  # straight down, the image's upper edge points ahead; straight up, back
        back = -np.sign(camera_to_world[1, 2]) * camera_to_world[:3, 1] * np.array([1.0, 0.0, 1.0])
    back = back / max(float(np.linalg.norm(back)), 1e-12)
    up = np.array([0.0, 1.0, 0.0])
    return np.stack([np.cross(up, back), up, back], axis=1).astype(np.float32)


def _area(image: Float[np.ndarray, "h w *c"], size: tuple[int, int]) -> Float[np.ndarray, "h2 w2 *c"]:
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
