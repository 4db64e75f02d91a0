"""Furniture lit by a panorama on a shell, and the shell darkened by the furniture.

World frame: y up, metres; radiance in kcd/m2, irradiance in kcd/m2 times steradians.

Light from the panorama's bright parts (lamps, windows, sunny floors) is summed over fixed samples of them, each with a
shadow ray; the rest is gathered by cosine-distributed rays. The shell reflects what the panorama shows of it, up to an
albedo of 0.9 under the light of the empty room; the rest it emits. With furniture the reflected part is multiplied by
the irradiance with furniture over that without.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64

from roomlight.conventions import LUMINANCE, panorama_solid_angles
from roomlight_generator.panoramas.furniture import Furniture
from roomlight_generator.panoramas.kernels import gather
from roomlight_generator.panoramas.kernels.gather import LightSamples, Rays
from roomlight_generator.panoramas.kernels.shell_views import PanoramaArrays
from roomlight_generator.panoramas.shell import PanoramaShell
from roomlight_generator.rooms.scene import Scene, Sky
from roomlight_generator.transport.kernels.structs import RayEnds, allocated
from roomlight_generator.transport.lights.coat import ROUGHEST, coat_table
from roomlight_generator.transport.paths import Surfaces, surfaces_of
from roomlight_generator.transport.tracer import Tracer

LIGHTS: Final = 96
"""Samples of the bright parts: the same for all points, so that shading is smooth."""
GATHER_RAYS: Final = 64
"""Rays of a point to the rest."""
CELL_M: Final = (0.05, 0.12)
"""Size of the cells of furniture that share an irradiance: in frames, and in probes."""

_ALBEDO: Final = 0.9
"""Largest reflectance of the shell."""
_BOUNCE_ALBEDO: Final = 0.35
_BOUNCE_LIGHT: Final = 0.5
"""Furniture as other furniture sees it: grey, under half of the empty room's mean irradiance."""
_MAX_SHADE: Final = 1.25
_MAP_ROWS: Final = 256


_Sources = tuple[LightSamples, PanoramaArrays]
"""The panorama's bright parts as samples; the rest as a picture."""


