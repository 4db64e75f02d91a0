"""The network inside the package: metric depth from one picture and its lens (`roomlight_model` trains it).

Any picture is stretched to a square; the lens enters as the pixels' rays.
"""

from functools import cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float32

from roomlight.camera import Intrinsics
from roomlight.engine.networks.graph import Graph
from roomlight.engine.networks.graphs import SHIPPED, load_part
from roomlight.engine.networks.providers import Provider
from roomlight.monocular.estimate import DepthEstimate, DepthKind

DEPTH_SIDE: Final = 224
"""Side of the network's square input."""
DEPTH_CHANNELS: Final = 5
_LOG_RIGHT: Final = float(np.log(1.25))
_LOG_RANGE: Final = (-3.0, 4.0)
"""Of log depth: 5 cm to 55 m."""


class DepthNetworkModel:
    """The network, loaded once and shared; a call uses buffers of its own."""

    name = "network"
    kind: DepthKind = "metric"

    def __init__(self, graph: Graph) -> None:
        """Take the loaded graph."""
        self._graph = graph
        self.digest = graph.digest

    def estimate(self, picture: Float32[np.ndarray, "h w 3"], intrinsics: Intrinsics) -> DepthEstimate:
        """Estimate metric depth at half the square's resolution."""
        square = cv2.resize(picture, (DEPTH_SIDE, DEPTH_SIDE), interpolation=cv2.INTER_AREA)
        planes = np.concatenate([np.moveaxis(square, -1, 0), ray_planes(intrinsics)])[None]
        outputs = self._graph.new_outputs()
        self._graph.bind({"planes": np.ascontiguousarray(planes, np.float32)}, outputs).run()
        log_depth, log_scale = outputs["log_depth"][0]
        inverse = np.exp(-np.clip(log_depth, *_LOG_RANGE))
        # the error's distribution is Laplace's, of the scale that the network states
        confidence = 1 - np.exp(-_LOG_RIGHT * np.exp(-log_scale))
        return DepthEstimate(inverse.astype(np.float32), confidence.astype(np.float32), "metric")


@cache
def shipped_depth(provider: Provider = "auto", folder: Path = SHIPPED / "depth") -> DepthNetworkModel:
    """Load the network inside the package, once.

    Raises:
        ModelError: The weights are missing or damaged.
    """
    return DepthNetworkModel(load_part(folder, "depth", provider=provider))


def ray_planes(intrinsics: Intrinsics) -> Float32[np.ndarray, "2 side side"]:
    """Return x / z and y / z (y down) of the rays of the square's pixels."""
    middle = (np.arange(DEPTH_SIDE) + 0.5) / DEPTH_SIDE
    columns = (middle * intrinsics.width - intrinsics.cx) / intrinsics.fx
    rows = (middle * intrinsics.height - intrinsics.cy) / intrinsics.fy
    return np.stack(np.meshgrid(columns, rows)).astype(np.float32)
