"""Paths of a view's rays: through panes and over mirrors to a surface, a light or the sky.

Frames: world, y up, metres; radiance in kcd/m2.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64, UInt8

from roomlight.dataset.recording import GLASS, LIGHT, MIRROR, ORDINARY
from roomlight.rays import RayHits
from roomlight_generator.transport.kernels.common import LEAST_COSINE
from roomlight_generator.transport.kernels.glossy import pane_rays
from roomlight_generator.transport.kernels.irradiance_cache import diffuse_light
from roomlight_generator.transport.kernels.patches import mirror_rays
from roomlight_generator.transport.kernels.structs import PaneRays, RayEnds, SurfacePoints, allocated
from roomlight_generator.transport.kernels.surfaces import surface_points
from roomlight_generator.transport.lights.coat import coat_table
from roomlight_generator.transport.tracer import OFFSET_M, Tracer

MIRRORS: Final = 3
"""Mirrors that a path follows; the last mirror shows black."""

PANES: Final = 4
"""Panes that a path passes."""


class Surfaces(NamedTuple):
    """Surface points on which rays ended, and the rays' indices. Positions, normals and alpha are as in `Points`.

    Attributes:
        view: Unit direction back along the ray.
        foot_m: Width of the ray there.
    """

    ray: Int32[np.ndarray, " m"]
    face: Int32[np.ndarray, " m"]
    material: Int32[np.ndarray, " m"]
    alpha: Float32[np.ndarray, " m"]
    view: Float32[np.ndarray, "m 3"]
    foot_m: Float32[np.ndarray, " m"]
    position: Float32[np.ndarray, "m 3"]
    normal: Float32[np.ndarray, "m 3"]
    geometric_normal: Float32[np.ndarray, "m 3"]
    albedo: Float32[np.ndarray, "m 3"]
    emission: Float32[np.ndarray, "m 3"]

    def part(self, at: Int32[np.ndarray, " k"] | Int64[np.ndarray, " k"]) -> "Surfaces":
        """Return some of the points, copied."""
        return Surfaces(*(column[at] for column in self))

    def reflected(self, received: Float32[np.ndarray, "m 3"], with_lobe: Bool[np.ndarray, " m"]) -> np.ndarray:
        """Return the radiance along the rays, [m, 3], by irradiance; arguments as in `diffuse_light`."""
        cosine = np.clip((self.normal * self.view).sum(1), LEAST_COSINE, 1)
        out = np.empty_like(received)
        diffuse_light(received, self.albedo, self.alpha, cosine, coat_table(), with_lobe, out)
        return out


@dataclass(frozen=True, eq=False)
class Paths:
    """Rays followed to their ends, in the order in which they were given.

    The panes' columns are reflections still to be traced: index of the ray, origin, direction, share, distance so far.

    Attributes:
        share: Share of the light that panes and mirrors leave.
        distance_m: Distance to the first surface of any kind, inf without.
        surface: Class of that surface.
        ends: Last hits (face -1: the sky along `direction`).
    """

    share: Float32[np.ndarray, " n"]
    distance_m: Float32[np.ndarray, " n"]
    surface: UInt8[np.ndarray, " n"]
    ends: RayEnds
    length_m: Float32[np.ndarray, " n"]
    mirrors: UInt8[np.ndarray, " n"]
    pane_ray: Int32[np.ndarray, " p"]
    pane_origin: Float32[np.ndarray, "p 3"]
    pane_direction: Float32[np.ndarray, "p 3"]
    pane_share: Float32[np.ndarray, " p"]
    pane_length_m: Float32[np.ndarray, " p"]


def follow_view(tracer: Tracer, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"]) -> Paths:
    """Trace rays (unit directions) of a view to their ends."""
    materials = tracer.materials
    hits = tracer.trace(origins, directions)
    count = len(origins)
    share = np.ones(count, np.float32)
    distance = np.where(hits.face >= 0, hits.distance_m, np.float32(np.inf))
    material = tracer.geometry.material[hits.face]
    glowing = materials.emission.max(1)[material] > 0
    surface = np.where(glowing, LIGHT, np.where(materials.mirror[material] > 0, MIRROR, ORDINARY)).astype(np.uint8)
    surface[hits.face < 0] = ORDINARY
    panes = _through_panes(tracer, origins, directions, distance, share)
    if len(panes[0]):
        first = np.full(count, np.inf, np.float32)
        np.minimum.at(first, panes[0], panes[4])
        glassy = first < distance
        distance[glassy], surface[glassy] = first[glassy], GLASS
    _, direction, mirrors = over_mirrors(tracer, hits, origins, directions, share, most=MIRRORS)
    ends = RayEnds(hits.face, hits.u, hits.v, direction)
    return Paths(share, distance, surface, ends, hits.distance_m, mirrors, *panes)


def over_mirrors(
    tracer: Tracer,
    hits: RayHits,
    origins: Float32[np.ndarray, "n 3"],
    directions: Float32[np.ndarray, "n 3"],
    share: Float32[np.ndarray, " n"],
    *,
    most: int,
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"], UInt8[np.ndarray, " n"]]:
    """Follow rays from their hits over mirrors; the one after the last absorbs the ray.

    Changes the hits, whose distances become the lengths of the paths, and multiplies `share` by what the mirrors leave.

    Returns:
        The last origins and directions, and the number of mirrors on each path.
    """
    mirrors = np.zeros(len(origins), np.uint8)
    if not tracer.has_mirrors:
        return origins, directions, mirrors
    face, distance, u, v = hits
    shiny = tracer.materials.mirror[tracer.geometry.material] > 0
    at = np.flatnonzero((face >= 0) & shiny[face])
    if len(at) == 0:
        return origins, directions, mirrors
    origins, directions = origins.copy(), directions.copy()
    for number in range(1, most + 1):
        if len(at) == 0:
            break
        begin, along, left = origins[at], directions[at], share[at]
        mirror_rays(tracer.geometry, tracer.materials, RayEnds(face[at], u[at], v[at], along), begin, left)
        again = tracer.trace(begin, along)
        origins[at], directions[at], share[at], mirrors[at] = begin, along, left, number
        face[at], u[at], v[at] = again.face, again.u, again.v
        distance[at] += again.distance_m
        at = at[(again.face >= 0) & shiny[again.face]]
    share[at] = 0
    return origins, directions, mirrors


def _through_panes(
    tracer: Tracer,
    origins: Float32[np.ndarray, "n 3"],
    directions: Float32[np.ndarray, "n 3"],
    distance: Float32[np.ndarray, " n"],
    share: Float32[np.ndarray, " n"],
) -> tuple[np.ndarray, ...]:
    """Lower `share` by each pane before the first surface; returns the reflections of the first panes (`Paths`)."""
    empty = np.zeros(0, np.int32), *(np.zeros((0, 3), np.float32) for _ in range(2))
    result = *empty, np.zeros(0, np.float32), np.zeros(0, np.float32)
    if not tracer.has_glass:
        return result
    at = np.arange(len(origins), dtype=np.int32)
    travelled = np.zeros(len(origins), np.float32)
    begin = origins
    for number in range(PANES):
        hits = tracer.trace_glass(begin, directions[at])
        on = (hits.face >= 0) & (travelled[at] + hits.distance_m < distance[at])
        if not on.any():
            break
        at = at[on]
        panes = allocated(PaneRays, len(at))
        pane_rays(tracer.geometry, RayEnds(hits.face[on], hits.u[on], hits.v[on], directions[at]), panes)
        travelled[at] += hits.distance_m[on]
        if number == 0:
            result = at.copy(), panes.reflected, panes.direction, panes.share, travelled[at]
        share[at] *= 1 - panes.share
        begin = panes.through
        travelled[at] += np.float32(OFFSET_M)  # the kernel's start beyond the pane
    return result


def surfaces_of(tracer: Tracer, ends: RayEnds, foot_m: Float32[np.ndarray, " n"]) -> Surfaces:
    """Compute the surface points of the rays that hit a face; foot_m is the rays' width where they end."""
    ray = np.flatnonzero(ends.face >= 0).astype(np.int32)
    ends, foot = RayEnds(*(column[ray] for column in ends)), foot_m[ray]
    points = allocated(SurfacePoints, len(ray))
    surface_points(tracer.arrays, ends, foot, points)
    material = tracer.geometry.material[ends.face]
    return Surfaces(ray, ends.face, material, tracer.materials.roughness[material], -ends.direction, foot, *points)


def unit_rows(vectors: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Divide each row by its length."""
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return (vectors / length[:, None]).astype(np.float32)
