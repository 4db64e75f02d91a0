"""A coloured box room with exact answers, for the tests: frames from any camera, panoramas at any point.

World: metres, y up; the room is centred on the origin in x and z and stands on y = 0. Each wall has a smooth
pattern of its own, so that swapped axes or an offset of half a pixel change the colours.
"""

from dataclasses import dataclass, replace

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.conventions import panorama_directions
from roomlight.frame import Frame

WALLS = np.array(
    [[0.8, 0.3, 0.2], [0.2, 0.6, 0.3], [0.5, 0.4, 0.3], [0.9, 0.9, 0.8], [0.2, 0.3, 0.8], [0.7, 0.6, 0.2]], np.float64
)
"""Base colours of the walls at -x, +x, -y, +y, -z, +z."""


@dataclass(frozen=True)
class BoxRoom:
    """A box room.

    Attributes:
        size_m: Size along x, y, z.
        block: Opposite corners of a block in the room.
        lamp: Centre and radius of a round lamp on the wall that it touches.
        lamp_radiance: Grey radiance of the lamp.
        pattern: How much the walls' pattern varies.
    """

    size_m: tuple[float, float, float] = (6.0, 3.0, 5.0)
    block: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    lamp: tuple[tuple[float, float, float], float] | None = None
    lamp_radiance: float = 8.0
    pattern: float = 0.25

    def cast(self, origins, directions):
        """Radiance [..., 3] and distance [...] along rays with unit directions from inside the room."""
        origins, directions = np.broadcast_arrays(np.asarray(origins, np.float64), np.asarray(directions, np.float64))
        half = np.array([self.size_m[0] / 2, self.size_m[1] / 2, self.size_m[2] / 2])
        centre = np.array([0, self.size_m[1] / 2, 0])
        with np.errstate(divide="ignore", invalid="ignore"):
            to_wall = np.where(directions > 0, centre + half - origins, centre - half - origins) / directions
        to_wall = np.where(np.abs(directions) < 1e-12, np.inf, to_wall)
        axis = to_wall.argmin(axis=-1)
        distance = to_wall.min(axis=-1)
        face = 2 * axis + (np.take_along_axis(directions, axis[..., None], -1)[..., 0] > 0)
        if self.block is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                sides = np.stack([(np.array(corner) - origins) / directions for corner in self.block])
            near, far = sides.min(axis=0), sides.max(axis=0)
            enter, leave = near.max(axis=-1), far.min(axis=-1)
            hit = (enter > 0) & (enter < leave) & (enter < distance)
            distance = np.where(hit, enter, distance)
            face = np.where(hit, 5 - (2 * near.argmax(axis=-1)), face)
        points = origins + distance[..., None] * directions
        pattern = 1 - self.pattern + self.pattern * np.sin(2.0 * points + np.arange(3)).prod(axis=-1)
        radiance = WALLS[face] * pattern[..., None]
        if self.lamp is not None:
            lit = np.linalg.norm(points - np.array(self.lamp[0]), axis=-1) < self.lamp[1]
            radiance = np.where(lit[..., None], self.lamp_radiance, radiance)
        return radiance.astype(np.float32), distance.astype(np.float32)

    def panorama(self, position, height=60):
        """Exact radiance [H, 2H, 3] and distance [H, 2H] at a point."""
        return self.cast(np.asarray(position), panorama_directions(height))

    def frame(self, camera_to_world, *, index=0, width=160, height=120, depth_size=None, fov_degrees=75.0):
        """The camera's linear image and exact z-depth (of `depth_size` = (width, height) if given)."""
        k = pinhole(width, height, fov_degrees)
        image, depth = self._render(k, camera_to_world)
        if depth_size is not None:
            _, depth = self._render(k.resized(*depth_size), camera_to_world)
        clipped = np.zeros((height, width), bool)
        return Frame(index, image, clipped, depth, k, camera_to_world, source=f"room frame {index}")

    def _render(self, k, camera_to_world):
        rays = k.rays().astype(np.float64)
        length = np.linalg.norm(rays, axis=-1)
        directions = (rays / length[..., None]) @ camera_to_world[:3, :3].T
        image, distance = self.cast(camera_to_world[:3, 3], directions)
        return image, (distance / length).astype(np.float32)


def saturated(frame, white=1.0):
    """The frame as a camera gives it that clips at this radiance."""
    clipped = frame.image.max(axis=-1) >= np.float32(white)
    return replace(frame, image=np.minimum(frame.image, np.float32(white)), clipped=clipped)


def pinhole(width, height, fov_degrees=75.0):
    """Intrinsics with square pixels and this horizontal field of view; the principal point is off-centre."""
    focal = width / 2 / np.tan(np.radians(fov_degrees) / 2)
    return Intrinsics(focal, focal, width / 2 + 1.25, height / 2 - 0.75, width, height)


def camera_at(position, yaw_degrees=0.0, pitch_degrees=0.0):
    """Camera-to-world pose: yaw 0 looks along -z, 90 along -x (counter-clockwise from above); pitch > 0 up."""
    yaw, pitch = np.radians(yaw_degrees), np.radians(pitch_degrees)
    yaw_rotation = rotation_about_y(yaw)
    pitch_rotation = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    pose = np.eye(4)
    pose[:3, :3] = yaw_rotation @ pitch_rotation
    pose[:3, 3] = position
    return pose


def pixel_of(frame, point):
    """The pixel that shows a world point."""
    offset = (np.asarray(point) - frame.camera_to_world[:3, 3]) @ frame.camera_to_world[:3, :3]
    ((column, row),), _ = frame.intrinsics.project(offset[None])
    return float(column) - 0.5, float(row) - 0.5


def rotation_about_y(radians):
    """Rotation matrix about y, counter-clockwise seen from above."""
    c, s = np.cos(radians), np.sin(radians)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def pan(room, count=12, *, start_degrees=0.0, step_degrees=10.0, position=(0.3, 1.4, 0.2), **options):
    """Frames of a camera that rotates about its own position, `step_degrees` per frame."""
    return [room.frame(camera_at(position, start_degrees + i * step_degrees), index=i, **options) for i in range(count)]
