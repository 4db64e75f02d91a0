"""Panoramas as the light of virtual objects: importance sampling, several probes, prefiltered levels for previews.

Directions are unit vectors of the world, y up; panoramas as in `roomlight.conventions`. A panorama is light from
infinitely far away: near lamps and walls have no parallax within one probe, so objects wider than about a tenth of the
distance to the nearest surface want several probes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64

from roomlight.compositing.kernels import environment
from roomlight.compositing.kernels.shadow_rays import LightSamples
from roomlight.conventions import LUMINANCE, Position, panorama_directions, panorama_solid_angles
from roomlight.errors import OptionError, ProbeError
from roomlight.light.checks import check_panorama
from roomlight.light.cube import CubeMap
from roomlight.light.prefilter import prefilter
from roomlight.spheres import resize_panorama

MAX_PROBES: Final = 64
PREFILTERED_SIZE: Final = 32
"""Cube map pixels of the prefiltered levels: 2.8 degrees, under lobes of 20 degrees and more; 10 ms a probe."""
PREFILTERED_ROWS: Final = 64
IRRADIANCE_ROWS: Final = 48
"""Rows of the irradiance by direction, interpolated within 0.1 %; 4 ms a probe."""
CELL_ROWS: Final = 8
"""Rows of cells of 22 degrees, by which light x scattering is sampled; finer ones took more time than they saved."""


_NO_IRRADIANCE: Final = np.zeros((1, 1, 2, 3), np.float32)


class SamplingTables(NamedTuple):
    """What directions are drawn by.

    Attributes:
        density: Probability per steradian of each pixel's directions.
        rows: Cumulative probability of the rows.
        columns: Cumulative probability of the columns within each row.
        cells: Probability of each of 8 x 16 cells, for `roomlight.compositing.kernels.guiding`.
        toward: Mean direction of the light in a cell.
        bands: Cumulative probability down each column of cells.
        heights: Cosines of the polar angle at the edges of the rows.
    """

    density: Float32[np.ndarray, "*k h w"]
    rows: Float32[np.ndarray, "*k h1"]
    columns: Float32[np.ndarray, "*k h w1"]
    cells: Float32[np.ndarray, "*k r c"]
    toward: Float32[np.ndarray, "*k r c 3"]
    bands: Float64[np.ndarray, "*k c h1"]
    heights: Float64[np.ndarray, "*k h1"]


class Environment(NamedTuple):
    """Probes as the kernels read them: panoramas, irradiance / pi by the surface's normal, and `SamplingTables`.

    Smooth mirrors and glass show `mirrored`, all else is lit by `radiance`. `spread_m2` is `ProbeSet.spread_m2`.
    """

    position: Float32[np.ndarray, "k 3"]
    spread_m2: Float32[np.ndarray, " k"]
    radiance: Float32[np.ndarray, "k h w 3"]
    mirrored: Float32[np.ndarray, "k h w 3"]
    irradiance: Float32[np.ndarray, "k i j 3"]
    density: Float32[np.ndarray, "k h w"]
    rows: Float32[np.ndarray, "k h1"]
    columns: Float32[np.ndarray, "k h w1"]
    cells: Float32[np.ndarray, "k r c"]
    toward: Float32[np.ndarray, "k r c 3"]
    bands: Float64[np.ndarray, "k c h1"]
    heights: Float64[np.ndarray, "k h1"]


class LightSampler:
    """One panorama at one position: radiance, and directions drawn in proportion to luminance and solid angle."""

    position: Position
    panorama: Float32[np.ndarray, "h w 3"]
    kept: dict[tuple[int, bytes], LightSamples]
    """Samples of `roomlight.compositing.rendering.light_samples`, by number and normal."""
    mixed_from: "Mixture | None"
    """What `mixed` made it of."""

    def __init__(self, panorama: Float[np.ndarray, "h w 3"], position: Position = (0.0, 0.0, 0.0)) -> None:
        """Begin; `panorama` is linear RGB [H, 2H, 3], `position` world metres. Tables are made at first use: 2 ms for
        120 rows.

        Raises:
            ValueError: The panorama is not [H, 2H, 3] of finite floats.
            ProbeError: The position is not finite.
        """
        if not np.isfinite(position).all():
            raise ProbeError(f"a probe's position must be finite, got {position}")
        self.position = position
        self.panorama = np.maximum(np.ascontiguousarray(check_panorama(panorama), np.float32), 0)
        self.kept: dict[tuple[int, bytes], LightSamples] = {}
        self.mixed_from: Mixture | None = None

    def environment(self) -> Environment:
        """Return the tables as the kernels read them, without irradiance."""
        place, panorama = np.array([self.position], np.float32), self.panorama[None]
        tables = (table[None] for table in self._tables)
        return Environment(place, np.zeros(1, np.float32), panorama, panorama, _NO_IRRADIANCE, *tables)

    @cached_property
    def irradiance(self) -> Float32[np.ndarray, "i j 3"]:
        """Irradiance / pi of surfaces with the normals of `irradiance_normals`."""
        finer = -(-IRRADIANCE_ROWS // len(self.panorama))
        if finer == 1:
            return _irradiance(self.panorama)
        rows = finer * len(self.panorama)  # wide pixels: what counts is the light between their centres
        return _irradiance(self.radiance(panorama_directions(rows).reshape(-1, 3)).reshape(rows, 2 * rows, 3))

    def sample(self, points: Float[np.ndarray, "n 2"]) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, " n"]]:
        """Draw a direction for each point of [0, 1)^2; returns directions and their density per steradian."""
        directions, density = np.empty((len(points), 3), np.float32), np.empty(len(points), np.float32)
        light = self.environment()
        environment.fill_samples(light, np.ascontiguousarray(points, np.float64), directions)
        environment.fill_density(light, directions, density)
        return directions, density

    def radiance(self, directions: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        """Read the panorama bilinearly in each direction."""
        rays = np.ascontiguousarray(directions, np.float32)
        out = np.empty((len(rays), 3), np.float32)
        environment.fill_radiance(self.environment(), np.zeros_like(rays), rays, out)
        return out

    @cached_property
    def _tables(self) -> SamplingTables:
        return _sampling_tables(self.panorama)

    @cached_property
    def prefiltered(self) -> Float32[np.ndarray, "levels rows columns 3"]:
        """Panoramas blurred by the GGX lobe: roughness evenly from 0 to 1, where 1 is irradiance / pi."""
        if self.mixed_from is not None:
            return _mean_of([sampler.prefiltered for sampler in self.mixed_from.samplers], self.mixed_from.shares)
        mips = prefilter(CubeMap.from_panorama(self.panorama, size=PREFILTERED_SIZE))
        return np.stack([level.to_panorama(PREFILTERED_ROWS) for level in mips.levels]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Mixture:
    """What a mixed light is made of.

    Attributes:
        samplers: The lights.
        shares: [k] of each in the mean; they sum to 1.
        even: The mean of all in equal shares: directions drawn from it serve every mixture of the set, so that they
            rest while an object moves and the shares change.
        kept: Directions drawn from `even`, with 1 / (pdf number) as weights, and each light's radiance there
            [k, s, m, 3], by number and normal; common to all mixtures of a set.
    """

    samplers: tuple[LightSampler, ...]
    shares: Float[np.ndarray, " k"]
    even: LightSampler
    kept: dict[tuple[int, bytes], tuple[LightSamples, Float32[np.ndarray, "k s m 3"]]]


class ProbeSet:
    """Probes around objects; the light at a point is their mean, weighted by 1 / (squared distance + `spread_m2`).

    Attributes:
        spread_m2: [k] m2; 0 for a probe whose light is all that reaches a point at it.
    """

    def __init__(
        self,
        samplers: Sequence[LightSampler],
        *,
        spread_m2: Sequence[float] | Float32[np.ndarray, " k"] | None = None,
        mirrored: Sequence[LightSampler] | None = None,
    ) -> None:
        """Join the probes; panoramas of fewer rows are resampled to the finest one's.

        Args:
            spread_m2: the attribute; zeros by default.
            mirrored: what smooth mirrors and glass show instead, at the same positions in the same order.

        Raises:
            OptionError: There is none, or more than `MAX_PROBES`; or `mirrored` has other positions.
        """
        if not 1 <= len(samplers) <= MAX_PROBES:
            raise OptionError(f"a probe set takes 1 to {MAX_PROBES} probes, got {len(samplers)}")
        if mirrored is not None and [probe.position for probe in mirrored] != [probe.position for probe in samplers]:
            raise OptionError("the probes that mirrors show must be at the positions of the others")
        self.spread_m2 = np.array([0.0] * len(samplers) if spread_m2 is None else spread_m2, np.float32)
        height = max(len(probe.panorama) for probe in samplers)
        self.samplers = tuple(_at_height(probe, height) for probe in samplers)
        self._mirrored = self.samplers if mirrored is None else tuple(_at_height(probe, height) for probe in mirrored)
        self._kept: dict[tuple[int, bytes], tuple[LightSamples, Float32[np.ndarray, "k s m 3"]]] = {}

    @cached_property
    def environment(self) -> Environment:
        """Panoramas and tables as the kernels read them; made at first use."""
        parts = [
            sampler.environment()._replace(irradiance=sampler.irradiance[None], mirrored=mirrored.panorama[None])
            for sampler, mirrored in zip(self.samplers, self._mirrored, strict=True)
        ]
        joined = Environment(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        return joined._replace(spread_m2=self.spread_m2)

    @cached_property
    def panoramas(self) -> Environment:
        """The same without tables, for kernels that draw no directions."""
        positions = np.array([sampler.position for sampler in self.samplers], np.float32)
        radiance = np.stack([sampler.panorama for sampler in self.samplers])
        unused = _sampling_tables(radiance[0, :1, :2])  # the kernels want arrays of the same types
        mirrored = np.stack([sampler.panorama for sampler in self._mirrored])
        tables = (table[None] for table in unused)
        return Environment(positions, self.spread_m2, radiance, mirrored, _NO_IRRADIANCE, *tables)

    @classmethod
    def single(cls, panorama: Float[np.ndarray, "h w 3"], position: Position = (0.0, 0.0, 0.0)) -> "ProbeSet":
        """Make a set of one probe. Raises as `LightSampler`."""
        return cls([LightSampler(panorama, position)])

    def weights(self, position: Position) -> Float[np.ndarray, " k"]:
        """Return each probe's share of the light at a position; the shares sum to 1."""
        out = np.empty(len(self.samplers))
        environment.probe_weights.py_func(self.panoramas, *position, out)  # not compiled for one call
        return out

    def mixed(self, position: Position) -> LightSampler:
        """Return the light at a position as one panorama: the probes' mean."""
        shares = self.weights(position)
        made = LightSampler(_mean_of([sampler.panorama for sampler in self.samplers], shares), position)
        made.mixed_from = Mixture(self.samplers, shares, self._even, self._kept)
        return made

    @cached_property
    def _even(self) -> LightSampler:
        count = len(self.samplers)
        return LightSampler(_mean_of([sampler.panorama for sampler in self.samplers], np.full(count, 1 / count)))

    @cached_property
    def prefiltered(self) -> Float32[np.ndarray, "k levels rows columns 3"]:
        """Each probe's `LightSampler.prefiltered`."""
        return np.stack([sampler.prefiltered for sampler in self.samplers])


