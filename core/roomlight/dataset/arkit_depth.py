"""Depth as a phone with a LiDAR gives it, made from exact depth when a sequence is loaded.

Such depth is a network's guess, led by a few hundred laser dots and by the colour picture: smooth, with edges that
bleed and follow colour, thin things lost, slow flicker that grows with distance, guesses beyond the laser's five
metres, and nonsense on glass and mirrors. Phones, rooms and recording apps differ, so every sequence draws its own
`DepthSensor`. Depth is z-depth in millimetres, 0 = unknown; confidence is 0, 1 or 2 as ARKit's.

The default range is laid around two measurements. Simulated phone depth of three path-traced captures: relative
deviation 0.7 % up to 4 m, 0.9 % at 5.5 m, 2.3 % at 10 m; alike over 30 of 256 pixels and, from frame to frame, by
0.55 (the camera turning by 5 degrees). Real iPhone maps: next to no grain (0.05 %), edges some 6 pixels wide from 10
to 90 % of the jump (3 to 11), relief where there is only texture.
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
"""Farther than this there are no dots, only the network's idea."""

_FLICKER_CELLS: Final = (6, 8)
_GUESS_MM: Final = 14_000
"""No phone says more."""
_LEAST_INVERSE: Final = 0.05
_KNOWN: Final = np.uint8(2)

Unseen = Literal["guess", "far", "hole"]
"""Sky and panes: smoothly filled from around, put far away, or left out as apps that filter do."""


