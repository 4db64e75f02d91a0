"""Calls of a session that survive a server which was started again or has let the session expire.

The session is opened once more with the same options, its points are tracked, and the frames that the server lost are
sent again, one after the other. The steps are generators without I/O, so that both clients share them: they yield
calls and pauses, and receive results and errors.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeVar

from roomlight.wire.messages import FrameResult, SessionRequest, SessionState
from roomlight_client import _waiting
from roomlight_client.calls import PERMANENT, Call, SessionCalls, ready
from roomlight_client.errors import BusyError, GoneError, RefusedError, RemoteError, UnreachableError
from roomlight_client.memory import BufferLimits, SessionMemory
from roomlight_client.retry import NO_RETRY, Retry, Timeouts

T = TypeVar("T")
_LOST_KINDS: Final = ("", "blank", "stopping", "session-moved")


@dataclass(frozen=True)
class Send:
    """Send this call; `retry` replaces the client's policy."""

    call: Call[Any]
    retry: Retry | None = None


@dataclass(frozen=True)
class Pause:
    """Wait for some seconds."""

    seconds: float


@dataclass(frozen=True)
class Restore:
    """Follow `recovery.restore()`, once for all calls that wait for it."""

    recovery: "Recovery"


Steps = Generator[Send | Pause | Restore, Any, T]


@dataclass(frozen=True)
class Resumed:
    """The state of a session after a connection was lost, and whether it had to be opened again."""

    state: SessionState
    reopened: bool


@dataclass(frozen=True)
class RecoveryEvent:
    """What happens to a session whose server is away.

    Attributes:
        state: `waiting`: the server does not answer, and the client tries again. `restored`: it answers again.
        error: With `waiting`: the last failure.
        reopened: With `restored`: the server had lost the session, which was opened again.
        resent: With `restored`: frames that were sent again.
        incomplete: With `restored`: frames are lost that are no longer kept; the light differs from before.
    """

    state: Literal["waiting", "restored"]
    error: RemoteError | None = None
    reopened: bool = False
    resent: int = 0
    incomplete: bool = False


@dataclass(frozen=True)
class ClientOptions:
    """How a client connects, how often it repeats calls, what it keeps and who is told.

    Attributes:
        url: The server's address.
        token: The bearer token.
        timeouts: Of each attempt.
        retry: Attempts of a call, and after the server has refused a frame for now.
        reconnect: Attempts after a frame without an answer, and after a lost connection.
        buffer: Bounds of the frames that are kept.
        notify: Receives the events.
    """

    url: str
    token: str | None
    timeouts: Timeouts
    retry: Retry
    reconnect: Retry
    buffer: BufferLimits
    notify: Callable[[RecoveryEvent], object] | None


PushRepeat = Literal["always", "without answer", "never"]
"""When a frame is sent again after a failure; a missing session is opened again in any case."""


