"""Limits of one owner (token): sessions and their memory, named probes, late probes in progress.

They keep one client from taking what all share. A request beyond a limit is answered with 429 and `Retry-After`.
"""

from collections import Counter
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import TYPE_CHECKING

from roomlight_server.base.problems import ProblemError
from roomlight_server.base.request_context import current_flow
from roomlight_server.base.settings import ServerSettings

if TYPE_CHECKING:
    from roomlight_server.sessions.live_session import LiveSession


class Quotas:
    """What each owner uses, and its limits. The owner is that of the current request. Event loop only."""

    def __init__(self, settings: ServerSettings, sessions_of: "Callable[[str], Iterable[LiveSession]]") -> None:
        """Create quotas; `sessions_of` returns the open sessions of an owner."""
        self._settings, self._sessions_of = settings, sessions_of
        self._late: Counter[str] = Counter()
        self._adding: dict[str, list[int]] = {}  # rows of probes that are being added

    def check_session(self, owner: str, bound_bytes: int, *, retry_after_s: int) -> None:
        """Check that an owner may open a session of this size.

        Raises:
            ProblemError: The owner has too many sessions, or they could need too much memory (429).
        """
        sessions = list(self._sessions_of(owner))
        limit = self._settings.owner_sessions
        if len(sessions) >= limit:
            detail = f"the token has {len(sessions)} open sessions; delete one, or retry later"
            raise _exceeded("session", detail, f"at most {limit} sessions for one token", retry_after_s)
        used, limit = sum(session.bound_bytes for session in sessions), self._settings.owner_session_bytes
        if used + bound_bytes > limit:
            detail = (
                f"the sessions of the token could need {used} bytes and this one {bound_bytes} more; "
                "delete one, choose a lower height, or retry later"
            )
            raise _exceeded("height", detail, f"at most {limit} bytes of sessions for one token", retry_after_s)

    @contextmanager
    def adding_probe(self, rows: int) -> Generator[None]:
        """Reserve a named probe with a panorama of this many rows, until the session counts it.

        Raises:
            ProblemError: The owner has too many probes, or their panoramas too many rows (429).
        """
        owner = current_flow.get().owner
        adding = self._adding.setdefault(owner, [])
        sessions = list(self._sessions_of(owner))
        count = sum(session.probe_count for session in sessions) + len(adding)
        limit = self._settings.max_owner_probes
        if count >= limit:
            detail = f"the token has {count} named probes; delete one first"
            raise _exceeded("name", detail, f"at most {limit} named probes for one token", 1)
        used = sum(session.probe_count * session.request.height for session in sessions) + sum(adding)
        limit = self._settings.max_owner_rows
        if used + rows > limit:
            detail = f"the panoramas of the token's named probes have {used} rows and this one has {rows}; delete one"
            raise _exceeded("name", detail, f"at most {limit} rows of named probes for one token", 1)
        adding.append(rows)
        try:
            yield
        finally:
            adding.remove(rows)
            if not adding:
                self._adding.pop(owner, None)

    @property
    def late_points(self) -> int:
        """Points without a named probe that are being computed or waiting, of all owners."""
        return self._late.total()

    @contextmanager
    def late_probes(self, count: int) -> Generator[None]:
        """Reserve the computing of late probes.

        Raises:
            ProblemError: Too many are being computed or waiting for this owner (429).
        """
        owner, limit = current_flow.get().owner, self._settings.max_owner_late_probes
        if self._late[owner] + count > limit:
            detail = f"{self._late[owner]} points of the token are waiting or being computed; retry later"
            raise _exceeded("probes", detail, f"at most {limit} points at the same time for one token", 1)
        self._late[owner] += count
        try:
            yield
        finally:
            self._late[owner] -= count
            if not self._late[owner]:
                del self._late[owner]


def _exceeded(field: str, detail: str, rule: str, retry_after_s: int) -> ProblemError:
    return ProblemError("owner-quota", detail, field=field, rule=rule, retry_after_s=retry_after_s)
