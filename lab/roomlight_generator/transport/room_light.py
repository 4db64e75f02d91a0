"""The light of a room, solved once, and the frames and panoramas rendered from it.

Frames: world, y up, metres; camera x right, y up, z backward; panoramas world-aligned (`roomlight.conventions`).
Radiance is linear RGB in kcd/m2.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, UInt8

from roomlight.camera import Intrinsics
from roomlight.conventions import direction_to_uv, panorama_solid_angles, uv_to_direction
from roomlight.spheres import resize_panorama
from roomlight_generator.transport.irradiance_cache import IrradianceCache
from roomlight_generator.transport.kernels import glossy
from roomlight_generator.transport.kernels.structs import allocated
from roomlight_generator.transport.lights.direct import DirectLight, ShadowRays
from roomlight_generator.transport.patches import solve_room
from roomlight_generator.transport.paths import unit_rows
from roomlight_generator.transport.tracer import FAR_M, Tracer
from roomlight_generator.transport.view import Camera, Viewer

FINER: Final = 2
"""A panorama is rendered at this many times its height and averaged."""

SMALL_PIXELS: Final = 3.0
"""Lights narrower than this many pixels of a panorama are sampled separately: rays would miss them."""

SPLAT_SAMPLES: Final = 512
"""Samples of a small light's cluster in a panorama."""

SUN_SAMPLES: Final = 64
"""Samples of the sun's disc in a panorama."""

PRECISE_RAYS: Final = 1024
"""Gather rays of each cell in precise views."""

PRECISE_LOBES: Final = 6
"""Passes of coats' reflections in precise views."""


@dataclass(frozen=True, eq=False)
class FrameView:
    """A rendered frame: radiance, exact depth, and the surface's class (`roomlight.dataset.recording`).

    Radiance is the mean over each pixel; depth is z-depth at the pixel centres in metres (0: nothing), to the nearest
    surface, panes, mirrors and lamps included.
    """

    radiance: Float32[np.ndarray, "h w 3"]
    depth_m: Float32[np.ndarray, "h w"]
    surface: UInt8[np.ndarray, "h w"]


