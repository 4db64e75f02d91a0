"""The blocking client: `Client` and `Session`. A session belongs to one thread at a time; a client may be shared."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import httpx

from roomlight.conventions import Position
from roomlight.depth import UnknownDepth
from roomlight.frame import Frame
from roomlight.wire.compositing import (
    CompositeFormat,
    CompositeObject,
    CompositeQuality,
    ObjectFormat,
    ObjectInfo,
    ObjectList,
)
from roomlight.wire.frame_encoding import CameraFrame, FrameEncoding
from roomlight.wire.messages import FrameResult, LightForm, LightFormat, ModelName, SessionRequest, SessionState
from roomlight_client import _waiting, calls
from roomlight_client.blocking_stream import Stream
from roomlight_client.calls import DEFAULT_FORMS, Attempt, Call, Forms, PositionOrName, Result, SessionCalls, T
from roomlight_client.compositing import CompositeFile, composite_request, object_file
from roomlight_client.errors import RemoteError
from roomlight_client.light import Light, LightFile
from roomlight_client.memory import BufferLimits
from roomlight_client.recovery import ClientOptions, Pause, Recovery, RecoveryEvent, Restore, Resumed, Send, Steps
from roomlight_client.retry import NO_RETRY, RECONNECT, Retry, Timeouts
from roomlight_client.stream_link import StreamHandlers, StreamLink, StreamStatus


class Client:
    """A connection to a server. Use it in a `with` statement, or call `close`.

    Args:
        url: The server's address, e.g. http://localhost:8090. The constructor does not connect.
        token: Sent as a bearer token. A session belongs to the token that opened it.
        timeouts: Timeouts of each attempt.
        retry: Number of attempts and their delays.
        reconnect: The same for pushes and streams whose server is away; by default `retry` if it is given, else for
            about eight minutes.
        buffer: Bounds of the frames that are kept to be sent again.
        on_recovery: Is told when pushes wait for a server, and when a session was brought up to date.
        transport: Replaces the network.

    Raises:
        OptionError: If `url` or `token` is invalid.
    """

    def __init__(
        self,
        url: str,
        *,
        token: str | None = None,
        timeouts: Timeouts | None = None,
        retry: Retry | None = None,
        reconnect: Retry | None = None,
        buffer: BufferLimits | None = None,
        on_recovery: Callable[[RecoveryEvent], object] | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        arguments = calls.client_arguments(url, token=token)
        self._http = httpx.Client(transport=transport, **arguments)
        self.options = ClientOptions(
            url=url,
            token=token,
            timeouts=timeouts or Timeouts(),
            retry=retry or Retry(),
            reconnect=reconnect or retry or RECONNECT,
            buffer=buffer or BufferLimits(),
            notify=on_recovery,
        )

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection. Sessions stay on the server until their own `close`, or until they expire."""
        self._http.close()

    def ready(self) -> bool:
        """Return whether the server accepts sessions.

        Raises:
            RemoteError: If the server does not respond.
        """
        return self.run(calls.ready())

    def open(
        self,
        session_id: str | None = None,
        *,
        model: ModelName = "auto",
        height: int = 120,
        reference_exposure: float | None = None,
        use_limited_tracking: bool = False,
        min_confidence: int = 1,
        unknown_depth: UnknownDepth = "rim",
    ) -> "Session":
        """Open a session, or continue an existing one with the same id and options.

        Args:
            session_id: 1 to 64 of the characters A-Z a-z 0-9 _ -; by default a random one.
            model: `auto` is the server's default model.
            height: Of the panoramas, in pixels; they are twice as wide.
            reference_exposure: Exposure that shows radiance 1.0 as white; by default the first frame's.
            use_limited_tracking: Use frames whose tracking state is `limited`, too.
            min_confidence: Depth pixels with a lower confidence (0 to 2) are unknown.
            unknown_depth: Where the engine puts pixels of unknown depth.

        Raises:
            ConflictError: If the session exists with other options; `field` names the first that differs, `value` is
                the requested value.
            RemoteError: If the server refuses or does not respond.
            WireError: If an option is out of range.
            OptionError: If the id is invalid.
        """
        session_calls = SessionCalls(session_id)
        request = calls.session_request(
            model=model,
            height=height,
            reference_exposure=reference_exposure,
            use_limited_tracking=use_limited_tracking,
            min_confidence=min_confidence,
            unknown_depth=unknown_depth,
        )
        state = self.run(session_calls.open(request))
        return Session(self, session_calls, state, request)

    def join(self, session_id: str) -> "Session":
        """Continue an existing session, whatever its options.

        Raises:
            GoneError: If there is no such session.
            RemoteError: If the server refuses or does not respond.
            OptionError: If the id is invalid.
        """
        session_calls = SessionCalls(session_id)
        state = self.run(session_calls.state())
        return Session(self, session_calls, state, None)

    def upload(
        self, source: str | Path | bytes, kind: ObjectFormat | None = None, *, session_id: str | None = None
    ) -> ObjectInfo:
        """Store an object on the server for composites; a file that it holds already is not stored again.

        Args:
            source: A GLB, glTF, OBJ or PLY file: its path or its bytes.
            kind: The format; needed for the bytes of an OBJ.
            session_id: Id of the session that uses it; needed where a proxy shares sessions among servers.

        Raises:
            OptionError: If the session id is invalid.
            ObjectError: If the file cannot be read.
            InvalidError: If the server refuses the file.
            ConflictError: If the objects of this token would take too much memory.
        """
        return self.run(calls.upload(*object_file(source, kind), session_id))

    def objects(self, *, session_id: str | None = None) -> ObjectList:
        """Return the objects of this token on the server, their memory and its limit; `session_id` as in `upload`."""
        return self.run(calls.list_objects(session_id))

    def delete_object(self, object_id: str, *, session_id: str | None = None) -> None:
        """Delete an object on the server; `session_id` as in `upload`. A missing one is not an error."""
        self.run(calls.delete_object(object_id, session_id))

    def run(self, call: Call[T], *, retry: Retry | None = None) -> T:
        """Send a call and return its result. `retry` replaces the client's policy.

        Raises:
            RemoteError: If no attempt succeeds, or the client was closed.
        """
        attempt = Attempt(call, retry or self.options.retry, self.options.url)
        while True:
            calls.check_open(closed=self._http.is_closed)
            try:
                response = self._http.request(**calls.request_arguments(call, self.options.timeouts))
            except httpx.HTTPError as error:
                outcome = attempt.failed(error)
            else:
                outcome = attempt.answered(response)
            if isinstance(outcome, Result):
                return outcome.value
            _waiting.wait(outcome)

    def follow(self, steps: Steps[T]) -> T:
        """Run the steps of a call that survives a restart of the server.

        Raises:
            RemoteError: If they fail in the end.
        """
        try:
            step = next(steps)
            while True:
                try:
                    value = self._take(step)
                except RemoteError as error:
                    step = steps.throw(error)
                else:
                    step = steps.send(value)
        except StopIteration as end:
            return end.value

    def _take(self, step: Send | Pause | Restore) -> Any:
        if isinstance(step, Restore):
            return self.follow(step.recovery.restore())
        if isinstance(step, Pause):
            return _waiting.wait(step.seconds)
        return self.run(step.call, retry=step.retry)


