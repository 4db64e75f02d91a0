"""The order of one session's frames: which index may come, which frame waits, and what became of each.

Lives on the event loop; no locks. One frame waits at most: a newer one takes its place.
"""

import asyncio
from dataclasses import dataclass, field

from roomlight.frame import Frame
from roomlight.wire.frame_message import FrameMessage
from roomlight.wire.messages import FrameCounts, FrameResult
from roomlight_server.problems import ProblemError


@dataclass
class Entry:
    """An accepted frame. `outcome` is its result or the problem it ended with; nobody has to look at it.

    One that took another's place comes as its `message`, to be decoded when its turn comes: on a busy server most never
    have one. With neither, its tracking state rules it out.
    """

    index: int
    digest: bytes
    frame: Frame | None = None
    message: FrameMessage | None = None
    outcome: "asyncio.Future[FrameResult]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())

    def settle(self, result: FrameResult) -> None:
        """State what became of it; once."""
        if not self.outcome.done():
            self.outcome.set_result(result)

    def fail(self, error: ProblemError) -> None:
        """State why nothing became of it."""
        if not self.outcome.done():
            self.outcome.set_exception(error)
            self.outcome.exception()  # looked at: asyncio has nothing to complain about when nobody waits


class FrameQueue:
    """Indices, counts and the frame that waits."""

    def __init__(self) -> None:
        """No frame yet."""
        self._last: Entry | None = None
        self._before_last: Entry | None = None
        self._waiting: Entry | None = None
        self._working: Entry | None = None
        self._counts = dict.fromkeys(("processed", "superseded", "skipped", "gaps", "replayed", "refused"), 0)

    def replay_of(self, index: int, digest: bytes) -> Entry | None:
        """The entry that this message repeats, None for a new frame; ProblemError (409) where its index is spent."""
        if self._last is None or index > self._last.index:
            return None
        if index == self._last.index and digest == self._last.digest:
            self._counts["replayed"] += 1
            return self._last
        same = index == self._last.index
        detail = f"frame {index} was sent with other bytes" if same else f"frame {self._last.index} was sent already"
        rule = f"above {self._last.index}, or {self._last.index} with the same bytes"
        raise ProblemError("frame-conflict", detail, field="index", value=index, rule=rule)

    def accept(self, entry: Entry) -> None:
        """Take a new frame; it waits, and one that waited so far is superseded. One without content is skipped."""
        self._before_last = self._last
        if self._last is not None:
            self._counts["gaps"] += entry.index - self._last.index - 1
        self._last = entry
        if entry.frame is None and entry.message is None:
            self._counts["skipped"] += 1
            entry.settle(FrameResult(index=entry.index, status="skipped"))
            return
        if self._waiting is not None:
            self._counts["superseded"] += 1
            self._waiting.settle(FrameResult(index=self._waiting.index, status="superseded"))
            self._waiting.frame = self._waiting.message = None
        self._waiting = entry

    def take(self) -> Entry | None:
        """The frame that waits, now being worked on."""
        self._working, self._waiting = self._waiting, None
        return self._working

    def processed(self, entry: Entry, result: FrameResult) -> None:
        """The engine has taken it."""
        self._counts["processed"] += 1
        self._done(entry)
        entry.settle(result)

    def refused(self, entry: Entry, error: ProblemError) -> None:
        """The engine would not have it, and is as before: so is the order, where nothing newer came."""
        self._counts["refused"] += 1
        self._done(entry)
        if self._last is entry:
            if self._before_last is not None:
                self._counts["gaps"] -= entry.index - self._before_last.index - 1
            self._last = self._before_last
        entry.fail(error)

    def count_refused(self) -> None:
        """A frame was refused before it was accepted."""
        self._counts["refused"] += 1

    def abandon(self, error: ProblemError) -> None:
        """The session ends: nobody is left waiting."""
        for entry in (self._waiting, self._working):
            if entry is not None:
                self._done(entry)
                entry.fail(error)
        self._waiting = None

    @property
    def has_waiting(self) -> bool:
        """Whether a frame waits for its turn."""
        return self._waiting is not None

    def counts(self) -> FrameCounts:
        """So far."""
        queued = (self._waiting is not None) + (self._working is not None)
        used = sum(self._counts[name] for name in ("processed", "superseded", "skipped"))
        last = None if self._last is None else self._last.index
        return FrameCounts(accepted=used + queued, queued=queued, last_index=last, **self._counts)

    def _done(self, entry: Entry) -> None:
        entry.frame = entry.message = None  # a replay needs the outcome alone
        if self._working is entry:
            self._working = None


def replayed(outcome: "asyncio.Future[FrameResult]") -> "asyncio.Future[FrameResult]":
    """The outcome of the frame that this one repeats."""
    again: asyncio.Future[FrameResult] = asyncio.get_running_loop().create_future()

    def copy(done: "asyncio.Future[FrameResult]") -> None:
        error = done.exception()
        if error is None:
            again.set_result(done.result().model_copy(update={"replay": True}))
        else:
            again.set_exception(error)
            again.exception()

    outcome.add_done_callback(copy)
    return again
