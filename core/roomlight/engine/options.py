"""Options of a session."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from annotated_types import Ge, Interval

from roomlight.depth import UnknownDepth
from roomlight.engine.networks.providers import Provider
from roomlight.engine.surface.keyframes import DEFAULT_KEYFRAMES
from roomlight.rules import check_options

ModelName = Literal["auto", "classical", "single", "video"]
"""`SessionOptions.model`."""

HEDGE: Final = 0.5
"""Default of `SessionOptions.hedge`. On 34 captures, for 0, 1/2 and 2/3: log-L2 0.93, 0.94, 0.95 of
classical's, worst capture 2.0, 1.4, 1.3, glossy sphere 0.63, 0.78, 0.84."""


@dataclass(frozen=True)
class SessionOptions:
    """Options of a session.

    Attributes:
        model: single or video (the paper's networks, on the mean volume of all frames or recurrent), classical (no
            networks), or auto: the form of `weights`, and without `weights` single.
        weights: A model folder of `roomlight export`, instead of the weights inside the package.
        hedge: Share of fills without networks in the light that networks infer; see
            `roomlight.engine.models.network_probe`.
        parts: A folder with `clipping`, `objects` or `prior` (of `roomlight train` or `dataset prior`), in place of the
            package's.
        provider: Where the networks run; auto: OpenVINO if it is installed and faster here, else ONNX Runtime (cpu).
        height: Panorama height in pixels; the width is twice that.
        keyframes: Most frames kept for positions that are requested later.
        unknown_depth: Pixels without depth: at the depth around them (rim), at the volume's far side (far), or unused
            (drop).

    Raises:
        OptionError: A value is out of range, or a name is unknown.
    """

    model: ModelName = "auto"
    weights: Path | None = None
    hedge: Annotated[float, Interval(ge=0, le=1)] = HEDGE
    parts: Path | None = None
    provider: Provider = "auto"
    height: Annotated[int, Interval(ge=16, le=2048)] = 120
    keyframes: Annotated[int, Ge(1)] = DEFAULT_KEYFRAMES
    unknown_depth: UnknownDepth = "rim"

    def __post_init__(self) -> None:
        check_options(self)
