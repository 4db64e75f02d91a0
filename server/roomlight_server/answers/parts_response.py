"""An HTTP response of several byte strings."""

from collections.abc import Sequence

from starlette.responses import Response
from starlette.types import Receive, Scope, Send


class PartsResponse(Response):
    """A response that is sent part after part, as fast as the client reads.

    Joining the parts would copy up to 64 MB on the event loop, while the requests of all clients wait.

    Attributes:
        size: Bytes of all parts.
    """

    def __init__(self, parts: Sequence[bytes], media_type: str) -> None:
        self._parts, self.size = parts, sum(len(part) for part in parts)
        super().__init__(media_type=media_type, headers={"Content-Length": str(self.size)})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response."""
        del scope, receive
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        for part in self._parts:
            await send({"type": "http.response.body", "body": part, "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})