class FurnishedLight:
    """Furniture in a shell, and the light that it receives and takes."""

    def __init__(self, shell: PanoramaShell, image: Float32[np.ndarray, "h w 3"], bright: Bool[np.ndarray, "h w"],
                 furniture: Furniture) -> None:  # fmt: skip
        """Solve the light of the shell from a panorama's radiance, of which the bright parts are sampled."""
        self.shell = shell
        empty = Sky(np.zeros((2, 4, 3), np.float32))
        self.tracer = Tracer(Scene(furniture.items, (), empty))
        kinds = np.zeros(bright.shape, np.uint8)
        self._bounce = np.zeros(3, np.float32)
        self.shade = np.empty((0, 3), np.float32)
        dim = padded(np.where(bright[..., None], np.float32(0), image))
        dark = np.zeros_like(dim)
        lights = _lights(shell, image, bright)
        position, normal = np.empty((shell.nodes, 3)), np.empty((shell.nodes, 3))
        gather.nodes(shell.arrays, position, normal)
        rest = PanoramaArrays(dim, dark, kinds, shell.centre)
        with_furniture, without = self._irradiance((lights, rest), position, normal)
        self._bounce = (_BOUNCE_ALBEDO * _BOUNCE_LIGHT / np.pi * without.mean(axis=0)).astype(np.float32)
        floor = np.float32(1e-3) * without.mean(axis=0)
        ratio = np.clip((with_furniture + floor) / (without + floor), 0, _MAX_SHADE).astype(np.float32)
        self.shade = _smoothed(shell, ratio)
        share = self._reflected_share(image, without)
        self.reflected = image * share[..., None]
        self.emitted = image - self.reflected
        kept = np.where(bright[..., None], np.float32(0), np.float32(1))
        rest = PanoramaArrays(padded(self.emitted * kept), padded(self.reflected * kept), kinds, shell.centre)
        self._sources = lights, rest
        self._cells: dict[bytes, np.ndarray] = {}  # irradiance by cell

    def _irradiance(
        self, sources: _Sources, position: np.ndarray, normal: np.ndarray
    ) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
        """Return the irradiance of points with and without the furniture, by the same rays."""
        count, (lights, rest), arrays = len(position), sources, self.shell.arrays
        weight = np.empty((count, len(lights.area)), np.float32)
        rays = allocated(Rays, weight.size)
        gather.light_rays(arrays, lights, position, normal, weight, rays)
        lit = np.flatnonzero(weight.ravel() > 0)
        without = weight @ lights.power
        seen = self.tracer.visible(rays.origin[lit], rays.direction[lit], rays.distance[lit])
        weight.ravel()[lit[~seen]] = 0
        irradiance = weight @ lights.power

        rays = allocated(Rays, count * GATHER_RAYS)
        radiance = np.empty((count * GATHER_RAYS, 3), np.float32)
        gather.gather_rays(arrays, self.shade, rest, position, normal, GATHER_RAYS, radiance, rays)
        scale = np.float32(np.pi / GATHER_RAYS)
        without += scale * radiance.reshape(count, GATHER_RAYS, 3).sum(axis=1)
        hits = self.tracer.trace(rays.origin, rays.direction)
        radiance[(hits.face >= 0) & (hits.distance_m < rays.distance)] = self._bounce
        irradiance += scale * radiance.reshape(count, GATHER_RAYS, 3).sum(axis=1)
        return irradiance, without

    def _reflected_share(
        self, image: Float32[np.ndarray, "h w 3"], irradiance: Float32[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, "h w"]:
        """Return the share of each pixel's radiance that an albedo of 0.9 can reflect in the empty room."""
        received = np.empty((_MAP_ROWS, 2 * _MAP_ROWS, 3), np.float32)
        kinds = np.zeros((2, 4), np.uint8)
        none = np.zeros((2, 6, 3), np.float32)
        gather.irradiance_map(
            self.shell.arrays, irradiance, PanoramaArrays(none, none, kinds, self.shell.centre), received
        )
        most = cv2.resize(received @ LUMINANCE, image.shape[1::-1]) * np.float32(_ALBEDO / np.pi)
        return np.minimum(1, most / np.maximum(image @ LUMINANCE, np.float32(1e-9))).astype(np.float32)

    def shaded(
        self, origins: Float32[np.ndarray, "n 3"], directions: Float32[np.ndarray, "n 3"],
        reach_m: Float32[np.ndarray, " n"], pixel_angle: float, *, cell_m: float,
    ) -> tuple[Int64[np.ndarray, " k"], Float32[np.ndarray, "k 3"], Float32[np.ndarray, " k"]]:  # fmt: skip
        """Return which rays meet furniture before reach_m, the radiance that they see, and their distances."""
        hits = self.tracer.trace(origins, directions)
        on = np.flatnonzero((hits.face >= 0) & (hits.distance_m < reach_m))
        if len(on) == 0:
            return on, np.empty((0, 3), np.float32), np.empty(0, np.float32)
        distance = hits.distance_m[on]
        foot = distance * np.float32(pixel_angle)
        ends = RayEnds(hits.face[on], hits.u[on], hits.v[on], directions[on])
        points = surfaces_of(self.tracer, ends, foot)
        received, through = self._received(points, cell_m), coat_table().mean_through
        coated = points.alpha > 0
        share = np.interp(points.alpha[coated], np.linspace(0, ROUGHEST, len(through)), through)
        received[coated] *= share[:, None].astype(np.float32)
        light = points.reflected(received, coated)
        return on, light + points.emission, distance

    def _received(self, points: Surfaces, cell_m: float) -> Float32[np.ndarray, "n 3"]:
        """Return the irradiance of points: that of the cell in which the point lies after a small random step.

        Steps of up to half a cell within the surface interpolate between cells on the mean.
        """
        count = len(points.position)
        rng = np.random.default_rng(count)
        step = rng.uniform(-0.5, 0.5, (count, 3)).astype(np.float32) * np.float32(cell_m)
        step -= (step * points.normal).sum(1, keepdims=True) * points.normal
        place = points.position + step
        key = np.empty((count, 8), np.int16)
        key[:, :3] = np.rint(place / cell_m)
        key[:, 3:6] = np.rint(3 * points.normal)
        key[:, 6] = self.tracer.geometry.item[points.face]
        key[:, 7] = round(1000 * cell_m)
        cells, index = np.unique(key.view("V16").ravel(), return_inverse=True)
        names = [cell.tobytes() for cell in cells]
        new = np.array([k for k, name in enumerate(names) if name not in self._cells], np.int64)
        if len(new):
            total = np.bincount(index, minlength=len(names))[:, None]
            position, normal = (
                np.stack([np.bincount(index, part[:, axis], len(names)) for axis in range(3)], axis=1) / total
                for part in (points.position, points.normal)
            )
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            irradiance, _ = self._irradiance(self._sources, position[new], normal[new])
            for k, value in zip(new.tolist(), irradiance, strict=True):
                self._cells[names[k]] = value
        return np.stack([self._cells[name] for name in names])[index]


def padded(image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w2 3"]:
    """Return a panorama with its last column before the first, and its first after the last."""
    return np.ascontiguousarray(np.concatenate([image[:, -1:], image, image[:, :1]], axis=1), np.float32)


def _lights(shell: PanoramaShell, image: Float32[np.ndarray, "h w 3"], bright: Bool[np.ndarray, "h w"]) -> LightSamples:
    """Sample the bright parts in proportion to their power, at equal steps of it along a curve."""
    solid = np.broadcast_to(panorama_solid_angles(len(image)), bright.shape)
    power = np.where(bright, (image @ LUMINANCE) * solid, 0).astype(np.float64)
    total = float(power.sum())
    if total <= 0:
        return allocated(LightSamples, 0)
    blocks = _block_order(bright.shape)
    cumulative = np.cumsum(power.ravel()[blocks])
    chosen = blocks[np.searchsorted(cumulative, (np.arange(LIGHTS) + 0.5) / LIGHTS * total)]
    pixels = np.stack(np.divmod(chosen, image.shape[1]), axis=1)
    radiance = image.reshape(-1, 3)[chosen]
    luminance = np.maximum(radiance @ LUMINANCE, 1e-12)
    angle = total / LIGHTS / luminance.astype(np.float64)
    position, normal = np.empty((LIGHTS, 3)), np.empty((LIGHTS, 3))
    weighted = np.empty((LIGHTS, 3), np.float32)
    panorama = PanoramaArrays(
        np.zeros((2, 4, 3), np.float32), np.zeros((2, 4, 3), np.float32), bright.astype(np.uint8), shell.centre
    )
    emitted = (radiance * angle[:, None]).astype(np.float32)
    gather.light_samples(shell.arrays, panorama, pixels, emitted, position, normal, weighted, angle)
    return LightSamples(position, normal, weighted, angle)


def _block_order(shape: tuple[int, int]) -> Int64[np.ndarray, " n"]:
    """Return the pixels of a picture along a Morton curve: near each other in the list, near in the picture."""
    row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    code = np.zeros(len(row), np.int64)
    for bit in range(12):
        code |= ((column >> bit) & 1) << (2 * bit)
        code |= ((row >> bit) & 1) << (2 * bit + 1)
    return np.argsort(code)


def _smoothed(shell: PanoramaShell, ratio: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Smooth each face's light map over its next nodes: the rest of the noise of the gather rays."""
    out = np.empty_like(ratio)
    for (rows, columns), start in zip(shell.arrays.shape.tolist(), shell.arrays.start.tolist(), strict=True):
        part = slice(start, start + rows * columns)
        grid = np.ascontiguousarray(ratio[part].reshape(rows, columns, 3))
        out[part] = cv2.GaussianBlur(grid, (3, 3), 0.7, borderType=cv2.BORDER_REPLICATE).reshape(-1, 3)
    return out
