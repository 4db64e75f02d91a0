"""The picture of an evaluation on a dataset: input, truth, each method's panorama, its mirror and glossy spheres."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.images import write_png
from roomlight.imaging.drawing import Canvas
from roomlight.spheres import SphereRenderer

_TILE: Final = 240
_SPHERE: Final = 104
_MARGIN: Final = 20
_GAP: Final = 8
_LABEL: Final = 18


@dataclass(frozen=True)
class PictureRow:
    """One sequence's first probe under every method.

    Attributes:
        name: The sequence's name.
        room_type: The room's type, e.g. `living_room`.
        image: The first frame, linear RGB.
        view: Direction from the camera to the probe, world axes; see `SphereRenderer`.
        panoramas: Linear HDR panoramas [h, 2h, 3] by column: truth first, then the methods.
    """

    name: str
    room_type: str
    image: Float[np.ndarray, "ih iw 3"]
    view: tuple[float, float, float]
    panoramas: Mapping[str, Float[np.ndarray, "h w 3"]]


def compose_picture(rows: Sequence[PictureRow]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw an 8-bit sRGB picture: a row per sequence, a column for the frame, the truth and each method.

    Raises:
        ValueError: There are no rows.
    """
    if not rows:
        raise ValueError("a picture needs at least one row")
    columns = list(rows[0].panoramas)
    row_height = _TILE // 2 + _GAP + _SPHERE + 2 * _GAP
    width = 2 * _MARGIN + (len(columns) + 1) * (_TILE + _GAP) - _GAP
    canvas = Canvas(width, 2 * _MARGIN + _LABEL + len(rows) * (row_height + _LABEL) - 2 * _GAP)
    lefts = [_MARGIN + k * (_TILE + _GAP) for k in range(len(columns) + 1)]
    for left, label in zip(lefts, ["input", *columns], strict=True):
        canvas.text((left, _MARGIN), label, width=_TILE)
    for k, row in enumerate(rows):
        top = _MARGIN + _LABEL + k * (row_height + _LABEL)
        canvas.text((_MARGIN, top), f"{row.name}, {row.room_type.replace('_', ' ')}", width=_TILE)
        top += _LABEL
        canvas.picture((_MARGIN, top), row.image, size=(_TILE, round(_TILE * row.image.shape[0] / row.image.shape[1])))
        spheres = SphereRenderer(row.view, size=_SPHERE)
        inset = (_TILE // 2 - _SPHERE) // 2
        for left, column in zip(lefts[1:], columns, strict=True):
            panorama = row.panoramas[column]
            canvas.picture((left, top), panorama, size=(_TILE, _TILE // 2))
            sphere_top = top + _TILE // 2 + _GAP
            canvas.sphere((left + inset, sphere_top), panorama, spheres, "mirror")
            canvas.sphere((left + _TILE // 2 + inset, sphere_top), panorama, spheres, "glossy")
    return canvas.image


def write_picture(path: Path, rows: Sequence[PictureRow]) -> None:
    """Write `compose_picture` as a PNG, atomically.

    Raises:
        OutputError: The file cannot be written.
        ValueError: There are no rows.
    """
    write_png(path, compose_picture(rows))
