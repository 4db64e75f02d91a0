"""Light transport: direct light by shadow rays, all later bounces from a cache on the mesh's vertices.

Bake, then view: `bake_indirect` solves the diffuse interreflection of the room once (radiosity by gathered rays);
`radiance` then shades any ray, of a frame or of a probe, from the same cache, so that both agree by construction.
Frames: world, y up, metres; radiance linear and relative.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.threads import shard
from roomlight_model.sample_room.light import frames_about
from roomlight_model.sample_room.scene import Hits, Scene

F0 = 0.04
"""Mirror reflection of varnish and glass at normal incidence (index of refraction 1.5)."""

CHUNK = 16384
"""Rays shaded at a time: arrays of a few MB stay in the cache, and the random numbers do not depend on the threads."""


BRIGHTEST = np.float32(18.0)
"""Reflected direct light of a face (pi times its radiance) is held to this: sunlit white paint has 7, and what exceeds
it is a lamp's own socket or a rare sample beside the opening, which would leave spots on the walls."""


@dataclass(frozen=True)
class Indirect:
    """Irradiance (linear RGB, times metres squared per metre squared) at vertices, from everything but the lights."""

    irradiance: Float[np.ndarray, "v 3"]


def sequence(start: int, count: int, rotation: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n {count} 2"]:
    """`count` points of the R2 sequence from `start` on, turned by each point's own rotation modulo 1."""
    golden = 1.32471795724474602596
    index = np.arange(start + 1, start + count + 1)[:, None]
    points = index * np.array([1 / golden, 1 / golden**2])
    return ((points[None] + rotation[:, None]) % 1.0).astype(np.float32)


def direct_irradiance(
    scene: Scene,
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    turn: Float[np.ndarray, "n 2"],
    *,
    pass_index: int = 0,
    boost: int = 1,
) -> Float[np.ndarray, "n 3"]:
    """Irradiance from the scene's lights; `boost` multiplies each light's shadow rays.

    Passes over one pixel give the same random `turn` (uniform in [0, 1)) and count `pass_index` up, so that the samples
    of all passes interleave to one low-discrepancy set.
    """
    total = np.zeros((len(points), 3), np.float32)
    for which, light in enumerate(scene.lights):
        count = light.samples * boost
        uniform = sequence(pass_index * count, count, turn + which * np.array([0.382, 0.177]))
        for at in range(count):
            sample = light.sample(points, uniform[:, at])
            cosine = (normals * sample.direction).sum(1)
            use = np.flatnonzero((cosine > 0) & (sample.weight.max(axis=1) > 1e-5))
            reach = sample.distance_m[use] - np.float32(0.002)
            seen = use[scene.visible(points[use], sample.direction[use], reach)]
            total[seen] += sample.weight[seen] * (cosine[seen] / np.float32(count))[:, None]
    return total


def bake_indirect(
    scene: Scene, *, seed: int = 0, rays: int = 256, bounces: int = 10, points_per_face: int = 2
) -> Indirect:
    """Solve `irradiance = gather(emission + albedo / pi * (direct + irradiance))` on the vertices by iteration.

    Rays that meet the back of a face started inside something and are dropped; a vertex with over a third of such rays
    lies within a solid and takes its neighbours' mean.
    """
    reflected, albedo, emission = _face_light(scene, seed, points_per_face)
    seen = _gather_rays(scene, seed, rays)
    faces = len(scene.faces)
    usable = (seen <= faces).sum(1)
    buried = usable < rays * 2 / 3
    links = _links(scene)
    irradiance = np.zeros((len(scene.vertices), 3), np.float32)
    for _ in range(bounces):
        radiosity = emission + (
            np.minimum(reflected, BRIGHTEST) + albedo * irradiance[scene.faces].mean(1)
        ) / np.float32(np.pi)
        table = np.concatenate([radiosity, np.zeros((2, 3), np.float32)])  # then: the sky (a light), backs
        gathered = np.empty_like(irradiance)

        def gather(start: int, stop: int, *, table: np.ndarray = table, gathered: np.ndarray = gathered) -> None:
            for low in range(start, stop, 1024):
                block = slice(low, min(low + 1024, stop))
                gathered[block] = table[seen[block]].sum(1) * (np.pi / np.maximum(usable[block], 1))[:, None]

        shard(gather, len(gathered))
        irradiance = _mend(gathered, buried, links)
    return Indirect(irradiance)


def _face_light(
    scene: Scene, seed: int, points_per_face: int
) -> tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3"]]:
    """Mean of reflected direct irradiance, albedo and gathered emission of each face, from random points."""
    count = len(scene.faces)
    reflected, albedo, emission = (np.zeros((count, 3), np.float32) for _ in range(3))
    gathers = np.array([not one.found_by_samples for one in scene.materials])

    def work(start: int, stop: int) -> None:
        for chunk in range(start, stop):
            face = np.arange(chunk * CHUNK, min((chunk + 1) * CHUNK, count), dtype=np.int32)
            rng = np.random.default_rng([seed, 1, chunk])
            for _ in range(points_per_face):
                root = np.sqrt(rng.random(len(face)))
                v = rng.random(len(face)) * root
                hits = Hits(
                    face,
                    (1 - root).astype(np.float32),
                    v.astype(np.float32),
                    np.zeros(len(face), np.float32),
                    np.zeros(len(face), bool),
                )
                corner = scene.vertices[scene.faces[face]]
                outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
                surface = scene.surface(hits, -outward)
                received = direct_irradiance(
                    scene, surface.position, surface.normal, rng.random((len(face), 2)), boost=2
                )
                # The mean of the product: a pale board in the sun gives more than the product of the means.
                reflected[face] += surface.albedo * received / np.float32(points_per_face)
                albedo[face] += surface.albedo / np.float32(points_per_face)
                emission[face] += surface.emission * gathers[surface.material][:, None] / np.float32(points_per_face)

    shard(work, (count + CHUNK - 1) // CHUNK, pieces_per_thread=1)
    return reflected, albedo, emission


def _gather_rays(scene: Scene, seed: int, rays: int) -> Int[np.ndarray, "v {rays}"]:
    """Faces seen from each vertex by cosine-weighted rays; `faces` stands for the sky, `faces + 1` for a back."""
    count, faces = len(scene.vertices), len(scene.faces)
    middle = scene.vertices[scene.faces].mean(1)
    pull = np.zeros((count, 3), np.float64)
    share = np.zeros(count)
    for corner in range(3):
        np.add.at(pull, scene.faces[:, corner], middle)
        np.add.at(share, scene.faces[:, corner], 1.0)
    toward = pull / np.maximum(share, 1)[:, None] - scene.vertices
    # A vertex in the corner of two walls would look along both: start a little way into its own faces.
    origins = scene.vertices + 0.2 * toward * (share > 0)[:, None] + np.float32(2e-3) * scene.normals
    seen = np.full((count, rays), faces + 1, np.int32)
    block = max(1, (4 * CHUNK) // rays)

    def work(start: int, stop: int) -> None:
        for chunk in range(start, stop):
            low, high = chunk * block, min((chunk + 1) * block, count)
            rng = np.random.default_rng([seed, 2, chunk])
            uniform = sequence(0, rays, rng.random((high - low, 2)))
            radius, angle = np.sqrt(uniform[..., 0]), 2 * np.pi * uniform[..., 1]
            normal = scene.normals[low:high]
            side, up = frames_about(normal)
            direction = (
                (radius * np.cos(angle))[..., None] * side[:, None]
                + (radius * np.sin(angle))[..., None] * up[:, None]
                + np.sqrt(1 - uniform[..., 0])[..., None] * normal[:, None]
            )
            begin = np.repeat(origins[low:high], rays, axis=0)
            hits = scene.trace(begin.astype(np.float32), direction.reshape(-1, 3).astype(np.float32))
            face = np.where(hits.face < 0, faces, np.where(hits.from_behind, faces + 1, hits.face))
            seen[low:high] = face.reshape(high - low, rays)

    shard(work, (count + block - 1) // block)
    return seen


def _links(scene: Scene) -> Int[np.ndarray, "e 2"]:
    """Directed edges of the mesh, each once."""
    faces = scene.faces
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0).astype(np.int64)


def _mend(
    values: Float[np.ndarray, "v 3"], buried: Bool[np.ndarray, " v"], links: Int[np.ndarray, "e 2"]
) -> Float[np.ndarray, "v 3"]:
    """Neighbours' means: for buried vertices until all are reached, then two steps for all against noise."""
    count = len(values)
    values = np.where(buried[:, None], 0, values).astype(np.float64)
    known = ~buried

    def means(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        source, target = links[:, 0], links[:, 1]
        total = np.bincount(target, weight[source], count)
        parts = [np.bincount(target, weight[source] * values[source, k], count) for k in range(3)]
        return np.stack(parts, 1) / np.maximum(total, 1e-9)[:, None], total > 0

    for _ in range(12):
        if known.all():
            break
        mean, reached = means(known.astype(np.float64))
        fresh = ~known & reached
        values[fresh] = mean[fresh]
        known = known | fresh
    for _ in range(2):
        mean, reached = means(np.ones(count))
        values[reached] = 0.4 * values[reached] + 0.6 * mean[reached]
    return values.astype(np.float32)


def radiance(
    scene: Scene,
    indirect: Indirect,
    origins: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    turn: Float[np.ndarray, "n 2"],
    *,
    rng: np.random.Generator,
    pass_index: int = 0,
    reflected: bool = False,
) -> Float[np.ndarray, "n 3"]:
    """Radiance that arrives along unit rays (`turn` and `pass_index` as in `direct_irradiance`).

    What a mirror reflection shows has no reflection of its own. The sun's disc is seen directly but not in
    reflections, where it would be a few white dots.
    """
    hits = scene.trace(origins, directions)
    out = scene.sky.radiance(directions, with_sun=not reflected)
    on = np.flatnonzero(hits.face >= 0)
    if len(on) == 0:
        return out
    hits = Hits(hits.face[on], hits.u[on], hits.v[on], hits.distance_m[on], hits.from_behind[on])
    surface = scene.surface(hits, directions[on])
    received = direct_irradiance(scene, surface.position, surface.normal, turn[on], pass_index=pass_index)
    received += scene.interpolate(hits, indirect.irradiance)
    shade = surface.albedo * received / np.float32(np.pi)
    gloss = np.array([one.gloss for one in scene.materials], np.float32)[surface.material]
    glossy = np.flatnonzero(gloss > 0) if not reflected else np.zeros(0, np.int64)
    if len(glossy):
        roughness = np.array([one.roughness for one in scene.materials], np.float32)[surface.material[glossy]]
        normal = surface.normal[glossy]
        facet = normal + roughness[:, None] * rng.standard_normal(normal.shape, np.float32)
        facet /= np.linalg.norm(facet, axis=1, keepdims=True)
        incoming = directions[on][glossy]
        cosine = np.clip(-(incoming * facet).sum(1), 0, 1)
        mirror = incoming + 2 * cosine[:, None] * facet
        below = (mirror * normal).sum(1)
        mirror += np.maximum(0.02 - below, 0)[:, None] * normal  # a facet turned away looks along the surface
        mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
        fresnel = (gloss[glossy] * (F0 + (1 - F0) * (1 - cosine) ** 5))[:, None].astype(np.float32)
        seen = radiance(
            scene,
            indirect,
            surface.position[glossy],
            mirror.astype(np.float32),
            turn[on][glossy],
            rng=rng,
            pass_index=pass_index,
            reflected=True,
        )
        shade[glossy] = (1 - fresnel) * shade[glossy] + fresnel * seen
    out[on] = shade + surface.emission
    return out
