"""Queue of one session's frames: checks the order of indices, holds the waiting frame and records outcomes.

At most one frame waits; a newer frame replaces it. All methods run on the event loop, so there are no locks.
"""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

from roomlight.frame import Frame
from roomlight.wire.frame_message import FrameMessage
from roomlight.wire.messages import FrameCounts, FrameResult
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.request_context import request_id
from roomlight_server.state.live_state import SavedQueue


@dataclass
class Entry:
    """An accepted frame. `outcome` becomes its result or a ProblemError; it may stay unread.

    A frame that replaced a waiting one is stored undecoded (`frame` is None), because on a busy server most of these
    are replaced too; `decoding` begins when its session is the next one that the engine works for. A frame with neither
    `frame` nor `message` is skipped because of its tracking state. `request_id` is that of the request or WebSocket
    that sent it.
    """

    index: int
    digest: bytes
    frame: Frame | None = None
    message: FrameMessage | None = None
    decoding: "asyncio.Task[Frame] | None" = None
    request_id: str = field(default_factory=request_id.get)
    outcome: "asyncio.Future[FrameResult]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())

    def decode(self, work: Coroutine[Any, Any, Frame]) -> None:
        """Begin to decode the frame; if its error stays unread, asyncio does not log it."""
        self.decoding = asyncio.create_task(work)
        self.decoding.add_done_callback(lambda done: done.cancelled() or done.exception())

    def drop(self) -> None:
        """Release the frame: a replay needs only the outcome."""
        self.frame = self.message = None
        if self.decoding is not None:
            self.decoding.cancel()
            self.decoding = None

    def settle(self, result: FrameResult) -> None:
        """Record the result, unless there is an outcome already."""
        if not self.outcome.done():
            self.outcome.set_result(result)

    def fail(self, error: ProblemError) -> None:
        """Record the reason for rejection, unless there is an outcome already."""
        if not self.outcome.done():
            self.outcome.set_exception(error)
            self.outcome.exception()  # marks it as retrieved: asyncio would log it if no request awaits it


