"""Completion of a probe's panorama by a network: the light of directions that no frame has shown.

The classical model fills them from their surroundings. The network sees that fill with all that was observed, and
predicts how much brighter or darker the unobserved light is: E[log(1 + L)] - log(1 + fill), per channel. It sees the
panorama that the frames of the stream make together, never its own results, so that nothing that it inferred can grow
by being looked at.

Cost for a panorama of 120 rows: 8.6 ms of processor time on one thread, 3.5 times the stage `volume` of the same run
(2.5 ms; least of 30 calls), for each probe and frame. It is part of the stage `blend` of `FrameReport.stage_ms`.
"""

from functools import cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32

from roomlight.engine.classical_backend import ClassicalBackend, Observed
from roomlight.engine.networks.graphs import SHIPPED, Graph, load_part
from roomlight.engine.networks.providers import Provider
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.surface.mesh import PartialPanorama

HEIGHT: Final = 60
"""Rows of the network's panoramas."""
PANELS: Final = 9
"""Input: observed radiance (3), share observed, share of it clipped, distance in metres, the classical fill (3)."""
FARTHEST_M: Final = 50.0
BRIGHTEST: Final = 60_000.0
"""Limits of the input: distance, and radiance in units of white."""


class CompletionModel:
    """The network, loaded once and shared by all sessions; a call uses buffers of its own."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.digest = graph.digest

    def complete(
        self, panels: Float32[np.ndarray, "9 ph pw"], fill: Float[np.ndarray, "h w 3"], known: Float[np.ndarray, "h w"]
    ) -> Float32[np.ndarray, "h w 3"]:
        """Return `fill` with the predicted change where `known` (the share observed) leaves room."""
        outputs = self._graph.new_outputs()
        self._graph.bind({"panels": panels[None]}, outputs).run()
        return changed_light(fill, outputs["change"][0], 1 - known)


@cache
def shipped_completion(provider: Provider = "auto", folder: Path = SHIPPED / "completion") -> CompletionModel:
    """Load the network inside the package, once.

    Raises:
        ModelError: the weights are missing or damaged.
    """
    return CompletionModel(load_part(folder, "completion", provider=provider))


def changed_light(
    light: Float[np.ndarray, "h w 3"], change: Float32[np.ndarray, "3 ph pw"], share: Float[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w 3"]:
    """Return light whose log(1 + L) has changed by a network's output, by as much of it as `share` says.

    Where the share is 0 the light keeps its bits.
    """
    fine = _resize(np.ascontiguousarray(np.moveaxis(change, 0, -1)), light.shape[0], cv2.INTER_LINEAR)
    log = np.log1p(np.maximum(light, 0)) + fine * share[..., None]
    return np.where(share[..., None] > 0, np.expm1(np.clip(log, 0, np.float32(np.log1p(BRIGHTEST)))), light)


def panel(plane: Float[np.ndarray, "h w *c"]) -> Float32[np.ndarray, "ph pw *c"]:
    """Reduce a plane of a panorama to the networks' size."""
    return _resize(np.asarray(plane, np.float32), HEIGHT)


def completion_panels(
    *,
    detail: Float[np.ndarray, "h w 3"],
    known: Float[np.ndarray, "h w"],
    clipped: Float[np.ndarray, "h w"],
    depth_m: Float[np.ndarray, "h w"],
    fill: Float[np.ndarray, "h w 3"],
) -> Float32[np.ndarray, "9 ph pw"]:
    """Compute the network's input: means over its pixels, those of observed values weighted by the share observed."""
    share = panel(known)

    def mean(plane: Float[np.ndarray, "h w *c"]) -> Float32[np.ndarray, "ph pw *c"]:
        weighted = known.reshape(known.shape + (1,) * (plane.ndim - 2)) * plane
        return panel(weighted) / np.maximum(share, 1e-3).reshape(share.shape + (1,) * (plane.ndim - 2))

    panels = np.empty((PANELS, HEIGHT, 2 * HEIGHT), np.float32)
    panels[0:3] = np.moveaxis(mean(np.minimum(detail, BRIGHTEST)), -1, 0)
    panels[3], panels[4] = share, mean(clipped)
    panels[5] = mean(np.minimum(depth_m, FARTHEST_M))
    panels[6:9] = np.moveaxis(panel(np.minimum(fill, BRIGHTEST)), -1, 0)
    return panels


class CompletionBackend(ClassicalBackend):
    """The classical model with learned completion of what no frame has shown."""

    name = "completion"

    def __init__(self, model: CompletionModel) -> None:
        super().__init__()
        self._model = model
        self.digest = model.digest

    def completed(
        self, observed: Observed, state: PanoramaState, partial: PartialPanorama
    ) -> Float[np.ndarray, "h w 3"]:
        """Return the classical fill, changed by the network where nothing was observed."""
        fresh = partial.mask & state.is_closer(partial.depth_m)
        # as in training: the panorama that the frames make, with the fill only where they show nothing
        known = observed.known[..., None]
        panels = completion_panels(
            detail=observed.detail,
            known=observed.known,
            clipped=state.clipped if partial.clipped is None else np.where(fresh, partial.clipped, state.clipped),
            depth_m=np.where(fresh, partial.depth_m, state.depth_m),
            fill=known * observed.detail + (1 - known) * observed.fill,
        )
        return self._model.complete(panels, observed.fill, observed.known)


def _resize(
    image: Float[np.ndarray, "h w *c"], height: int, interpolation: int | None = None
) -> Float32[np.ndarray, "{height} 2*{height} *c"]:
    if image.shape[0] == height:
        return np.asarray(image, np.float32)
    smaller = image.shape[0] > height
    chosen = interpolation if interpolation is not None else cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return cv2.resize(np.asarray(image, np.float32), (2 * height, height), interpolation=chosen)
