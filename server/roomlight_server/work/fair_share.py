"""Slots of a thread pool, shared by time: a free slot goes to whoever has used the least time so far.

Owners come first, then the order of an owner's jobs, its sessions, and arrival. A job that runs for long gives up its
slot at its next pause if another job is ahead of it, and continues later on the same thread. So a client whose jobs are
large, or many, delays other clients by one time slice.

An owner (or session) that was idle starts with the time of the one that is served at present (start-time fair
queueing), so that it cannot save up time. Event loop only, except `Turn.pause`.
"""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Final

from roomlight_server.base.request_context import Flow, current_flow

SLICE_S: Final = 0.15
"""Time for which a job keeps its slot although another is ahead of it. A frame of the default options takes less, so
that frames of many sessions are finished one after the other. A job of a lower order does not wait for it."""
PATIENCE_S: Final = 20.0
"""Time after which a job that waits is no longer behind jobs of its owner of a lower order."""
MAX_PAUSED: Final = 8
"""Jobs that may be paused at once; each holds a thread and its intermediate data."""
_FORGET_AFTER: Final = 1024
"""Owners, or sessions of one, whose used time is kept; beyond it, that of idle ones is forgotten."""


class AbandonedError(Exception):
    """Raised by `Turn.pause` in a job whose client is gone."""


class _UsedTime:
    """The time that each owner or session has used, comparable between them."""

    def __init__(self) -> None:
        self._used_s: dict[str, float] = {}
        self._active: dict[str, int] = {}  # waiting and running jobs
        self._floor_s = 0.0  # of the job served last

    def enter(self, name: str) -> None:
        if not self._active.get(name):
            self._used_s[name] = max(self._used_s.get(name, 0.0), self._floor_s)
        self._active[name] = self._active.get(name, 0) + 1

    def leave(self, name: str) -> None:
        self._active[name] -= 1
        if not self._active[name]:
            del self._active[name]
            if len(self._used_s) > _FORGET_AFTER:
                self._used_s = {kept: self._used_s[kept] for kept in self._active}

    def serve(self, name: str) -> None:
        self._floor_s = max(self._floor_s, self._used_s[name])

    def charge(self, name: str, seconds: float) -> None:
        self._used_s[name] += seconds

    @property
    def are_active(self) -> bool:
        return bool(self._active)

    def used_s(self, name: str) -> float:
        return self._used_s[name]


@dataclass(eq=False)
class Turn:
    """One job: waiting for a slot, or running in one."""

    flow: Flow
    number: int
    share: "FairShare"
    order: int = 0
    asked_s: float = 0.0
    on_next: Callable[[], object] = lambda: None
    granted: "asyncio.Future[None]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    since_s: float = 0.0
    _abandoned: bool = False

    def abandon(self) -> None:
        """End the job at its next pause."""
        self._abandoned = True

    def pause(self) -> None:
        """Let jobs that are ahead run first. Called on the thread of the job, which waits here meanwhile.

        Raises:
            AbandonedError: The client is gone, and the result is not needed.
        """
        self.check()
        self.share.pause(self)
        self.check()

    def check(self) -> None:
        """Check that the result is still needed. Raises AbandonedError if the client is gone."""
        if self._abandoned:
            raise AbandonedError


