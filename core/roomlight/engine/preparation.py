"""A frame as the session works on it: reduced, its depth completed, its clipped light restored."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from roomlight.depth import UnknownDepth, complete_depth, without_unseen
from roomlight.engine.networks.clipping import ClippingModel, white_of
from roomlight.engine.surface.bracket import take_clipped_light
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.frame import Frame

WORKING_SIZE: Final = (320, 240)
"""Frames are reduced to this size (width, height; swapped for upright images), the paper's: eight pixels for one of a
panorama of 120 rows."""


@dataclass(frozen=True)
class PreparedFrame:
    """A frame that is ready for volume and mesh.

    Attributes:
        frame: With completed depth and restored clipped light.
        sensor_depth_m: Depth before it was completed.
        sensor_clipped: Clipped pixels before any was taken from earlier frames.
    """

    frame: Frame
    sensor_depth_m: Float[np.ndarray, "dh dw"]
    sensor_clipped: Bool[np.ndarray, "h w"]

    @classmethod
    def of(
        cls,
        measured: Frame,
        depth_m: Float[np.ndarray, "dh dw"],
        earlier: Iterable[FrameMesh] = (),
        *,
        clipping: ClippingModel,
    ) -> "PreparedFrame":
        """Restore the clipped light of a frame: from earlier frames that show it, and else by the network.

        Args:
            measured: The frame with the sensor's depth.
            depth_m: Its completed depth.
            earlier: Meshes of earlier frames; of two that know as much, the later one counts.
            clipping: Estimates what no frame shows.
        """
        bracketed = take_clipped_light(measured, depth_m, earlier)
        own_white = white_of(measured) if measured.clipped.any() else None
        restored = clipping.restore(bracketed, depth_m, own_white=own_white)
        return cls(replace(restored, depth_m=depth_m), measured.depth_m, measured.clipped)

    def mesh(self) -> FrameMesh:
        """Make the frame's mesh."""
        return FrameMesh(self.frame, sensor_depth_m=self.sensor_depth_m, sensor_clipped=self.sensor_clipped)


def at_working_size(frame: Frame, unknown_depth: UnknownDepth) -> tuple[Frame, Float[np.ndarray, "dh dw"]]:
    """Return the frame reduced to `WORKING_SIZE`, and its depth, completed if the rule for unknown depth says so."""
    measured = frame.resized(*WORKING_SIZE)
    if measured.image is frame.image:  # the caller may write into its arrays again
        measured = replace(measured, image=frame.image.copy(), clipped=frame.clipped.copy())
    depth_m = complete_depth(measured.depth_m) if unknown_depth == "rim" else measured.depth_m
    return measured, without_unseen(depth_m, measured.seen)