def _at_height(sampler: LightSampler, height: int) -> LightSampler:
    if len(sampler.panorama) == height:
        return sampler
    return LightSampler(resize_panorama(sampler.panorama, height), sampler.position)


def _mean_of(images: Sequence[Float32[np.ndarray, "*s"]], shares: Float[np.ndarray, " k"]) -> Float32[np.ndarray, "*s"]:
    total = np.zeros_like(images[0])
    for image, share in zip(images, shares, strict=True):
        total += np.float32(share) * image
    return total


def _sampling_tables(panorama: Float32[np.ndarray, "h w 3"]) -> SamplingTables:
    luminance = (panorama @ LUMINANCE).astype(np.float64)
    # Radiance is read bilinearly: a pixel's mean reaches over its neighbours, by 1/8 on each side.
    padded = np.pad(luminance, ((1, 1), (0, 0)), mode="edge")
    luminance = (padded[:-2] + 6 * padded[1:-1] + padded[2:]) / 8
    luminance = (np.roll(luminance, 1, 1) + 6 * luminance + np.roll(luminance, -1, 1)) / 8
    if luminance.max() <= 0:
        luminance = np.ones_like(luminance)
    height = len(panorama)
    solid_angle = panorama_solid_angles(height).astype(np.float64)
    weight = luminance * solid_angle
    per_row = weight.sum(axis=1)
    total = per_row.sum()
    weight /= total
    rows = np.concatenate([[0.0], np.cumsum(per_row)]) / total
    columns = np.concatenate([np.zeros((height, 1)), np.cumsum(weight, axis=1)], axis=1)
    columns /= np.maximum(columns[:, -1:], 1e-300)
    rows[-1] = columns[:, -1] = 1.0
    return SamplingTables(
        (luminance / total).astype(np.float32),
        rows.astype(np.float32),
        columns.astype(np.float32),
        *_cells(weight),
        np.cos(np.arange(height + 1) * (np.pi / height)),
    )


