"""A phone's auto exposure and white balance.

Radiance is linear RGB in kcd/m2, as the transport gives it. The phone shows `radiance * gains * multiplier`, where 1.0
clips. A whole sequence has one triple of gains, and its panoramas are scaled by the same gains and the first frame's
multiplier, so that pictures, exposures and ground truth are consistent.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.conventions import LUMINANCE
from roomlight_generator.rooms.colour import blackbody_rgb
from roomlight_generator.sequences.walk import FRAME_INTERVAL_S

MAX_MULTIPLIER: Final = (250.0, 900.0)
"""Range of phones' largest multipliers: f/1.8, 1/30 s, ISO 6,400 clip at 78 N^2 / (t S) = 1.2 cd/m2, which is 850."""
PERCENTILE: Final = 80
BRIGHT_LEVEL: Final = 0.43
"""A phone shows a frame's 80th percentile of luminance at 0.43 of white: 0.41 to 0.45 in the frames of five phone
recordings, whose mean is 0.26 to 0.34 and whose median is 0.21 to 0.35."""
_HIGHLIGHT_PERCENTILE: Final = 96
_HIGHLIGHT_LEVEL: Final = 1.5
"""Exposed level of the brightest channel's 96th percentile if the meter exposes for highlights alone; white is 1."""
_FLOOR: Final = 1e-5
"""kcd/m2 of the night sky: darker pixels count as this dark, which keeps logarithms finite."""
_METER_SIZE: Final = (40, 30)
"""Width and height of the picture that is metered."""
_DEAD_BAND: Final = 0.15
"""Stops by which the meter may differ before a phone changes its exposure."""


@dataclass(frozen=True)
class MeterSettings:
    """Metering of a phone and its app.

    Attributes:
        bias, first_error: exposure offset of the sequence, and error of its first frame, in stops.
        highlights: 0 (let them clip) to 1 (expose for them alone).
        settle_s: time constant: 63 % of the way to a new brightness.
        locked: exposure stays as in the first frame, as in some AR apps.
        max_multiplier: largest multiplier per kcd/m2.
        balance: strength of the white balance, 0 (none) to 1 (full).
        grey_world: weight of the mean colour against the bright parts' colour in the white balance.
    """

    bias: float
    highlights: float
    settle_s: float
    locked: bool
    first_error: float
    max_multiplier: float
    balance: float
    grey_world: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "MeterSettings":
        """Draw a phone at random."""
        return cls(
            bias=float(rng.normal(0.15, 0.18)),
            highlights=float(rng.uniform(0.0, 0.1)),
            settle_s=float(rng.uniform(0.3, 1.5)),
            locked=bool(rng.random() < 0.25),
            first_error=float(rng.normal(0, 0.12)),
            max_multiplier=float(np.exp(rng.uniform(*np.log(MAX_MULTIPLIER)))),
            balance=float(rng.uniform(0.7, 0.95)),
            grey_world=float(rng.uniform(0.3, 0.9)),
        )


