"""Simulate the depth maps of a phone with a LiDAR from exact depth, when a sequence is loaded.

A phone's depth is estimated by a network from a few hundred laser dots and the colour image. It is smooth; edges bleed
and follow colour; thin objects vanish; slow flicker grows with distance; depth beyond the laser's five metres is
estimated; depth on glass and mirrors is wrong. Phones, rooms and recording apps differ, so every sequence draws its own
`DepthSensor`. Depth is z-depth in millimetres, 0 = unknown.

The default ranges are centred on two measurements. Simulated phone depth of three path-traced captures: relative
deviation 0.7 % up to 4 m, 0.9 % at 5.5 m, 2.3 % at 10 m; correlated over 30 of 256 pixels and, from frame to frame,
by 0.55 (the camera rotating by 5 degrees). Real iPhone maps: almost no grain (0.05 %), edges about 6 pixels wide from
10 to 90 % of the jump (3 to 11), relief where there is only texture.
"""

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16

from roomlight.dataset.recording import GLASS, MIRROR

WIDTH: Final = 256
HEIGHT: Final = 192
LASER_M: Final = 5.0
"""Reach of the laser dots; beyond it depth is the network's estimate."""

_FLICKER_CELLS: Final = (6, 8)
_GUESS_MM: Final = 14_000
"""Largest depth that phones report."""
_MIN_INVERSE_M: Final = 0.05

Unseen = Literal["guess", "far", "hole"]
"""Depth of sky and panes: interpolated from their surroundings, far away, or unknown, as in apps that filter it."""


@dataclass(frozen=True)
class DepthSensor:
    """Error parameters of one sequence's depth.

    Attributes:
        noise: Relative standard deviation of the slow flicker near the phone.
        grain: Relative standard deviation of the noise from pixel to pixel.
        persistence: Correlation of the flicker between consecutive frames.
        scale: Relative error of all depth.
        jitter: Relative standard deviation of each frame's scale.
        bleed_px: Radius of the smoothing that follows colour.
        bleed: Share of that smoothing, 0 to 1.
        softness_px: Standard deviation of the blur of every edge.
        thin_px: Near objects thinner than this vanish.
        far_slope: Reported metres for each metre beyond `LASER_M`.
        sky: Depth of pixels that hit nothing.
        glass: Depth of panes; "pane" is the pane's own.
        mirror: Depth of mirrors: their plane's, or far away.
        through: Factor by which panes and mirrors appear farther than they are.
        relief: Relative unevenness of estimated depth.
        unseen_m: Depth of sky that is far away, in metres.
    """

    noise: float = 0.007
    grain: float = 0.001
    persistence: float = 0.7
    scale: float = 0.0
    jitter: float = 0.001
    bleed_px: int = 3
    bleed: float = 0.6
    softness_px: float = 0.6
    thin_px: int = 1
    far_slope: float = 0.8
    sky: Unseen = "guess"
    glass: Unseen | Literal["pane"] = "far"
    mirror: Literal["plane", "far"] = "far"
    through: float = 1.6
    relief: float = 0.1
    unseen_m: float = 7.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "DepthSensor":
        """Draw a sensor at random, between the clean simulations that exist and the worst real phones."""
        sky: Unseen = rng.choice(np.array(["guess", "far", "hole"]), p=[0.4, 0.25, 0.35]).item()
        glass = rng.choice(np.array(["pane", "guess", "far", "hole"]), p=[0.3, 0.2, 0.25, 0.25]).item()
        mirror = rng.choice(np.array(["plane", "far"]), p=[0.4, 0.6]).item()
        return cls(
            noise=float(np.exp(rng.normal(np.log(0.007), 0.5))),
            grain=float(rng.uniform(0.001, 0.004)) if rng.random() < 0.4 else 0.0004,
            persistence=float(rng.uniform(0.5, 0.9)),
            scale=float(rng.normal(0, 0.006)),
            jitter=float(rng.uniform(0, 0.003)),
            bleed_px=int(rng.integers(1, 6)),
            bleed=float(rng.uniform(0.1, 1.0)) if rng.random() < 0.75 else 0.0,
            softness_px=float(rng.uniform(0.3, 1.1)),
            thin_px=int(rng.choice([1, 1, 3, 3, 5])),
            far_slope=1.0 if rng.random() < 0.3 else float(rng.uniform(0.45, 1.1)),
            sky=sky,
            glass=glass,
            mirror=mirror,
            through=float(rng.uniform(1.15, 2.2)),
            relief=float(rng.uniform(0.03, 0.2)),
            unseen_m=float(rng.uniform(4.5, 10.0)),
        )