@dataclass(frozen=True)
class DepthSensor:
    """How bad one sequence's depth is.

    noise: relative deviation of the slow flicker near the phone; grain: of the noise from pixel to pixel; hold: how
    alike the flicker is from frame to frame; scale: relative error of everything; jitter: that of each frame.
    bleed_px, bleed: reach and share of the smoothing that follows colour; softness_px: of every edge. thin_px: near
    things thinner than this vanish. far_slope: metres told for each metre past `LASER_M`. through: how much farther
    than they are panes and mirrors seem, relief how uneven.
    """

    noise: float = 0.007
    grain: float = 0.001
    hold: float = 0.7
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
        """One at random, from the clean simulations that are about to the worst of the real ones."""
        sky: Unseen = rng.choice(np.array(["guess", "far", "hole"]), p=[0.4, 0.25, 0.35]).item()
        glass = rng.choice(np.array(["pane", "guess", "far", "hole"]), p=[0.3, 0.2, 0.25, 0.25]).item()
        mirror = rng.choice(np.array(["plane", "far"]), p=[0.4, 0.6]).item()
        return cls(
            noise=float(np.exp(rng.normal(np.log(0.007), 0.5))),
            grain=float(rng.uniform(0.001, 0.004)) if rng.random() < 0.4 else 0.0004,
            hold=float(rng.uniform(0.5, 0.9)),
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


def exact(depth_mm: UInt16[np.ndarray, "f h w"]) -> tuple[UInt16[np.ndarray, "f h w"], UInt8[np.ndarray, "f h w"]]:
    """The depth itself, with full confidence wherever there is any."""
    return depth_mm, np.where(depth_mm > 0, _KNOWN, np.uint8(0))


def arkit_like(
    depth_mm: UInt16[np.ndarray, "f h w"],
    surface: UInt8[np.ndarray, "f h w"],
    colour: UInt8[np.ndarray, "f h w 3"] | None,
    rng: np.random.Generator,
    *,
    sensor: DepthSensor | None = None,
) -> tuple[UInt16[np.ndarray, "f 192 256"], UInt8[np.ndarray, "f 192 256"]]:
    """Phone-like depth and confidence of consecutive frames, 256 x 192 (some 2 ms a frame).

    surface says what each pixel is (`recording.GLASS`, ...); colour, the sRGB frames, leads the edges where given. The
    sensor is drawn from rng unless given; the same generator state gives the same depth.
    """
    sensor = sensor or DepthSensor.draw(rng)
    frames = len(depth_mm)
    flicker, relief = (_slow_fields(rng, frames, sensor.hold) for _ in range(2))
    factors = 1 + sensor.scale + sensor.jitter * rng.standard_normal(frames)
    told = np.empty((frames, HEIGHT, WIDTH), np.uint16)
    confidence = np.empty((frames, HEIGHT, WIDTH), np.uint8)
    for k in range(frames):
        kind = cv2.resize(surface[k], (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)
        near = cv2.resize(depth_mm[k], (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)
        true_m = near.astype(np.float32) / 1000
        bump = _enlarged(relief[k])
        believed_m, holes, doubtful = _believed(true_m, kind, bump, sensor)
        guide = None if colour is None else _luma(colour[k])
        smooth_m = _smoothed(believed_m, guide, sensor)
        slow = _enlarged(flicker[k])
        deviation = sensor.noise * np.sqrt(1 + (smooth_m / 5.5) ** 4)
        noise = slow * np.minimum(deviation, 0.08) + np.float32(factors[k])
        if sensor.grain:
            noise += np.float32(sensor.grain) * rng.standard_normal((HEIGHT, WIDTH), np.float32)
        depth = np.clip(smooth_m * noise * 1000, 1, _GUESS_MM)
        depth[holes] = 0
        told[k] = np.rint(depth)
        confidence[k] = _confidence(believed_m, slow, holes, doubtful)
    return told, confidence


def _believed(
    true_m: Float[np.ndarray, "h w"],
    kind: UInt8[np.ndarray, "h w"],
    bump: Float[np.ndarray, "h w"],
    sensor: DepthSensor,
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """What the phone takes for the room, where it says nothing, and where it should not be trusted."""
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
        guess = _from_around(true_m, ~doubtful) * (1 + sensor.relief * bump)
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
    if sensor.thin_px > 1:  # dots miss thin things: the background closes over them
        depth = cv2.morphologyEx(depth, cv2.MORPH_CLOSE, np.ones((sensor.thin_px, sensor.thin_px), np.uint8))
    return np.maximum(depth, 0.05).astype(np.float32), holes, doubtful


def _from_around(depth_m: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """A smooth guess for what is unknown, from the inverse depths around: the nearer, the more they count."""
    inverse = np.where(known, 1 / np.maximum(depth_m, 0.05), 0).astype(np.float32)
    share = known.astype(np.float32)
    total, weight = np.float32(1e-6) / 4, np.float32(1e-6)  # 4 m where nothing at all is known
    for size in ((32, 24), (12, 9), (4, 3)):
        fine = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (inverse, share)]
        strength = (size[0] / 32) ** 2 * 0.5 + 0.01
        fine = [cv2.resize(cv2.blur(image, (3, 3)), (32, 24), interpolation=cv2.INTER_LINEAR) for image in fine]
        total, weight = total + strength * fine[0], weight + strength * fine[1]
    mean = np.asarray(weight / total, np.float32)
    return cv2.resize(mean, depth_m.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _smoothed(
    depth_m: Float[np.ndarray, "h w"], guide: Float[np.ndarray, "h w"] | None, sensor: DepthSensor
) -> Float[np.ndarray, "h w"]:
    """Edges bleed: a guided filter (He et al. 2010) on inverse depth, led by luma, mixed with a little plain blur."""
    inverse = cv2.GaussianBlur(1 / depth_m, (3, 3), sensor.softness_px)
    if sensor.bleed:
        image = inverse if guide is None else guide
        size = (2 * sensor.bleed_px + 1, 2 * sensor.bleed_px + 1)
        mean_image, mean = cv2.blur(image, size), cv2.blur(inverse, size)
        covariance = cv2.blur(image * inverse, size) - mean_image * mean
        variance = cv2.blur(image * image, size) - mean_image**2
        slope = covariance / (np.maximum(variance, 0) + np.float32(0.002))
        filtered = cv2.blur(slope, size) * (image - mean_image) + cv2.blur(mean, size)
        inverse = inverse + np.float32(sensor.bleed) * (filtered - inverse)
    return 1 / np.maximum(inverse, np.float32(_LEAST_INVERSE))


def _confidence(
    depth_m: Float[np.ndarray, "h w"],
    slow: Float[np.ndarray, "h w"],
    holes: Bool[np.ndarray, "h w"],
    doubtful: Bool[np.ndarray, "h w"],
) -> UInt8[np.ndarray, "h w"]:
    """2 on plain surfaces within the laser's reach, 1 at edges and farther, 0 on jumps, panes, sky and far away."""
    square = np.ones((5, 5), np.uint8)
    jump = (cv2.dilate(depth_m, square) - cv2.erode(depth_m, square)) / depth_m
    wobble = 1 + np.float32(0.05) * slow
    level = np.full(depth_m.shape, _KNOWN)
    level[(jump > 0.12 * wobble) | (depth_m > (LASER_M - 0.3) * wobble)] = 1
    level[(jump > 0.4 * wobble) | (depth_m > (LASER_M + 1.2) * wobble) | doubtful | holes] = 0
    return level


def _luma(colour: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "192 256"]:
    grey = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def _slow_fields(rng: np.random.Generator, frames: int, hold: float) -> Float[np.ndarray, "{frames} 6 8"]:
    """Coarse noise of deviation 1 that lives on from frame to frame (first-order autoregressive)."""
    fields = rng.standard_normal((frames, *_FLICKER_CELLS)).astype(np.float32)
    for k in range(1, frames):
        fields[k] = hold * fields[k - 1] + np.sqrt(1 - hold**2) * fields[k]
    return fields


def _enlarged(field: Float[np.ndarray, "6 8"]) -> Float[np.ndarray, "192 256"]:
    """To full size; 1.145 makes up for what the cubic spline averages away (measured)."""
    return np.float32(1.145) * cv2.resize(field, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
