"""Upright bounding boxes of furniture and their intersection tests.

Plan coordinates (x, z) of the room, metres; heights over the floor. Rotations as in `Mesh.placed`: a piece rotated by
degrees has its right side along (cos, -sin) and its front along (sin, cos).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from roomlight_generator.rooms.plan import Placement
from roomlight_generator.rooms.shapes import Number

TOUCH_M: Final = 0.001
"""Maximum overlap of boxes that are in contact: kitchen units stand side by side."""

Segment = tuple[float, float, float, float]
"""x0, z0, x1, z1."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """An upright box: centre of its footprint, half its width (x) and depth (z), rotation, lowest and highest point."""

    x: float
    z: float
    half_width: float
    half_depth: float
    sine: float
    cosine: float
    low: float
    high: float
    reach: float

    @classmethod
    def of(
        cls, x: Number, z: Number, degrees: Number, *, width: Number, depth: Number, low: Number = 0.0, high: Number
    ) -> "Body":
        """Make a box from full sizes and a rotation in degrees."""
        angle = math.radians(degrees)
        half_width, half_depth = width / 2, depth / 2
        reach = math.hypot(half_width, half_depth)
        return cls(
            float(x), float(z), half_width, half_depth, math.sin(angle), math.cos(angle), float(low), float(high), reach
        )

    @classmethod
    def placed(cls, placement: Placement) -> "Body":
        """Return the bounding box of a placed model."""
        model = placement.model
        return cls.of(
            placement.x,
            placement.z,
            placement.degrees,
            width=float(model.width_m),
            depth=float(model.depth_m),
            low=placement.y,
            high=placement.y + model.height_m,
        )

    def to_plan(self, right_m: float, front_m: float) -> tuple[float, float]:
        """Return the plan point at a distance to its right and its front."""
        return (
            self.x + right_m * self.cosine + front_m * self.sine,
            self.z - right_m * self.sine + front_m * self.cosine,
        )

    def to_local(self, x: float, z: float) -> tuple[float, float]:
        """Return the distances of a plan point to its right and its front."""
        dx, dz = x - self.x, z - self.z
        return dx * self.cosine - dz * self.sine, dx * self.sine + dz * self.cosine

    def corners(self) -> list[tuple[float, float]]:
        """Return its four corners in plan."""
        return [self.to_plan(a * self.half_width, b * self.half_depth) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]

    def overlaps(self, other: "Body", slack_m: float = TOUCH_M) -> bool:
        """Return whether the boxes overlap by more than the slack (separating axes, height intervals)."""
        if self.low >= other.high - slack_m or other.low >= self.high - slack_m:
            return False
        dx, dz = other.x - self.x, other.z - self.z
        reach = self.reach + other.reach
        if dx * dx + dz * dz >= reach * reach:
            return False
        along = abs(self.cosine * other.cosine + self.sine * other.sine)
        across = abs(self.cosine * other.sine - self.sine * other.cosine)
        return (
            abs(dx * self.cosine - dz * self.sine)
            < self.half_width + other.half_width * along + other.half_depth * across - slack_m
            and abs(dx * self.sine + dz * self.cosine)
            < self.half_depth + other.half_width * across + other.half_depth * along - slack_m
            and abs(dx * other.cosine - dz * other.sine)
            < other.half_width + self.half_width * along + self.half_depth * across - slack_m
            and abs(dx * other.sine + dz * other.cosine)
            < other.half_depth + self.half_width * across + self.half_depth * along - slack_m
        )

    def crosses(self, segments: Sequence[Segment]) -> bool:
        """Return whether any of the plan segments crosses its footprint by more than `TOUCH_M`."""
        half_width, half_depth = self.half_width - TOUCH_M, self.half_depth - TOUCH_M
        for x0, z0, x1, z1 in segments:
            ax, az = x0 - self.x, z0 - self.z
            bx, bz = x1 - self.x, z1 - self.z
            right0, front0 = ax * self.cosine - az * self.sine, ax * self.sine + az * self.cosine
            right1, front1 = bx * self.cosine - bz * self.sine, bx * self.sine + bz * self.cosine
            enter, leave = 0.0, 1.0
            for start, step, half in ((right0, right1 - right0, half_width), (front0, front1 - front0, half_depth)):
                if abs(step) < 1e-9:
                    if abs(start) >= half:
                        leave = -1.0
                    continue
                first, last = sorted(((-half - start) / step, (half - start) / step))
                enter, leave = max(enter, first), min(leave, last)
            if enter < leave:
                return True
        return False


def contains_point(x: float, z: float, segments: Sequence[Segment]) -> bool:
    """Return whether a plan point lies inside the closed outline."""
    inside = False
    for x0, z0, x1, z1 in segments:
        if (z0 > z) != (z1 > z) and x < x0 + (z - z0) * (x1 - x0) / (z1 - z0):
            inside = not inside
    return inside