def _irradiance(panorama: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "i j 3"]:
    """Return the irradiance / pi around each direction of a panorama that is to be read bilinearly.

    Light is summed over the pixels of about 32 rows by the cosine to their mean direction, which is exact but for the
    pixels that the surface's plane cuts.
    """
    height = len(panorama)
    tops = np.arange(min(32, height)) * height // min(32, height)
    lefts = np.concatenate([tops, tops + height])
    light = panorama * panorama_solid_angles(height)[..., None]
    grey = np.maximum(light.sum(axis=-1, keepdims=True), 1e-30)
    light, grey, moments = (
        np.add.reduceat(np.add.reduceat(values, tops, axis=0), lefts, axis=1).reshape(-1, values.shape[-1])
        for values in (light, grey, grey * _mean_directions(height))
    )
    normals = np.ascontiguousarray(irradiance_normals().reshape(-1, 3).T)
    out = np.zeros_like(normals)
    environment.add_irradiance(normals, (moments / grey).astype(np.float32), (light / np.pi).astype(np.float32), out)
    return np.ascontiguousarray(out.T).reshape(IRRADIANCE_ROWS, 2 * IRRADIANCE_ROWS, 3)


def irradiance_normals() -> Float32[np.ndarray, "i j 3"]:
    """Return the normals of `LightSampler.irradiance`: as a panorama's directions, with rows on the poles."""
    theta = np.linspace(0, np.pi, IRRADIANCE_ROWS)[:, None]
    phi = ((np.arange(2 * IRRADIANCE_ROWS) + 0.5) / (2 * IRRADIANCE_ROWS) - 0.5) * (2 * np.pi)
    up = np.broadcast_to(np.cos(theta), (IRRADIANCE_ROWS, 2 * IRRADIANCE_ROWS))
    return np.stack([np.sin(theta) * np.cos(phi), up, np.sin(theta) * np.sin(phi)], axis=-1).astype(np.float32)


