"""Options of a session, and the size at which it works."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, get_args

from roomlight.depth import UnknownDepth
from roomlight.engine.networks.providers import Provider
from roomlight.engine.surface.keyframes import DEFAULT_KEYFRAMES
from roomlight.errors import OptionError

ModelName = Literal["auto", "classical", "single", "video"]
"""`SessionOptions.model`."""

HEDGE: Final = 0.5
"""Default of `SessionOptions.hedge`: 0.65 lowers log-L2 by 1 % and raises the glossy sphere's error by 8 %."""
WORKING_SIZE: Final = (320, 240)
"""Frames are reduced to this size (width, height; swapped for upright images), the paper's: eight pixels for one of a
panorama of 120 rows."""


@dataclass(frozen=True)
class SessionOptions:
    """Options of a session.

    Attributes:
        model: classical (no networks), single or video (the paper's networks), or auto: the network form of `weights`,
            and without `weights` classical. On streams of 35 captures that no choice was made with, the networks inside
            the package had 1.0 to 1.2 of warp-and-fill's log-L2, classical 0.82 to 0.94.
        weights: a model directory of `roomlight export`, instead of the weights inside the package.
        hedge: share of the classical fill in the light that networks infer, 0 to 1; see `network_backend`.
        parts: a folder with the model directories `clipping` and `objects`, instead of those inside the package.
        provider: runs the networks: openvino, cpu, or auto (OpenVINO if it is installed and supported).
        height: rows of the panoramas, 16 to 2048; they have twice as many columns.
        keyframes: most frames kept for positions that are requested later, 1 or more.
        unknown_depth: where pixels without depth are placed (`roomlight.depth`).

    Raises:
        OptionError: a value is out of range, or a name is unknown.
    """

    model: ModelName = "auto"
    weights: Path | None = None
    hedge: float = HEDGE
    parts: Path | None = None
    provider: Provider = "auto"
    height: int = 120
    keyframes: int = DEFAULT_KEYFRAMES
    unknown_depth: UnknownDepth = "rim"

    def __post_init__(self) -> None:
        for name, allowed in (
            ("model", ModelName),
            ("provider", Provider),
            ("unknown_depth", UnknownDepth),
        ):
            if getattr(self, name) not in get_args(allowed):
                raise OptionError(f"{name} must be one of {', '.join(get_args(allowed))}; got {getattr(self, name)!r}")
        if not 0 <= self.hedge <= 1:
            raise OptionError(f"hedge must be 0 (networks alone) to 1 (the classical fill alone), got {self.hedge}")
        if not 16 <= self.height <= 2048:
            raise OptionError(f"height must be 16 to 2048 rows of the panorama, got {self.height}")
        if self.keyframes < 1:
            raise OptionError(f"keyframes must be 1 or more, got {self.keyframes}")
