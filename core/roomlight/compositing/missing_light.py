"""The light of virtual objects: a session's light, completed to what the room's surfaces need.

A session's panorama is the best estimate of each direction, and has too little light in all: lamps are clipped or never
seen, and the mean of a logarithm lies below the mean. In rooms looked at after a walk the irradiance from above was
half of the truth's (median). Three steps bring it nearer to the truth, for objects and their shadows alone:

1. Where no frame looked, the completion network's light takes the place of the classical fill (`completed_light`).
2. The radiance that was estimated for clipped pixels counts `CLIPPED_GAIN` times: the network estimates the mean of its
   logarithm, and the light of a lamp is the mean of its radiance (`with_clipped_energy`).
3. Light is added evenly from above, from where no frame looked (`with_missing_light`): the more, the less was seen
   above, and the brighter the surface below is. That surface's radiance is albedo x irradiance / pi: a panorama that
   would need an albedo of more than `ALBEDO` probably lacks light, one that would need less lacks none.

Objects are lit with all three. Shadows are cast, and mirrors and glass show, the light of the first two: the added
light comes from nowhere in particular, would be seen in mirrors, and would make shadows fainter.

Constants were chosen at 83 probes (docs/experiments.md); `roomlight eval-objects` scores the result in many rooms.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles
from roomlight.engine.blend import PanoramaState
from roomlight.engine.completion import completion_panels, shipped_completion
from roomlight.engine.graphs import SHIPPED
from roomlight.engine.session import Session

CLIPPED_GAIN: Final = 1.5
"""Factor on the radiance that was estimated for clipped pixels."""
ALBEDO: Final = 0.22
"""Of floors and tables: wood, carpet and tiles. The radiance below the centre of 38 real panoramas, relative to the
irradiance, has quartiles of 0.15, 0.29 and 0.48; at 33 probes in artists' rooms 0.11, 0.14 and 0.28."""
TRUST: Final = 0.35
"""Exponent of the ratio of the two irradiances: 1 follows the albedo, 0 the panorama."""
UNSEEN_GAIN: Final = 0.3
"""Logarithm by which the light from above grows if no frame looked there; less, the more frames have shown."""
MOST: Final = 8.0
"""Largest ratio of the irradiance with the missing light to that without."""
_CONE: Final = float(np.cos(np.radians(55.0)))
"""Directions this close to straight down show the surface below."""
_LEAST_SEEN: Final = 0.3
"""Share of these directions that frames have shown, at least."""
_LEAST_UNSEEN: Final = 0.1
"""What frames have shown counts as unseen by this share: lamps are clipped, and all may have been seen."""

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


def object_light(session: Session, handle: int) -> ObjectLight:
    """Return the light of objects at a tracked position of a session.

    Raises:
        ProbeError: no tracked probe has this handle, or no frame was pushed yet.
        ModelError: the completion network's weights are missing or damaged.
    """
    state = session.panorama_state(handle)
    panorama = completed_light(session, state) if session.model == "classical" else state.radiance
    casting = with_clipped_energy(panorama, state.guessed)
    return ObjectLight(with_missing_light(casting, state.seen), casting)


def completed_light(session: Session, state: PanoramaState) -> Panorama:
    """Return the panorama of a state of the classical model with the completion network's light where none looked."""
    options = session.options
    network = shipped_completion(options.provider, (options.parts or SHIPPED) / "completion")
    panels = completion_panels(
        detail=state.radiance, known=state.seen, clipped=state.clipped, depth_m=state.depth_m, fill=state.radiance
    )
    return network.complete(panels, state.radiance, state.seen)


def with_clipped_energy(panorama: Float[np.ndarray, "h w 3"], guessed: Float[np.ndarray, "h w"]) -> Panorama:
    """Return the panorama with `CLIPPED_GAIN` times the light that was estimated for clipped pixels.

    guessed:  luminance of the panorama that is such an estimate (`PanoramaState.guessed`).
    """
    luminance = np.maximum(panorama @ LUMINANCE, np.float32(1e-6))
    gain = 1 + (CLIPPED_GAIN - 1) * np.clip(guessed / luminance, 0, 1)
    return np.ascontiguousarray(panorama * gain[..., None], np.float32)


def with_missing_light(panorama: Float[np.ndarray, "h w 3"], observed: Float[np.ndarray, "h w"]) -> Panorama:
    """Return the panorama with light from above that it lacks; the panorama itself where none is missing.

    observed:  share of each direction that frames have shown.
    """
    panorama = np.ascontiguousarray(panorama, np.float32)
    height = len(panorama)
    directions = panorama_directions(height).astype(np.float32)
    solid_angle = np.broadcast_to(panorama_solid_angles(height), panorama.shape[:2]).astype(np.float32)
    sine = np.maximum(directions[..., 1], 0)
    above = np.einsum("hwc,hw->c", panorama, solid_angle * sine)
    present = float(above @ LUMINANCE)
    if present <= 0:
        return panorama
    unseen = (1 - np.clip(observed, 0, 1)).astype(np.float32)
    lacking = UNSEEN_GAIN * float((unseen * sine * solid_angle).sum()) / np.pi
    ground = _ground(panorama, observed, directions, solid_angle)
    if ground is not None:
        lacking += TRUST * float(np.log(max(np.pi * ground / (ALBEDO * present), 1e-6)))
    if lacking <= 0:
        return panorama
    ratio = min(float(np.exp(lacking)), MOST)
    shape = sine * np.maximum(unseen, np.float32(_LEAST_UNSEEN))
    share = float((shape * solid_angle * sine).sum())
    colour = 0.5 * above / present + 0.5
    colour /= colour @ LUMINANCE
    return panorama + (shape * np.float32((ratio - 1) * present / share))[..., None] * colour.astype(np.float32)


def _ground(
    panorama: Panorama,
    observed: Float[np.ndarray, "h w"],
    directions: Float32[np.ndarray, "h w 3"],
    solid_angle: Float32[np.ndarray, "h w"],
) -> float | None:
    """Return the median luminance of the surface below by solid angle; None where too little of it was seen."""
    below: Bool[np.ndarray, "h w"] = -directions[..., 1] > _CONE
    seen = below & (observed > 0.5)
    weight = solid_angle[seen]
    if weight.sum() < _LEAST_SEEN * solid_angle[below].sum():
        return None
    values = panorama[seen] @ LUMINANCE
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])
