"""The session of a replay on a server: bit for bit the same panoramas as here.

Frames travel as linear floats at the engine's working size (frame encoding `exact`), so the server's engine sees the
same numbers as one here would; panoramas come back as the floats that it holds (form `npy`).
"""

from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Final, TypeVar

from roomlight.conventions import Position
from roomlight.engine.session import FrameReport, SessionOptions
from roomlight.engine.surface.drift import NO_GAIN
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.errors import FrameError, WireError
from roomlight.frame import Frame
from roomlight.wire.messages import LightForm
from roomlight_client import BadReplyError, Client, InvalidError, Light, UnreachableError

_T = TypeVar("_T")
_PROBES_PER_CALL: Final = 16
"""5 MB of floats at 120 rows."""
_FORMS: Final = ("npy", LightForm(format="npy", use="reflection"), "confidence", "main_light")
"""The panoramas of both uses, how far each direction was observed, and the lights."""


class RemoteSession:
    """A server's session as a replay uses one. A `with` statement deletes it at the end, after errors too.

    Model, height and unknown depth are as the options say; the rest is as the server is set up.
    """

    def __init__(self, client: Client, options: SessionOptions) -> None:
        self._session = client.open(
            model=options.model,
            height=options.height,
            reference_exposure=1.0,  # frames come in its units
            unknown_depth=options.unknown_depth,
        )
        self._names: list[str] = []
        self._first: Frame | None = None
        self._grid: VolumeGrid | None = None

    def __enter__(self) -> "RemoteSession":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.__exit__(kind, error, trace)

    @property
    def model(self) -> str:
        """The model in use on the server."""
        return self._session.model

    @property
    def keyframes(self) -> int:
        """Number of keyframes that the server holds."""
        return self._with_recovery(self._session.state).keyframes

    @property
    def grid(self) -> VolumeGrid | None:
        """The lighting volume's place, which is that of the first camera; None before the first frame."""
        if self._grid is None and self._first is not None:
            volume = self._with_recovery(self._session.state).volume
            if volume is not None:
                deep, high, wide = volume.shape
                self._grid = VolumeGrid(self._first.camera_to_world, volume.depth_max_m, (deep, high, wide))
        return self._grid

    def track(self, position: Position) -> int:
        """Estimate the light at a position from now on, under a name made of its number; return the number."""
        number = len(self._names)
        name = f"probe-{number:02d}"
        self._with_recovery(lambda: self._session.track(name, position))
        self._names.append(name)
        return number

    def push(self, frame: Frame) -> FrameReport:
        """Send a frame and wait until it is processed.

        Raises:
            FrameError: The server refuses the frame; the session continues without it.
            RemoteError: The server fails.
        """
        try:
            result = self._session.push(frame)
        except WireError as error:
            raise FrameError(f"{frame.source}: {error}") from error
        except InvalidError as error:
            if error.kind != "bad-frame":
                raise
            raise FrameError(f"{frame.source}: {error}") from error
        if result.status != "processed":
            raise BadReplyError(f"frame {frame.index} is {result.status}: another program uses this session")
        self._first = self._first or frame
        coverage = tuple(result.coverage.get(name, 0.0) for name in self._names)
        red, green, blue = result.gain or NO_GAIN
        return FrameReport(frame.index, dict(result.stage_ms), bool(result.keyframe), coverage, (red, green, blue))

    def lights(self) -> Sequence[Light]:
        """Return the light at every tracked position, as the engine holds it."""
        return [
            light
            for start in range(0, len(self._names), _PROBES_PER_CALL)
            for light in self._with_recovery(
                partial(self._session.lights_at, self._names[start : start + _PROBES_PER_CALL], _FORMS)
            )
        ]

    def _with_recovery(self, call: Callable[[], _T]) -> _T:
        """Make a call; if the server is away, wait for it and bring the session up to date first."""
        try:
            return call()
        except UnreachableError:
            self._session.recover()
            return call()
