"""What to replay: the options that make two replays the same."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Interval

from roomlight.captures import CaptureOptions
from roomlight.conventions import Position
from roomlight.engine.session import SessionOptions
from roomlight.engine.volume.sglv import check_position
from roomlight.errors import OptionError
from roomlight.light.sources import LightUse, SavedFormat
from roomlight.placement import ABOVE_M
from roomlight.rules import check_options
from roomlight_cli.options import Flag, Without
from roomlight_cli.shared_options import POINTS, LightOptions, refuse_local_model


@dataclass(frozen=True)
class ReplayOptions:
    """What to replay and how much of it.

    Attributes:
        capture: How to read the capture.
        session: How to estimate the light.
        probes: Light this point: world metres, y up. Repeatable. Default: one point in front of the first camera, at
            60 % of its frame's median depth.
        pixels: Light a point above the surface that this pixel of the first frame that is used shows: column U, row V
            from the top left, without the distortion of its lens. Repeatable.
        above_m: Distance in metres of the points of `--pixel` from their surface.
        probes_from_capture: Light the positions of the capture's own probes.
        every: Process every n-th frame only.
        interpolate: With `--every`: interpolate the frames in between, linearly in radiance (paper, section 5.2).
        use: Write panoramas and forms of this use: lighting, to light a scene with as a dome light, or reflection, what
            a mirror shows. Pictures and the video show reflection.
        forms: Also write the light after the last frame in this form, beside its panoramas: usdz, glb, ktx2, ...
            Repeatable.
        overwrite: Replace what the output folder holds, also this replay if it is finished.
        server: Let the `roomlight serve` at this address do the work, e.g. http://host:8090.

    Raises:
        OptionError: A value is out of range, or excludes another one.
        ProbeError: A position is not finite or too far away.
    """

    capture: Annotated[CaptureOptions, Without("every")] = field(default_factory=CaptureOptions)
    session: LightOptions = field(default_factory=SessionOptions)
    probes: Annotated[tuple[Position, ...], Flag(panel=POINTS)] = ()
    pixels: Annotated[tuple[tuple[float, float], ...], Flag(panel=POINTS)] = ()
    above_m: Annotated[float, Interval(ge=0, le=10), Flag(panel=POINTS)] = ABOVE_M
    probes_from_capture: Annotated[bool, Flag(panel=POINTS)] = False
    every: Annotated[int, Ge(1)] = 1
    interpolate: bool = False
    use: LightUse = "lighting"
    forms: tuple[SavedFormat, ...] = ()
    overwrite: bool = False
    server: Annotated[str | None, Flag(metavar="URL")] = None

    def __post_init__(self) -> None:
        check_options(self)
        if self.probes_from_capture and (self.probes or self.pixels):
            raise OptionError("probes_from_capture excludes `probes` and `pixels`: give either")
        if self.interpolate and self.every == 1:
            raise OptionError("interpolate fills in the frames that `every` leaves out: add every=2 or more")
        if self.server is not None:
            refuse_local_model(self.server, self.session)
        for position in self.probes:
            check_position(position)
