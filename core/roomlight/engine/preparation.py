"""A frame as the session works on it: reduced, its depth completed, its clipped light restored."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.depth import UnknownDepth, complete_depth, without_unseen
from roomlight.engine.networks.clipping import ClippingModel, white_of
from roomlight.engine.surface.bracket import take_clipped_light
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.frame import Frame

WORKING_SIZE: Final = (320, 240)
"""Frames are reduced to this size (width, height; swapped for upright images), the paper's: eight pixels for one of a
panorama of 120 rows."""


def restored(
    measured: Frame,
    depth_m: Float[np.ndarray, "dh dw"],
    earlier: Iterable[FrameMesh] = (),
    *,
    clipping: ClippingModel,
) -> Frame:
    """Return a frame with its completed depth and its clipped light: of earlier frames that show it, or estimated.

    `measured` has the sensor's depth, `depth_m` is that depth completed; of two earlier meshes that know as much, the
    later one counts.
    """
    bracketed = take_clipped_light(measured, depth_m, earlier)
    own_white = white_of(measured) if measured.clipped.any() else None
    return replace(clipping.restore(bracketed, depth_m, own_white=own_white), depth_m=depth_m)


def at_working_size(frame: Frame, unknown_depth: UnknownDepth) -> tuple[Frame, Float[np.ndarray, "dh dw"]]:
    """Return the frame reduced to `WORKING_SIZE`, and its depth, completed if the rule for unknown depth says so.

    Of a black frame nothing was seen.
    """
    measured = frame.resized(*WORKING_SIZE)
    if measured.image is frame.image:  # the caller may write into its arrays again
        measured = replace(measured, image=frame.image.copy(), clipped=frame.clipped.copy())
    if measured.is_black:
        measured = replace(measured, seen=np.zeros(measured.clipped.shape, bool))
    depth_m = complete_depth(measured.depth_m) if unknown_depth == "rim" else measured.depth_m
    return measured, without_unseen(depth_m, measured.seen)
