"""The contact sheet of a replay: frames over time, and below them the light at each probe at the same times.

Below each panorama are a mirror sphere and a glossy sphere. They are seen from the same direction at all times, so that
changes in them are changes of the light. Tone mapping is that of `roomlight.drawing`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.drawing import HEADING, LABEL_ROWS, Canvas
from roomlight.images import write_png
from roomlight.spheres import SphereRenderer
from roomlight_cli.probe_notes import percent

COLUMNS: Final = 6
"""Times shown: enough to see a room filling up, few enough to see details of each panorama."""

_MARGIN: Final = 24
_GAP: Final = 10
_TILE: Final = 240
_SPHERE: Final = 114
_HEADING_SIZE: Final = 20
_HEADING_ROWS: Final = 36
_PROBE_SIZE: Final = 16
_PROBE_ROWS: Final = 26
_PROBE_GAP: Final = 22
_INSET: Final = (_TILE // 2 - _SPHERE) // 2


@dataclass(frozen=True)
class SheetColumn:
    """One time of the sheet.

    Attributes:
        label: The column's title, above the frame; above the panoramas where there is no frame.
        frame: The camera's picture, linear RGB; None for a column without one, such as the ground truth.
        panoramas: A panorama for each probe; None for a probe without one at this time.
        coverage: The share of the sphere seen at each probe, 0 to 1; empty if it is not to be shown.
    """

    label: str
    frame: Float[np.ndarray, "h w 3"] | None
    panoramas: tuple[Float[np.ndarray, "..."] | None, ...]
    coverage: tuple[float, ...] = ()


def sheet_times(frames: int, columns: int = COLUMNS) -> list[int]:
    """Return the numbers (from 0) of the frames to show: evenly spread, with the first and the last."""
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
    """Return the sheet as 8-bit sRGB: a column per time, a group of rows per probe.

    Args:
        columns: The times, from the left.
        probes: Labels of the probes.
        views: World directions along which each probe's spheres are seen (`spheres.view_toward`).
        heading: The sheet's title.
        exposure_ev: Exposure in stops.

    Raises:
        ValueError: There is no column, or the numbers of probes, panoramas and views differ.
    """
    if not columns:
        raise ValueError("a contact sheet needs at least one column")
    for column in columns:
        if len(column.panoramas) != len(probes):
            raise ValueError(f"column {column.label!r} has {len(column.panoramas)} panoramas, not {len(probes)}")
    if len(views) != len(probes):
        raise ValueError(f"{len(probes)} probes need as many views, not {len(views)}")
    frame_rows = _frame_rows(columns)
    probe_rows = _PROBE_GAP + _PROBE_ROWS + LABEL_ROWS + _TILE // 2 + _GAP + LABEL_ROWS + _SPHERE
    top = _MARGIN + (_HEADING_ROWS if heading else 0)
    width = 2 * _MARGIN + len(columns) * _TILE + (len(columns) - 1) * _GAP
    height = top + LABEL_ROWS + frame_rows + len(probes) * probe_rows + _MARGIN
    canvas = Canvas(width, height, exposure_ev=exposure_ev)
    canvas.text((_MARGIN, _MARGIN - 4), heading, size=_HEADING_SIZE, grey=HEADING, width=width - 2 * _MARGIN)
    lefts = [_MARGIN + number * (_TILE + _GAP) for number in range(len(columns))]
    for left, column in zip(lefts, columns, strict=True):
        if column.frame is not None:
            canvas.text((left, top), column.label, width=_TILE)
            size = (_TILE, round(_TILE * column.frame.shape[0] / column.frame.shape[1]))
            canvas.picture((left, top + LABEL_ROWS), column.frame, size=size)
    top += LABEL_ROWS + frame_rows
    for number, (label, view) in enumerate(zip(probes, views, strict=True)):
        top += _PROBE_GAP
        canvas.text((_MARGIN, top), label, size=_PROBE_SIZE, grey=HEADING, width=width - 2 * _MARGIN)
        top += _PROBE_ROWS
        # a renderer's tables take 40 MB: one at a time, however many probes there are
        _draw_probe(canvas, top, columns, lefts, number, SphereRenderer(view, size=_SPHERE))
        top += probe_rows - _PROBE_GAP - _PROBE_ROWS
    return canvas.image


def _draw_probe(
    canvas: Canvas,
    top: int,
    columns: Sequence[SheetColumn],
    lefts: Sequence[int],
    number: int,
    spheres: SphereRenderer,
) -> None:
    """Draw one probe's coverage, panoramas and spheres; the first column names the spheres."""
    panorama_top = top + LABEL_ROWS
    name_top = panorama_top + _TILE // 2 + _GAP
    sphere_top = name_top + LABEL_ROWS
    for side, material in enumerate(("mirror", "glossy")):
        canvas.text((lefts[0] + side * _TILE // 2 + _INSET, name_top), f"{material} sphere", width=_SPHERE)
    for left, column in zip(lefts, columns, strict=True):
        panorama = column.panoramas[number]
        if panorama is None:
            continue
        canvas.text((left, top), _panorama_label(column, number), width=_TILE)
        canvas.picture((left, panorama_top), panorama, size=(_TILE, _TILE // 2))
        canvas.sphere((left + _INSET, sphere_top), panorama, spheres, "mirror")
        canvas.sphere((left + _TILE // 2 + _INSET, sphere_top), panorama, spheres, "glossy")


def write_contact_sheet(
    path: Path,
    columns: Sequence[SheetColumn],
    *,
    probes: Sequence[str],
    views: Sequence[tuple[float, float, float]],
    heading: str = "",
    exposure_ev: float = 0.0,
) -> None:
    """Write `compose_sheet`'s picture as a PNG, atomically. Raises OutputError if it cannot be written."""
    write_png(path, compose_sheet(columns, probes, views=views, heading=heading, exposure_ev=exposure_ev))


def _panorama_label(column: SheetColumn, number: int) -> str:
    """Return the text above a panorama: the coverage, or the title of a column that has no frame for it."""
    if column.frame is None:
        return column.label
    return f"coverage {percent(column.coverage[number])}" if column.coverage else ""


def _frame_rows(columns: Sequence[SheetColumn]) -> int:
    frames = [column.frame for column in columns if column.frame is not None]
    return max((round(_TILE * frame.shape[0] / frame.shape[1]) for frame in frames), default=0)
