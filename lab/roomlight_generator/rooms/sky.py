"""The outdoors: a small panorama of sky, skyline and ground, and the sun.

Panorama: the project's equirectangular convention, 64 x 128, radiance in kcd/m2 (without the sun). The sun's irradiance
on a surface facing it is in klx (kcd/m2 x sr). Its light is consistent: ground and facades are lit by the sky above
them and by the sun. Relative sky luminance follows the CIE general sky (ISO 15469:2004), absolute levels the hour.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float

from roomlight.conventions import LUMINANCE, panorama_directions, panorama_solid_angles
from roomlight_generator.rooms.colour import blackbody_rgb, paint
from roomlight_generator.rooms.noise import fbm
from roomlight_generator.rooms.scene import Sky, Sun

SkyKind = Literal["clear", "partly_cloudy", "overcast", "golden", "dusk", "night"]
SKY_KINDS: Final[tuple[SkyKind, ...]] = ("clear", "partly_cloudy", "overcast", "golden", "dusk", "night")

HEIGHT: Final = 64
_SHAPE: Final = (HEIGHT, 2 * HEIGHT)

_Number = int | float
_Range = tuple[_Number, _Number]

Panorama = Float[np.ndarray, "64 128 3"]
ScalarMap = Float[np.ndarray, "64 128"]


@dataclass(frozen=True)
class _SkyParameters:
    """Parameter ranges for one kind of sky: the sun's elevation in degrees, horizontal illuminance by the sky alone
    and the sun's on a surface facing it (klx), colour temperatures at the zenith, at the horizon and of the sun; CIE
    parameters (gradation a, b; indicatrix c, d, e)."""

    elevation: _Range
    sky_klx: _Range
    sun_klx: _Range
    zenith_kelvin: _Range
    horizon_kelvin: _Range
    sun_kelvin: _Range
    cie: tuple[_Number, ...]


_SKY_PARAMETERS: Final[dict[SkyKind, _SkyParameters]] = {
    "clear": _SkyParameters(
        (15, 58), (8, 16), (50, 100), (14000, 26000), (6600, 8000), (4600, 5600), (-1, -0.32, 10, -3, 0.45)
    ),
    "partly_cloudy": _SkyParameters(
        (15, 58), (14, 28), (35, 90), (13000, 24000), (6500, 7800), (4600, 5500), (0, -1, 5, -2.5, 0.3)
    ),
    "overcast": _SkyParameters(
        (15, 55), (5, 20), (0, 0), (6500, 7800), (6300, 7400), (5500, 5500), (4, -0.7, 0, -1, 0)
    ),
    "golden": _SkyParameters(
        (8, 14), (3, 8), (20, 45), (12000, 22000), (4200, 5600), (3000, 3900), (-1, -0.32, 10, -3, 0.45)
    ),
    "dusk": _SkyParameters(
        (-7, -2), (0.004, 0.4), (0, 0), (14000, 26000), (4500, 9000), (2600, 2600), (-1, -0.25, 5, -2, 0.3)
    ),
    "night": _SkyParameters(
        (-40, -20), (1e-4, 1.5e-3), (0, 0), (4500, 9000), (2100, 3800), (2600, 2600), (3.5, -0.6, 0, -1, 0)
    ),
}


def make_sky(
    kind: str,
    rng: np.random.Generator,
    *,
    toward: Float[np.ndarray, "3"] | None = None,
    spread_degrees: float | int = 40.0,
) -> Sky:
    """Make a sky of one of `SKY_KINDS`, with its skyline and ground.

    The sun is always above the skyline. Behind a cloud (in a quarter of `partly_cloudy` skies) it is left out.

    Args:
        toward: World direction toward the sun's azimuth, a direction out of a window for example; None: any azimuth.
        spread_degrees: Largest difference of the sun's azimuth from `toward`.

    Raises:
        ValueError: `kind` is not in `SKY_KINDS`.
    """
    if kind not in _SKY_PARAMETERS:
        raise ValueError(f"unknown sky {kind!r}: choose one of {', '.join(SKY_KINDS)}")
    parameters = _SKY_PARAMETERS[kind]
    azimuth = float(rng.uniform(-np.pi, np.pi))
    if toward is not None and float(np.hypot(toward[0], toward[2])) > 1e-6:
        azimuth = float(np.arctan2(toward[2], toward[0]) + np.radians(spread_degrees) * rng.uniform(-1, 1))
    elevation = np.radians(rng.uniform(*parameters.elevation))
    direction = _direction(azimuth, float(elevation))
    views = panorama_directions(HEIGHT)
    sky = _clear_dome(parameters, views, direction, rng)
    sun, hidden = None, False
    if kind == "partly_cloudy":
        sky, hidden = _with_clouds(sky, views, direction, rng)
    if kind == "overcast":
        low = fbm(rng, _SHAPE, (8, 8), octaves=3) * np.maximum(views[..., 1], 0)
        sky = (sky * (1 + rng.uniform(0.1, 0.4) * low)[..., None]).astype(np.float32)
    if kind in ("dusk", "golden"):
        sky = _with_afterglow(sky, views, azimuth, rng, strength=2.5 if kind == "dusk" else 0.6)
    level = np.exp(rng.uniform(*np.log(parameters.sky_klx)))
    klx = float(LUMINANCE @ _irradiance(sky, np.array([0.0, 1.0, 0.0])))
    sky = (sky * (level / klx)).astype(np.float32)
    if parameters.sun_klx[1] > 0 and not hidden:
        # A low sun is weaker and redder: its light passes through more air.
        (lowest, highest), (weak, strong) = parameters.elevation, parameters.sun_klx
        red_k, white_k = parameters.sun_kelvin
        height = (elevation - np.radians(lowest)) / np.radians(highest - lowest)
        share = float(np.clip(height + rng.normal(0, 0.15), 0, 1))
        klx = weak + (strong - weak) * share
        red, green, blue = blackbody_rgb(round(red_k + (white_k - red_k) * share))
        sun = Sun(direction.astype(np.float64), (klx * red, klx * green, klx * blue))
    return _with_ground(Sky(sky, sun), views, rng, dark=kind in ("dusk", "night"))


def horizontal_irradiance(sky: Sky) -> Float[np.ndarray, "3"]:
    """Return the linear RGB irradiance in klx of a horizontal surface under the sky, sun included."""
    up = np.array([0.0, 1.0, 0.0])
    return _irradiance(sky.panorama, up) + _sun_irradiance(sky.sun, up)


def vertical_irradiance(
    sky: Sky, outward: Float[np.ndarray, "3"], *, sun_share: float | int = 0.5
) -> Float[np.ndarray, "3"]:
    """Return the linear RGB irradiance in klx of a vertical surface that faces `outward`, ground and skyline included.

    The y of `outward` is ignored. Of the sun's part `sun_share` counts: the reveal of a window shades the rest.
    """
    normal = np.array([outward[0], 0.0, outward[2]], np.float64)
    normal /= max(float(np.linalg.norm(normal)), 1e-9)
    return _irradiance(sky.panorama, normal) + sun_share * _sun_irradiance(sky.sun, normal)


def _direction(azimuth: float, elevation: float) -> Float[np.ndarray, "3"]:
    ring = np.cos(elevation)
    return np.array([ring * np.cos(azimuth), np.sin(elevation), ring * np.sin(azimuth)])


def _irradiance(panorama: Panorama, normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    weight = np.maximum(panorama_directions(HEIGHT) @ normal, 0) * panorama_solid_angles(HEIGHT)
    return (panorama * weight[..., None]).sum((0, 1), dtype=np.float64)


def _sun_irradiance(sun: Sun | None, normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    if sun is None:
        return np.zeros(3)
    return np.array(sun.irradiance) * max(0.0, float(sun.direction @ normal))


def _clear_dome(
    parameters: _SkyParameters, views: Panorama, sun: Float[np.ndarray, "3"], rng: np.random.Generator
) -> Panorama:
    """Return relative CIE luminance times the colour from horizon to zenith; zero below the horizon."""
    up = np.maximum(views[..., 1], 0.012)
    a, b, c, d, e = parameters.cie
    gradation = 1 + a * np.exp(b / up)
    angle = np.arccos(np.clip(views @ sun, -1, 1))
    # The circumsolar peak is capped at 12 degrees: the sun itself models anything narrower.
    around = np.maximum(angle, np.radians(12))
    scattered = 1 + c * (np.exp(d * around) - np.exp(d * np.pi / 2)) + e * np.cos(around) ** 2
    brightness = np.maximum(gradation * scattered, 0.02)
    zenith = np.array(blackbody_rgb(round(rng.uniform(*parameters.zenith_kelvin))))
    horizon = np.array(blackbody_rgb(round(rng.uniform(*parameters.horizon_kelvin))))
    share = (up ** rng.uniform(0.35, 0.6))[..., None]
    colour = horizon + (zenith - horizon) * share
    if c > 0:
        # Forward-scattered light has the sun's colour.
        near = np.exp(-angle / 0.35)[..., None]
        colour = colour + (np.array(blackbody_rgb(round(parameters.sun_kelvin[1]))) - colour) * 0.8 * near
    return (colour * brightness[..., None] * (views[..., 1:2] > 0)).astype(np.float32)


def _with_clouds(
    sky: Panorama, views: Panorama, sun: Float[np.ndarray, "3"], rng: np.random.Generator
) -> tuple[Panorama, bool]:
    """Add white clouds, brightest near the sun, grey below; also return whether one hides the sun."""
    size = 128
    field = fbm(rng, (size, size), (6, 6), octaves=5, gain=0.6)
    scale = rng.uniform(6, 12)
    up = np.maximum(views[..., 1], 0.08)
    x, z = views[..., 0] / up * scale + size / 2, views[..., 2] / up * scale + size / 2
    there = cv2.remap(field, x.astype(np.float32), z.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    density = np.clip((there - rng.uniform(-0.25, 0.3)) * 3, 0, 1) * (views[..., 1] > 0)
    lit = float(np.quantile(sky @ LUMINANCE, 0.9)) * rng.uniform(1.5, 4.0)
    facing = 0.75 + 0.6 * np.maximum(views @ sun, 0) ** 3
    white = np.array(blackbody_rgb(6000)) * lit
    grey = np.array(blackbody_rgb(7200)) * lit * 0.4
    thick = (np.clip(density - 0.6, 0, 1) * rng.uniform(0.5, 2.2))[..., None]
    cloud = (white + (grey - white) * np.clip(thick, 0, 1)) * facing[..., None]
    mixed = (sky + (cloud - sky) * density[..., None]).astype(np.float32)
    return mixed, bool(rng.random() < 0.25)


def _with_afterglow(
    sky: Panorama, views: Panorama, azimuth: float, rng: np.random.Generator, *, strength: float
) -> Panorama:
    """Add a warm band at the horizon near the sun's azimuth, rose further up."""
    bearing = np.arctan2(views[..., 2], views[..., 0])
    side = np.exp(-((1 - np.cos(bearing - azimuth)) / rng.uniform(0.3, 0.9)))
    up = np.maximum(views[..., 1], 0)
    level = float((sky @ LUMINANCE)[views[..., 1] > 0].mean()) * strength
    orange, rose = np.array(blackbody_rgb(round(rng.uniform(2000, 2600)))), np.array([1.7, 0.78, 1.0])
    band = (side * np.exp(-up / 0.13))[..., None] * orange + 0.35 * (side * np.exp(-up / 0.35))[..., None] * rose
    return (sky + level * band * (views[..., 1:2] > 0)).astype(np.float32)


