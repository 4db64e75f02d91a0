"""The client that waits: `Client` and `Session`. One thread at a time uses a session; a client serves several."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType

import httpx

from roomlight.conventions import Position
from roomlight.depth import UnknownDepth
from roomlight.frame import Frame
from roomlight.wire.messages import FrameResult, LightForm, LightFormat, ModelName, SessionState
from roomlight_client import calls
from roomlight_client.calls import FORMS, Attempt, Call, Result, SessionCalls, T, Where
from roomlight_client.errors import RemoteError
from roomlight_client.frames import CameraFrame, Colour
from roomlight_client.light import Light, LightFile
from roomlight_client.retry import NEVER, Retry, Timeouts


class Client:
    """A connection to a server; use it in a `with` statement, or close it."""

    def __init__(
        self,
        url: str,
        *,
        token: str | None = None,
        timeouts: Timeouts | None = None,
        retry: Retry | None = None,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        """Nothing is sent yet. `transport` and `sleep` replace the network and time.

        Raises RoomLightError for a `url` or a `token` that is none.
        """
        arguments = calls.client_arguments(url, token=token, timeouts=timeouts or Timeouts())
        self._http = httpx.Client(transport=transport, **arguments)
        self._retry, self._sleep, self._url = retry or Retry(), sleep, url

    def __enter__(self) -> "Client":
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connection. Sessions stay: each ends with its own `close`, or when it has idled for long."""
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def ready(self) -> bool:
        """Whether the server takes sessions."""
        return self.run(calls.ready())

    def open(
        self,
        session_id: str | None = None,
        *,
        mode: ModelName = "auto",
        height: int = 120,
        reference_exposure: float | None = None,
        use_limited_tracking: bool = False,
        min_confidence: int = 1,
        unknown_depth: UnknownDepth = "rim",
    ) -> "Session":
        """Begin a session, or go on with the one of this id and these options (`wire.messages.SessionRequest`).

        Without an id the client makes one. Raises RemoteError; WireError for options that are none.
        """
        asked = SessionCalls(session_id)
        request = calls.session_request(
            mode=mode,
            height=height,
            reference_exposure=reference_exposure,
            use_limited_tracking=use_limited_tracking,
            min_confidence=min_confidence,
            unknown_depth=unknown_depth,
        )
        return Session(self, asked, self.run(asked.open(request)))

    def join(self, session_id: str) -> "Session":
        """A session that is there, whatever its options: GoneError if it is not."""
        asked = SessionCalls(session_id)
        return Session(self, asked, self.run(asked.state()))

    def run(self, call: Call[T], *, retry: Retry | None = None) -> T:
        """Send a call, and again as `retry` has it. Raises RemoteError."""
        attempt = Attempt(call, retry or self._retry, self._url)
        while True:
            try:
                response = self._http.request(**calls.request_arguments(call))
            except httpx.HTTPError as error:
                outcome = attempt.failed(error)
            else:
                outcome = attempt.answered(response)
            if isinstance(outcome, Result):
                return outcome.value
            self._sleep(outcome)


class Session:
    """One room on a server. In a `with` statement it is deleted at the end."""

    def __init__(self, client: Client, asked: SessionCalls, state: SessionState) -> None:
        """Made by `Client.open` and `Client.join`."""
        self._client, self._calls = client, asked
        self.id, self.model = state.id, state.model
        asked.begin(state)

    def __enter__(self) -> "Session":
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Delete the session; after an error as well as it goes, so that the error is what is seen."""
        if error is None:
            self.close()
            return
        with suppress(RemoteError):
            self._client.run(self._calls.close(), retry=NEVER)

    @property
    def next_index(self) -> int:
        """The index that the next `CameraFrame` gets: one above all that were sent."""
        return self._calls.next_index

    def push(
        self,
        frame: Frame | CameraFrame,
        index: int | None = None,
        *,
        colour: Colour = "exact",
        wait: bool = True,
        retry: bool = True,
    ) -> FrameResult:
        """Send a frame and hear what became of it.

        index:   above all that were sent; default: a `Frame`'s own, else the next.
        colour:  how a `Frame` travels.
        wait:    for the frame to be processed; else the answer is `queued` as soon as it has arrived.
        retry:   False for live streams, in which a late frame is worth nothing.

        Raises WireError for a frame that no server would take, InvalidError where this one does not, ConflictError for
        an index that is spent.
        """
        index = self._calls.reserve(frame, index)
        call = self._calls.push(frame, index, colour=colour, wait=wait)
        return self._client.run(call, retry=None if retry else NEVER)

    def light_at(self, place: Where, forms: Sequence[LightFormat | LightForm] = FORMS) -> Light:
        """The light at a point or a tracked probe; a prior before the first frame was processed (`Light.is_prior`)."""
        return self.lights_at([place], forms)[0]

    def lights_at(self, places: Sequence[Where], forms: Sequence[LightFormat | LightForm] = FORMS) -> list[Light]:
        """The light at up to 64 points, all after the same frame, in one call."""
        return self._client.run(self._calls.lights(places, forms))

    def file(
        self, place: Where, form: LightFormat | LightForm = "exr", *, unless: str | None = None
    ) -> LightFile | None:
        """One form as a file; None if its etag still is `unless`, so that nothing is sent again."""
        return self._client.run(self._calls.file(place, calls.as_form(form), unless=unless))

    def track(self, name: str, position: Position) -> None:
        """Follow a point from now on: its light then costs nothing to ask for. A name that is taken moves."""
        self._client.run(self._calls.track(name, position))

    def untrack(self, name: str) -> None:
        """No longer follow it."""
        self._client.run(self._calls.untrack(name))

    def state(self) -> SessionState:
        """Frames so far, tracked probes, coverage, memory, the lighting volume."""
        return self._client.run(self._calls.state())

    def close(self) -> None:
        """Delete the session, its frames and its light on the server."""
        self._client.run(self._calls.close())
