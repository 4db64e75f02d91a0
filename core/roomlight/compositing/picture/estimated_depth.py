"""Estimated depth made to fit the surfaces that objects stand on.

An object is placed once, but the depth that a network estimates of each frame is wrong by another factor, which varies
smoothly over the picture. Around an object that factor is known: its support is where it was.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.compositing.placement.places import Plane
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.frame import Frame

FACTOR_RADII: Final = 2.0
"""The factor is that of the support within this many radii of the object."""
ON_PLANE_RADII: Final = 3.0
"""Depth near the support's lies on it within this many radii."""
NEARER: Final = 0.12
DOUBTFUL: Final = 0.25
FARTHER: Final = 0.4
"""How near, as logarithms of the ratio. Nothing is behind the support; what is nearer than `NEARER` is a real thing in
front, up to `DOUBTFUL` only if other frames show it too."""
SPREAD: Final = 0.1
PRIOR: Final = 0.2
"""The factor is the median around the mode of the pixels' factors, smoothed by `SPREAD`, as things in front of the
support have others; those beyond `PRIOR` are less likely. Logarithms too.

On 95 placements in 12 captures, most of them partly hidden, what is visible of objects agrees with what is visible by
exact or a sensor's depth by an intersection over union of 0.83, the ground that takes contact shadows by 0.69; without
the fit it was 0.80 and 0.28. What real things hide agrees by 0.32, as little as before (0.34); by 0.22 with the median
as factor and a `NEARER` of 0.25."""
_FACTORS: Final = np.linspace(-0.8, 0.8, 321)
"""Factors beyond 0.45 and 2.2 are other things."""
_LEAST_PIXELS: Final = 20


def fitted_to_supports(
    depth_m: Float32[np.ndarray, "h w"],
    frame: Frame,
    supports: Sequence[Plane | None],
    spheres: Sequence[Float[np.ndarray, "4"]],
    geometry: RoomGeometry,
) -> Float32[np.ndarray, "h w"]:
    """Return estimated depth with the surfaces that objects stand on in their places.

    Between objects the factor is the mean of theirs, weighted by the angle to each.

    Args:
        depth_m: z-depth of the frame, of any size, 0 unknown.
        frame: its lens and pose are used.
        supports: what each object stands on, world metres; None for nothing. Those seen from behind do not count.
        spheres: [4] centre and radius of each object's bounding sphere.
        geometry: what other frames showed.
    """
    rows, columns = depth_m.shape
    camera = frame.intrinsics.resized(columns, rows)
    rays = camera.rays() @ frame.camera_to_world[:3, :3].T.astype(np.float32)
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    origin = frame.camera_to_world[:3, 3]
    known = depth_m > 0
    log_depth = np.log(np.where(known, depth_m, np.float32(1)))
    zones: list[tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]] = []
    factors, weights = np.zeros(depth_m.shape, np.float32), np.zeros(depth_m.shape, np.float32)
    for plane, sphere in zip(supports, spheres, strict=True):
        if plane is None or float(plane.height_of(origin)) <= 0:
            continue
        foot = (sphere[:3] - float(plane.height_of(sphere[:3])) * plane.normal - origin).astype(np.float32)
        toward = np.minimum(rays @ plane.normal.astype(np.float32), np.float32(-1e-3))  # above, the plane is far away
        plane_m = (foot @ plane.normal.astype(np.float32)) / toward
        away = np.linalg.norm(rays * plane_m[..., None] - foot, axis=-1) / np.float32(sphere[3])
        near = known & (away < FACTOR_RADII)
        if near.sum() < _LEAST_PIXELS:
            continue
        factor = _likely_factor(np.log(plane_m[near]) - log_depth[near])
        if factor is None:
            continue
        weight = 1 / (1.001 - directions @ (foot / np.linalg.norm(foot)))
        factors += weight * factor
        weights += weight
        zones.append((plane_m, away))
    if not zones:
        return depth_m
    log_depth += factors / weights
    fitted = np.where(known, np.exp(log_depth), np.float32(0))
    ratios = [np.where(away < ON_PLANE_RADII, np.log(plane_m) - log_depth, np.inf) for plane_m, away in zones]
    least = np.min(np.abs(ratios), axis=0)  # to the nearest plane alone: others would cut what stands on it to pieces
    for (plane_m, _), nearer in zip(zones, ratios, strict=True):
        near = known & (np.abs(nearer) == least) & (nearer > -FARTHER)
        on_plane, doubtful = near & (nearer < NEARER), near & (nearer >= NEARER) & (nearer < DOUBTFUL)
        if doubtful.any():
            others_m = geometry.depth_image(camera, frame.camera_to_world, doubtful)
            on_plane |= doubtful & (others_m > plane_m * np.float32(np.exp(-NEARER)))
        fitted = np.where(on_plane, plane_m, fitted)
    return fitted


def _likely_factor(factors: Float32[np.ndarray, " n"]) -> np.float32 | None:
    """Return the logarithm of the factor that most pixels agree on, of the logarithms of theirs; None: of `_FACTORS`
    none fits."""
    step = float(_FACTORS[1] - _FACTORS[0])
    counts, _ = np.histogram(factors, bins=np.append(_FACTORS - step / 2, _FACTORS[-1] + step / 2))
    votes = np.exp(-0.5 * ((_FACTORS[:, None] - _FACTORS) / SPREAD) ** 2) @ counts
    mode = _FACTORS[int((votes * np.exp(-0.5 * (_FACTORS / PRIOR) ** 2)).argmax())]
    agreeing = factors[np.abs(factors - mode) < 2 * SPREAD]
    return np.float32(np.median(agreeing)) if len(agreeing) else None
