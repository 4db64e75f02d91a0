"""Report of `roomlight bench hostile`: what a neighbour keeps during each attack, as tables, criteria and JSON."""

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight_bench.reporting import Criterion, criteria_table, short_number
from roomlight_bench.server.server_report import Latencies

KEPT_SHARE: Final = 0.8
"""Least share of its frames that a neighbour keeps, compared with the neighbour alone in the same run."""
GROWN: Final = 1.2
"""Limit on the memory after an attack, relative to before."""
SLOPE: Final = 0.01
"""Limit on the growth of memory in a minute of churn, relative to the memory at its beginning."""
P99_MS: Final = 1000.0
"""Limit on the response time of the neighbour's frames."""


@dataclass(frozen=True)
class AttackRow:
    """The neighbour during an attack.

    Attributes:
        attack: Name of the attack; `alone` for none.
        due: Frames of the neighbour that were due.
        processed: Frames that were processed in time.
        frame: Response times of the neighbour's frames.
        light: Response times of the neighbour's light.
        rss_bytes: Largest resident memory of the server's process.
        rss_after_bytes: Resident memory after, when its sessions have ended.
        requests: Requests or messages of the hostile client.
        answers: Its answers by status; `closed` counts connections closed without one.
    """

    attack: str
    seconds: float
    due: int
    processed: int
    frame: Latencies
    light: Latencies
    rss_bytes: int
    rss_before_bytes: int
    rss_after_bytes: int
    requests: int
    answers: dict[str, int]

    @property
    def share(self) -> float:
        """Share of the due frames that were processed in time."""
        return self.processed / max(1, self.due)


@dataclass(frozen=True)
class HostileReport:
    """A run of `roomlight bench hostile`.

    Attributes:
        churn: Seconds and the resident memory after each attack of the churn, without its first round.
        rss_start_bytes: Resident memory of the server before the first session.
        rss_bound_bytes: Bound on the resident memory: start, sessions of both tokens, requests and answers in
            progress, and an allowance for the rest of the process.
        busy: Load average at the end of the run; None where the system has none.
    """

    alone: AttackRow
    attacks: tuple[AttackRow, ...]
    churn: tuple[tuple[float, int], ...]
    rss_start_bytes: int
    rss_bound_bytes: int
    fps: float
    machine: dict[str, str]
    cores: int
    busy: float | None

    def kept(self, row: AttackRow) -> float:
        """Return the neighbour's share of frames during an attack, relative to the neighbour alone."""
        return row.share / self.alone.share if self.alone.share else 0.0

    @property
    def slope(self) -> float | None:
        """Growth of memory in a minute of churn, relative to its beginning; None without enough of it."""
        if len(self.churn) < 3:
            return None
        seconds, sizes = np.array(self.churn, float).T
        growth, start = np.polyfit(seconds, sizes, 1)
        return float(60.0 * growth / max(1.0, start + growth * seconds[0]))

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The project's criteria, judged on this run."""
        criteria: list[Criterion] = []
        for row in self.attacks:
            kept, p99_ms = self.kept(row), row.frame.p99_ms
            criteria.append(Criterion(f"{row.attack}: keeps {KEPT_SHARE:.0%}", kept, KEPT_SHARE, kept >= KEPT_SHARE))
            slowest = float("inf") if p99_ms is None else p99_ms
            grown = row.rss_after_bytes / max(1, row.rss_before_bytes)
            criteria.append(Criterion(f"{row.attack}: memory returns", grown, GROWN, grown <= GROWN))
            criteria.append(Criterion(f"{row.attack}: p99 under {P99_MS:g} ms", slowest, P99_MS, slowest < P99_MS))
        most, bound = max(row.rss_bytes for row in (self.alone, *self.attacks)) / 1e6, self.rss_bound_bytes / 1e6
        criteria.append(Criterion(f"memory under {bound:.0f} MB", most, bound, most <= bound))
        if self.slope is not None:
            demand = f"memory grows less than {SLOPE:.0%} a minute in {self.churn[-1][0] / 60:.0f} minutes of churn"
            criteria.append(Criterion(demand, self.slope, SLOPE, self.slope < SLOPE))
        return tuple(criteria)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values, including the shares and criteria that follow from them."""
        values = asdict(self)
        for row, entry in zip(self.attacks, values["attacks"], strict=True):
            entry |= {"share": row.share, "kept": self.kept(row)}
        values["alone"]["share"] = self.alone.share
        return values | {"criteria": [asdict(criterion) for criterion in self.criteria]}

    def tables(self) -> list[Table]:
        """Return the table of the neighbour, and the criteria."""
        busy = "" if self.busy is None else f", load average {self.busy:.1f}"
        table = figure_table(
            f"A neighbour that streams {self.fps:g} frames per second, during attacks of another client",
            ("s", "frames", "kept", "frame ms", "light ms", "MB", "after", "requests"),
            caption=f"frames: processed in time, of those due; kept: relative to the neighbour alone; ms: p50 / p99; "
            f"MB: largest resident memory of all its processes, after: when the attack is over, relative to before; "
            f"{self.rss_start_bytes / 1e6:.0f} at the start; {self.cores} cores, {self.machine['processor']}{busy}",
        )
        table.add_column("answers")
        for row in (self.alone, *self.attacks):
            table.add_row(
                row.attack,
                f"{row.seconds:.0f}",
                f"{row.processed} of {row.due}",
                f"{self.kept(row):.0%}",
                _percentiles(row.frame),
                _percentiles(row.light),
                f"{row.rss_bytes / 1e6:.0f}",
                f"{row.rss_after_bytes / max(1, row.rss_before_bytes):.2f}",
                str(row.requests),
                ", ".join(f"{status}: {count}" for status, count in sorted(row.answers.items())),
            )
        return [table, criteria_table(self.criteria)]


def _percentiles(latencies: Latencies) -> str:
    return " / ".join(map(short_number, (latencies.p50_ms, latencies.p99_ms)))