def _with_ground(sky: Sky, views: Panorama, rng: np.random.Generator, *, dark: bool) -> Sky:
    """Add lawn or street below, and hills, trees, hedges or facades at the horizon, lit by the sky and the sun."""
    bearing = np.arctan2(views[0, :, 2], views[0, :, 0])
    skyline, kind = _skyline(bearing, sky.sun, rng)
    elevation = np.arcsin(np.clip(views[..., 1], -1, 1))
    down = horizontal_irradiance(sky)
    if dark:  # street lamps: 0.2 to 15 lux, of sodium or white diodes
        down = down + np.exp(rng.uniform(*np.log((2e-4, 1.5e-2)))) * np.array(
            blackbody_rgb(int(rng.integers(2000, 4200)))
        )
    ground = _ground_albedo(views, rng)
    # Surrounding houses and trees hide part of the sky from the ground.
    panorama = np.where((elevation < 0)[..., None], ground * (down * rng.uniform(0.6, 0.95) / np.pi), sky.panorama)
    behind = (elevation < skyline[None, :]) & (elevation > -0.06)
    facing = (_direction(float(angle), 0.0) for angle in bearing[::8] + np.pi)
    sides = np.stack([vertical_irradiance(sky, outward, sun_share=1.0) for outward in facing])
    lit = np.stack(
        [np.interp(np.arange(len(bearing)), np.arange(0, len(bearing), 8), sides[:, k]) for k in range(3)], 1
    )
    lit = lit + 0.5 * 0.15 * down  # plus light reflected by the street
    albedo = _facades(elevation, bearing, skyline, rng) if kind == "houses" else _foliage(rng, kind)
    panorama = np.where(behind[..., None], albedo * (lit / np.pi)[None], panorama)
    if dark:
        panorama = _add_night_lights(panorama, elevation, behind & (kind == "houses"), rng)
    return replace(sky, panorama=np.ascontiguousarray(panorama, np.float32))


