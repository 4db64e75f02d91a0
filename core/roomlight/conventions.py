"""Conventions of RoomLight: axes, units, images, colour. Tests check the code against this table.

| what          | convention                                                                              |
|---------------|-----------------------------------------------------------------------------------------|
| world         | metres, right-handed, y up (gravity), as ARKit's                                        |
| camera        | x right, y up, z backward (OpenGL); poses are camera-to-world, 4 x 4                     |
| image         | pixel (column i, row j) has its centre at (i + 0.5, j + 0.5); row 0 is the top           |
| depth         | z-depth (along the optical axis) in metres; 0 = unknown                                 |
| radiance      | linear RGB, relative: 1.0 is white at the session's reference exposure                   |
| panorama      | equirectangular, H x 2H, world-aligned: u = 0.5 + atan2(z, x) / 2pi, v = acos(y) / pi;   |
|               | +Y in the top row, the centre column looks along +X, right of it comes +Z               |
| volume        | the first camera's frame; arrays are [z, y, x] or [channel, z, y, x]                     |

Readers convert every other convention to this one, when a file or message is read.
"""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Position = tuple[float, float, float]
"""A point (x, y, z) in world metres, y up."""
NO_FRAME: Final = -1
"""Frame index of a light to which no frame contributed."""
LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec. 709 weights of linear RGB; their sum is 1."""
OPENCV_TO_OPENGL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
"""Right factor that converts a camera-to-world pose from OpenCV axes (x right, y down, z forward) to these."""


def luminance(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    """Return the luminance of linear RGB, on this thread alone, in a twentieth of the time of `np.einsum`."""
    return cv2.transform(image, LUMINANCE[None])


def srgb_to_linear(encoded: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Decode sRGB values in [0, 1] to linear radiance in [0, 1] (IEC 61966-2-1)."""
    low = encoded / 12.92
    high = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, low, high).astype(encoded.dtype)


def linear_to_srgb(linear: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Encode linear radiance as sRGB in [0, 1]; values outside [0, 1] are clipped, as in a camera."""
    clipped = np.clip(linear, 0.0, 1.0)
    low = clipped * 12.92
    high = 1.055 * np.maximum(clipped, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(clipped <= 0.0031308, low, high).astype(linear.dtype)


_SRGB8_TABLE: Final = srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255))


def srgb8_to_linear(encoded: UInt8[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Decode 8-bit sRGB to linear float32 by table: the same values as `srgb_to_linear`, 100 times faster."""
    if encoded.size == 0:  # OpenCV returns None
        return np.empty(encoded.shape, np.float32)
    return cv2.LUT(encoded.reshape(-1), _SRGB8_TABLE).reshape(encoded.shape)


def linear_to_srgb8(linear: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """Encode linear radiance as 8-bit sRGB, rounded to nearest."""
    return np.rint(linear_to_srgb(linear) * 255).astype(np.uint8)


def direction_to_uv(direction: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 2"]:
    """Map unit directions (world frame) to panorama coordinates (u, v) in [0, 1)."""
    u = 0.5 + np.arctan2(direction[..., 2], direction[..., 0]) / (2 * np.pi)
    v = np.arccos(np.clip(direction[..., 1], -1.0, 1.0)) / np.pi
    return np.stack([u % 1.0, v], axis=-1).astype(direction.dtype)


def uv_to_direction(uv: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 3"]:
    """Map panorama coordinates (u, v) to unit directions in the world frame; inverse of `direction_to_uv`."""
    azimuth = (uv[..., 0] - 0.5) * (2 * np.pi)
    polar = uv[..., 1] * np.pi
    ring = np.sin(polar)
    return np.stack([ring * np.cos(azimuth), np.cos(polar), ring * np.sin(azimuth)], axis=-1).astype(uv.dtype)


def panorama_directions(height: int) -> Float[np.ndarray, "{height} 2*{height} 3"]:
    """Return the unit world directions of the pixel centres of a panorama, float32 [H, 2H, 3]."""
    columns = (np.arange(2 * height) + 0.5) / (2 * height)
    rows = (np.arange(height) + 0.5) / height
    u, v = np.meshgrid(columns, rows)
    return uv_to_direction(np.stack([u, v], axis=-1)).astype(np.float32)


@lru_cache(maxsize=8)
def panorama_rays(height: int) -> Float[np.ndarray, "2*{height}*{height} 3"]:
    """Return `panorama_directions` as a list [H * 2H, 3], row by row; cached and read-only."""
    directions = panorama_directions(height).reshape(-1, 3)
    directions.setflags(write=False)
    return directions


def panorama_solid_angles(height: int) -> Float[np.ndarray, "{height} 1"]:
    """Return the exact solid angle in steradians of one pixel of each row; all pixels together cover 4 pi."""
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    return ((edges[:-1] - edges[1:]) * (np.pi / height))[:, None].astype(np.float32)


def rotation_to_y_up(world_up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return the shortest rotation (4 x 4, float64) from the given up direction to +Y.

    Z-up worlds (nerfstudio, Blender) become x' = x, y' = z, z' = -y.

    Raises:
        ValueError: the direction is zero or not finite.
    """
    up = np.asarray(world_up, np.float64)
    norm = np.linalg.norm(up)
    if not np.isfinite(norm) or norm < 1e-9:
        raise ValueError(f"world up must be a finite non-zero vector, got {world_up}")
    up = up / norm
    target = np.array([0.0, 1.0, 0.0])
    cosine = float(up @ target)
    rotation = np.eye(4)
    if cosine < -1 + 1e-9:  # upside down: 180 degrees about x
        rotation[:3, :3] = np.diag([1.0, -1.0, -1.0])
        return rotation
    axis = np.cross(up, target)
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation[:3, :3] = np.eye(3) + skew + skew @ skew / (1 + cosine)
    return rotation
