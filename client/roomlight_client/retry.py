"""Retry policy: which delay comes before the next attempt. No I/O and no clock, so that both clients share it.

Every call of the interface is idempotent: PUT and DELETE by definition (the server answers a frame whose index and
bytes it has seen before as a replay), and the POST of probes only reads. Both clients repeat a call after a failed
connection, after a lost response, and after the statuses 408, 429, 502, 503 and 504. They do not repeat it after any
other status: a second attempt would get the same one. A composite or upload without an answer in time (408 and 504
too) is not repeated either: the server would do its work twice, or the file be sent twice.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

from roomlight.errors import OptionError


@dataclass(frozen=True)
class Timeouts:
    """Seconds after which one attempt fails.

    Attributes:
        connect_s: For a connection, TLS included.
        write_s: Without a byte sent. Mobile networks stall for seconds.
        read_s: Without a byte of the response. The server answers a frame after processing it: 0.1 to 1 s on two
            cores, after the frames of other sessions.
        composite_s: The same for a composite, for which servers take up to 120 s, and for the upload of an object.

    Raises:
        OptionError: If a timeout is not above 0.
    """

    connect_s: float = 5.0
    write_s: float = 30.0
    read_s: float = 60.0
    composite_s: float = 130.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise OptionError(f"{name} must be above 0, got {value}")


@dataclass(frozen=True)
class Retry:
    """Number of attempts and the delays between them.

    Attributes:
        attempts: In all; 1 means no retry.
        first_delay_s: Delay after the first attempt. It doubles after each one, and half of it is random, so that
            clients that failed together do not retry together.
        max_delay_s: Upper limit of the doubling.
        max_retry_after_s: Longest Retry-After that the client waits for; after a longer one it raises at once.

    Raises:
        OptionError: If there is less than one attempt, or a delay is negative.
    """

    attempts: int = 4
    first_delay_s: float = 0.2
    max_delay_s: float = 5.0
    max_retry_after_s: float = 30.0

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise OptionError(f"attempts must be at least 1, got {self.attempts}")
        if min(self.first_delay_s, self.max_delay_s, self.max_retry_after_s) < 0:
            raise OptionError(f"delays must be at least 0 s, got {self}")

    def delay_s(self, failed: int, *, retry_after_s: float | None = None, jitter: float) -> float | None:
        """Return the delay after `failed` attempts, or None when no attempt is left.

        Args:
            failed: Attempts made so far.
            retry_after_s: The server's Retry-After. The delay is never shorter, and at most a tenth longer.
            jitter: A random number from 0 to 1.
        """
        if failed >= self.attempts or (retry_after_s or 0.0) > self.max_retry_after_s:
            return None
        backoff_s = min(self.max_delay_s, self.first_delay_s * 2.0 ** min(failed - 1, 60)) * (0.5 + 0.5 * jitter)
        return backoff_s if retry_after_s is None else max(backoff_s, retry_after_s * (1 + 0.1 * jitter))


RECONNECT = Retry(attempts=60, first_delay_s=0.25, max_delay_s=10.0)
"""For streams and pushes whose server is away: about eight minutes."""

NO_RETRY = Retry(attempts=1)
"""One attempt: for calls whose repetition the caller decides."""


def parse_retry_after(value: str | None, *, now: datetime | None = None) -> float | None:
    """Return the seconds of a Retry-After header (seconds or an HTTP date), or None if it is missing or malformed."""
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
