"""Score a session on walks whose exposure and white balance drift, beside the same walks without drift."""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position, linear_to_srgb8, srgb8_to_linear
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import SessionOptions
from roomlight.frame import Frame
from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator
from roomlight_evaluation.walks import Compared

FOLLOWED: Final = "drift"
STATED: Final = "drift, exposure taken as stated"
_STOPS: Final = 0.75
"""Amplitude; the range is twice that."""
_BALANCE: Final = 0.12
"""Amplitude of the logarithm of a colour's gain."""
_PERIODS: Final = np.array([17.0, 23.0, 31.0])
"""Frames of a period of red, green and blue; exposure takes the first."""


def drift_models(options: SessionOptions) -> Compared:
    """Return the same session on a walk as it is, and with drift, which it follows or is told not to expect.

    Raises:
        ModelError: The weights are missing, damaged or untrained.
    """
    graphs = choose_graphs(options)

    def exact() -> list[Estimator]:
        plain, followed, stated = (EngineEstimator(options, graphs) for _ in range(3))
        return [
            plain,
            Drifting(followed, FOLLOWED, auto_exposed=True),
            Drifting(stated, STATED, auto_exposed=False),
        ]

    return Compared(exact)


class Drifting:
    """An estimator whose frames are 8-bit pictures with `drift_gain`."""

    def __init__(self, inner: Estimator, name: str, *, auto_exposed: bool) -> None:
        """Give `inner` the frames; `auto_exposed` is as in `Frame`."""
        self.name, self._inner, self._auto_exposed, self._pushed = name, inner, auto_exposed, 0

    def push(self, frame: Frame) -> None:
        """Take the next frame."""
        image = frame.image * drift_gain(self._pushed).astype(np.float32)
        clipped = frame.clipped | (image >= 1).any(-1)
        image = srgb8_to_linear(linear_to_srgb8(image))
        self._inner.push(replace(frame, image=image, clipped=clipped, auto_exposed=self._auto_exposed))
        self._pushed += 1

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"] | None:
        """Return the panorama [h, 2h, 3] of the inner estimator at a point."""
        return self._inner.light_at(position)


def drift_gain(number: int) -> Float[np.ndarray, "3"]:
    """Return the gains of red, green and blue of the frame with this number; those of the first are 1."""
    turns = np.sin(2 * np.pi * number / _PERIODS)
    return np.exp(-_STOPS * np.log(2) * turns[0] + _BALANCE * turns)
