"""The light that lights things at a probe, by a network.

A session's panorama is the best estimate of each direction: what mirrors show, and where shadows have their lamps. It
has too little light in all: lamps are clipped or never seen, and the mean of a logarithm lies below the mean. Matte and
glossy things are lit by sums over many directions, and need the mean of what may be there. The network sees what the
frames have shown of a place together, and changes the light of directions that no frame has shown, and of clipped
pixels, so that pictures of objects come out as near to those under the true light as it can: it is trained on matte,
glossy and metal spheres (`roomlight train objects`).

Directions that were measured keep their bits. Cost: the network runs three times when somebody asks for light, which
takes a third of the time of the SGLV's networks.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from roomlight.conventions import LUMINANCE
from roomlight.engine.networks.graph import Graph
from roomlight.engine.networks.graphs import SHIPPED, PartFiles, load_part
from roomlight.engine.networks.providers import Provider
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.panorama.likely_light import likely_lights
from roomlight.engine.panorama.panels import BRIGHTEST, HEIGHT, PANELS, changed_light, panorama_panels, resized
from roomlight.light.main_light import TrackedLights, relit
from roomlight.light.sources import LightPanorama, LightUse

LIGHTING_PANELS: Final = PANELS + 1
"""Input: the panorama's panels, and the luminance that was estimated for clipped pixels."""


class LightingModel:
    """The network, loaded once and shared by all sessions; a call uses buffers of its own."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.digest = graph.digest

    def panorama(self, state: PanoramaState) -> Float32[np.ndarray, "h w 3"]:
        """Compute the light, linear RGB, that lights things at the place of a panorama.

        The change is the mean of three runs, between which the colour channels take turns: no channel is special in
        a room's light, and the mean errs less than one run.
        """
        panels, outputs = lighting_panels(state), self._graph.new_outputs()
        graph = self._graph.bind({"panels": panels[None]}, outputs)
        change = np.zeros_like(outputs["change"][0])
        for _ in range(3):  # after which each channel is in its place again
            graph.run()
            change = np.roll(change + outputs["change"][0] / 3, 1, axis=0)
            for colours in (panels[0:3], panels[6:PANELS]):
                colours[:] = np.roll(colours, 1, axis=0)
        return changed_light(state.radiance, change, unmeasured_share(state))


@cache
def shipped_lighting(
    provider: Provider = "auto",
    folder: Path = SHIPPED / "objects",
    files: PartFiles = (),  # noqa: ARG001 - of the cache's key
) -> LightingModel:
    """Load the network inside the package, or of another folder, once as long as its `files` are these.

    Raises:
        ModelError: the weights are missing or damaged.
    """
    return LightingModel(load_part(folder, "objects", provider=provider))


def lighting_panels(state: PanoramaState) -> Float32[np.ndarray, "10 ph pw"]:
    """Compute the network's input from what the frames have shown of a place."""
    panels = panorama_panels(
        detail=state.radiance, known=state.observed, clipped=state.clipped, depth_m=state.depth_m, fill=state.radiance
    )
    return np.concatenate([panels, resized(np.minimum(state.guessed, BRIGHTEST), HEIGHT)[None]])


def unmeasured_share(state: PanoramaState) -> Float32[np.ndarray, "h w"]:
    """Return the share of each direction's light that was not measured: not seen, or an estimate for clipped pixels."""
    luminance = np.maximum(state.radiance @ LUMINANCE, np.float32(1e-6))
    return np.maximum(1 - state.observed, np.clip(state.guessed / luminance, 0, 1)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ProbeLightSource:
    """What a probe has accumulated up to a frame, from which its light is computed when somebody asks.

    Attributes:
        state: a copy that later frames do not change (`PanoramaState.for_lighting`).
        tracked: the main lights in `state`; None at a point that is not tracked: they are looked for in it.
        load: returns the network.
    """

    state: PanoramaState
    tracked: TrackedLights | None
    load: Callable[[], LightingModel]

    def panorama(self, use: LightUse) -> LightPanorama:
        """Return the estimate as what is seen, or run the network for what lights things."""
        estimate = self.state.radiance
        lights = self.tracked or likely_lights(estimate, self.state.observed)
        if use == "reflection":
            return LightPanorama(estimate, lights)
        lighting = self.load().panorama(self.state)
        return LightPanorama(lighting, relit(lights, before=estimate, after=lighting))

    def digest(self) -> str:
        """Hash the network and its input."""
        state = self.state
        sha = hashlib.sha256(self.load().digest.encode())
        for plane in (state.radiance, state.observed, state.clipped, state.guessed, state.depth_m):
            sha.update(np.ascontiguousarray(plane).data)
        lights = () if self.tracked is None else (self.tracked.main, *self.tracked.sources)
        sha.update(json.dumps([light.to_json() for light in lights]).encode())
        return sha.hexdigest()
