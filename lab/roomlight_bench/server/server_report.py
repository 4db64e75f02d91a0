"""Report of `roomlight bench server`: rows and criteria, as tables and JSON. Milliseconds and megabytes (10^6)."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight_bench.reporting import Criterion, criteria_table, short_number
from roomlight_bench.server.server_load import IN_FLIGHT

OVERHEAD_SHARE: Final = 0.05
"""Limit on the time that HTTP adds to a frame, as a share."""
HEALTH_MS: Final = 50.0
"""Limit on the response time of /healthz while frames are processed."""


@dataclass(frozen=True)
class Latencies:
    """Percentiles and maximum of `count` response times; None without responses."""

    count: int
    p50_ms: float | None
    p95_ms: float | None
    p99_ms: float | None
    most_ms: float | None

    @classmethod
    def of(cls, values_ms: Sequence[float]) -> "Latencies":
        """Compute the interpolated percentiles of the values."""
        if not values_ms:
            return cls(0, None, None, None, None)
        p50, p95, p99 = (float(value) for value in np.percentile(values_ms, (50, 95, 99)))
        return cls(len(values_ms), p50, p95, p99, float(max(values_ms)))


@dataclass(frozen=True)
class OverheadRow:
    """The same frames through the server and through the engine in this process, alternating.

    Times are medians over the frames of each frame's least time over the rounds: the least time leaves out other work
    on the machine.

    Attributes:
        body_bytes: Mean size of a frame message.
        engine_ms: The engine called directly.
        decoded_ms: The same with parsing, decoding and resizing the message.
        http_ms: The frame sent, processed and answered over HTTP.
    """

    colour: str
    body_bytes: int
    frames: int
    rounds: int
    engine_ms: float
    decoded_ms: float
    http_ms: float

    @property
    def share(self) -> float:
        """Time that HTTP adds to a frame that is decoded in either case, as a share of that time."""
        return self.http_ms / self.decoded_ms - 1

    @property
    def share_of_engine(self) -> float:
        """Time that HTTP and decoding add to the engine's own time, as a share of it."""
        return self.http_ms / self.engine_ms - 1


@dataclass(frozen=True)
class LoadRow:
    """A number of sessions at the same time.

    Attributes:
        wanted_fps: Frames per second and session that were due.
        held_fps: Frames per second and session that were processed in time.
        lost: Share of the due frames that the phone dropped or the server skipped.
        memory_mb: Growth of the process's resident memory per session; None on systems without /proc.
        stated_mb: Memory that the sessions report for themselves, mean.
        keyframes: Keyframes per session, mean.
    """

    sessions: int
    wanted_fps: float
    held_fps: float
    lost: float
    frame: Latencies
    light: Latencies
    health: Latencies
    memory_mb: float | None
    stated_mb: float
    keyframes: float


@dataclass(frozen=True)
class ServerReport:
    """A run of `roomlight bench server`.

    Attributes:
        seconds: How long phones streamed, for each row of `load`.
        start_alive_ms: Start of each server process to its first response.
        start_ready_ms: Start of each server process until it accepts sessions.
        busy: Load average of the machine before the run; None where the system has none.
    """

    model: str
    seconds: float
    start_alive_ms: tuple[float, ...]
    start_ready_ms: tuple[float, ...]
    overhead: tuple[OverheadRow, ...]
    load: tuple[LoadRow, ...]
    machine: dict[str, str]
    threads: int
    cores: int
    busy: float | None

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The project's criteria, judged on this run."""
        return (
            *(
                Criterion(
                    f"HTTP adds under {OVERHEAD_SHARE:.0%} to a frame ({row.colour})",
                    row.share,
                    OVERHEAD_SHARE,
                    row.share < OVERHEAD_SHARE,
                )
                for row in self.overhead
            ),
            *(
                Criterion(
                    f"/healthz under {HEALTH_MS:g} ms, p99 at {row.sessions} sessions",
                    row.health.p99_ms,
                    HEALTH_MS,
                    row.health.p99_ms < HEALTH_MS,
                )
                for row in self.load
                if row.health.p99_ms is not None
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values, including the shares and criteria that follow from them."""
        values = asdict(self)
        for row, entry in zip(self.overhead, values["overhead"], strict=True):
            entry |= {"share": row.share, "share_of_engine": row.share_of_engine}
        return values | {"criteria": [asdict(criterion) for criterion in self.criteria]}

    def tables(self) -> list[Table]:
        """Return all tables, with the criteria at the end."""
        return [self._overhead_table(), self._load_table(), criteria_table(self.criteria)]

    def _overhead_table(self) -> Table:
        alive, ready = (np.median(values) / 1e3 for values in (self.start_alive_ms, self.start_ready_ms))
        busy = "" if self.busy is None else f", load average before the run {self.busy:.1f}"
        rounds = self.overhead[0].rounds
        return figure_table(
            "One session, one frame after the other, in this process and over HTTP, ms: "
            f"median of each frame's least of {rounds}",
            ("kB", "frames", "engine", "+ decoding", "+ HTTP", "HTTP adds", "to the engine alone"),
            [
                (
                    row.colour,
                    f"{row.body_bytes / 1e3:.0f}",
                    f"{row.frames}",
                    *map(short_number, (row.engine_ms, row.decoded_ms, row.http_ms)),
                    f"{row.share:+.1%}",
                    f"{row.share_of_engine:+.1%}",
                )
                for row in self.overhead
            ],
            caption=f"model {self.model}; {self.threads} engine threads, {self.cores} cores, "
            f"{self.machine['processor']}{busy}; the server started {len(self.start_ready_ms)} times: /healthz after "
            f"{alive:.1f} s, ready after {ready:.1f} s (median; most {max(self.start_ready_ms) / 1e3:.1f})",
        )

    def _load_table(self) -> Table:
        return figure_table(
            f"Sessions at the same time, each streaming for {self.seconds:g} s: frames per second and session, "
            "ms p50 / p95 / p99",
            ("wanted", "held", "lost", "frame", "light", "/healthz", "most", "MB", "stated", "keyframes"),
            [
                (
                    f"{row.sessions} sessions",
                    f"{row.wanted_fps:g}",
                    f"{row.held_fps:.2f}",
                    f"{row.lost:.0%}",
                    *map(_percentiles, (row.frame, row.light, row.health)),
                    *map(short_number, (row.health.most_ms, row.memory_mb, row.stated_mb, row.keyframes)),
                )
                for row in self.load
            ],
            caption="light: harmonics and main light of the tracked probe, requested after each frame; lost: dropped "
            f"by the phone because {IN_FLIGHT} frames were unanswered, or skipped by the server for a newer one; MB: "
            "resident memory per session with this many keyframes; stated: what sessions report for themselves",
        )


def _percentiles(latencies: Latencies) -> str:
    return " / ".join(map(short_number, (latencies.p50_ms, latencies.p95_ms, latencies.p99_ms)))