class Session:
    """One room on a server, made by `Client.open` or `Client.join`. A `with` statement deletes it at its end.

    Every method raises a `RemoteError` if the server refuses the call or does not respond; `GoneError` is the one for
    a session that was deleted or has expired.

    Attributes:
        id: The session's id.
        model: The model that estimates the light: classical, single or video.
    """

    def __init__(
        self, client: Client, session_calls: SessionCalls, state: SessionState, request: SessionRequest | None
    ) -> None:
        self._client, self._calls = client, session_calls
        self._recovery = Recovery(session_calls, request, client.options)
        self.id, self.model = state.id, state.model
        session_calls.resume(state)

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object, /) -> None:
        if error is None:
            self.close()
            return
        self._recovery.memory.deleted = True
        with suppress(RemoteError):  # the error of the block is the one to show
            self._client.run(self._calls.close(), retry=NO_RETRY)

    @property
    def next_index(self) -> int:
        """The index of the next `CameraFrame`: one above all indices sent."""
        return self._calls.next_index

    def push(
        self,
        frame: Frame | CameraFrame,
        index: int | None = None,
        *,
        colour: FrameEncoding = "exact",
        wait: bool = True,
        retry: bool | Literal["without answer"] = True,
    ) -> FrameResult:
        """Send a frame and return its result.

        Args:
            frame: The frame.
            index: Above all indices sent; by default a `Frame`'s own, else the next one.
            colour: Encoding of a `Frame`.
            wait: Wait until the frame is processed; else return `queued` as soon as it has arrived.
            retry: Whether to send the frame again after a failure. False for live streams, where a late frame is
                useless; `without answer` sends it again only if the server is away.

        Raises:
            WireError: If the frame is invalid: no server would accept it.
            InvalidError: If this server does not accept it.
            ConflictError: If the index was used before.
            RemoteError: If the server refuses for another reason, or does not respond.
        """
        index = self._calls.reserve(frame, index)
        call = self._calls.push(frame, index, colour=colour, wait=wait)
        repeat = retry if isinstance(retry, str) else "always" if retry else "never"
        return self._client.follow(self._recovery.push(call, index, repeat=repeat))

    def light_at(self, probe: PositionOrName, forms: Forms = DEFAULT_FORMS) -> Light:
        """Return the light at a point or a tracked probe; the prior before the first frame (`Light.is_prior`).

        Raises:
            WireError: If the position, the name or a form is invalid.
            GoneError: If there is no such probe.
        """
        return self.lights_at([probe], forms)[0]

    def lights_at(self, probes: Sequence[PositionOrName], forms: Forms = DEFAULT_FORMS) -> list[Light]:
        """Return the light at up to 64 probes after one and the same frame, in one call.

        Raises:
            WireError: If a position, a name or a form is invalid.
            GoneError: If there is no such probe.
        """
        return self._client.follow(self._recovery.call(self._calls.lights(probes, forms)))

    def file(
        self, probe: PositionOrName, form: LightFormat | LightForm = "exr", *, if_none_match: str | None = None
    ) -> LightFile | None:
        """Return one form of the light as a file.

        Args:
            probe: A point, or the name of a tracked probe.
            form: The form of the file.
            if_none_match: The ETag of an earlier file. If the light is still the same, the result is None and the
                server sends no file.

        Raises:
            WireError: If the position, the name or the form is invalid.
            GoneError: If there is no such probe.
        """
        return self._client.follow(
            self._recovery.call(self._calls.file(probe, calls.as_form(form), if_none_match=if_none_match))
        )

    def composite(
        self,
        objects: Sequence[CompositeObject | dict[str, Any]],
        *,
        quality: CompositeQuality = "preview",
        picture_format: CompositeFormat = "png",
    ) -> CompositeFile:
        """Return the last processed frame with objects in it.

        Args:
            objects: `CompositeObject`s or dictionaries with their fields; 1 to 16.
            quality: preview, good or final.
            picture_format: png, jpeg, exr, or layers for a zip of the layers.

        Raises:
            WireError: If a field is invalid.
            InvalidError: If a place is refused: no surface there, behind the camera, outside the picture.
            GoneError: If there is no object of an id.
            ConflictError: If the session has no frame yet.
        """
        request = composite_request(objects, quality=quality, picture_format=picture_format)
        return self._client.follow(self._recovery.call(self._calls.composite(request)))

    def track(self, name: str, position: Position) -> None:
        """Track a point: the engine then updates its light with each frame. An existing name moves to the position.

        Raises:
            OptionError: If the name is invalid.
            WireError: If the position is invalid.
            ConflictError: If the session tracks as many probes as the server allows.
        """
        self._client.follow(self._recovery.call(self._calls.track(name, position)))
        self._recovery.memory.track(name, position)

    def untrack(self, name: str) -> None:
        """Stop tracking a point. An unknown name is not an error.

        Raises:
            OptionError: If the name is invalid.
        """
        self._client.follow(self._recovery.call(self._calls.untrack(name)))
        self._recovery.memory.untrack(name)

    def stream(
        self,
        *,
        on_lighting: Callable[[list[Light]], object] | None = None,
        on_status: Callable[[StreamStatus], object] | None = None,
        on_problem: Callable[[RemoteError], object] | None = None,
    ) -> Stream:
        """Open the session's WebSocket; a lost connection is opened again by itself. See `Stream`.

        The handlers are called on the stream's own thread.

        Args:
            on_lighting: Receives the light of the tracked probes after each frame, after `subscribe`.
            on_status: Receives each state of the connection.
            on_problem: Receives what the server refused; a call that waits for an answer fails with it as well.

        Raises:
            GoneError: If the session is missing.
            RemoteError: If the server refuses or does not respond.
        """
        handlers = StreamHandlers(on_lighting, on_status, on_problem)
        client = self._client

        async def resume(reopen: bool) -> Resumed:
            return await asyncio.to_thread(client.follow, self._recovery.resume(reopen=reopen))

        return Stream(StreamLink(client.options, self._calls, self._recovery, resume), handlers)

    def state(self) -> SessionState:
        """Return counts of frames, tracked probes with their coverage, memory and the lighting volume."""
        return self._client.follow(self._recovery.call(self._calls.state()))

    def recover(self) -> None:
        """Wait until the server answers, and bring the session up to date.

        A missing session is opened again with the same options, its probes are tracked, and frames that the server
        lost are sent again. `push` does this by itself; call it after another call that failed with
        `UnreachableError`.

        Raises:
            UnreachableError: If no attempt is left.
            GoneError: If the session is missing and was joined.
        """
        self._client.follow(self._recovery.recover())

    def close(self) -> None:
        """Delete the session with its frames and its light on the server. A missing session is not an error."""
        self._recovery.memory.deleted = True  # its streams end with it
        self._client.run(self._calls.close())
