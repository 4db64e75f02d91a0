"""Client of the RoomLight server: send frames, get light. It imports no engine, no ONNX Runtime and no PyTorch.

    import roomlight as rl
    from roomlight_client import Client

    with Client("http://localhost:8090") as client, client.open() as session:
        session.track("table", (0.2, 0.1, -1.5))  # world metres, y up; updated with each frame
        for frame in rl.open_capture("my-capture"):
            session.push(frame)
        light = session.light_at("table")  # or at any point, at any time: light_at((x, y, z))
        print(light.main_light, light.harmonics, light.coverage)  # coverage: observed share of the sphere
        print(light.panorama.shape)  # float32 [120, 240, 3], linear RGB, 1.0 = white in the frames

`AsyncClient` has the same names with `await`. Frames are `roomlight.frame.Frame` or, with a camera's JPEG bytes and
depth map, `CameraFrame`. Conventions: `roomlight.conventions` (world metres, y up; linear RGB); the wire format:
`docs/wire.md`. Every error is a `roomlight.errors.RoomLightError`; `errors` shows the classes.
"""

from roomlight.wire.frame_encoding import CameraFrame, FrameEncoding
from roomlight_client.async_client import AsyncClient, AsyncSession
from roomlight_client.blocking_stream import Stream
from roomlight_client.calls import PositionOrName
from roomlight_client.client import Client, Session
from roomlight_client.compositing import CompositeFile
from roomlight_client.errors import (
    BadReplyError,
    BusyError,
    ConflictError,
    GoneError,
    InvalidError,
    RefusedError,
    RemoteError,
    ServerFailedError,
    UnauthorizedError,
    UnreachableError,
)
from roomlight_client.light import Light, LightFile
from roomlight_client.memory import BufferLimits
from roomlight_client.recovery import RecoveryEvent
from roomlight_client.retry import Retry, Timeouts
from roomlight_client.stream import AsyncStream
from roomlight_client.stream_link import StreamStatus

__all__ = [
    "AsyncClient",
    "AsyncSession",
    "AsyncStream",
    "BadReplyError",
    "BufferLimits",
    "BusyError",
    "CameraFrame",
    "Client",
    "CompositeFile",
    "ConflictError",
    "FrameEncoding",
    "GoneError",
    "InvalidError",
    "Light",
    "LightFile",
    "PositionOrName",
    "RecoveryEvent",
    "RefusedError",
    "RemoteError",
    "Retry",
    "ServerFailedError",
    "Session",
    "Stream",
    "StreamStatus",
    "Timeouts",
    "UnauthorizedError",
    "UnreachableError",
]