def _skyline(
    bearing: Float[np.ndarray, " w"], sun: Sun | None, rng: np.random.Generator
) -> tuple[Float[np.ndarray, " w"], str]:
    """Return the elevation, in radians, of the skyline at each azimuth, and its kind."""
    kind = ("houses", "trees", "hedge", "hills")[int(rng.choice(4, p=(0.34, 0.38, 0.16, 0.12)))]
    width = len(bearing)
    if kind == "houses":
        line = np.zeros(width)
        at = int(rng.integers(width))
        end = at + width
        while at < end:
            wide = int(rng.integers(6, 22))
            tall = rng.uniform(0.08, 0.6) if rng.random() < 0.8 else 0.03
            line[np.arange(at, min(at + wide, end)) % width] = tall
            at += wide
    else:
        low, high, cells = {"trees": (0.08, 0.5, 10), "hedge": (0.02, 0.1, 16), "hills": (0.02, 0.14, 4)}[kind]
        noise = fbm(rng, (8, width), (1, cells), octaves=3)[0]
        line = low + (high - low) * np.clip(0.5 + noise, 0, 1)
    if sun is not None:
        top = float(np.arcsin(sun.direction[1])) - 0.06
        off = np.arccos(np.clip(np.cos(bearing - np.arctan2(sun.direction[2], sun.direction[0])), -1, 1))
        line = np.where(off < 0.35, np.minimum(line, max(top, 0.02)), line)
    return line, kind