class Recovery:
    """The calls of one session, with what they take after a restart of the server.

    Args:
        calls: The session's calls.
        request: The options of a session that this client opened; None for one that it joined.
        options: Of the client.
    """

    def __init__(self, calls: SessionCalls, request: SessionRequest | None, options: ClientOptions) -> None:
        self.memory = SessionMemory(request, options.buffer)
        self._calls, self._options = calls, options
        self._may_have_restarted = self._announced = False
        self._stopping: RemoteError | None = None  # the refusal of a server that stops, until one is ready
        self._restoring = False

    def call(self, call: Call[T]) -> Steps[T]:
        """Send a call; if the session is missing, open it again once. Waits while that is done."""
        if self._restoring:
            yield Restore(self)
        try:
            return (yield Send(call))
        except RemoteError as error:
            self._note(error)
            if not self._can_reopen_after(error):
                raise
        yield Restore(self)
        return (yield Send(call))

    def push(self, call: Call[FrameResult], index: int, *, repeat: PushRepeat) -> Steps[FrameResult]:
        """Send a frame.

        Args:
            call: The call.
            index: Index of the frame.
            repeat: When it is sent again after a failure.
        """
        frames = self.memory.frames
        frames.add(index, call.content or b"", state="sent")
        try:
            result = yield from self._push_until_done(call, repeat=repeat)
        except RemoteError:
            frames.remove(index)
            raise
        frames.settle(result)
        return result

    def recover(self) -> Steps[None]:
        """Wait until the server answers, and bring the session up to date."""
        failures = 0
        self._may_have_restarted = True
        while self._may_have_restarted:
            try:
                yield from self._check_started()
                yield Restore(self)
            except RemoteError as error:
                self._note(error)
                failures += 1
                delay_s = self._delay_s(error, failures) if is_server_lost(error) else None
                if delay_s is None:
                    raise
                self._tell_waiting(error)
                yield Pause(delay_s)

    def resume(self, *, reopen: bool) -> Steps[Resumed]:
        """Get the session's state, with one attempt; with `reopen` a missing session is opened again."""
        retry = NO_RETRY if reopen else None
        try:
            return Resumed((yield Send(self._calls.state(), retry)), reopened=False)
        except RemoteError as error:
            if not reopen or not self._can_reopen_after(error):
                raise
            if _kind(error) == "state-refused":  # the server keeps its damaged files until then
                yield Send(self._calls.close(), retry)
        assert self.memory.request is not None
        return Resumed((yield Send(self._calls.open(self.memory.request), retry)), reopened=True)

    def _push_until_done(self, call: Call[FrameResult], *, repeat: PushRepeat) -> Steps[FrameResult]:
        failures, reopened = 0, False
        while True:
            try:
                if self._may_have_restarted:
                    yield from self._check_started()
                    yield Restore(self)
                return (yield Send(call, NO_RETRY))
            except RemoteError as error:
                if self._can_reopen_after(error) and not reopened:
                    self._may_have_restarted = reopened = True
                    continue
                failures += 1
                self._note(error)
                wanted = repeat == "always" or (repeat == "without answer" and is_server_lost(error))
                delay_s = self._delay_s(error, failures) if wanted else None
                if delay_s is None:
                    raise
                if is_server_lost(error):
                    self._tell_waiting(error)
            yield Pause(delay_s)

    def _delay_s(self, error: RemoteError, failures: int) -> float | None:
        if is_server_lost(error):
            return self._options.reconnect.delay_s(failures, jitter=_waiting.jitter())
        if isinstance(error, BusyError):
            return self._options.retry.delay_s(failures, retry_after_s=error.retry_after_s, jitter=_waiting.jitter())
        return None

    def _note(self, error: RemoteError) -> None:
        self._may_have_restarted |= is_server_lost(error)
        if _kind(error) == "stopping":
            self._stopping = error

    def _check_started(self) -> Steps[None]:
        """Check that a server is ready again: one that stops refuses frames, and still gives the session's state."""
        if self._stopping is not None and not (yield Send(ready(), NO_RETRY)):
            raise self._stopping
        self._stopping = None

    def restore(self) -> Steps[None]:
        """Bring the session up to date; only a client that takes a `Restore` follows these steps."""
        self._may_have_restarted = self._restoring = True  # until all is done
        try:
            yield from self._restore()
        finally:
            self._restoring = False

    def _restore(self) -> Steps[None]:
        resumed = yield from self.resume(reopen=self.memory.can_reopen)
        missing, unwanted = self.memory.probe_changes(resumed.state)
        for name in unwanted:
            yield Send(self._calls.untrack(name))
            self.memory.changed.discard(name)
        for name, position in missing.items():
            yield Send(self._calls.track(name, position))
            self.memory.changed.discard(name)
        last = resumed.state.frames.last_index
        lost = [frame for frame in self.memory.frames if frame.state == "done" and (last is None or frame.index > last)]
        incomplete = self.memory.frames.lacks(last)
        for frame in lost:
            yield from self._resend(frame.index, frame.message)
        self._may_have_restarted = False
        if self._announced or resumed.reopened or lost:
            self._announced = False
            self._tell(RecoveryEvent("restored", reopened=resumed.reopened, resent=len(lost), incomplete=incomplete))

    def _tell_waiting(self, error: RemoteError) -> None:
        if not self._announced:
            self._announced = True
            self._tell(RecoveryEvent("waiting", error=error))

    def _tell(self, event: RecoveryEvent) -> None:
        if self._options.notify is not None:
            self._options.notify(event)

    def _resend(self, index: int, message: bytes) -> Steps[None]:
        try:
            result: FrameResult = yield Send(self._calls.frame(index, message))
        except RefusedError as error:
            if isinstance(error, GoneError) or is_server_lost(error):
                raise
            self.memory.frames.remove(index)  # refused, or already there
        else:
            self.memory.frames.settle(result)

    def _can_reopen_after(self, error: RemoteError) -> bool:
        return self.memory.can_reopen and _kind(error) in ("session-not-found", "session-closed", "state-refused")


def is_server_lost(error: RemoteError) -> bool:
    """Return whether there was no answer, or only that of a proxy whose server is away, or of a server before."""
    if isinstance(error, UnreachableError):
        return not isinstance(error.__cause__, PERMANENT)
    if not isinstance(error, RefusedError):
        return False
    return error.status in (502, 504) or (error.status == 503 and error.kind in _LOST_KINDS)


def is_session_gone(error: RemoteError) -> bool:
    """Return whether the server no longer has the session."""
    return _kind(error) in ("session-not-found", "session-closed")


def _kind(error: RemoteError) -> str:
    return error.kind if isinstance(error, RefusedError) else ""
