"""Memory budget of a server for frames that are being received and answers that are being made or sent."""

from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager

from roomlight_server.base.problems import ProblemError
from roomlight_server.base.request_context import current_flow


class ByteBudget:
    """Bytes reserved by all requests of the process. Used on the event loop only."""

    def __init__(self, limit: int, unsent_bytes: Callable[[str | None], int], *, owner_limit: int) -> None:
        """Create a budget.

        Args:
            limit: Bytes of all owners.
            unsent_bytes: Returns the size of the finished answers that clients of an owner, or all (None), have not
                received yet.
            owner_limit: Bytes of one owner.
        """
        self._limit, self._owner_limit = limit, min(limit, owner_limit)
        self._unsent_bytes = unsent_bytes
        self._reserved: Counter[str] = Counter()

    @property
    def used(self) -> int:
        """Bytes reserved or unsent."""
        return self._reserved.total() + self._unsent_bytes(None)

    @contextmanager
    def reservation(self) -> Generator["Reservation"]:
        """Yield an empty reservation of the current owner and release it at the end of the context."""
        reserved = Reservation(self, current_flow.get().owner)
        try:
            yield reserved
        finally:
            self.release(reserved.owner, reserved.size)

    def reserve(self, owner: str, size: int) -> None:
        """Reserve bytes. Raises ProblemError if the owner's share is used up (429), or the budget (503)."""
        used = self._reserved[owner] + self._unsent_bytes(owner)
        if self._owner_limit < self._limit and used + size > self._owner_limit:
            rule = f"at most {self._owner_limit} bytes for the requests and answers of one token"
            detail = f"{used} bytes are in use and this request needs {size} more; read answers, or retry later"
            raise ProblemError("owner-busy", detail, rule=rule, retry_after_s=1)
        used = self.used
        if used + size > self._limit:
            rule = f"at most {self._limit} bytes for the requests and answers of all clients"
            detail = f"{used} bytes are in use and this request needs {size} more; retry later"
            raise ProblemError("server-busy", detail, rule=rule, retry_after_s=1)
        self._reserved[owner] += size

    def release(self, owner: str, size: int) -> None:
        """Release bytes."""
        self._reserved[owner] -= size
        if not self._reserved[owner]:
            del self._reserved[owner]


class Reservation:
    """Bytes that one request has reserved."""

    def __init__(self, budget: ByteBudget, owner: str) -> None:
        self._budget, self.owner, self.size = budget, owner, 0

    def add(self, size: int) -> None:
        """Reserve more bytes. Raises ProblemError if the owner's share is used up (429), or the budget (503)."""
        self._budget.reserve(self.owner, size)
        self.size += size

    def keep(self, size: int) -> None:
        """Release all but `size` bytes, or nothing if fewer are reserved."""
        released = max(0, self.size - size)
        self._budget.release(self.owner, released)
        self.size -= released