def _ground_albedo(views: Panorama, rng: np.random.Generator) -> Panorama:
    """Return the albedo of lawn, paving, asphalt, gravel or (seldom) snow, with noise."""
    albedos = (
        paint(rng.uniform(0.06, 0.14), 0.07, rng.uniform(115, 140)),
        paint(rng.uniform(0.15, 0.35), 0.02, rng.uniform(60, 90)),
        paint(rng.uniform(0.06, 0.12), 0.004, 250),
        paint(rng.uniform(0.1, 0.22), 0.04, rng.uniform(55, 80)),
        paint(rng.uniform(0.6, 0.8), 0.01, 240),
    )
    first = albedos[int(rng.choice(5, p=(0.42, 0.24, 0.2, 0.1, 0.04)))]
    second = albedos[int(rng.choice(4))]
    patches = np.clip(fbm(rng, _SHAPE, (8, 4), octaves=3) * 3 + 0.2, 0, 1)[..., None]
    # One ground cover near the house (steeply below), another beyond it.
    near = np.clip((-views[..., 1:2] - rng.uniform(0.2, 0.7)) * 12, 0, 1)
    share = np.clip(near + 0.2 * patches, 0, 1)
    return (np.array(first) + (np.array(second) - np.array(first)) * share).astype(np.float32)


