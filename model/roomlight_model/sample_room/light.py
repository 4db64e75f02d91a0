"""What shines: a window onto a sky, the sun through it, an opal globe, a lampshade with two open ends.

Frames: world, y up, metres. Radiance is linear RGB relative to the frames' white. Each light turns two numbers in
[0, 1) into a direction and a weight such that the mean of `weight * cos(normal, direction)` over visible samples is
its irradiance.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class LightSamples:
    """Toward a light: unit directions, how far until it (or nothing more) is reached, and the sample's weight."""

    direction: Float[np.ndarray, "n 3"]
    distance_m: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, "n 3"]


@runtime_checkable  # so that a checker of annotations can look at it in the test run
class Light(Protocol):
    """Anything that can be sampled from a point of the room."""

    @property
    def samples(self) -> int:
        """Shadow rays for each shading point of a frame."""
        ...

    def sample(self, points: Float[np.ndarray, "n 3"], uniform: Float[np.ndarray, "n 2"]) -> LightSamples:
        """One sample for each point, from two uniform numbers each."""
        ...


@dataclass(frozen=True)
class Sky:
    """The world outside: a sky with soft clouds over hills, trees and a lawn; depends on direction only."""

    scale: float = 1.0
    sun_direction: tuple[float, float, float] = (0.0, 1.0, 0.0)
    sun_irradiance: Colour = (0.0, 0.0, 0.0)
    sun_radius_rad: float = 0.012

    def radiance(self, direction: Float[np.ndarray, "n 3"], *, with_sun: bool = False) -> Float[np.ndarray, "n 3"]:
        """Radiance that comes from a direction; the sun's disc only where asked for."""
        x, y, z = direction[:, 0], direction[:, 1], direction[:, 2]
        azimuth = np.arctan2(x, -z)
        clouds = 0.5 + 0.28 * np.sin(5 * azimuth + 9 * y) + 0.22 * np.sin(11 * azimuth - 17 * y + 1.3)
        blue = np.array([5.3, 7.2, 9.7], np.float32)
        white = np.array([9.6, 9.8, 9.8], np.float32)
        haze = np.clip(1.2 - 2.2 * np.abs(y), 0.0, 1.0) * 0.6
        mix = np.clip(haze + 0.7 * clouds * np.clip(1 - y, 0, 1), 0, 1)[:, None]
        out = blue + (white - blue) * mix
        hills = 0.11 + 0.03 * np.sin(3 * azimuth + 0.4) + 0.012 * np.sin(11 * azimuth)
        far = np.array([0.78, 0.98, 1.06], np.float32) * (1 - 0.6 * (y - 0.1))[:, None]
        out = np.where((y < hills)[:, None], far, out)
        crown = 0.03 + sum(
            size * np.abs(np.sin(rate * azimuth + shift))
            for size, rate, shift in ((0.06, 4.0, 0.9), (0.035, 11.0, 1.0), (0.02, 29.0, 0.0), (0.008, 83.0, 0.5))
        )
        leaf = (
            1.0
            + 0.24 * np.sin(37 * azimuth + 23 * y + 3 * np.sin(29 * y + 11 * azimuth))
            + 0.20 * np.sin(83 * azimuth - 61 * y + 2 * np.sin(71 * azimuth + 17 * y))
            + 0.12 * np.sin(190 * azimuth + 150 * y + 2.5 * np.sin(97 * y - 130 * azimuth))
        )
        trees = np.array([0.27, 0.47, 0.17], np.float32) * (leaf * (0.85 + 3 * np.clip(y, 0, 0.15)))[:, None]
        out = np.where((y < crown)[:, None], trees, out)
        lawn = np.array([0.50, 0.74, 0.27], np.float32) * (1 + 0.1 * np.sin(3 / np.minimum(y, -0.02)))[:, None]
        out = np.where((y < -0.035)[:, None], lawn, out) * np.float32(self.scale)
        if with_sun and max(self.sun_irradiance) > 0:
            cosine = direction @ np.array(self.sun_direction, np.float32)
            disc = np.array(self.sun_irradiance, np.float32) / np.float32(np.pi * self.sun_radius_rad**2)
            out = np.where((cosine > np.cos(self.sun_radius_rad))[:, None], disc, out)
        return out.astype(np.float32)


@dataclass(frozen=True)
class WindowLight:
    """The opening that the sky shines through: a rectangle on a plane of constant z, light toward +z."""

    sky: Sky
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    z_m: float
    samples: int = 4

    def sample(self, points: Float[np.ndarray, "n 3"], uniform: Float[np.ndarray, "n 2"]) -> LightSamples:
        """Uniform over the opening; the distance is unbounded, since the sky is."""
        target = np.empty_like(points)
        target[:, 0] = self.x_m[0] + (self.x_m[1] - self.x_m[0]) * uniform[:, 0]
        target[:, 1] = self.y_m[0] + (self.y_m[1] - self.y_m[0]) * uniform[:, 1]
        target[:, 2] = self.z_m
        area = (self.x_m[1] - self.x_m[0]) * (self.y_m[1] - self.y_m[0])
        direction, distance = _toward(points, target)
        # The squared distance is held off zero: next to the opening a rare sample would outshine all others.
        factor = area * np.maximum(-direction[:, 2], 0) / np.maximum(distance, 0.05) ** 2
        far = np.full(len(points), 1e4, np.float32)
        return LightSamples(direction, far, self.sky.radiance(direction) * factor[:, None].astype(np.float32))


