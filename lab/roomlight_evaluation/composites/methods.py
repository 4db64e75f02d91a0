"""The lights that are compared in composites: each gives a panorama at the object's position.

The directional light of `harmonics_and_directional` is a small disc, so that the compositor casts its shadow.
"""

from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.compositing.compositor import Compositor
from roomlight.compositing.light.probes import LightAt
from roomlight.conventions import panorama_rays, panorama_solid_angles
from roomlight.engine.session import Session
from roomlight.light.main_light import main_light
from roomlight.light.spherical_harmonics import project
from roomlight_evaluation.baselines import WarpAndFill
from roomlight_evaluation.composites.scenes import CompositeScene

OURS: Final = "ours"
NO_SHADOW: Final = "no shadow"
HARMONICS: Final = "SH + directional"
WARPED: Final = "warp and fill"
TRUE_LIGHT: Final = "true panorama"
METHODS: Final = (NO_SHADOW, HARMONICS, WARPED, OURS, TRUE_LIGHT)
"""ours: the session's light as the compositor takes it. no shadow: the object lit by ours,
without its shadow. SH + directional: nine harmonics and the main light of
warp-and-fill's panorama cut at white, as from pictures without HDR."""

_DISC_DEG: Final = 2.0
"""Radius of the directional light: more than a pixel's diagonal of 120 rows."""

Panorama = Float32[np.ndarray, "h w 3"]
Picture = Float32[np.ndarray, "h w 3"]


def harmonics_and_directional(panorama: Float[np.ndarray, "h w 3"]) -> Panorama:
    """Reduce a panorama to nine spherical harmonics a channel and one directional light; negative light is cut."""
    light = main_light(panorama)
    height = len(panorama)
    rays = panorama_rays(height)
    ambient = np.maximum(project(panorama, kind="ambient", light=light).evaluate(rays), 0)
    inside = rays @ light.direction.astype(rays.dtype) > np.cos(np.radians(_DISC_DEG))
    solid_angle = np.broadcast_to(panorama_solid_angles(height), (height, 2 * height)).reshape(-1)
    if inside.any():
        ambient[inside] += light.intensity / solid_angle[inside].sum()
    return ambient.reshape(height, 2 * height, 3).astype(np.float32)


def composites(scene: CompositeScene, session: Session) -> dict[str, Picture]:
    """Return the composite of each of `METHODS`, in linear radiance, without the camera's noise on the object.

    Args:
        session: Has seen the scene's frames.
    """
    warped = WarpAndFill()
    for frame in scene.frames:
        warped.push(frame)

    lights: dict[str, LightAt | None] = {
        HARMONICS: lambda position: harmonics_and_directional(np.minimum(warped.light_at(position), 1)),
        WARPED: warped.light_at,
        TRUE_LIGHT: lambda _: scene.true_light,
        OURS: None,
    }
    pictures: dict[str, Picture] = {}
    for name, light in lights.items():
        compositor = Compositor(session, scene.objects, quality="good", light=light)
        try:
            result = compositor.composite(scene.frame)
        finally:
            compositor.close()
        pictures[name] = result.radiance
        if name == OURS:
            pictures[NO_SHADOW] = scene.frame.image * (1 - result.alpha[..., None]) + result.objects
    return {name: pictures[name] for name in METHODS}
