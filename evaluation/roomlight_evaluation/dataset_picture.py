"""The picture of an evaluation on a dataset: input, truth, each method's panorama, its mirror and glossy spheres."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import UInt8

from roomlight.drawing import Canvas
from roomlight.images import write_png
from roomlight.spheres import SphereRenderer
from roomlight_evaluation.dataset_eval import Shown

_TILE: Final = 240
_BALL: Final = 104
_MARGIN: Final = 20
_GAP: Final = 8
_LABEL: Final = 18


def compose_picture(shown: Sequence[Shown]) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit sRGB: a row a sequence, a column for the frame, the truth and each method; ValueError for none."""
    if not shown:
        raise ValueError("there is nothing to draw")
    columns = list(shown[0].panoramas)
    row_height = _TILE // 2 + _GAP + _BALL + 2 * _GAP
    width = 2 * _MARGIN + (len(columns) + 1) * (_TILE + _GAP) - _GAP
    canvas = Canvas(width, 2 * _MARGIN + _LABEL + len(shown) * (row_height + _LABEL) - 2 * _GAP)
    lefts = [_MARGIN + k * (_TILE + _GAP) for k in range(len(columns) + 1)]
    for left, label in zip(lefts, ["input", *columns], strict=True):
        canvas.text((left, _MARGIN), label, width=_TILE)
    for k, one in enumerate(shown):
        top = _MARGIN + _LABEL + k * (row_height + _LABEL)
        canvas.text((_MARGIN, top), f"{one.name}, {one.room_type.replace('_', ' ')}", width=_TILE)
        top += _LABEL
        canvas.picture((_MARGIN, top), one.image, size=(_TILE, round(_TILE * one.image.shape[0] / one.image.shape[1])))
        spheres = SphereRenderer(one.view, size=_BALL)
        inset = (_TILE // 2 - _BALL) // 2
        for left, column in zip(lefts[1:], columns, strict=True):
            panorama = one.panoramas[column]
            canvas.picture((left, top), panorama, size=(_TILE, _TILE // 2))
            row = top + _TILE // 2 + _GAP
            canvas.sphere((left + inset, row), panorama, spheres, "mirror")
            canvas.sphere((left + _TILE // 2 + inset, row), panorama, spheres, "glossy")
    return canvas.image


def write_picture(path: Path, shown: Sequence[Shown]) -> None:
    """`compose_picture` into a PNG, whole or not at all; OutputError if it cannot be written."""
    write_png(path, compose_picture(shown))