@dataclass(frozen=True)
class SunLight:
    """The sun's disc, small enough that its edges on the floor are soft over a centimetre or two."""

    sky: Sky
    samples: int = 1

    def sample(self, points: Float[np.ndarray, "n 3"], uniform: Float[np.ndarray, "n 2"]) -> LightSamples:
        """Uniform over the disc."""
        axis = np.array(self.sky.sun_direction, np.float32)
        side, up = _frame(axis)
        radius = np.tan(self.sky.sun_radius_rad) * np.sqrt(uniform[:, :1])
        angle = 2 * np.pi * uniform[:, 1:]
        direction = axis + radius * (np.cos(angle) * side + np.sin(angle) * up)
        direction = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
        weight = np.broadcast_to(np.array(self.sky.sun_irradiance, np.float32), direction.shape).copy()
        return LightSamples(direction, np.full(len(points), 1e4, np.float32), weight)


@dataclass(frozen=True)
class GlobeLight:
    """An opal ball of uniform radiance."""

    centre: tuple[float, float, float]
    radius_m: float
    radiance: Colour
    samples: int = 2

    def sample(self, points: Float[np.ndarray, "n 3"], uniform: Float[np.ndarray, "n 2"]) -> LightSamples:
        """Uniform over the solid angle that the ball subtends."""
        axis, distance = _toward(points, np.broadcast_to(np.array(self.centre, np.float32), points.shape))
        sine_sq = np.clip((self.radius_m / np.maximum(distance, self.radius_m * 1.0001)) ** 2, 0, 1)
        cosine_max = np.sqrt(1 - sine_sq)
        # 1 - cos without cancellation for a small ball
        spread = sine_sq / (1 + cosine_max)
        cosine = 1 - uniform[:, 0] * spread
        sine = np.sqrt(np.clip(1 - cosine**2, 0, 1))
        angle = 2 * np.pi * uniform[:, 1]
        side, up = frames_about(axis)
        direction = cosine[:, None] * axis + sine[:, None] * (
            np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up
        )
        reach = distance * cosine - np.sqrt(np.clip(self.radius_m**2 - (distance * sine) ** 2, 0, None))
        weight = (2 * np.pi * spread)[:, None] * np.array(self.radiance, np.float32)
        return LightSamples(direction.astype(np.float32), reach.astype(np.float32), weight.astype(np.float32))


@dataclass(frozen=True)
class ShadeLight:
    """The side of an upright cylinder of uniform radiance (a lampshade of cloth)."""

    centre: tuple[float, float, float]
    radius_m: float
    height_m: float
    radiance: Colour
    samples: int = 2

    def sample(self, points: Float[np.ndarray, "n 3"], uniform: Float[np.ndarray, "n 2"]) -> LightSamples:
        """Uniform over the half of the side that faces each point."""
        centre = np.array(self.centre, np.float32)
        toward = np.arctan2(points[:, 2] - centre[2], points[:, 0] - centre[0])
        angle = toward + (uniform[:, 0] - 0.5) * np.pi
        normal = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], 1)
        target = centre + self.radius_m * normal
        target[:, 1] = centre[1] + (uniform[:, 1] - 0.5) * self.height_m
        direction, distance = _toward(points, target.astype(np.float32))
        area = np.pi * self.radius_m * self.height_m
        facing = np.maximum(-(direction * normal).sum(1), 0)
        factor = area * facing / np.maximum(distance, 0.03) ** 2
        weight = factor[:, None] * np.array(self.radiance, np.float32)
        return LightSamples(direction, distance, weight.astype(np.float32))


@dataclass(frozen=True)
class DiscLight:
    """A level disc that shines up or down (the open end of a lampshade)."""

    centre: tuple[float, float, float]
    radius_m: float
    radiance: Colour
    up: bool
    samples: int = 1

    def sample(self, points: Float[np.ndarray, "n 3"], uniform: Float[np.ndarray, "n 2"]) -> LightSamples:
        """Uniform over the disc."""
        radius, angle = self.radius_m * np.sqrt(uniform[:, 0]), 2 * np.pi * uniform[:, 1]
        offset = np.stack([radius * np.cos(angle), np.zeros_like(angle), radius * np.sin(angle)], 1)
        direction, distance = _toward(points, (np.array(self.centre, np.float32) + offset).astype(np.float32))
        facing = np.maximum(-direction[:, 1] if self.up else direction[:, 1], 0)
        factor = np.pi * self.radius_m**2 * facing / np.maximum(distance, 0.03) ** 2
        weight = factor[:, None] * np.array(self.radiance, np.float32)
        return LightSamples(direction, distance, weight.astype(np.float32))


def _toward(
    points: Float[np.ndarray, "n 3"], targets: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    offset = targets - points
    distance = np.maximum(np.sqrt((offset * offset).sum(1)), 1e-6).astype(np.float32)
    return (offset / distance[:, None]).astype(np.float32), distance


def _frame(axis: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    side, up = frames_about(axis[None])
    return side[0], up[0]


def frames_about(axis: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Two unit vectors at right angles to each axis (Duff et al. 2017, without a branch)."""
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    side = np.stack([1 + sign * x * x * a, sign * b, -sign * x], 1)
    up = np.stack([b, sign + y * y * a, -y], 1)
    return side.astype(np.float32), up.astype(np.float32)
