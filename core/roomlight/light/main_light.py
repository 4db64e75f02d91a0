"""Light sources of a panorama: the main light, which casts the shadows, and up to two others.

A light is a lobe (lamp, window) of light above the room's level, the median luminance by solid angle. Pixels that are
brighter than both that level and the mean count. Within about 25 degrees of the lobe's centre, what they have above the
level is the light's:

    intensity = sum over the lobe of (share above the level) x radiance x solid angle

which is its irradiance on a surface that faces it (three.js's `DirectionalLight.intensity` x colour), in the
panorama's unit x steradian. As a point at `direction` it has harmonics intensity x basis(direction), and the ambient
harmonics are total minus exactly those.

Lamps are told from bright surfaces by luminance. A white surface that faces the only lamp of a room reflects 4 times
the mean luminance at the position. Lobes are therefore chosen and centred by their light x `emitted`, which rises from
0 at the mean luminance to 1 at 4 times the mean. Surfaces below the horizon may face up and lie in the sun or show
glare. There both limits rise with the angle below the horizon, to 8 times as much at 17 degrees (a sine of 0.3). At 33
probes in path-traced rooms of other authors, which have no light below the horizon, the lobe with most light came from
below in 17 % of the frames; with these limits it never does, and the mean error of direction is 40 instead of 43
degrees. With 4 instead of 8 a few remain; 2 or 8 instead of the first 4 changes nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from roomlight.conventions import LUMINANCE, panorama_rays, panorama_solid_angles
from roomlight.light.checks import check_panorama
from roomlight.spheres import resize_panorama

MAX_LIGHTS: Final = 3
NO_SOURCE: Final = -1
"""Number of a main light that is not in the list of lights: mostly one whose place is inferred, not seen."""
_SEARCH_ROWS: Final = 24  # 7.5 degrees a pixel, under a kernel of 12
_KERNELS: Final = np.radians((12.0, 12.0, 12.0, 6.0, 6.0, 6.0, 6.0))
"""Widths (standard deviation, in radians) of the steps to the centre: from that of a lobe to one that separates lamps
15 degrees apart."""
_LOBE: Final = (math.radians(20), math.radians(30))
"""All of the light above the level counts up to the first angle, none from the second on."""
_NEAR_DEG: Final = 60.0  # no lobe reaches farther from its peak in the coarse panorama
_FAINTEST: Final = 1e-4  # of all light: a fainter lobe is a rounding error of even light
_WEAKEST: Final = 0.05  # of the strongest light: weaker ones are not worth a shadow
_BRIGHTEST_SURFACE: Final = 4.0  # in units of the mean luminance; see the module docstring
_BELOW: Final = 8.0  # factor of both limits below the horizon
_BELOW_SINE: Final = 0.3  # sine of the angle below the horizon at which the factor is full


@dataclass(frozen=True, eq=False)
class MainLight:
    """One light: where it is, how strong, how large.

    (0, 1, 0) with intensity 0 where the light comes evenly from everywhere, or not at all.

    Attributes:
        direction: unit vector in the world, from the position toward the light; float64.
        intensity: RGB irradiance >= 0 on a surface that faces the light, in radiance x steradian; float64.
        radius_deg: angular radius of a round light of the same spread, in degrees; 0 is a point.
        shadow_strength: share of the irradiance on a surface facing the light that the light gives, 0 to 1: how much
            darker its shadow is there. On the ground that is about y s / (y s + 1 - s) with y = max(direction[1], 0).
        emitted: 1 where the light is brighter than any surface that the room's light could explain (a lamp, a window),
            toward 0 where it may be a bright surface.
        number: identity of the light at a tracked probe, equal from frame to frame; elsewhere its rank, 0 the first;
            -1 for a main light that is not in the list: mostly one whose place is inferred, not seen. A main light has
            the number of the listed light near it, whose direction and intensity differ.

    Examples:
        >>> import numpy as np, roomlight as rl
        >>> panorama = np.full((16, 32, 3), 0.1, np.float32)
        >>> panorama[2, 10] = 100  # a lamp above
        >>> bool(rl.Light((0.0, 0.0, 0.0), panorama).main_light.direction[1] > 0.8)
        True
    """

    direction: Float[np.ndarray, "3"]
    intensity: Float[np.ndarray, "3"]
    radius_deg: float = 0.0
    shadow_strength: float = 0.0
    emitted: float = 0.0
    number: int = 0

    @property
    def weight(self) -> float:
        """Luminance of the intensity x `emitted`: lights are ordered by it."""
        return float(self.intensity @ LUMINANCE) * self.emitted

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The rotation (x, y, z, w) of a light that shines along its own -z, as those of USD, glTF and Blender do."""
        x, y, z = self.direction.tolist()
        if z < -1 + 1e-9:  # half a turn about x
            return 1.0, 0.0, 0.0, 0.0
        scale = 1 / float(np.sqrt(2 * (1 + z)))  # half way from +z to the direction
        return -y * scale, x * scale, 0.0, (1 + z) * scale

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values of all attributes."""
        return {
            "direction": self.direction.tolist(),
            "intensity": self.intensity.tolist(),
            "radius_deg": self.radius_deg,
            "shadow_strength": self.shadow_strength,
            "emitted": self.emitted,
            "number": self.number,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "MainLight":
        """Return the light of which `to_json` returned these values."""
        direction, intensity = (np.array(values[name], np.float64) for name in ("direction", "intensity"))
        others = {name: value for name, value in values.items() if name not in ("direction", "intensity")}
        return cls(direction, intensity, **others)


@dataclass(frozen=True)
class TrackedLights:
    """The lights of a tracked probe after a frame.

    Attributes:
        main: the main light. It turns from one light to another at a bounded rate, with reduced intensity.
        sources: up to `MAX_LIGHTS` lights, each in its own place, the strongest first.
    """

    main: MainLight
    sources: tuple[MainLight, ...]


def no_light() -> MainLight:
    """Return the main light of even light: from above, intensity 0."""
    return MainLight(np.array([0.0, 1.0, 0.0]), np.zeros(3))


def main_light(panorama: Float[np.ndarray, "h w 3"]) -> MainLight:
    """Return the first of `find_lights`, or `no_light` where there is none."""
    return next(iter(find_lights(panorama)), no_light())


def find_lights(panorama: Float[np.ndarray, "h w 3"]) -> tuple[MainLight, ...]:
    """Find up to `MAX_LIGHTS` lights, the main light first. Negative radiance counts as black.

    About 1 ms for 120 x 240 on one core. Products are computed with einsum, on this thread alone: BLAS uses its own
    threads, which wait for a core beside a running engine (12 to 16 ms in all, at a load of 8 on two cores).

    Raises:
        ValueError: the panorama is not [H, 2H, 3] with 4 to 4096 rows of finite floats.
    """
    return Surroundings.of(panorama).lights()


def relit(
    tracked: TrackedLights, *, before: Float[np.ndarray, "h w 3"], after: Float[np.ndarray, "h w 3"]
) -> TrackedLights:
    """Return tracked lights as strong as another panorama of the same place has them.

    Directions, sizes and numbers stay, the strongest is first. Where a light was fading in or out in `before`, it fades
    as much in `after`.
    """
    seen, lit = Surroundings.of(before), Surroundings.of(after)

    def measured(light: MainLight) -> MainLight:
        full = float(seen.intensity(light.direction) @ LUMINANCE)
        share = min(float(light.intensity @ LUMINANCE) / full, 1.0) if full > 0 else 0.0
        changed = replace(light, intensity=share * lit.intensity(light.direction))
        return replace(changed, shadow_strength=lit.shadow_strength(changed))

    sources = sorted(map(measured, tracked.sources), key=lambda light: -light.weight)
    return TrackedLights(measured(tracked.main), tuple(sources))


def without_lights(
    panorama: Float[np.ndarray, "h w 3"], lights: Sequence[MainLight]
) -> tuple[Float[np.ndarray, "h w 3"], tuple[MainLight, ...]]:
    """Return the panorama without lights, and the lights: both together shed as much as before.

    A light's pixels keep the room's level and lose its intensity in proportion to what they have above it. A light that
    is stronger than the light that is left in its place is returned with that.

    Args:
        panorama: linear RGB [H, 2H, 3], in which the lights were seen.
        lights: its lights, as strong as they are there or weaker; without light none is returned.
    """
    pixels = Surroundings.of(panorama).pixels
    per_solid_angle = pixels.excess / panorama_solid_angles(pixels.rows)[pixels.index // (2 * pixels.rows), 0]
    kept = np.ones((len(pixels.index), 3))  # share of each pixel's radiance
    left = np.ones(len(pixels.index))  # share of each pixel's excess that no light has yet
    taken: list[MainLight] = []
    for light in lights:
        share = left * _lobe(_along(pixels.rays, light.direction))
        full = np.einsum("i,ij->j", share * pixels.excess, pixels.radiance)
        part = np.clip(light.intensity / np.maximum(full, 1e-30), 0, 1)
        kept -= (share * per_solid_angle)[:, None] * part
        left -= share
        if (part * full).max() > 0:
            taken.append(replace(light, intensity=part * full))
    rest = np.maximum(panorama, 0).reshape(-1, 3).astype(np.float32)
    rest[pixels.index] *= np.maximum(kept, 0).astype(np.float32)
    return rest.reshape(panorama.shape), tuple(taken)


@dataclass(frozen=True)
class _Pixels:
    """The pixels of a panorama that may belong to a light.

    Attributes:
        rows: of the panorama.
        index: in the flat panorama.
        rays: unit directions.
        radiance: RGB.
        excess: share of the radiance above the level x solid angle.
        power: luminance of the excess x emitted.
    """

    rows: int
    index: Int[np.ndarray, " n"]
    rays: Float[np.ndarray, "n 3"]
    radiance: Float[np.ndarray, "n 3"]
    excess: Float[np.ndarray, " n"]
    power: Float[np.ndarray, " n"]

    @staticmethod
    def above(panorama: Float[np.ndarray, "h w 3"], *, level: float, mean: float) -> "_Pixels":
        """Select the pixels above the level that are brighter than the mean luminance."""
        rows = len(panorama)
        luminance = (panorama @ LUMINANCE).reshape(-1)
        index = np.flatnonzero(luminance > max(level, mean))
        rays, luminance = panorama_rays(rows)[index].astype(np.float64), luminance[index].astype(np.float64)
        excess = (1 - level / luminance) * panorama_solid_angles(rows)[index // (2 * rows), 0]
        emitted = emitted_share(luminance, rays[:, 1], mean)
        radiance = panorama.reshape(-1, 3)[index].astype(np.float64)
        return _Pixels(rows, index, rays, radiance, excess, excess * luminance * emitted)

    def cell_of(self, rows: int) -> Int[np.ndarray, " n"]:
        """Return the pixel of a panorama of `rows` rows that each pixel lies in."""
        row, column = np.divmod(self.index, 2 * self.rows)
        return row * rows // self.rows * 2 * rows + column * rows // self.rows


@dataclass(frozen=True)
class Surroundings:
    """A panorama as light about given directions.

    Attributes:
        pixels: what may belong to a light.
        coarse: luminance of the panorama of the search.
        search: its pixels.
        total: sum of luminance x solid angle.
    """

    pixels: _Pixels
    coarse: Float[np.ndarray, " n"]
    search: "Search"
    total: float

    @property
    def mean(self) -> float:
        """Mean luminance of all directions."""
        return self.total / (4 * np.pi)

    @staticmethod
    def of(panorama: Float[np.ndarray, "h w 3"]) -> "Surroundings":
        """Look at a panorama. Raises ValueError as `find_lights`."""
        panorama = np.maximum(check_panorama(panorama), 0)
        coarse = resize_panorama(panorama, min(len(panorama), _SEARCH_ROWS)) @ LUMINANCE
        search = Search.of_rows(len(coarse))
        coarse = coarse.reshape(-1)
        total, level = float(_dot(coarse, search.solid_angle)), _median(coarse, search.solid_angle)
        return Surroundings(_Pixels.above(panorama, level=level, mean=total / (4 * np.pi)), coarse, search, total)

    def lights(self) -> tuple[MainLight, ...]:
        """Return up to `MAX_LIGHTS` lights, the strongest first."""
        # numba: 0.5 s that clients without lights save
        from roomlight.light.kernels.lobes import gather, shift_to_centre

        pixels, search = self.pixels, self.search
        cell = pixels.cell_of(search.rows)
        left = np.ones(len(cell))  # share of each pixel's light that no lobe has yet
        chosen: list[MainLight] = []
        gathered = np.empty(len(search.kernel), np.float32)
        while len(cell) and len(chosen) < MAX_LIGHTS:
            gather(search.kernel, np.bincount(cell, pixels.power * left, minlength=len(self.coarse)), gathered)
            peak = search.rays[np.argmax(gathered)].astype(np.float64)
            near = left * (_along(pixels.rays, peak) > np.cos(np.radians(_NEAR_DEG)))
            centre = np.array(shift_to_centre(pixels.rays, pixels.power * near, peak, _KERNELS))
            light, share = _light_toward(pixels, near, centre)
            if light.intensity @ LUMINANCE <= _FAINTEST * self.total or (
                chosen and light.weight < _WEAKEST * chosen[0].weight
            ):
                break
            chosen.append(replace(light, shadow_strength=self.shadow_strength(light)))
            left -= share
        ordered = sorted(chosen, key=lambda light: -light.weight)
        return tuple(replace(light, number=number) for number, light in enumerate(ordered))

    def light(self, direction: Float[np.ndarray, "3"]) -> MainLight:
        """Return the light about a direction, in exactly that direction; it has no number."""
        light, _ = _light_toward(self.pixels, np.ones(len(self.pixels.index)), direction)
        return replace(light, shadow_strength=self.shadow_strength(light), number=NO_SOURCE)

    def intensity(self, direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return the irradiance RGB of the lobe about a direction, on a surface that faces it."""
        share = _lobe(_along(self.pixels.rays, direction))
        return np.einsum("i,ij->j", share * self.pixels.excess, self.pixels.radiance)

    def shadow_strength(self, light: MainLight) -> float:
        """Return the light's share of the irradiance on a surface that faces it."""
        facing = np.maximum(_along(self.search.rays, light.direction.astype(np.float32)), 0)
        irradiance = float(np.einsum("i,i,i->", self.coarse, self.search.solid_angle, facing))
        return min(float(light.intensity @ LUMINANCE) / max(irradiance, 1e-30), 1.0)


