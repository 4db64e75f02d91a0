"""The light of virtual objects: a session's light, changed by a network to what objects and their shadows need.

A session's panorama is the best estimate of each direction, and has too little light in all: lamps are clipped or never
seen, and the mean of a logarithm lies below the mean. Objects are lit by sums over many directions. The network sees
what the frames have shown of a place together, and changes the light of directions that no frame has shown, and of
clipped pixels, so that pictures of objects come out as near to those under the true light as it can: it is trained on
matte, glossy and mirror spheres and on a sphere's shadow (`roomlight_model.training.objects`).

Its two panoramas differ where a direction is uncertain. Matte and glossy objects need the mean of what may be there.
Mirrors show single directions, and light from nowhere in particular would make shadows fainter.

Directions that were measured keep their bits. Cost: one run of the network for each probe and update, see
`roomlight.engine.panorama.panels`.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from roomlight.conventions import LUMINANCE
from roomlight.engine.networks.graphs import SHIPPED, Graph, load_part
from roomlight.engine.networks.providers import Provider
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.panorama.panels import BRIGHTEST, PANELS, changed_light, panel, panorama_panels
from roomlight.engine.session import Session

OBJECT_PANELS: Final = PANELS + 1
"""Input: the panorama's panels, and the luminance that was estimated for clipped pixels."""

Panorama = Float32[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False)
class ObjectLight:
    """The light of virtual objects at a tracked position: panoramas, radiance in units of white.

    Attributes:
        shown: lights matte and glossy surfaces.
        casting: casts their shadows, and is what mirrors and glass show.
    """

    shown: Panorama
    casting: Panorama


class ObjectLightModel:
    """The network, loaded once and shared by all sessions; a call uses buffers of its own."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph

    def light(self, state: PanoramaState) -> ObjectLight:
        """Return the light of objects at the place of a panorama."""
        outputs = self._graph.new_outputs()
        self._graph.bind({"panels": object_panels(state)[None]}, outputs).run()
        free = free_share(state)
        shown, casting = (changed_light(state.radiance, change, free) for change in np.split(outputs["changes"][0], 2))
        return ObjectLight(shown, casting)


def object_light(session: Session, handle: int) -> ObjectLight:
    """Return the light of objects at a tracked position of a session.

    Raises:
        ProbeError: no tracked probe has this handle, or no frame was pushed yet.
        ModelError: the network's weights are missing or damaged.
    """
    options = session.options
    model = shipped_object_light(options.provider, (options.parts or SHIPPED) / "objects")
    return model.light(session.panorama_state(handle))


@cache
def shipped_object_light(provider: Provider = "auto", folder: Path = SHIPPED / "objects") -> ObjectLightModel:
    """Load the network inside the package, once.

    Raises:
        ModelError: the weights are missing or damaged.
    """
    return ObjectLightModel(load_part(folder, "objects", provider=provider))


def object_panels(state: PanoramaState) -> Float32[np.ndarray, "10 ph pw"]:
    """Compute the network's input from what the frames have shown of a place."""
    panels = panorama_panels(
        detail=state.radiance, known=state.seen, clipped=state.clipped, depth_m=state.depth_m, fill=state.radiance
    )
    return np.concatenate([panels, panel(np.minimum(state.guessed, BRIGHTEST))[None]])


def free_share(state: PanoramaState) -> Float32[np.ndarray, "h w"]:
    """Return the share of each direction's light that was not measured: not seen, or an estimate for clipped pixels."""
    luminance = np.maximum(state.radiance @ LUMINANCE, np.float32(1e-6))
    return np.maximum(1 - state.seen, np.clip(state.guessed / luminance, 0, 1)).astype(np.float32)
