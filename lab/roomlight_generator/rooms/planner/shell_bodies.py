"""Bodies of the shell's parts that stand in the room: curtains, open door leaves, beams, columns.

They are derived from the meshes of the shell's items, so that the planner does not depend on how a shell is built.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.plan import Shell, inside_outline
from roomlight_generator.rooms.planner.body import Body
from roomlight_generator.rooms.scene import Mesh

ENCLOSING_ROLES: Final = frozenset(
    {"wall", "floor", "ceiling", "second_room", "skirting", "moulding", "frame", "pane", "sill"}
)
"""Parts that enclose the room or run along its walls."""

MIN_PROTRUSION_M: Final = 0.07
"""Minimum protrusion from the wall of an obstacle; skirtings, linings and sills protrude less."""

SLICE_M: Final = 0.25
"""Length of the slices into which a slanted part is cut."""

SAMPLE_SPACING_M: Final = 0.1
"""Spacing of sample points on triangle edges."""

CELL_M: Final = 0.15
"""Points of one connected part lie in neighbouring cells of this size."""


def shell_bodies(shell: Shell) -> list[Body]:
    """Return boxes around the parts of the shell that stand in the room: a box for each connected part of an item."""
    bodies: list[Body] = []
    for item in shell.items:
        if item.role in ENCLOSING_ROLES:
            continue
        points = _along_edges(item.mesh)
        inside, squared_m2 = inside_outline(shell.polygon, points[:, 0], points[:, 2])
        points = points[inside & (squared_m2 >= MIN_PROTRUSION_M**2)]
        if len(points):
            bodies += _boxes(points)
    return bodies


def _along_edges(mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    starts, ends = corners.reshape(-1, 3), np.roll(corners, -1, axis=1).reshape(-1, 3)
    lengths = np.linalg.norm(ends - starts, axis=1)
    long = lengths > SAMPLE_SPACING_M
    steps = int(np.ceil(lengths.max(initial=0.0) / SAMPLE_SPACING_M))
    shares = np.arange(1, steps)[:, None, None] / max(steps, 1)
    between = starts[long] + shares * (ends[long] - starts[long])
    return np.concatenate([starts, between.reshape(-1, 3)])


def _boxes(points: Float[np.ndarray, "n 3"]) -> list[Body]:
    plan = points[:, [0, 2]]
    cells = np.floor((plan - plan.min(0)) / CELL_M).astype(int)
    grid = np.zeros(cells.max(0) + 1, np.uint8)
    grid[cells[:, 0], cells[:, 1]] = 1
    count, labels = cv2.connectedComponents(grid, connectivity=8)
    part = labels[cells[:, 0], cells[:, 1]]
    bodies: list[Body] = []
    for label in range(1, count):
        bodies += [_box(own) for own in _slices(points[part == label])]
    return bodies


def _slices(points: Float[np.ndarray, "n 3"]) -> list[Float[np.ndarray, "m 3"]]:
    """Cut a slanted part (a rafter) into slices, each with a low box of its own; return other parts whole."""
    middle = points.mean(0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    if not 0.15 < abs(float(axes[0, 1])) < 0.97:
        return [points]
    place = np.floor((points - middle) @ axes[0] / SLICE_M).astype(int)
    return [points[place == slice_index] for slice_index in np.unique(place)]


def _box(own: Float[np.ndarray, "n 3"]) -> Body:
    corners = cv2.boxPoints(cv2.minAreaRect(np.ascontiguousarray(own[:, [0, 2]], np.float32))).astype(np.float64)
    side, other = corners[1] - corners[0], corners[2] - corners[1]
    x, z = corners.mean(0)
    # A rotation of t has its right side along (cos t, -sin t).
    degrees = float(np.degrees(np.arctan2(-side[1], side[0])))
    width, depth = float(np.linalg.norm(side)), float(np.linalg.norm(other))
    low, high = float(own[:, 1].min()), float(own[:, 1].max())
    return Body.of(float(x), float(z), degrees, width=width + 0.02, depth=depth + 0.02, low=low, high=high)