class RoomLight:
    """A room with its light solved.

    Views fill the irradiance cache and later views share it, so a view's noise (not its mean) depends on the views
    before it: the same calls in the same order give the same bytes.
    """

    def __init__(self, viewer: Viewer) -> None:
        """Take the renderer of a solved room; `solve` makes it."""
        self.tracer, self.light, self.irradiance_cache = viewer.tracer, viewer.light, viewer.irradiance_cache
        self._viewer = viewer

    @classmethod
    def solve(cls, tracer: Tracer, rng_seed: int, *, precise: bool = False) -> "RoomLight":
        """Solve the room's interreflection; the same arguments give the same bytes.

        Precise views have no blotches and little noise, at several times the cost: every cell of a surface that they
        show gathers its own light, and reflections are the mean of `PRECISE_LOBES` passes. Views of nearly the same
        room share their random numbers.
        """
        light = DirectLight(tracer)
        room = solve_room(light, seed=rng_seed)
        cache = IrradianceCache(light, room, seed=rng_seed)
        if not precise:
            return cls(Viewer(cache))
        view_cache = IrradianceCache(light, room, seed=rng_seed, gather_rays=PRECISE_RAYS, interpolated=False)
        return cls(Viewer(cache, view_cache=view_cache, lobe_passes=PRECISE_LOBES))

    def frame(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], *, seed: int) -> FrameView:
        """Render what a pinhole camera sees; the pose is camera-to-world, OpenGL axes."""
        rotation = camera_to_world[:3, :3].astype(np.float32)

        def rays_at(row: Float[np.ndarray, " n"], column: Float[np.ndarray, " n"]) -> Float32[np.ndarray, "n 3"]:
            x, y = (column - intrinsics.cx) / intrinsics.fx, -(row - intrinsics.cy) / intrinsics.fy
            return unit_rows(np.stack([x, y, np.full_like(x, -1.0)], 1).astype(np.float32) @ rotation.T)

        shape = intrinsics.height, intrinsics.width
        camera = Camera(camera_to_world[:3, 3], rays_at, shape, 1 / intrinsics.fx)
        picture = self._viewer.picture(camera, seed=seed)
        depth = z_depth(intrinsics, picture.distance_m.reshape(-1))
        return FrameView(picture.radiance, depth, picture.surface)

    def depth(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]) -> Float32[np.ndarray, "h w"]:
        """Compute the depth of `frame` alone."""
        rays = unit_rows(intrinsics.rays().reshape(-1, 3) @ camera_to_world[:3, :3].T)
        return z_depth(intrinsics, self.tracer.distances(np.broadcast_to(camera_to_world[:3, 3], rays.shape), rays))

    def panorama(
        self, position: Float[np.ndarray, "3"], height: int = 120, *, seed: int
    ) -> Float32[np.ndarray, "{height} 2*{height} 3"]:
        """Render the radiance that arrives at a point from all sides, the mean over each pixel.

        Small lights and the sun's disc are added by samples of their own, with their exact energy in the mean.
        """
        fine = FINER * height

        def rays_at(row: Float[np.ndarray, " n"], column: Float[np.ndarray, " n"]) -> Float32[np.ndarray, "n 3"]:
            return unit_rows(uv_to_direction(np.stack([column / (2 * fine), row / fine], 1).astype(np.float32)))

        lights = self.light.lights
        distance = np.linalg.norm(lights.centre.T - np.asarray(position, np.float32), axis=1)
        small = 2 * lights.radius < SMALL_PIXELS * np.pi / height * distance
        splatted = small[lights.cluster] & (lights.face >= 0)
        dark = np.zeros(len(lights.face_cuts), bool)
        dark[lights.face[splatted]] = True
        # A face that belongs to a small and a large cluster is rendered by rays.
        dark[lights.face[(lights.face >= 0) & ~splatted]] = False
        splatted &= dark[np.maximum(lights.face, 0)]
        camera = Camera(position, rays_at, (fine, 2 * fine), 1.5 * np.pi / fine, dark_faces=dark, show_sun=False)
        picture = self._viewer.picture(camera, seed=seed)
        image = resize_panorama(picture.radiance, height)
        self._splat(image, np.asarray(position, np.float32), splatted, seed)
        return image

    def _splat(
        self, image: Float32[np.ndarray, "h w 3"], position: Float32[np.ndarray, "3"], splatted: np.ndarray, seed: int
    ) -> None:
        """Add small lights and the sun to a panorama, where the point sees them."""
        light, tracer = self.light, self.tracer
        count = SPLAT_SAMPLES * max(1, len(light.lights.start)) + SUN_SAMPLES
        rays = allocated(ShadowRays, count)
        x, y, z = position.tolist()
        written = glossy.splat_rays(light.sources, splatted, SPLAT_SAMPLES, (x, y, z), seed, rays)
        origin, direction, reach, carried = rays.origin, rays.direction, rays.reach, rays.weight
        outdoors = light.outdoors
        if outdoors.sun_irradiance.max() > 0:
            rng = np.random.default_rng([seed, 6])
            spread = outdoors.sun_radius * np.sqrt(rng.random((SUN_SAMPLES, 1)))
            around = np.cross(rng.standard_normal((SUN_SAMPLES, 3)), outdoors.sun_direction)
            disc = slice(written, written + SUN_SAMPLES)
            direction[disc] = unit_rows(outdoors.sun_direction + spread * unit_rows(around))
            origin[disc], reach[disc], carried[disc] = position, FAR_M, outdoors.sun_irradiance / SUN_SAMPLES
            written += SUN_SAMPLES
        seen = np.flatnonzero(tracer.visible(origin[:written], direction[:written], reach[:written]))
        height, width = image.shape[:2]
        uv = direction_to_uv(direction[seen].astype(np.float64))
        row = np.minimum((uv[:, 1] * height).astype(np.int64), height - 1)
        column = np.minimum((uv[:, 0] * width).astype(np.int64), width - 1)
        np.add.at(image, (row, column), carried[seen] / panorama_solid_angles(height)[row])


def z_depth(intrinsics: Intrinsics, distance_m: Float[np.ndarray, " n"]) -> Float32[np.ndarray, "h w"]:
    """Convert distances along the rays of the pixel centres to z-depth, metres; 0 where they are infinite."""
    shape = intrinsics.height, intrinsics.width
    slant = np.linalg.norm(intrinsics.rays(), axis=2)
    distance = np.where(np.isfinite(distance_m), distance_m, 0).reshape(shape)
    return (distance / slant).astype(np.float32)
