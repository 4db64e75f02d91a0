"""Drafts of procedural furniture: sizes are known at once, the mesh is built on demand.

Model frame: metres, y up, front +z, standing on y = 0, centre of the footprint at the origin.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.furniture_model import LightSource
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, Vector, block, blocks, box, rod, rotated, with_material

UNLIMITED_STEP = 99.0
"""A maximum edge length that no part reaches: flat parts are not subdivided."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A model before its mesh: `size` is its bounding box (width, height, depth), to which the mesh is scaled
    exactly; the built mesh is within a few per cent of it."""

    name: str
    size: tuple[float, float, float]
    build: Callable[[], Mesh]
    elevation_m: float = 0.0
    top_m: float | None = None
    lights: tuple[LightSource, ...] = ()


Maker = Callable[[np.random.Generator], Draft]
"""Draws one variant. `build` may go on drawing from the same generator: it is called once, after the maker."""


def scaled_to_size(mesh: Mesh, size: tuple[Number, Number, Number]) -> Mesh:
    """Scale and move a mesh so that its bounding box is `size`, centred in x and z and standing on y = 0."""
    low, high = mesh.bounds().astype(np.float64)
    scale = np.array(size) / np.maximum(high - low, 1e-9)
    middle = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    return mesh.transformed(np.diag(scale).astype(np.float32), (-middle * scale).astype(np.float32))


class Parts:
    """Collects the parts of one mesh. `at` is the position of the origin of a part's own frame."""

    def __init__(self) -> None:
        self._parts: list[Mesh] = []

    def add(
        self,
        shape: Mesh,
        material: Material,
        at: Vector = (0, 0, 0),
        *,
        yaw: Number = 0,
        pitch: Number = 0,
        roll: Number = 0,
    ) -> None:
        """Add a shape in a material: rotated about z (roll), x (pitch), then y (yaw), in degrees, then moved."""
        mesh = with_material(shape, material)
        for degrees, axis in ((roll, "z"), (pitch, "x"), (yaw, "y")):
            if degrees:
                mesh = rotated(mesh, degrees, axis)
        self._parts.append(mesh.transformed(np.eye(3, dtype=np.float32), np.array([*at], np.float32)))

    def slab(
        self,
        material: Material,
        size: Vector,
        at: Vector = (0, 0, 0),
        *,
        radius: Number = 0.006,
        arcs: int = 1,
        yaw: Number = 0,
        pitch: Number = 0,
    ) -> None:
        """Add a box with its bottom centre at `at`: 108 triangles with rounded edges, 12 if radius is 0."""
        width, height, depth = (float(length) for length in size)
        shape = (
            box(width, height, depth, radius=radius, step=UNLIMITED_STEP, arcs=arcs)
            if radius
            else block(width, height, depth)
        )
        self.add(shape, material, at, yaw=yaw, pitch=pitch)

    def bar(
        self,
        material: Material,
        start: Vector,
        end: Vector,
        radius: Number,
        end_radius: Number | None = None,
        *,
        segments: int = 8,
    ) -> None:
        """Add a straight round bar."""
        self.add(rod(start, end, radius, end_radius, segments=segments, step=UNLIMITED_STEP), material)

    def blocks(self, material: Material, boxes: Iterable[tuple[Number, ...]]) -> None:
        """Add sharp-edged boxes in one material, each (width, height, depth, x, y, z of its bottom centre)."""
        table = np.array([[float(value) for value in row] for row in boxes], np.float64).reshape(-1, 6)
        if len(table):
            self.add(blocks(table[:, :3], table[:, 3:]), material)

    def add_mesh(self, mesh: Mesh, at: Vector = (0, 0, 0), *, yaw: Number = 0) -> None:
        """Add a mesh that already has materials."""
        x, y, z = (float(value) for value in at)
        self._parts.append(mesh.placed(x, y, z, degrees=float(yaw)))

    def mesh(self) -> Mesh:
        """Join all parts into one mesh."""
        return Mesh.joined(self._parts)


def uniform(rng: np.random.Generator, low: Number, high: Number) -> float:
    """Return a uniform random number."""
    return float(rng.uniform(low, high))


def light_source(x: Number, y: Number, z: Number, diameter_m: Number = 0.06) -> LightSource:
    """Return a bulb in the model frame."""
    return LightSource(position=np.array([x, y, z], np.float64), diameter_m=diameter_m)


def circle_points(count: int, radius: Number, phase: Number = 0.0) -> Float[np.ndarray, "n 2"]:
    """Return points (x, z) evenly spaced on a circle."""
    angle = 2 * np.pi * np.arange(count) / count + phase
    return radius * np.stack([np.cos(angle), np.sin(angle)], 1)