def _foliage(rng: np.random.Generator, kind: str) -> Panorama:
    """Return the albedo of foliage, in clumps; far hills are bluer."""
    if kind == "hills":
        colour = paint(rng.uniform(0.08, 0.18), 0.03, rng.uniform(150, 240))
    else:
        colour = paint(rng.uniform(0.04, 0.1), rng.uniform(0.045, 0.08), rng.uniform(118, 145))
    clumps = fbm(rng, _SHAPE, (32, 64), octaves=2)
    return (np.array(colour) * np.clip(1 + 0.7 * clumps, 0.3, 2)[..., None]).astype(np.float32)


def _facades(
    elevation: ScalarMap, bearing: Float[np.ndarray, " w"], skyline: Float[np.ndarray, " w"], rng: np.random.Generator
) -> Panorama:
    """Return the albedo of houses: one wall colour each; windows in rows, dark by day; roofs on some."""
    out = np.zeros((*_SHAPE, 3), np.float32)
    edges = np.flatnonzero(np.diff(skyline, prepend=skyline[-1]) != 0)
    house = np.searchsorted(edges, np.arange(len(bearing)), side="right") % max(len(edges), 1)
    storey = rng.uniform(0.11, 0.17)
    for number in range(max(len(edges), 1)):
        pick = rng.random()
        if pick < 0.45:
            wall = paint(rng.uniform(0.35, 0.75), rng.uniform(0, 0.04), rng.uniform(50, 100))
        elif pick < 0.75:
            wall = paint(rng.uniform(0.1, 0.25), rng.uniform(0.05, 0.09), rng.uniform(35, 50))
        else:
            wall = paint(rng.uniform(0.1, 0.5), rng.uniform(0, 0.06), rng.uniform(0, 360))
        columns = np.flatnonzero(house == number)
        out[:, columns] = wall
        spacing = int(rng.integers(3, 6))
        rows = ((elevation[:, 0] / storey) % 1 > 0.4) & (elevation[:, 0] > -0.02)
        glass = np.ix_(rows, columns[np.arange(len(columns)) % spacing > spacing // 2])
        out[glass] = np.array([0.06, 0.07, 0.08])
        if rng.random() < 0.6:
            roof = paint(rng.uniform(0.04, 0.2), rng.uniform(0, 0.07), rng.uniform(30, 60))
            top = elevation[:, columns] > skyline[None, columns] - 0.08
            out[:, columns] = np.where(top[..., None], np.array(roof, np.float32), out[:, columns])
    return out


def _add_night_lights(
    panorama: Panorama, elevation: ScalarMap, houses: Bool[np.ndarray, "64 128"], rng: np.random.Generator
) -> Panorama:
    """Add lit windows (5 to 150 cd/m2) across the street and a few pixels of street lamps (0.2 to 3 kcd/m2)."""
    out = panorama.copy()
    candidates = np.argwhere(houses & (elevation > 0.0))
    if len(candidates):
        for row, column in candidates[rng.integers(0, len(candidates), int(rng.integers(2, 14)))]:
            glow = np.exp(rng.uniform(np.log(0.005), np.log(0.15))) * np.array(
                blackbody_rgb(int(rng.integers(2400, 4500)))
            )
            out[row : row + 2, column : column + int(rng.integers(1, 3))] += glow
    for _ in range(int(rng.integers(0, 4))):
        row = int(rng.integers(int(0.42 * HEIGHT), int(0.49 * HEIGHT)))
        column = int(rng.integers(2 * HEIGHT))
        out[row, column] += np.exp(rng.uniform(np.log(0.2), np.log(3.0))) * np.array(
            blackbody_rgb(int(rng.integers(2000, 4000)))
        )
    return out.astype(np.float32)