class FairShare:
    """Slots that are shared by time."""

    def __init__(
        self,
        slots: int,
        *,
        slots_per_owner: int | None = None,
        clock: Callable[[], float] = time.perf_counter,
        waited: Callable[[float], object] = lambda _: None,
    ) -> None:
        """Create free slots.

        Args:
            slots: Jobs at once.
            slots_per_owner: Jobs of one owner at once; by default all.
            waited: Called with the waiting time of each job, in seconds.
        """
        self._free, self._per_owner, self._clock, self._waited = slots, slots_per_owner or slots, clock, waited
        self._owners = _UsedTime()
        self._sessions: dict[str, _UsedTime] = {}  # by owner
        self._running: list[Turn] = []
        self._waiting: list[Turn] = []
        self._count = self._paused = 0
        self._closed = False

    @property
    def waiting(self) -> int:
        """Number of jobs that wait for a slot."""
        return len(self._waiting)

    @asynccontextmanager
    async def slot(self, order: int = 0, on_next: Callable[[], object] = lambda: None) -> AsyncGenerator[Turn]:
        """Wait for a slot and hold it inside the context; the time counts for the current flow.

        Args:
            order: Jobs of a lower one come first, until the others have waited for `PATIENCE_S` or their owner has
                used less time. One above 0 runs alone, or beside owners that have used more time.
            on_next: Called when the job waits as the next one: what it needs may be prepared.
        """
        self._count += 1
        turn = Turn(current_flow.get(), self._count, self, order, self._clock(), on_next)
        if len(self._sessions) > _FORGET_AFTER:
            self._sessions = {owner: kept for owner, kept in self._sessions.items() if kept.are_active}
        sessions = self._sessions.setdefault(turn.flow.owner, _UsedTime())
        self._owners.enter(turn.flow.owner)
        sessions.enter(turn.flow.session)
        try:
            await self._wait(turn)
            self._waited(self._clock() - turn.asked_s)
            try:
                yield turn
            finally:
                self._release(turn)
        finally:
            self._owners.leave(turn.flow.owner)
            sessions.leave(turn.flow.session)

    def pause(self, turn: Turn) -> None:
        """Give the slot to jobs that are ahead of this one and wait for it again; called on the thread of the job."""
        others = (*self._waiting, *self._running)
        before = any(self._order(other) < self._order(turn) and not self._used_less(turn, other) for other in others)
        watched = self._waiting or self._order(turn)  # frames of others run beside the latter: its time must be known
        due = before or (watched and self._clock() - turn.since_s >= SLICE_S)
        if due and not self._closed:
            loop = turn.granted.get_loop()
            asyncio.run_coroutine_threadsafe(self._pause(turn), loop).result()

    def close(self) -> None:
        """Let all paused jobs finish, without regard to the number of slots; later jobs are not paused."""
        self._closed = True
        for turn in tuple(self._waiting):
            if turn.granted.done():
                continue
            self._waiting.remove(turn)
            self._start(turn)

    async def _pause(self, turn: Turn) -> None:
        self._charge(turn)
        overtaken = any(self._is_ahead(waiting, turn) for waiting in self._waiting) or not self._may_run(turn)
        if self._paused >= MAX_PAUSED or self._closed or not overtaken:
            return
        self._paused += 1
        try:
            self._stop(turn)
            turn.granted = asyncio.get_running_loop().create_future()
            await self._wait(turn)
        finally:
            self._paused -= 1

    async def _wait(self, turn: Turn) -> None:
        """Wait for a slot; on return the job runs."""
        self._waiting.append(turn)
        self._assign()
        try:
            await turn.granted
        except asyncio.CancelledError:
            if turn in self._waiting:
                self._waiting.remove(turn)
            else:  # the slot was granted in the meantime
                self._release(turn)
            raise

    def _assign(self) -> None:
        """Start waiting jobs in free slots, and tell the one that is next."""
        waiting = [turn for turn in self._waiting if not turn.granted.done()]
        while self._free > 0:
            ready = [turn for turn in waiting if self._may_start(turn)]
            if not ready:
                return
            turn = min(ready, key=self._key)
            waiting.remove(turn)
            self._waiting.remove(turn)
            self._start(turn)
        if waiting:
            min(waiting, key=self._key).on_next()

    def _start(self, turn: Turn) -> None:
        self._free -= 1
        self._running.append(turn)
        self._owners.serve(turn.flow.owner)
        self._sessions[turn.flow.owner].serve(turn.flow.session)
        turn.since_s = self._clock()
        turn.granted.set_result(None)

    def _release(self, turn: Turn) -> None:
        self._charge(turn)
        self._stop(turn)

    def _stop(self, turn: Turn) -> None:
        self._free += 1
        self._running.remove(turn)
        self._assign()

    def _charge(self, turn: Turn) -> None:
        now_s = self._clock()
        used_s, turn.since_s = now_s - turn.since_s, now_s
        self._owners.charge(turn.flow.owner, used_s)
        self._sessions[turn.flow.owner].charge(turn.flow.session, used_s)

    def _is_ahead(self, other: Turn, turn: Turn) -> bool:
        startable = other.flow.owner == turn.flow.owner or self._may_start(other)
        return startable and self._key(other) < self._key(turn)

    def _may_start(self, turn: Turn) -> bool:
        same = sum(other.flow.owner == turn.flow.owner for other in self._running)
        return same < self._per_owner and self._may_run(turn)

    def _may_run(self, turn: Turn) -> bool:
        return self._order(turn) == 0 or all(other is turn or self._used_less(turn, other) for other in self._running)

    def _used_less(self, turn: Turn, other: Turn) -> bool:
        return self._owners.used_s(turn.flow.owner) < self._owners.used_s(other.flow.owner)

    def _order(self, turn: Turn) -> int:
        return turn.order if self._clock() - turn.asked_s < PATIENCE_S else 0

    def _key(self, turn: Turn) -> tuple[float, int, float, int]:
        owner, session = turn.flow
        return self._owners.used_s(owner), self._order(turn), self._sessions[owner].used_s(session), turn.number
