"""Pinhole cameras and rigid poses.

Frames: camera x right, y up, z backward; world y up; poses camera-to-world. Units: metres and pixels.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.rules import is_finite

FOCAL_LENGTH: Final = (0.01, 100.0)
"""Shortest and longest focal length, relative to the image's side: from 179 degrees to half a degree of view."""


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera for an image of `width` x `height` pixels; pixel centres are at half integers.

    Attributes:
        fx, fy: focal length in pixels.
        cx, cy: principal point in pixels.

    Raises:
        ValueError: a value is impossible for a camera; the message names field and value.

    Examples:
        >>> import roomlight as rl
        >>> camera = rl.Intrinsics(fx=300.0, fy=300.0, cx=160.0, cy=120.0, width=320, height=240)
        >>> camera.resized(160, 120).fx
        150.0
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if not is_finite(value) or int(value) != value:
                raise ValueError(f"image {name} is a whole number of pixels, got {value!r}")
            object.__setattr__(self, name, int(value))
        if self.width < 1 or self.height < 1:
            raise ValueError(f"image size must be positive, got {self.width} x {self.height}")
        low, high = FOCAL_LENGTH
        for name, value, size in (("fx", self.fx, self.width), ("fy", self.fy, self.height)):
            if not is_finite(value) or value <= 0:
                raise ValueError(f"focal length {name} must be a positive number, got {value!r}")
            if not low * (1 - 1e-6) <= value / size <= high * (1 + 1e-6):  # `resized` rounds
                raise ValueError(f"focal length {name} = {value:g} does not fit {size} pixels; check its unit (pixels)")
        for name, value, size in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if not is_finite(value) or not -size <= value <= 2 * size:
                raise ValueError(f"principal point {name} = {value!r} is far outside the image ({size} pixels)")
        for name in ("fx", "fy", "cx", "cy"):  # NumPy scalars would promote float32 rays to float64
            object.__setattr__(self, name, float(getattr(self, name)))

    def resized(self, width: int, height: int) -> "Intrinsics":
        """Return the camera of the same view resampled to another size in pixels (K scales with the ratio)."""
        sx, sy = width / self.width, height / self.height
        return Intrinsics(self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy, width, height)

    def rays(self) -> Float[np.ndarray, "{self.height} {self.width} 3"]:
        """Return camera-frame rays through the pixel centres with z = -1: `depth * ray` is the point seen."""
        x = (np.arange(self.width, dtype=np.float32) + 0.5 - self.cx) / self.fx
        y = -(np.arange(self.height, dtype=np.float32) + 0.5 - self.cy) / self.fy
        rays = np.empty((self.height, self.width, 3), np.float32)
        rays[..., 0] = x
        rays[..., 1] = y[:, None]
        rays[..., 2] = -1.0
        return rays

    def project(
        self, points_camera: Float[np.ndarray, "*shape 3"]
    ) -> tuple[Float[np.ndarray, "*shape 2"], Float[np.ndarray, "*shape"]]:
        """Project camera-frame points to image coordinates (column, row; pixel centres at half integers) and z-depth.

        Points at or behind the camera plane (depth <= 0) get coordinates of NaN.
        """
        depth = -points_camera[..., 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            column = self.cx + self.fx * points_camera[..., 0] / depth
            row = self.cy - self.fy * points_camera[..., 1] / depth
        xy = np.stack([column, row], axis=-1)
        xy[depth <= 0] = np.nan
        return xy, depth


def check_rigid(camera_to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose as a clean float64 rigid transform.

    Rounding in text files is repaired (nearest rotation by SVD). A rotation within 1e-12 keeps its bits, so that a pose
    that was cleaned before transmission is the same pose after it.

    Raises:
        ValueError: the pose holds NaN, infinity, a mirror image, a scale or a shear: lost tracking or a misread
            convention.
    """
    matrix = np.asarray(camera_to_world, np.float64)
    if matrix.shape != (4, 4):
        raise ValueError(f"a pose is a 4 x 4 matrix, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ValueError("the pose holds NaN or infinity (lost tracking)")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-4:
        columns = "; it is stored by columns: transpose it" if matrix[:, 3].tolist() == [0, 0, 0, 1] else ""
        raise ValueError(f"the pose's last row is {matrix[3].tolist()}, not 0 0 0 1{columns}")
    rotation = matrix[:3, :3]
    scale = np.ones(3)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-12:
        u, scale, vt = np.linalg.svd(rotation)
        rotation = u @ vt
    if np.linalg.det(rotation) < 0:
        raise ValueError("the pose's rotation is a mirror image (determinant -1)")
    if np.abs(scale - 1).max() > 0.02:
        raise ValueError(f"the pose's rotation has scales {scale.round(4).tolist()}, not 1 1 1")
    clean = np.eye(4)
    clean[:3, :3] = rotation
    clean[:3, 3] = matrix[:3, 3]
    return clean


def rigid_inverse(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Invert a rigid transform (rotation transposed; no matrix inversion)."""
    rotation = transform[:3, :3].T
    inverse = np.eye(4)
    inverse[:3, :3] = rotation
    inverse[:3, 3] = -rotation @ transform[:3, 3]
    return inverse


def pose_from_quaternion(
    quaternion_xyzw: Float[np.ndarray, "4"], translation: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Make a rigid 4 x 4 transform from a quaternion (x, y, z, w; any length but zero) and a translation in metres.

    Raises:
        ValueError: the quaternion is zero or not finite.
    """
    q = np.asarray(quaternion_xyzw, np.float64)
    norm = np.linalg.norm(q)
    if not np.isfinite(norm) or norm < 1e-6:
        raise ValueError(f"quaternion {q.tolist()} has no direction (lost tracking)")
    pose = np.eye(4)
    pose[:3, :3] = rotation_of_quaternion(q / norm)
    pose[:3, 3] = translation
    return pose


def rotation_of_quaternion(unit_xyzw: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a quaternion (x, y, z, w) of length 1; the identity for zeros."""
    x, y, z, w = unit_xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def transform_points(
    transform: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*shape 3"]
) -> Float[np.ndarray, "*shape 3"]:
    """Apply a rigid transform to points, in the precision of the points."""
    matrix = transform.astype(points.dtype)
    return points @ matrix[:3, :3].T + matrix[:3, 3]
