"""RoomLight over the network: frames in, light out. Needs no engine: no ONNX Runtime, no PyTorch is imported.

    from pathlib import Path
    from roomlight.captures import open_capture
    from roomlight_client import Client

    with Client("http://localhost:8090") as client, client.open() as session:
        session.track("table", (0.2, 0.1, -1.5))  # world metres, y up: followed from frame to frame
        for frame in open_capture(Path("my-capture")):
            session.push(frame)
        light = session.light_at("table")  # or any point, asked at any time: light_at((x, y, z))
        print(light.main_light, light.harmonics, light.coverage)  # what shades, and how much of it was seen
        print(light.panorama.shape)  # float32 [120, 240, 3], linear RGB, 1.0 = white in the frames

`AsyncClient` has the same names with `await`. Frames are `roomlight.frame.Frame` or, as a camera gives them,
`CameraFrame`. Conventions: `roomlight.conventions` (world metres, y up; linear RGB); the wire: `server/WIRE.md`.
Everything that can go wrong is a RoomLightError: see `errors`.
"""

from roomlight_client.async_client import AsyncClient, AsyncSession
from roomlight_client.calls import Where
from roomlight_client.client import Client, Session
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
from roomlight_client.frames import CameraFrame, Colour
from roomlight_client.light import Light, LightFile
from roomlight_client.retry import Retry, Timeouts

__all__ = [
    "AsyncClient",
    "AsyncSession",
    "BadReplyError",
    "BusyError",
    "CameraFrame",
    "Client",
    "Colour",
    "ConflictError",
    "GoneError",
    "InvalidError",
    "Light",
    "LightFile",
    "RefusedError",
    "RemoteError",
    "Retry",
    "ServerFailedError",
    "Session",
    "Timeouts",
    "UnauthorizedError",
    "UnreachableError",
    "Where",
]