def _mean_directions(height: int) -> Float64[np.ndarray, "h w 3"]:
    """Return the mean of each pixel's directions over its solid angle: a little shorter than unit vectors."""
    theta = np.arange(height + 1) * (np.pi / height)
    top, bottom = np.cos(theta[:-1]), np.cos(theta[1:])
    ring = np.diff(theta / 2 - np.sin(2 * theta) / 4) / (top - bottom)
    ring *= np.sinc(1 / (2 * height))  # over the columns: np.sinc(x) is sin(pi x) / (pi x)
    phi = ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5) * (2 * np.pi)
    up = np.broadcast_to((top + bottom)[:, None] / 2, (height, 2 * height))
    return np.stack([ring[:, None] * np.cos(phi), up, ring[:, None] * np.sin(phi)], axis=-1)


def _cells(
    weight: Float64[np.ndarray, "h w"],
) -> tuple[Float32[np.ndarray, "r c"], Float32[np.ndarray, "r c 3"], Float64[np.ndarray, "c h1"]]:
    """Return each cell's probability and mean direction, and the cumulative probability down the columns of cells."""
    height, width = weight.shape
    rows, columns = min(CELL_ROWS, height), 2 * min(CELL_ROWS, height)
    tops, lefts = np.arange(rows) * height // rows, np.arange(columns) * width // columns
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    phi = ((np.arange(width) + 0.5) / width - 0.5) * (2 * np.pi)
    parts = np.stack([np.add.reduceat(weight * by, lefts, axis=1) for by in (1.0, np.cos(phi), np.sin(phi))])
    whole, along_x, along_z = parts
    ring, up = np.sin(theta)[:, None], np.cos(theta)[:, None]
    toward = np.add.reduceat(np.stack([along_x * ring, whole * up, along_z * ring], axis=-1), tops, axis=0)
    toward /= np.maximum(np.linalg.norm(toward, axis=-1, keepdims=True), 1e-300)
    bands = np.concatenate([np.zeros((1, columns)), np.cumsum(whole, axis=0)]).T
    cells = np.add.reduceat(whole, tops, axis=0)
    return cells.astype(np.float32), toward.astype(np.float32), np.ascontiguousarray(bands)
