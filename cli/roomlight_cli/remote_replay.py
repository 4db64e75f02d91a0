"""A replay whose session is behind a server: the same loop, and bit for bit the same panoramas.

Frames travel as linear floats at the engine's working size (`sdk.frames`, colour `exact`), so the server's engine sees
the very numbers that one here would see; panoramas come back as the floats that it holds (form `npy`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.session import FrameReport, SessionOptions
from roomlight.engine.volume import VolumeGrid
from roomlight.errors import FrameError, WireError
from roomlight.frame import Frame
from roomlight_cli.replay import Progress, ReplayOptions, ReplayResult, replay
from roomlight_client import BadReplyError, Client, InvalidError

_AT_ONCE = 16
"""Probes asked for in one call: 5 MB of floats at 120 rows."""


@dataclass(frozen=True)
class RemoteLight:
    """The light at a probe: panorama [H, 2H, 3], linear RGB float32."""

    position: Position
    panorama: Float[np.ndarray, "h w 3"]
    coverage: float


class RemoteSession:
    """A server's session as a replay uses one. In a `with` statement it is deleted at the end, whatever happens."""

    def __init__(self, client: Client, options: SessionOptions) -> None:
        """Open it: model, height and unknown depth as the options say, the rest as the server is set up."""
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
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Delete the session."""
        self._session.__exit__(kind, error, trace)

    @property
    def model(self) -> str:
        """The model in use on the server."""
        return self._session.model

    @property
    def keyframes(self) -> int:
        """Keyframes that the server holds."""
        return self._session.state().keyframes

    @property
    def grid(self) -> VolumeGrid | None:
        """The volume's frame, which stands where the first camera stood; None before the first frame."""
        if self._grid is None and self._first is not None:
            volume = self._session.state().volume
            if volume is not None:
                deep, high, wide = volume.shape
                self._grid = VolumeGrid(self._first.camera_to_world, volume.depth_max_m, (deep, high, wide))
        return self._grid

    def track(self, position: Position) -> int:
        """Follow a position under a name made of its number; returns the number."""
        number = len(self._names)
        self._session.track(f"probe-{number:02d}", position)
        self._names.append(f"probe-{number:02d}")
        return number

    def push(self, frame: Frame) -> FrameReport:
        """Send a frame and wait until it is processed. FrameError if the server refuses it; all goes on without it."""
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
        return FrameReport(frame.index, dict(result.stage_ms), bool(result.keyframe), coverage)

    def lights(self) -> Sequence[RemoteLight]:
        """The light at every tracked position, as the engine holds it."""
        return [
            RemoteLight(light.position, light.panorama, light.coverage)
            for start in range(0, len(self._names), _AT_ONCE)
            for light in self._session.lights_at(self._names[start : start + _AT_ONCE], ("npy",))
        ]


def replay_through(
    server: str,
    path: Path,
    out: Path,
    options: ReplayOptions,
    *,
    token: str | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """`replay` by the session of a server. Raises RoomLightError, RemoteError among them."""
    with Client(server, token=token) as client, RemoteSession(client, options.session) as session:
        return replay(path, out, replace(options, server=server), session=session, progress=progress)