@dataclass(frozen=True, eq=False)
class Exposure:
    """A multiplier (per kcd/m2) for each frame, and the sequence's white balance as gains of red, green and blue."""

    multiplier: Float[np.ndarray, " f"]
    gains: Float[np.ndarray, "3"]

    @property
    def relative(self) -> Float[np.ndarray, " f"]:
        """Multipliers relative to the first frame's, as a recording stores them."""
        return self.multiplier / self.multiplier[0]

    def panorama(self, radiance: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
        """Convert radiance in kcd/m2 to the first frame's units: 1.0 is what the first frame shows as white."""
        scale = (self.gains * self.multiplier[0]).astype(radiance.dtype)
        return radiance * scale


def expose(
    radiance: Float[np.ndarray, "f h w 3"], rng: np.random.Generator, *, interval_s: float = FRAME_INTERVAL_S
) -> Exposure:
    """Draw a phone at random and compute its exposure and white balance over the frames of a sequence."""
    settings = MeterSettings.draw(rng)
    small = np.stack([cv2.resize(np.asarray(frame, np.float32), _METER_SIZE, interpolation=cv2.INTER_AREA)
                      for frame in radiance])  # fmt: skip
    gains = white_balance(small[0], settings)
    wanted = np.array([meter(frame * gains.astype(np.float32), settings) for frame in small])
    return Exposure(multiplier=2.0 ** settle(wanted, settings, interval_s), gains=gains)


def meter(frame: Float[np.ndarray, "h w 3"], settings: MeterSettings) -> float:
    """Return log2 of the multiplier by which one frame would be exposed.

    The 80th percentile of luminance goes to `BRIGHT_LEVEL`. Where the highlights' 96th percentile would then be above
    `_HIGHLIGHT_LEVEL`, the exposure goes the share `highlights` of the way (in stops) to the exposure that prevents it:
    phones let lamps and windows clip rather than show the room dark.
    """
    level = float(np.percentile(frame @ LUMINANCE, PERCENTILE))
    by_level = np.log2(BRIGHT_LEVEL / max(level, _FLOOR)) + settings.bias
    bright = float(np.percentile(frame.max(axis=2), _HIGHLIGHT_PERCENTILE))
    by_highlights = np.log2(_HIGHLIGHT_LEVEL / max(bright, _FLOOR)) + settings.bias
    wanted = by_level + settings.highlights * min(by_highlights - by_level, 0.0)
    return float(min(wanted, np.log2(settings.max_multiplier)))


def settle(
    wanted: Float[np.ndarray, " f"], settings: MeterSettings, interval_s: float = FRAME_INTERVAL_S
) -> Float[np.ndarray, " f"]:
    """Return the exposure of each frame, in stops, as it follows the metered one: late, and not for small changes."""
    stops = np.empty(len(wanted))
    now = float(wanted[0]) + settings.first_error
    follow = 1 - np.exp(-interval_s / settings.settle_s)
    for k, goal in enumerate(wanted):
        if k and not settings.locked and abs(goal - now) > _DEAD_BAND:
            now += follow * (float(goal) - now)
        stops[k] = now
    return stops


def white_balance(frame: Float[np.ndarray, "h w 3"], settings: MeterSettings) -> Float[np.ndarray, "3"]:
    """Compute gains that bring the frame's light part of the way (`balance`) to neutral, at equal luminance.

    The light is estimated between grey world (mean chroma of the pixels that are not black) and the bright parts'
    colour, then moved toward the nearest black body: a phone does not take a green wall for green light. Gains are
    between 0.4 and 2.5.
    """
    pixels = frame.reshape(-1, 3).astype(np.float64)
    luminance = pixels @ LUMINANCE
    lit = pixels[luminance >= max(float(np.percentile(luminance, 10)), _FLOOR)]
    if len(lit) == 0:
        return np.ones(3)
    bright = pixels[luminance >= np.percentile(luminance, 85)].mean(axis=0)
    logs = np.log(np.maximum(lit, _FLOOR / 10))
    guess = settings.grey_world * logs.mean(axis=0) + (1 - settings.grey_world) * np.log(
        np.maximum(bright, _FLOOR / 10)
    )
    chroma = guess[[0, 2]] - guess[1]
    locus = _locus()
    near = locus[np.argmin(((locus - chroma) ** 2).sum(axis=1))]
    chroma = 0.8 * near + 0.2 * chroma
    light = np.exp([chroma[0], 0.0, chroma[1]])
    light /= light @ LUMINANCE
    gains = np.clip(light**-settings.balance, 0.4, 2.5)
    return gains / ((gains * light) @ LUMINANCE)


@lru_cache(maxsize=1)
def _locus() -> Float[np.ndarray, "64 2"]:
    """Return log(red / green) and log(blue / green) of black bodies of 2,400 to 10,000 K, a phone's range."""
    bodies = np.array([blackbody_rgb(float(kelvin)) for kelvin in np.geomspace(2400, 10_000, 64)])
    return np.log(bodies[:, [0, 2]] / bodies[:, 1:2])