@dataclass(frozen=True)
class Search:
    """Weights that gather light about every direction of a coarse panorama."""

    rows: int
    kernel: Float[np.ndarray, "n n"]
    solid_angle: Float[np.ndarray, " n"]
    rays: Float[np.ndarray, "n 3"]

    @staticmethod
    @lru_cache(maxsize=4)
    def of_rows(rows: int) -> "Search":
        """Return the weights for a panorama of `rows` rows."""
        rays = panorama_rays(rows)
        solid_angle = np.repeat(panorama_solid_angles(rows)[:, 0], 2 * rows)
        kernel = np.exp((rays @ rays.T - 1) / np.float32(_KERNELS[0] ** 2))
        return Search(rows, kernel, solid_angle, rays)


def _light_toward(
    pixels: _Pixels, left: Float[np.ndarray, " n"], direction: Float[np.ndarray, "3"]
) -> tuple[MainLight, Float[np.ndarray, " n"]]:
    """Return the light about a direction, without shadow strength, and the share of each pixel's light that it takes.

    `radius_deg` is that of the uniform disc with the same mean of 1 - cos(angle), which is (1 - cos radius) / 2.
    """
    cosine = _along(pixels.rays, direction)
    share = left * _lobe(cosine)
    intensity = np.einsum("i,ij->j", share * pixels.excess, pixels.radiance)
    power = share * pixels.power
    sure = float(power.sum())
    radius = np.arccos(np.clip(1 - 2 * _dot(power, 1 - cosine) / max(sure, 1e-30), -1, 1))
    emitted = min(sure / max(float(intensity @ LUMINANCE), 1e-30), 1.0)
    return MainLight(direction, intensity, float(np.degrees(radius)), emitted=emitted), share


def emitted_share(
    luminance: Float[np.ndarray, " n"], height: Float[np.ndarray, " n"], mean: float
) -> Float[np.ndarray, " n"]:
    """Return how surely light comes from a lamp: 0 at the mean luminance, 1 at `_BRIGHTEST_SURFACE` times that.

    Args:
        luminance: of pixels.
        height: y of their unit directions.
        mean: luminance of all directions.
    """
    surface = max(mean, 1e-30) * (1 + (_BELOW - 1) * np.clip(-height / _BELOW_SINE, 0, 1))
    return np.clip((luminance - surface) / ((_BRIGHTEST_SURFACE - 1) * surface), 0, 1)


def _lobe(cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return 1 within a lobe and 0 beyond, with a smooth edge: a lamp that crosses it does not flicker."""
    from roomlight.light.kernels.lobes import lobe

    shares = np.empty(len(cosine))
    lobe(cosine, *_LOBE, shares)
    return shares


def _along(vectors: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, " n"]:
    return np.einsum("ij,j->i", vectors, axis)


def _dot(first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"]) -> Any:
    return np.einsum("i,i->", first, second)


def _median(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulative, cumulative[-1] / 2)]])
