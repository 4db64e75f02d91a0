"""A rectangle of an image, and the camera that sees only it: compositing works where objects and shadows are."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.camera import Intrinsics, rigid_inverse


@dataclass(frozen=True)
class Crop:
    """Rows top..bottom and columns left..right (exclusive) of an image of `width` x `height` pixels."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns, to index an image."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.bottom - self.top, self.right - self.left

    def inside(self, outer: "Crop") -> tuple[slice, slice]:
        """Return rows and columns of the rectangle in an image of the pixels of `outer`, which contains it."""
        top, left = self.top - outer.top, self.left - outer.left
        return slice(top, top + self.shape[0]), slice(left, left + self.shape[1])

    @property
    def empty(self) -> bool:
        """Whether there is no pixel."""
        return self.bottom <= self.top or self.right <= self.left

    def union(self, other: "Crop") -> "Crop":
        """Return the smallest rectangle around both."""
        if self.empty or other.empty:
            return other if self.empty else self
        return Crop(
            min(self.left, other.left),
            min(self.top, other.top),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )

    def grown(self, pixels: int, width: int, height: int) -> "Crop":
        """Return the rectangle with a margin, within the image."""
        return Crop(
            max(0, self.left - pixels),
            max(0, self.top - pixels),
            min(width, self.right + pixels),
            min(height, self.bottom + pixels),
        )


NO_CROP: Final = Crop(0, 0, 0, 0)


@dataclass(frozen=True)
class CropCamera:
    """A pinhole camera whose principal point may lie anywhere; pixel centres are at half integers."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @classmethod
    def of(cls, camera: Intrinsics, crop: Crop | None = None) -> "CropCamera":
        """Return the camera of a rectangle of an image, or of the whole image."""
        if crop is None:
            return cls(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        height, width = crop.shape
        return cls(camera.fx, camera.fy, camera.cx - crop.left, camera.cy - crop.top, width, height)

    def every(self, step: int) -> "CropCamera":
        """Return the camera whose pixels are every `step`-th pixel of this one, from step // 2 on."""
        first = step // 2 + 0.5
        rows, columns = (len(range(step // 2, size, step)) for size in (self.height, self.width))
        cx, cy = (self.cx - first) / step + 0.5, (self.cy - first) / step + 0.5
        return CropCamera(self.fx / step, self.fy / step, cx, cy, columns, rows)

    def rays(self) -> Float32[np.ndarray, "{self.height} {self.width} 3"]:
        """Return camera-frame rays through the pixel centres with z = -1: `depth * ray` is the point seen."""
        rays = np.empty((self.height, self.width, 3), np.float32)
        rays[..., 0] = (np.arange(self.width, dtype=np.float32) + np.float32(0.5 - self.cx)) / np.float32(self.fx)
        rays[..., 1] = -((np.arange(self.height, dtype=np.float32) + np.float32(0.5 - self.cy)) / np.float32(self.fy))[
            :, None
        ]
        rays[..., 2] = -1.0
        return rays


def crop_of_sphere(
    camera: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], centre: Float[np.ndarray, "3"], radius_m: float
) -> Crop:
    """Return the pixels that a sphere may cover; the whole image if the camera is inside, empty if it is behind."""
    matrix = rigid_inverse(camera_to_world)
    x, y, z = matrix[:3, :3] @ centre + matrix[:3, 3]
    if -z < -radius_m:
        return NO_CROP
    near = -z - radius_m
    if near < 0.05 * radius_m + 1e-3:
        return Crop(0, 0, camera.width, camera.height)
    # Bounds of each slope over the sphere: the tangents of the circle in the plane of that axis and the view.
    (left, right), (low, high) = _slopes(x, -z, radius_m), _slopes(y, -z, radius_m)
    return Crop(
        int(np.clip(np.floor(camera.cx + camera.fx * left), 0, camera.width)),
        int(np.clip(np.floor(camera.cy - camera.fy * high), 0, camera.height)),
        int(np.clip(np.ceil(camera.cx + camera.fx * right), 0, camera.width)),
        int(np.clip(np.ceil(camera.cy - camera.fy * low), 0, camera.height)),
    )


def _slopes(across: float, ahead: float, radius_m: float) -> tuple[float, float]:
    angle = np.arctan2(across, ahead)
    half = np.arcsin(min(radius_m / np.hypot(across, ahead), 1.0))
    low, high = max(angle - half, -1.55), min(angle + half, 1.55)
    return float(np.tan(low)), float(np.tan(high))
