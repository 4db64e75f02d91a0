"""What a stream of estimated depth knows between two frames."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from roomlight.monocular.fitting import Fit
from roomlight.monocular.floor import FloorFit
from roomlight.monocular.tracks import View


@dataclass
class StreamState:
    """What a stream knows after its last frame.

    Attributes:
        views: Keyframes.
        last: The last frame.
        motion: Of the last frames: log ratio of triangulated to estimated inverse depth, and weight.
        fit: Scale and shift of the last frame.
        floors: The camera's height in each of the last frames, until features move.
        unmoved: Whether none has moved yet.
        per_metre: Times 1 / depth in the stream's unit: 1 / depth in metres.
    """

    views: list[View] = field(default_factory=list[View])
    last: View | None = None
    motion: list[Float[np.ndarray, "_ 2"]] = field(default_factory=list[Float[np.ndarray, "_ 2"]])
    fit: Fit | None = None
    floors: list[FloorFit | None] = field(default_factory=list[FloorFit | None])
    unmoved: bool = True
    per_metre: float = 1.0
