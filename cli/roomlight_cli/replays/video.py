"""The pictures of a replay's video, one per frame.

Each shows the camera's frame and, for each probe, the panorama with a mirror sphere and a glossy sphere.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.imaging.drawing import LABEL_ROWS, Canvas
from roomlight.spheres import Material, SphereRenderer

MAX_PROBES: Final = 6
"""More rows would make a picture larger than screens; all probes are in the EXR files."""

_MATERIALS: Final[tuple[Material, Material]] = ("mirror", "glossy")
_MARGIN: Final = 16
_GAP: Final = 10
_FRAME_ROWS: Final = 384
_PANORAMA_ROWS: Final = (108, 240)  # least and most


class ReplayPicture:
    """Composes a video's pictures, all of one size, from frames and panoramas.

    Args:
        probes: Labels of the probes; the first `MAX_PROBES` are shown.
        views: World directions along which each probe's spheres are seen.
        frame_size: The frames' (columns, rows).

    Raises:
        ValueError: The numbers of probes and views differ.
    """

    def __init__(
        self,
        probes: Sequence[str],
        *,
        views: Sequence[tuple[float, float, float]],
        frame_size: tuple[int, int],
    ) -> None:
        if len(views) != len(probes):
            raise ValueError(f"{len(probes)} probes need as many views, not {len(views)}")
        self._probes = list(probes)[:MAX_PROBES]
        count = max(1, len(self._probes))
        least, most = _PANORAMA_ROWS
        self._rows = min(most, max(least, (_FRAME_ROWS + _GAP) // count - LABEL_ROWS - _GAP))
        self._rows -= self._rows % 2
        frame_columns, frame_rows = frame_size
        self._frame_size = (round(_FRAME_ROWS * frame_columns / frame_rows), _FRAME_ROWS)
        self._spheres = [SphereRenderer(view, size=self._rows) for view in list(views)[:MAX_PROBES]]

    def compose(
        self,
        frame: Float[np.ndarray, "h w 3"],
        panoramas: Sequence[Float[np.ndarray, "..."]],
        *,
        label: str = "",
    ) -> UInt8[np.ndarray, "ph pw 3"]:
        """Return one 8-bit sRGB picture: the linear frame on the left, a row per probe on the right."""
        rows, (frame_columns, frame_rows) = self._rows, self._frame_size
        left = 2 * _MARGIN + frame_columns
        width = left + 4 * rows + 2 * _GAP + _MARGIN
        probes_rows = len(self._probes) * (LABEL_ROWS + rows + _GAP) - _GAP
        height = 2 * _MARGIN + max(LABEL_ROWS + frame_rows, probes_rows)
        canvas = Canvas(width, height)
        canvas.text((_MARGIN, _MARGIN), label, width=frame_columns)
        canvas.picture((_MARGIN, _MARGIN + LABEL_ROWS), frame, size=self._frame_size)
        top = _MARGIN
        for title, spheres, panorama in zip(self._probes, self._spheres, panoramas, strict=False):
            canvas.text((left, top), title, width=2 * rows)
            canvas.picture((left, top + LABEL_ROWS), panorama, size=(2 * rows, rows))
            columns = (left + 2 * rows + _GAP, left + 3 * rows + 2 * _GAP)
            for column, material in zip(columns, _MATERIALS, strict=True):
                canvas.text((column, top), f"{material} sphere", width=rows)
                canvas.sphere((column, top + LABEL_ROWS), panorama, spheres, material)
            top += LABEL_ROWS + rows + _GAP
        return canvas.image
