"""The blocking form of `stream.AsyncStream`: its event loop runs on a thread of its own."""

import asyncio
import threading
from collections.abc import Coroutine, Sequence
from concurrent.futures import Future
from typing import Any, TypeVar

from roomlight.conventions import Position
from roomlight.errors import RoomLightError
from roomlight.frame import Frame
from roomlight.wire.frame_encoding import CameraFrame, FrameEncoding
from roomlight.wire.messages import FrameResult
from roomlight_client.calls import DEFAULT_FORMS, Forms, PositionOrName
from roomlight_client.errors import UnreachableError
from roomlight_client.light import Light
from roomlight_client.stream import AsyncStream
from roomlight_client.stream_link import StreamHandlers, StreamLink, StreamStatus

T = TypeVar("T")


class Stream:
    """The WebSocket of a session, made by `Session.stream`. A `with` statement closes it.

    It connects again by itself: `on_status` reports when, and `status` that it gave up (`closed`). Its handlers may
    call `submit` and `status`; the other methods wait for the thread that calls the handlers, and raise there.

    Raises:
        GoneError: If the session is missing.
        RemoteError: If the server refuses or does not respond.
    """

    def __init__(self, link: StreamLink, handlers: StreamHandlers) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="roomlight-stream", daemon=True)
        self._lock, self._closed = threading.Lock(), False
        self._thread.start()
        try:
            self._stream = self._run(AsyncStream.open(link, handlers))
        except BaseException:
            self._stop(None)
            raise

    def __enter__(self) -> "Stream":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def status(self) -> StreamStatus:
        """The state of the connection."""
        return self._stream.status

    def submit(
        self, frame: Frame | CameraFrame, index: int | None = None, *, colour: FrameEncoding = "exact"
    ) -> "Future[FrameResult]":
        """Send a frame and return at once; the future becomes its result. See `AsyncStream.push`."""
        return self._begin(self._stream.push(frame, index, colour=colour))

    def push(
        self, frame: Frame | CameraFrame, index: int | None = None, *, colour: FrameEncoding = "exact"
    ) -> FrameResult:
        """Send a frame and wait for its result; see `AsyncStream.push`.

        Raises:
            WireError: If the frame is invalid.
            RemoteError: If the server refuses the frame, or the stream ends.
        """
        return self._run(self._stream.push(frame, index, colour=colour))

    def light_at(self, probe: PositionOrName, forms: Forms = DEFAULT_FORMS) -> Light:
        """Return the light at a point or a tracked probe; see `Session.light_at`."""
        return self._run(self._stream.light_at(probe, forms))

    def lights_at(self, probes: Sequence[PositionOrName], forms: Forms = DEFAULT_FORMS) -> list[Light]:
        """Return the light at up to 64 probes after one and the same frame; see `Session.lights_at`."""
        return self._run(self._stream.lights_at(probes, forms))

    def subscribe(self, forms: Forms) -> None:
        """Receive the light of the tracked points in `on_lighting`, now and after each frame; no forms: unsubscribe."""
        self._run(self._stream.subscribe(forms))

    def track(self, name: str, position: Position) -> None:
        """Track a point under a name; an existing name moves to the position."""
        self._run(self._stream.track(name, position))

    def untrack(self, name: str) -> None:
        """Stop tracking a point."""
        self._run(self._stream.untrack(name))

    def close(self) -> None:
        """Close the connection; calls that wait for an answer fail. The session continues to exist."""
        self._check_thread()
        self._stop(self._stream)

    def _run(self, work: Coroutine[Any, Any, T]) -> T:
        try:
            self._check_thread()
        except RoomLightError:
            work.close()
            raise
        return self._begin(work).result()

    def _check_thread(self) -> None:
        if threading.current_thread() is self._thread:
            raise RoomLightError(
                "a handler of a stream called a method of it that waits for an answer, which the stream's own thread "
                "cannot: call it in another thread; `submit` and `status` work in handlers"
            )

    def _begin(self, work: Coroutine[Any, Any, T]) -> "Future[T]":
        with self._lock:
            if not self._closed:
                return asyncio.run_coroutine_threadsafe(work, self._loop)
        work.close()
        raise UnreachableError("the stream was closed")

    def _stop(self, stream: AsyncStream | None) -> None:
        with self._lock:
            if self._closed:
                return
            self._closed = True
            ended = asyncio.run_coroutine_threadsafe(_end(stream), self._loop)
        try:
            ended.result()
        finally:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
            self._loop.close()


async def _end(stream: AsyncStream | None) -> None:
    """Close the stream and end all work of this event loop; `None`: it did not open."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    if stream is not None:
        await stream.close()
    else:
        for task in others:
            task.cancel()
    if others:
        await asyncio.wait(others)
    await asyncio.get_running_loop().shutdown_default_executor()
