"""What a phone decides before it takes a picture: how bright, and what counts as white.

Radiance is linear RGB in kilocandela per square metre, as the transport gives it. What the phone shows is
`radiance * gains * multiplier`, where 1.0 clips. The gains are one triple for a whole sequence and the panoramas take
the first frame's multiplier with the same gains, so picture, exposure and ground truth always fit together.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.colour import LUMINANCE, blackbody_rgb

MAX_MULTIPLIER: Final = (250.0, 900.0)
"""Of a phone at the end of its range. A lens of f/1.8 at 1/30 s and ISO 6,400 clips at 78 N^2 / (t S) = 1.2 cd/m2:
multiplier 850."""
_GREY: Final = 0.18
"""Where a meter puts the mean: half-way up in sRGB."""
_FLOOR: Final = 1e-5
"""kcd/m2 below which everything counts as black: the night sky, not a logarithm of zero."""
_METER_SIZE: Final = (40, 30)
_DEAD_BAND: Final = 0.15
"""Stops that the meter may be off before a phone moves at all."""


@dataclass(frozen=True)
class Habits:
    """How one phone and its app meter. `bias` in stops; `highlights` 0 (ignore them) to 1 (expose for them alone);
    `settle_s` to come 63 % of the way to a new brightness; `locked` as AR apps do; `balance` 0 (none) to 1 (full)."""

    bias: float
    highlights: float
    settle_s: float
    locked: bool
    first_error: float
    max_multiplier: float
    balance: float
    grey_world: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Habits":
        """One phone at random."""
        return cls(
            bias=float(rng.normal(0.35, 0.4)),
            highlights=float(rng.uniform(0.2, 0.8)),
            settle_s=float(rng.uniform(0.3, 1.5)),
            locked=bool(rng.random() < 0.25),
            first_error=float(rng.normal(0, 0.12)),
            max_multiplier=float(np.exp(rng.uniform(*np.log(MAX_MULTIPLIER)))),
            balance=float(rng.uniform(0.7, 0.95)),
            grey_world=float(rng.uniform(0.3, 0.9)),
        )


@dataclass(frozen=True, eq=False)
class Exposure:
    """What was decided: a multiplier for each frame, the sequence's white balance."""

    multiplier: Float[np.ndarray, " f"]
    gains: Float[np.ndarray, "3"]

    @property
    def relative(self) -> Float[np.ndarray, " f"]:
        """Multipliers over the first frame's: what a recording stores."""
        return self.multiplier / self.multiplier[0]

    def panorama(self, radiance: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
        """Radiance in kcd/m2 in the first frame's units: 1.0 is what the first frame shows as white."""
        scale = (self.gains * self.multiplier[0]).astype(radiance.dtype)
        return radiance * scale


def expose(radiance: Float[np.ndarray, "f h w 3"], rng: np.random.Generator) -> Exposure:
    """Auto exposure and white balance of one phone, drawn at random, over the frames of a sequence."""
    habits = Habits.draw(rng)
    small = np.stack([cv2.resize(np.asarray(frame, np.float32), _METER_SIZE, interpolation=cv2.INTER_AREA)
                      for frame in radiance])  # fmt: skip
    gains = white_balance(small[0], habits)
    wanted = np.array([meter(frame * gains.astype(np.float32), habits) for frame in small])
    return Exposure(multiplier=2.0 ** settle(wanted, habits), gains=gains)


def meter(frame: Float[np.ndarray, "h w 3"], habits: Habits) -> float:
    """log2 of the multiplier that one frame asks for.

    The centre-weighted log-average goes to mid grey, unless highlights would clip: the brightest channel's 96th
    percentile is also asked to stay below white, and `highlights` says how far that counts.
    """
    height, width = frame.shape[:2]
    y, x = np.mgrid[:height, :width]
    off = ((x + 0.5) / width - 0.5) ** 2 + ((y + 0.5) / height - 0.5) ** 2
    weight = 0.35 + np.exp(-off / 0.08)
    log_mean = float((weight * np.log2(frame @ LUMINANCE + _FLOOR)).sum() / weight.sum())
    by_mean = np.log2(_GREY) - log_mean + habits.bias
    bright = float(np.percentile(frame.max(axis=2), 96))
    by_highlights = np.log2(0.9 / max(bright, _FLOOR)) + habits.bias
    wanted = by_mean + habits.highlights * min(by_highlights - by_mean, 0.0)
    return float(min(wanted, np.log2(habits.max_multiplier)))


def settle(wanted: Float[np.ndarray, " f"], habits: Habits, interval_s: float = 1 / 3) -> Float[np.ndarray, " f"]:
    """What the phone shows while its meter says `wanted`, both in stops: late, and not at all for small changes."""
    stops = np.empty(len(wanted))
    now = float(wanted[0]) + habits.first_error
    follow = 1 - np.exp(-interval_s / habits.settle_s)
    for k, goal in enumerate(wanted):
        if k and not habits.locked and abs(goal - now) > _DEAD_BAND:
            now += follow * (float(goal) - now)
        stops[k] = now
    return stops


def white_balance(frame: Float[np.ndarray, "h w 3"], habits: Habits) -> Float[np.ndarray, "3"]:
    """Gains that bring the frame's light part of the way (`balance`) to neutral, at equal luminance.

    The light is guessed between grey world (mean chroma of what is not black) and the bright parts' colour, then
    brought near the black body of like chroma: a phone takes no wall's green for light. Gains between 0.4 and 2.5.
    """
    pixels = frame.reshape(-1, 3).astype(np.float64)
    luminance = pixels @ LUMINANCE
    lit = pixels[luminance >= max(float(np.percentile(luminance, 10)), _FLOOR)]
    if len(lit) == 0:
        return np.ones(3)
    bright = pixels[luminance >= np.percentile(luminance, 85)].mean(axis=0)
    logs = np.log(np.maximum(lit, _FLOOR / 10))
    guess = habits.grey_world * logs.mean(axis=0) + (1 - habits.grey_world) * np.log(np.maximum(bright, _FLOOR / 10))
    chroma = guess[[0, 2]] - guess[1]
    locus = _locus()
    near = locus[np.argmin(((locus - chroma) ** 2).sum(axis=1))]
    chroma = 0.8 * near + 0.2 * chroma
    light = np.exp([chroma[0], 0.0, chroma[1]])
    light /= light @ LUMINANCE
    gains = np.clip(light**-habits.balance, 0.4, 2.5)
    return gains / ((gains * light) @ LUMINANCE)


@lru_cache(maxsize=1)
def _locus() -> Float[np.ndarray, "64 2"]:
    """log(red / green) and log(blue / green) of black bodies; phones look for no warmer light."""
    bodies = np.array([blackbody_rgb(float(kelvin)) for kelvin in np.geomspace(2400, 10_000, 64)])
    return np.log(bodies[:, [0, 2]] / bodies[:, 1:2])