def arkit_like(
    depth_mm: UInt16[np.ndarray, "f h w"],
    surface: UInt8[np.ndarray, "f h w"],
    colour: UInt8[np.ndarray, "f h w 3"],
    rng: np.random.Generator,
    *,
    sensor: DepthSensor | None = None,
) -> UInt16[np.ndarray, "f dh dw"]:
    """Simulate phone depth of consecutive frames, 256 x 192, or 192 x 256 if they are upright (about 2 ms a frame).

    Args:
        depth_mm: Exact z-depth in millimetres, 0 where nothing is hit.
        surface: Kind of surface of each pixel (`recording.GLASS`, ...).
        colour: sRGB frames whose edges the depth follows.
        rng: The generator; the same state gives the same depth.
        sensor: Error parameters; drawn from `rng` if None.
    """
    if depth_mm.shape[1] > depth_mm.shape[2]:
        depth_mm, surface, colour = (np.rot90(maps, axes=(1, 2)) for maps in (depth_mm, surface, colour))
        level_mm = arkit_like(depth_mm, surface, colour, rng, sensor=sensor)
        return np.ascontiguousarray(np.rot90(level_mm, -1, axes=(1, 2)))
    sensor = sensor or DepthSensor.draw(rng)
    frames = len(depth_mm)
    flicker, relief = (_slow_fields(rng, frames, sensor.persistence) for _ in range(2))
    factors = 1 + sensor.scale + sensor.jitter * rng.standard_normal(frames)
    measured_mm = np.empty((frames, HEIGHT, WIDTH), np.uint16)
    for k in range(frames):
        kind = cv2.resize(surface[k], (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)
        near = cv2.resize(depth_mm[k], (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)
        true_m = near.astype(np.float32) / 1000
        bump = _enlarged(relief[k])
        perceived_m, holes = _perceived(true_m, kind, bump, sensor)
        smooth_m = _smoothed(perceived_m, _luma(colour[k]), sensor)
        slow = _enlarged(flicker[k])
        deviation = sensor.noise * np.sqrt(1 + (smooth_m / 5.5) ** 4)
        noise = slow * np.minimum(deviation, 0.08) + np.float32(factors[k])
        if sensor.grain:
            noise += np.float32(sensor.grain) * rng.standard_normal((HEIGHT, WIDTH), np.float32)
        depth = np.clip(smooth_m * noise * 1000, 1, _GUESS_MM)
        depth[holes] = 0
        measured_mm[k] = np.rint(depth)
    return measured_mm


def _perceived(
    true_m: Float[np.ndarray, "h w"],
    kind: UInt8[np.ndarray, "h w"],
    bump: Float[np.ndarray, "h w"],
    sensor: DepthSensor,
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return the depth before noise in metres, and the mask of unknown pixels."""
    sky, glass, mirror = true_m == 0, kind == GLASS, kind == MIRROR
    doubtful = sky | glass | mirror
    holes = np.zeros_like(sky)
    depth = true_m
    if doubtful.any():
        depth = true_m.copy()
        farther = true_m * (sensor.through * (1 + 2 * sensor.relief * bump))
        if mirror.any():
            uneven = true_m * (1 + sensor.relief * bump)
            depth = np.where(mirror, farther if sensor.mirror == "far" else uneven, depth)
        guess = _interpolated(true_m, ~doubtful) * (1 + sensor.relief * bump)
        for place, how, far in (
            (glass & ~sky, sensor.glass, farther),
            (sky, sensor.sky, sensor.unseen_m * (1 + sensor.relief * bump)),
        ):
            if how == "hole":
                holes |= place
            if how != "pane":
                depth = np.where(place, far if how == "far" else guess, depth)
        if holes.any():
            holes = cv2.dilate(holes.astype(np.uint8), np.ones((2, 2), np.uint8)) > 0
    past = np.maximum(depth - LASER_M, 0)
    depth = depth - (1 - sensor.far_slope) * past
    if sensor.thin_px > 1:  # laser dots miss thin objects: the background closes over them
        depth = cv2.morphologyEx(depth, cv2.MORPH_CLOSE, np.ones((sensor.thin_px, sensor.thin_px), np.uint8))
    return np.maximum(depth, 0.05).astype(np.float32), holes


def _interpolated(depth_m: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Estimate unknown depth from the inverse depths around it; nearer pixels weigh more."""
    inverse = np.where(known, 1 / np.maximum(depth_m, 0.05), 0).astype(np.float32)
    share = known.astype(np.float32)
    total, weight = np.float32(1e-6) / 4, np.float32(1e-6)  # 4 m where no pixel is known
    for size in ((32, 24), (12, 9), (4, 3)):
        fine = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (inverse, share)]
        strength = (size[0] / 32) ** 2 * 0.5 + 0.01
        fine = [cv2.resize(cv2.blur(image, (3, 3)), (32, 24), interpolation=cv2.INTER_LINEAR) for image in fine]
        total, weight = total + strength * fine[0], weight + strength * fine[1]
    mean = np.asarray(weight / total, np.float32)
    return cv2.resize(mean, depth_m.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _smoothed(
    depth_m: Float[np.ndarray, "h w"], image: Float[np.ndarray, "h w"], sensor: DepthSensor
) -> Float[np.ndarray, "h w"]:
    """Let edges bleed: a guided filter (He et al. 2010) on inverse depth, guided by an image, and a slight blur."""
    inverse = cv2.GaussianBlur(1 / depth_m, (3, 3), sensor.softness_px)
    if sensor.bleed:
        size = (2 * sensor.bleed_px + 1, 2 * sensor.bleed_px + 1)
        mean_image, mean = cv2.blur(image, size), cv2.blur(inverse, size)
        covariance = cv2.blur(image * inverse, size) - mean_image * mean
        variance = cv2.blur(image * image, size) - mean_image**2
        slope = covariance / (np.maximum(variance, 0) + np.float32(0.002))
        filtered = cv2.blur(slope, size) * (image - mean_image) + cv2.blur(mean, size)
        inverse = inverse + np.float32(sensor.bleed) * (filtered - inverse)
    return 1 / np.maximum(inverse, np.float32(_MIN_INVERSE_M))


def _luma(colour: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "192 256"]:
    grey = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def _slow_fields(rng: np.random.Generator, frames: int, persistence: float) -> Float[np.ndarray, "{frames} 6 8"]:
    """Generate coarse noise of standard deviation 1, first-order autoregressive in time."""
    fields = rng.standard_normal((frames, *_FLICKER_CELLS)).astype(np.float32)
    for k in range(1, frames):
        fields[k] = persistence * fields[k - 1] + np.sqrt(1 - persistence**2) * fields[k]
    return fields


def _enlarged(field: Float[np.ndarray, "6 8"]) -> Float[np.ndarray, "192 256"]:
    """Upsample to full size; 1.145 restores the deviation that the cubic spline averages away (measured)."""
    return np.float32(1.145) * cv2.resize(field, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
