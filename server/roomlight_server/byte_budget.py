"""Memory budget of a server for frames that are being received and answers that are being made or sent."""

from collections.abc import Callable, Generator
from contextlib import contextmanager

from roomlight_server.problems import ProblemError


class ByteBudget:
    """Bytes reserved by all requests of the process. Used on the event loop only."""

    def __init__(self, limit: int, unsent_bytes: Callable[[], int]) -> None:
        """Create a budget. `unsent_bytes` returns the size of finished answers that clients have not received yet."""
        self._limit, self._unsent_bytes, self._reserved = limit, unsent_bytes, 0

    @property
    def used(self) -> int:
        """Bytes reserved or unsent."""
        return self._reserved + self._unsent_bytes()

    @contextmanager
    def reservation(self) -> Generator["Reservation"]:
        """Yield an empty reservation and release it at the end of the context."""
        held = Reservation(self)
        try:
            yield held
        finally:
            self._reserved -= held.size

    def reserve(self, size: int) -> None:
        """Reserve bytes.

        Raises:
            ProblemError: The budget is used up (503).
        """
        used = self.used
        if used + size > self._limit:
            rule = f"at most {self._limit} bytes for the requests and answers of all clients"
            detail = f"{used} bytes are in use and this request needs {size} more; retry later"
            raise ProblemError("server-busy", detail, rule=rule, retry_after_s=1)
        self._reserved += size


class Reservation:
    """Bytes that one request has reserved."""

    def __init__(self, budget: ByteBudget) -> None:
        self._budget, self.size = budget, 0

    def add(self, size: int) -> None:
        """Reserve more bytes.

        Raises:
            ProblemError: The budget is used up (503).
        """
        self._budget.reserve(size)
        self.size += size
