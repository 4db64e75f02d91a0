"""When a call is tried again, and how long to wait: no I/O and no clock here, so that both clients share it.

Every call of the interface may be repeated: PUT and DELETE by their nature (the same frame bytes under the same index
are answered as a replay), POST of probes because it only reads. A call is tried again after a failure to connect or to
hear the answer, and after 408, 429, 502, 503 and 504; nothing else would come out otherwise the second time.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime


@dataclass(frozen=True)
class Timeouts:
    """Seconds until a call counts as failed. Each attempt has its own.

    connect_s:  for a connection, TLS included.
    send_s:     without a byte sent: phones' networks stall.
    answer_s:   without a byte of the answer. A frame's answer comes after its processing: 0.1 to 1 s on two cores,
                behind the other sessions' frames.
    """

    connect_s: float = 5.0
    send_s: float = 30.0
    answer_s: float = 60.0

    def __post_init__(self) -> None:
        """Refuse, by ValueError, times that end before they begin."""
        for name, value in (("connect_s", self.connect_s), ("send_s", self.send_s), ("answer_s", self.answer_s)):
            if not value > 0:
                raise ValueError(f"{name} must be above 0, got {value}")


@dataclass(frozen=True)
class Retry:
    """How often, and how long in between.

    attempts:         in all; 1 = never again.
    first_delay_s:    the wait doubles from here with each attempt, and half of it is chance, so that clients that
                      failed together do not come back together.
    longest_delay_s:  the most that doubling comes to.
    patience_s:       a server that asks for a longer wait than this (Retry-After) is not waited for.
    """

    attempts: int = 4
    first_delay_s: float = 0.2
    longest_delay_s: float = 5.0
    patience_s: float = 30.0

    def __post_init__(self) -> None:
        """Refuse, by ValueError, less than one attempt and waits below 0."""
        if self.attempts < 1:
            raise ValueError(f"at least 1 attempt is made, got {self.attempts}")
        if min(self.first_delay_s, self.longest_delay_s, self.patience_s) < 0:
            raise ValueError(f"waits are 0 s or more, got {self}")

    def delay_s(self, failed: int, *, retry_after_s: float | None = None, luck: float) -> float | None:
        """The wait after so many failed attempts; None: give up. `luck` is a random number from 0 to 1.

        Never shorter than the server asks for, and up to a tenth longer.
        """
        if failed >= self.attempts or (retry_after_s or 0.0) > self.patience_s:
            return None
        backoff_s = min(self.longest_delay_s, self.first_delay_s * 2.0 ** min(failed - 1, 60)) * (0.5 + 0.5 * luck)
        return backoff_s if retry_after_s is None else max(backoff_s, retry_after_s * (1 + 0.1 * luck))


NEVER = Retry(attempts=1)
"""For frames that are of no use when they are late."""


def parse_retry_after(value: str | None, *, now: datetime | None = None) -> float | None:
    """Seconds of a Retry-After header, which holds seconds or a date; None without one that can be read."""
    if not value:
        return None
    if value.strip().isascii() and value.strip().isdigit():
        return float(value)
    try:
        moment = parsedate_to_datetime(value)
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return max(0.0, (moment - (now or datetime.now(UTC))).total_seconds())
