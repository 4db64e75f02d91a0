"""A frame with a mirror sphere at each probe that it shows, for the summary of a replay."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np

from roomlight.camera import rigid_inverse, transform_points
from roomlight.compositing.compositor import Compositor
from roomlight.compositing.placement.scene import parse_scene
from roomlight.conventions import Position
from roomlight.engine.session import Session
from roomlight.errors import ObjectError, SceneError
from roomlight.frame import Frame
from roomlight_cli.replays.sheet import InsertedObjects

_COLUMNS: Final = 960
"""Width of the printed picture. Small frames are enlarged to it first, so that the spheres' edges are sharp."""
_DIAMETER_SHARE: Final = 0.055
"""A sphere's diameter as a share of its distance: large enough to see the room in it."""
_DIAMETERS_M: Final = (0.08, 0.3)
_MARGIN_SHARE: Final = 0.06
"""Probes nearer to the frame's edge are not shown in full, and do not count."""
_BEHIND_M: Final = 0.05
"""A probe this far behind the surface that a pixel shows is hidden."""


@dataclass(frozen=True, eq=False)
class ProbeView:
    """A frame and the probes that can be seen in it.

    Attributes:
        frame: The frame.
        positions: All probes, world metres.
        marks: Where they are, as shares of width and height; None for one that is hidden or out of view.
        depths_m: Their distance along the camera's axis.
    """

    frame: Frame
    positions: tuple[Position, ...]
    marks: tuple[tuple[float, float] | None, ...]
    depths_m: tuple[float, ...]

    @property
    def score(self) -> int:
        """Number of probes in view."""
        return sum(mark is not None for mark in self.marks)

    @classmethod
    def of(cls, frame: Frame, positions: Sequence[Position]) -> "ProbeView":
        """Find which probes a frame shows; unknown depth hides nothing."""
        points = np.asarray(positions, np.float64).reshape(-1, 3)
        pixels, depths_m = frame.intrinsics.project(transform_points(rigid_inverse(frame.camera_to_world), points))
        shares = pixels / [frame.intrinsics.width, frame.intrinsics.height]
        marks: list[tuple[float, float] | None] = []
        for (x, y), depth_m in zip(shares.tolist(), depths_m.tolist(), strict=True):
            within = depth_m > 0.2 and _MARGIN_SHARE < x < 1 - _MARGIN_SHARE and _MARGIN_SHARE < y < 1 - _MARGIN_SHARE
            marks.append((x, y) if within and not _hidden(frame, x, y, depth_m) else None)
        return cls(frame, tuple(positions), tuple(marks), tuple(depths_m.tolist()))

    def printed(self) -> "ProbeView":
        """Return the view with its frame no wider than it is printed."""
        return replace(self, frame=printed(self.frame))


def printed(frame: Frame) -> Frame:
    """Return the frame no wider than it is printed."""
    height, width = frame.image.shape[:2]
    side = max(_COLUMNS, round(height * _COLUMNS / width))
    return frame if width <= _COLUMNS else frame.resized(side, side)


def insert_spheres(session: Session, view: ProbeView) -> InsertedObjects | None:
    """Composite a mirror sphere at each probe in view, lit by the session; None if there is none or it cannot be."""
    objects: list[dict[str, Any]] = []
    marks: list[tuple[float, float] | None] = []
    for number, (mark, depth_m) in enumerate(zip(view.marks, view.depths_m, strict=True)):
        if mark is None:
            marks.append(None)
            continue
        size_m = float(np.clip(_DIAMETER_SHARE * 2 * depth_m, *_DIAMETERS_M))
        x, y, z = view.positions[number]
        objects.append({
            "name": f"probe {number}",
            "shape": "sphere",
            "size_m": size_m,
            "material": {"kind": "mirror"},
            "position": [x, y - size_m / 2, z],
        })  # fmt: skip
        radius = size_m / 2 * view.frame.intrinsics.fy / depth_m / view.frame.intrinsics.height
        marks.append((mark[0], mark[1] - 1.5 * radius - 0.02))
    if not objects:
        return None
    try:
        compositor = Compositor(session, parse_scene({"objects": objects}, load=_no_file), quality="good")
        try:
            composite = compositor.composite(_enlarged(view.frame))
        finally:
            compositor.close()  # the session's tracked positions are the replay's again
    except SceneError:
        return None
    label = f"Frame {view.frame.index} with a mirror sphere at each probe in view, lit by RoomLight"
    return InsertedObjects(composite.image, label, tuple(marks))


def _hidden(frame: Frame, x: float, y: float, depth_m: float) -> bool:
    """Return whether a surface lies in front of a point at these shares of width and height."""
    height, width = frame.depth_m.shape
    surface_m = float(frame.depth_m[min(int(y * height), height - 1), min(int(x * width), width - 1)])
    return 0 < surface_m < depth_m - _BEHIND_M


def _enlarged(frame: Frame) -> Frame:
    """Return the frame with at least `_COLUMNS` columns; depth stays as it is."""
    height, width = frame.image.shape[:2]
    if width >= _COLUMNS:
        return frame
    size = (_COLUMNS, round(height * _COLUMNS / width))
    return replace(
        frame,
        image=np.maximum(cv2.resize(frame.image, size, interpolation=cv2.INTER_CUBIC), 0),
        clipped=cv2.resize(frame.clipped.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool),
        guessed=None if frame.guessed is None else cv2.resize(frame.guessed, size, interpolation=cv2.INTER_LINEAR),
        intrinsics=frame.intrinsics.resized(*size),
    )


def _no_file(name: str) -> Any:
    raise ObjectError(f"{name}: the summary's spheres have no files")
