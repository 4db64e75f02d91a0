"""The network inside the package: metric depth from one picture and its camera (`roomlight_model` trains it).

Any picture is stretched to a square. The lens enters as the pixels' rays, the camera's tilt as the rays' rise: how
high people hold a phone is much the same, so that the rise gives the depth of the floor.
"""

from functools import cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32

from roomlight.camera import Intrinsics
from roomlight.engine.networks.graph import Graph
from roomlight.engine.networks.graphs import SHIPPED, load_part
from roomlight.monocular.estimate import DepthEstimate, DepthKind

DEPTH_SIDE: Final = 224
"""Side of the network's square input."""
DEPTH_CHANNELS: Final = 7
"""sRGB (3), rays (2), their rise (2)."""
LEAST_RISE: Final = 0.1
"""Rays within 6 degrees of the horizon meet no floor of a room."""
MOST_RISE: Final = 2.0
"""Steeper rays are as this one."""
_LOG_RIGHT: Final = float(np.log(1.25))
_LOG_RANGE: Final = (-3.0, 4.0)
"""Of log depth: 5 cm to 55 m."""


class DepthNetworkModel:
    """The network, loaded once and shared; a call uses buffers of its own."""

    name = "network"
    kind: DepthKind = "metric"

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.digest = graph.digest

    def estimate(
        self, picture: Float32[np.ndarray, "h w 3"], intrinsics: Intrinsics, up: Float[np.ndarray, "3"] | None = None
    ) -> DepthEstimate:
        """Estimate metric depth at half the square's resolution."""
        square = cv2.resize(picture, (DEPTH_SIDE, DEPTH_SIDE), interpolation=cv2.INTER_AREA)
        planes = np.concatenate([np.moveaxis(square, -1, 0), ray_planes(intrinsics, up)])[None]
        outputs = self._graph.new_outputs()
        self._graph.bind({"planes": np.ascontiguousarray(planes, np.float32)}, outputs).run()
        log_depth, log_scale = outputs["log_depth"][0]
        inverse = np.exp(-np.clip(log_depth, *_LOG_RANGE))
        # the error's distribution is Laplace's, of the scale that the network states
        confidence = 1 - np.exp(-_LOG_RIGHT * np.exp(-log_scale))
        return DepthEstimate(inverse.astype(np.float32), confidence.astype(np.float32), "metric")


@cache
def shipped_depth() -> DepthNetworkModel:
    """Load the network inside the package, once.

    Raises:
        ModelError: The weights are missing or damaged.
    """
    return DepthNetworkModel(load_part(SHIPPED / "depth", "depth", provider="auto"))


def ray_planes(intrinsics: Intrinsics, up: Float[np.ndarray, "3"] | None = None) -> Float32[np.ndarray, "4 side side"]:
    """Return what the network knows of the camera, for the square's pixels.

    Args:
        up: The world's up in the camera's axes (OpenGL), a unit vector; None if it is not known.

    Returns:
        x / z and y / z (y down) of the rays; how far a ray rises in z = 1; and -log |rise|, which is the log of the
        depth of a floor a metre below, less the log of the focal length. The last two are 0 where up is not known.
    """
    middle = (np.arange(DEPTH_SIDE) + 0.5) / DEPTH_SIDE
    columns = (middle * intrinsics.width - intrinsics.cx) / intrinsics.fx
    rows = (middle * intrinsics.height - intrinsics.cy) / intrinsics.fy
    across, down = np.meshgrid(columns, rows)
    if up is None:
        return np.stack([across, down, np.zeros_like(down), np.zeros_like(down)]).astype(np.float32)
    rise = np.clip(up[0] * across - up[1] * down - up[2], -MOST_RISE, MOST_RISE)
    focal = np.sqrt(intrinsics.fx * intrinsics.fy / (intrinsics.width * intrinsics.height))
    return np.stack([across, down, rise, -np.log(np.maximum(np.abs(rise), LEAST_RISE) * focal)]).astype(np.float32)
