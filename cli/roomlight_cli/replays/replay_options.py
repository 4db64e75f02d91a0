"""What to replay: the options that make two replays the same."""

from dataclasses import dataclass, field

from roomlight.captures import CaptureOptions
from roomlight.conventions import Position
from roomlight.engine.session import SessionOptions
from roomlight.engine.volume.sglv import check_position
from roomlight.errors import OptionError
from roomlight.placement import ABOVE_M


@dataclass(frozen=True)
class ReplayOptions:
    """What to replay and how much of it.

    Attributes:
        capture: How to read the capture.
        session: How to estimate the light.
        probes: Positions to light, world metres. Without `probes` and `pixels`: the capture's own probes if
            `probes_from_capture`, else one point on the first frame's optical axis, at 60 % of its median depth.
        pixels: (column, row) in the first frame's colour image: points to light besides, `above_m` metres above the
            surface that each pixel shows.
        above_m: Distance of the `pixels` points from their surfaces.
        probes_from_capture: Light the capture's own probes.
        every: Light every n-th frame of the capture.
        interpolate: Also write the frames in between, linearly interpolated in radiance (paper, section 5.2).
        overwrite: Replace what the output folder holds.
        server: Address of the server that the session is on; None runs the engine here.
    """

    capture: CaptureOptions = field(default_factory=CaptureOptions)
    session: SessionOptions = field(default_factory=SessionOptions)
    probes: tuple[Position, ...] = ()
    pixels: tuple[tuple[float, float], ...] = ()
    above_m: float = ABOVE_M
    probes_from_capture: bool = False
    every: int = 1
    interpolate: bool = False
    overwrite: bool = False
    server: str | None = None

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            OptionError: `every` is below 1.
            ProbeError: A position is not finite or too far away.
        """
        if self.every < 1:
            raise OptionError(f"every is {self.every}; it must be 1 or more")
        for position in self.probes:
            check_position(position)
