"""Sun spots: sample points of all sunlit surfaces in a room, which then serve as lights.

Frames: world, y up, metres; radiance in kcd/m2. A sunlit patch of floor is small and a thousand times as bright as the
rest of a room: rays that meet it by chance leave blotches on every wall. Rays sent in through the openings along the
sun's direction sample it evenly instead.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32

from roomlight_generator.transport.kernels.lights import coat_gains, crossing_counts
from roomlight_generator.transport.kernels.structs import RayEnds, SurfacePoints, allocated
from roomlight_generator.transport.kernels.surfaces import surface_points
from roomlight_generator.transport.lights.coat import coat_table
from roomlight_generator.transport.lights.outdoors import Outdoors
from roomlight_generator.transport.tracer import FAR_M, Tracer

SPOTS: Final = 3072
"""Rays over all openings: in a beam of 2 m2 they are 2.5 cm apart."""

NEAR_SPOT_M2: Final = 0.06
"""The spots' area for `left_to_gathering`: gather rays bring most of their light within 0.2 m."""

LEAST_ALPHA: Final = 0.06
"""Least roughness of the spots' lobes: too few spots would meet a sharper lobe. It blurs reflections by 3 degrees."""


class Spots(NamedTuple):
    """Points off sunlit surfaces, and the sunlight that they reflect.

    Attributes:
        position: Positions, off the surface.
        normal: Geometric normal on the lit side.
        facing: Shading normal.
        radiance: Radiance of the base; under a coat, its mean over directions.
        alpha: Roughness of the coat's lobe about `facing` (0: no coat).
        lobe: The sun's irradiance that the lobe reflects.
        lobe_mean: Mean radiance of the lobe.
        area: Lit area for which the spot stands.
    """

    position: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    facing: Float32[np.ndarray, "n 3"]
    radiance: Float32[np.ndarray, "n 3"]
    alpha: Float32[np.ndarray, " n"]
    lobe: Float32[np.ndarray, "n 3"]
    lobe_mean: Float32[np.ndarray, "n 3"]
    area: Float32[np.ndarray, " n"]


def sun_spots(tracer: Tracer, outdoors: Outdoors) -> Spots:
    """Sample the surfaces lit by the sun through the scene's openings."""
    openings = tracer.scene.openings
    if not openings or outdoors.sun_irradiance.max() <= 0:
        return allocated(Spots, 0)
    rng = np.random.default_rng(7)
    sun = outdoors.sun_direction.astype(np.float64)
    across = [abs(float(np.cross(opening.edge_u, opening.edge_v) @ sun)) for opening in openings]
    starts: list[np.ndarray] = []
    areas: list[np.ndarray] = []
    for opening, area in zip(openings, across, strict=True):
        ratio = float(np.linalg.norm(opening.edge_u) / max(float(np.linalg.norm(opening.edge_v)), 1e-9))
        count = SPOTS * area / max(sum(across), 1e-12)
        nu, nv = max(1, round(np.sqrt(count * ratio))), max(1, round(np.sqrt(count / ratio)))
        i, j = (part.ravel() for part in np.meshgrid(np.arange(nu), np.arange(nv)))
        s, t = (i + rng.random(nu * nv)) / nu, (j + rng.random(nu * nv)) / nv
        starts.append(opening.corner + s[:, None] * opening.edge_u + t[:, None] * opening.edge_v)
        areas.append(np.full(nu * nv, area / (nu * nv)))
    start, area = np.concatenate(starts).astype(np.float32), np.concatenate(areas)
    along = np.broadcast_to(outdoors.sun_direction, start.shape).copy()
    outside = tracer.visible(start + np.float32(1e-3) * along, along, np.full(len(start), FAR_M, np.float32))
    start, area, along = start[outside], area[outside], -along[outside]
    hits = tracer.trace(start, along)
    materials = tracer.materials
    struck = np.flatnonzero((hits.face >= 0) & (materials.mirror[tracer.geometry.material[hits.face]] == 0))
    along, area = np.ascontiguousarray(along[struck]), area[struck]
    points = allocated(SurfacePoints, len(struck))
    foot = np.sqrt(area).astype(np.float32)
    ends = RayEnds(hits.face[struck], hits.u[struck], hits.v[struck], along)
    surface_points(tracer.arrays, ends, foot, points)
    passed = np.empty(len(struck), np.int32)
    crossing_counts(outdoors.hole, outdoors.parts, points.position, -along, passed)
    cosine = np.clip(-(points.normal * along).sum(1), 0, 1)
    slope = np.clip(-(points.geometric_normal * along).sum(1), 0.02, 1)
    alpha = materials.roughness[tracer.geometry.material[hits.face[struck]]]
    base, lobe = np.empty_like(alpha), np.empty_like(alpha)
    coat_gains(alpha, cosine, coat_table(), base, lobe)
    arriving = outdoors.sun_irradiance * cosine[:, None]
    radiance = points.albedo / np.pi * base[:, None] * arriving
    lobe_alpha = np.where(alpha > 0, np.maximum(alpha, LEAST_ALPHA), 0)
    on_coat = np.where(alpha[:, None] > 0, outdoors.sun_irradiance, 0)
    # A beam through two openings is found from both.
    own = area / slope / np.maximum(passed, 1)
    keep = (cosine > 0) & (passed > 0)
    columns = Spots(
        position=points.position,
        normal=points.geometric_normal,
        facing=points.normal,
        radiance=radiance,
        alpha=lobe_alpha,
        lobe=on_coat,
        lobe_mean=lobe[:, None] * arriving,
        area=own,
    )
    return Spots(*(column[keep].astype(np.float32) for column in columns))
