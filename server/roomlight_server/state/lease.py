"""The lease of an open session, for the event loop: checked before each answer, held while the state is written."""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

from roomlight_server.base.problems import ProblemError
from roomlight_server.state.fence import Fence, Lease

_log = logging.getLogger("roomlight.server")
_R = TypeVar("_R")
MOVED: Final = "session-moved"
"""Kind of the problem of a session that another server owns. Clients ask for its state and send lost frames again."""
_RETRY_AFTER_S: Final = 1


class SessionLease:
    """The lease of one open session."""

    def __init__(self, name: str, fence: Fence, lease: Lease, pool: ThreadPoolExecutor, *, refuses_gap: bool) -> None:
        """Hold the lease of the session `name`; the pool reads the shared directory.

        `refuses_gap`: see `check_frame`.
        """
        self._name, self._fence, self._lease, self._pool = name, fence, lease, pool
        self._refuses_gap = refuses_gap
        self.lost = False

    @property
    def epoch(self) -> int:
        """Number of this owner among all owners of the session."""
        return self._lease.record.epoch

    @property
    def problem(self) -> ProblemError:
        """The problem of a session whose lease is lost."""
        detail = "another server owns the session now; ask for its state, send lost frames again and go on"
        return ProblemError(MOVED, detail, field="id", value=self._name, retry_after_s=_RETRY_AFTER_S)

    async def check(self) -> None:
        """Check that this server owns the session; it takes 0.1 ms on a local disk.

        Raises:
            ProblemError: Another server owns it, or the shared directory cannot be read (503).
        """
        if not self.lost:
            loop = asyncio.get_running_loop()
            try:
                self.lost = not await loop.run_in_executor(self._pool, self._fence.holds, self._lease)
            except OSError as error:
                _log.error("the owner of a session cannot be read: %s", error, extra={"session": self._name})
                self.lost = True  # it cannot be known, and an answer could contradict another server's
        if self.lost:
            raise self.problem

    async def check_frame(self, index: int, last_index: int | None) -> None:
        """Check that this server owns the session, and that a frame continues what it has taken over.

        The owner before may have answered frames that it did not save. Therefore the first frame after a takeover that
        leaves a gap is refused, once: the client then sees which frames are missing.

        Args:
            last_index: Last index of the session; None before the first frame.

        Raises:
            ProblemError: Another server owns the session, or the frame leaves a gap (503).
        """
        await self.check()
        refused = self._refuses_gap and index > (-1 if last_index is None else last_index) + 1
        self._refuses_gap = False
        if refused:
            last = "no frame" if last_index is None else f"frame {last_index}"
            detail = f"this server took the session over after {last}; send the frames after it again"
            raise ProblemError(MOVED, detail, field="index", value=index, retry_after_s=_RETRY_AFTER_S)

    def guarded(self, work: Callable[..., _R]) -> Callable[..., _R]:
        """Return a function that runs blocking work while nobody else can become the owner.

        It raises LeaseLostError if another server owns the session.
        """

        def run(*args: object) -> _R:
            with self._fence.guarded(self._lease):
                return work(*args)

        return run

    def release(self) -> None:
        """Let the session go, in the background; its state must be on disk."""
        if not self.lost:
            self.lost = True
            self._pool.submit(self._release)

    def _release(self) -> None:
        try:
            self._fence.release(self._lease)
        except Exception as error:  # the next owner then asks the client for frames that it has
            _log.warning("a session was not released: %s", error, extra={"session": self._name})
