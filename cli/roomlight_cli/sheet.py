"""The contact sheet of a replay: frames over time, and below them the light at each probe at the same times.

Panoramas come with a mirror and a glossy sphere, seen from the same direction all along, so that what changes
in them is the light. Tone mapping is `canvas`'s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.drawing import HEADING, Canvas
from roomlight.images import write_png
from roomlight.spheres import SphereRenderer

COLUMNS: Final = 6
"""Times shown: enough to see a room filling up, few enough to see what is in each panorama."""

_MARGIN: Final = 24
_GAP: Final = 10
_TILE: Final = 240
_BALL: Final = 114
_LABEL_ROWS: Final = 20


@dataclass(frozen=True)
class SheetColumn:
    """One moment: its label, the frame (linear; None for a column without, such as the truth), a panorama a
    probe.

    A probe without a panorama at this moment has None.
    """

    label: str
    frame: Float[np.ndarray, "h w 3"] | None
    panoramas: tuple[Float[np.ndarray, "..."] | None, ...]


def sheet_times(frames: int, columns: int = COLUMNS) -> list[int]:
    """Positions (from 0) of the frames to show: evenly spread, with the first and the last."""
    if frames <= 0:
        return []
    return sorted({round(position) for position in np.linspace(0, frames - 1, min(columns, frames)).tolist()})


def compose_sheet(
    columns: Sequence[SheetColumn],
    probes: Sequence[str],
    *,
    views: Sequence[tuple[float, float, float]],
    heading: str = "",
    exposure_ev: float = 0.0,
) -> UInt8[np.ndarray, "h w 3"]:
    """The sheet as 8-bit sRGB: a column a moment, a row a probe.

    `probes` are the rows' labels and `views` the directions their spheres are seen along (`spheres.view_toward`).
    """
    if not columns:
        raise ValueError("a contact sheet needs at least one column")
    for column in columns:
        if len(column.panoramas) != len(probes):
            raise ValueError(f"column {column.label!r} has {len(column.panoramas)} panoramas, not {len(probes)}")
    if len(views) != len(probes):
        raise ValueError(f"{len(probes)} probes need as many views, not {len(views)}")
    frame_rows = _frame_rows(columns)
    top = _MARGIN + (30 if heading else 0)
    probe_rows = _LABEL_ROWS + _TILE // 2 + _GAP + _BALL + 2 * _GAP
    width = 2 * _MARGIN + len(columns) * _TILE + (len(columns) - 1) * _GAP
    height = top + _LABEL_ROWS + frame_rows + 2 * _GAP + len(probes) * probe_rows - 2 * _GAP + _MARGIN
    canvas = Canvas(width, height, exposure_ev=exposure_ev)
    canvas.text((_MARGIN, _MARGIN - 4), heading, cap_height=13, grey=HEADING, width=width - 2 * _MARGIN)
    lefts = [_MARGIN + number * (_TILE + _GAP) for number in range(len(columns))]
    for left, column in zip(lefts, columns, strict=True):
        canvas.text((left, top), column.label, width=_TILE)
        if column.frame is not None:
            size = (_TILE, round(_TILE * column.frame.shape[0] / column.frame.shape[1]))
            canvas.picture((left, top + _LABEL_ROWS), column.frame, size=size)
    row = top + _LABEL_ROWS + frame_rows + 2 * _GAP
    inset = (_TILE // 2 - _BALL) // 2
    for number, (label, view) in enumerate(zip(probes, views, strict=True)):
        spheres = SphereRenderer(
            view, size=_BALL
        )  # its tables take 40 MB: one at a time, however many probes there are
        canvas.text((_MARGIN, row), label, width=width - 2 * _MARGIN)
        sphere_row = row + _LABEL_ROWS + _TILE // 2 + _GAP
        for left, column in zip(lefts, columns, strict=True):
            panorama = column.panoramas[number]
            if panorama is not None:
                canvas.picture((left, row + _LABEL_ROWS), panorama, size=(_TILE, _TILE // 2))
                canvas.sphere((left + inset, sphere_row), panorama, spheres, "mirror")
                canvas.sphere((left + _TILE // 2 + inset, sphere_row), panorama, spheres, "glossy")
        row += probe_rows
    return canvas.image


def write_contact_sheet(
    path: Path,
    columns: Sequence[SheetColumn],
    *,
    probes: Sequence[str],
    views: Sequence[tuple[float, float, float]],
    heading: str = "",
    exposure_ev: float = 0.0,
) -> None:
    """`compose_sheet` into a PNG, whole or not at all; OutputError if it cannot be written."""
    write_png(path, compose_sheet(columns, probes, views=views, heading=heading, exposure_ev=exposure_ev))


def _frame_rows(columns: Sequence[SheetColumn]) -> int:
    frames = [column.frame for column in columns if column.frame is not None]
    return max((round(_TILE * frame.shape[0] / frame.shape[1]) for frame in frames), default=0)