class FrameQueue:
    """Indices, counts and the waiting frame of one session."""

    def __init__(
        self, counted: Callable[[str], object] = lambda _: None, durable: Callable[[], int | None] = lambda: None
    ) -> None:
        """Create an empty queue.

        Args:
            counted: Called with the status of each frame that is not processed.
            durable: Returns the index up to which frames are on disk.
        """
        self._counted, self._durable = counted, durable
        self._last: Entry | None = None
        self._before_last: Entry | None = None
        self.waiting: Entry | None = None
        """The frame that waits."""
        self._before_waiting: Entry | None = None
        self._skipped_after_waiting = 0
        self._processing: Entry | None = None
        names = ("processed", "superseded", "skipped", "gaps", "replayed", "refused")
        self._counts: dict[str, int] = dict[str, int].fromkeys(names, 0)

    def replay_of(self, index: int, digest: bytes) -> Entry | None:
        """Return the entry that this message repeats, or None for a new frame.

        Raises:
            ProblemError: The index was used before, by another message (409).
        """
        if self._last is None or index > self._last.index:
            return None
        if index == self._last.index and digest == self._last.digest:
            self._counts["replayed"] += 1
            return self._last
        same = index == self._last.index
        detail = f"frame {index} was sent with other bytes" if same else f"frame {self._last.index} was already sent"
        rule = f"must be above {self._last.index}, or {self._last.index} with the same bytes"
        raise ProblemError("frame-conflict", detail, field="index", value=index, rule=rule)

    def accept(self, entry: Entry) -> None:
        """Add a new frame. It supersedes the waiting frame; without frame and message it is skipped."""
        self._before_last = self._last
        if self._last is not None:
            self._counts["gaps"] += entry.index - self._last.index - 1
        self._last = entry
        if entry.frame is None and entry.message is None:
            self._counts["skipped"] += 1
            self._counted("skipped")
            self._skipped_after_waiting += self.waiting is not None
            entry.settle(FrameResult(index=entry.index, status="skipped", durable_index=self._durable()))
            return
        if self.waiting is not None:
            self._counts["superseded"] += 1
            self._counted("superseded")
            superseded = FrameResult(index=self.waiting.index, status="superseded", durable_index=self._durable())
            self.waiting.settle(superseded)
            self.waiting.drop()
        self.waiting, self._before_waiting, self._skipped_after_waiting = entry, self._before_last, 0

    def take(self) -> Entry | None:
        """Remove and return the waiting frame for processing, or None."""
        self._processing, self.waiting = self.waiting, None
        return self._processing

    def processed(self, entry: Entry, result: FrameResult) -> None:
        """Record that the engine has processed the frame."""
        self._counts["processed"] += 1
        self._done(entry)
        entry.settle(result)

    def reject(self, entry: Entry, error: ProblemError) -> None:
        """Record that the frame was rejected without a change to the engine.

        Its index becomes free again, unless a newer frame was accepted.
        """
        self._counts["refused"] += 1
        self._done(entry)
        if self._last is entry:
            if self._before_last is not None:
                self._counts["gaps"] -= entry.index - self._before_last.index - 1
            self._last = self._before_last
        entry.fail(error)

    def count_rejected(self) -> None:
        """Count a frame that was rejected before it was accepted."""
        self._counts["refused"] += 1

    def end_all(self, error: ProblemError) -> None:
        """End all pending frames with this error, because the session ends."""
        for entry in (self.waiting, self._processing):
            if entry is not None:
                self._done(entry)
                entry.fail(error)
        self.waiting = None

    @property
    def last_index(self) -> int | None:
        """Index of the last accepted frame; None before the first."""
        return None if self._last is None else self._last.index

    def counts(self) -> FrameCounts:
        """Return the counts of all frames so far."""
        queued = (self.waiting is not None) + (self._processing is not None)
        used = sum(self._counts[name] for name in ("processed", "superseded", "skipped"))
        return FrameCounts(
            accepted=used + queued,
            queued=queued,
            last_index=self.last_index,
            durable_index=self._durable(),
            **self._counts,
        )

    def saved(self) -> SavedQueue:
        """Return the order of frames up to the last one whose outcome is certain; call it while none is processed.

        A waiting frame and those after it are left out: they are sent again after a restart.
        """
        counts, last = dict(self._counts), self._last
        if self.waiting is not None and last is not None:
            skipped, before = self._skipped_after_waiting, self._before_waiting
            since = self.waiting.index - 1 if before is None else before.index  # none counts before the very first
            counts["skipped"] -= skipped
            counts["gaps"] -= max(0, last.index - since - 1 - skipped)
            last = before
        if last is None:
            return SavedQueue(last_index=None, digest="", result=None, counts=counts)
        rejected = not last.outcome.done() or last.outcome.exception() is not None
        result = None if rejected else last.outcome.result()
        return SavedQueue(last_index=last.index, digest=last.digest.hex(), result=result, counts=counts)

    def restore(self, saved: SavedQueue) -> None:
        """Continue after the last frame of a saved queue. A frame that was rejected has no replay."""
        self._counts |= saved.counts
        if saved.last_index is not None:
            digest = b"" if saved.result is None else bytes.fromhex(saved.digest)
            self._last = Entry(saved.last_index, digest)
            if saved.result is not None:
                self._last.settle(saved.result.model_copy(update={"epoch": None}))  # of another owner

    def _done(self, entry: Entry) -> None:
        entry.drop()
        if self._processing is entry:
            self._processing = None


def replayed(outcome: "asyncio.Future[FrameResult]") -> "asyncio.Future[FrameResult]":
    """Return a future with the outcome of the original frame, marked as a replay."""
    replay: asyncio.Future[FrameResult] = asyncio.get_running_loop().create_future()

    def copy(done: "asyncio.Future[FrameResult]") -> None:
        error = done.exception()
        if error is None:
            replay.set_result(done.result().model_copy(update={"replay": True}))
        else:
            replay.set_exception(error)
            replay.exception()

    outcome.add_done_callback(copy)
    return replay
