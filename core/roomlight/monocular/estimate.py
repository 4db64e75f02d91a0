"""What a model of monocular depth takes and returns."""

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, Float32

from roomlight.camera import Intrinsics
from roomlight.conventions import linear_to_srgb
from roomlight.frame import Frame

DepthKind = Literal["metric", "scale", "inverse"]
"""metric: metres. scale: depth up to a factor. inverse: 1 / depth up to a factor and a shift."""


@dataclass(frozen=True, eq=False)
class DepthEstimate:
    """Estimated depth of a picture.

    Attributes:
        inverse: 1 / z-depth; per metre if the kind is metric. At most 0: infinitely far.
        confidence: 0 to 1; the network's is the probability that depth is right within a factor of 1.25.
        kind: What is unknown of `inverse`.
    """

    inverse: Float32[np.ndarray, "h w"]
    confidence: Float32[np.ndarray, "h w"]
    kind: DepthKind

    def resized(self, width: int, height: int) -> "DepthEstimate":
        """Return the estimate at another size, interpolated."""
        inverse, confidence = (
            cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR)
            for plane in (self.inverse, self.confidence)
        )
        return DepthEstimate(inverse, confidence, self.kind)


@runtime_checkable
class DepthModel(Protocol):
    """A model of monocular depth, loaded once; threads may share it."""

    name: str
    kind: DepthKind

    def estimate(
        self, picture: Float32[np.ndarray, "h w 3"], intrinsics: Intrinsics, up: Float[np.ndarray, "3"] | None = None
    ) -> DepthEstimate:
        """Estimate the depth of an sRGB picture in [0, 1]; the answer may have another size of the same view.

        Args:
            up: The world's up in the camera's axes (OpenGL), a unit vector; None if it is not known.

        Raises:
            ModelError: The model's answer is no depth.
        """
        ...


def srgb_picture(frame: Frame) -> Float32[np.ndarray, "h w 3"]:
    """Return a frame's picture as its camera showed it: sRGB in [0, 1], white where it clipped."""
    white = 1.0
    if frame.clipped.any():
        white = max(float(np.median(frame.image[frame.clipped].max(axis=1))), 1e-6)
    return linear_to_srgb(np.minimum(frame.image / np.float32(white), 1)).astype(np.float32)
