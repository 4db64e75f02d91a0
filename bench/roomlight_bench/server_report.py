"""What `roomlight bench server` found: rows, demands, as tables and as JSON. Milliseconds and megabytes (10^6)."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table

from roomlight_bench.stages_report import Criterion, criteria_table, short
from roomlight_bench.server_load import IN_FLIGHT

OVERHEAD_SHARE: Final = 0.15
"""What the network's way may add to a frame's time, at most."""
HEALTH_MS: Final = 50.0
"""`/healthz` while frames are processed, at most."""


@dataclass(frozen=True)
class Latencies:
    """Of `count` answers; None where there were none."""

    count: int
    p50_ms: float | None
    p95_ms: float | None
    p99_ms: float | None
    most_ms: float | None

    @classmethod
    def of(cls, values_ms: Sequence[float]) -> "Latencies":
        """Percentiles of the values, interpolated."""
        if not values_ms:
            return cls(0, None, None, None, None)
        p50, p95, p99 = (float(value) for value in np.percentile(values_ms, (50, 95, 99)))
        return cls(len(values_ms), p50, p95, p99, float(max(values_ms)))


@dataclass(frozen=True)
class OverheadRow:
    """The same frames through the server and by the engine here, in turn: of each frame the least time of the rounds,
    which leaves out what else the machine was doing; of these the median.

    engine_ms:  the engine called directly.
    decoded_ms: the same from the message's bytes: parsed, decoded, at the working size.
    http_ms:    sent, processed, answered.
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
        """What HTTP adds to a frame that comes as bytes in either case, as a share of it."""
        return self.http_ms / self.decoded_ms - 1

    @property
    def share_of_engine(self) -> float:
        """What HTTP and decoding add to the engine's own time, as a share of it."""
        return self.http_ms / self.engine_ms - 1


@dataclass(frozen=True)
class LoadRow:
    """So many sessions at once. Rates are frames a second of one session; `lost` is the share of the frames due that
    was dropped by the phone or overtaken on the server.

    memory_mb:  resident memory that the process gained, a session; None where the system does not say.
    stated_mb:  what the sessions say of themselves, in the mean.
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
class ProbeRow:
    """Light at `count` points in one call and in as many calls; medians.

    followed:  tracked from the first frame on; else asked about late, and caught up from `keyframes`.
    frame_ms:  a frame with so many probes followed.
    """

    followed: bool
    count: int
    keyframes: int
    frame_ms: float | None
    batched_ms: float
    one_by_one_ms: float


@dataclass(frozen=True)
class ServerReport:
    """A run of `roomlight bench server`. `busy`: the machine's load average before it began, None where unknown."""

    model: str
    seconds: float
    start_alive_ms: tuple[float, ...]
    start_ready_ms: tuple[float, ...]
    overhead: tuple[OverheadRow, ...]
    load: tuple[LoadRow, ...]
    probes: tuple[ProbeRow, ...]
    machine: dict[str, str]
    threads: int
    cores: int
    busy: float | None

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The project's demands, and what this run measured."""
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
        """Plain JSON values, with the shares and criteria that follow from them."""
        values = asdict(self)
        for row, entry in zip(self.overhead, values["overhead"], strict=True):
            entry |= {"share": row.share, "share_of_engine": row.share_of_engine}
        return values | {"criteria": [asdict(criterion) for criterion in self.criteria]}

    def table(self) -> RenderableType:
        """Everything, with the machine beneath."""
        return Group(
            self._overhead_table(),
            "",
            self._load_table(),
            "",
            self._probes_table(),
            "",
            criteria_table(self.criteria),
        )

    def _overhead_table(self) -> Table:
        alive, ready = (np.median(values) / 1e3 for values in (self.start_alive_ms, self.start_ready_ms))
        busy = "" if self.busy is None else f", load average before the run {self.busy:.1f}"
        rounds = self.overhead[0].rounds
        return _table(
            f"One session, one frame after the other, there and here: median of the frames' least of {rounds}, ms",
            f"model {self.model}; {self.threads} engine threads, {self.cores} cores, {self.machine['processor']}"
            f"{busy}; the server started {len(self.start_ready_ms)} times: /healthz after {alive:.1f} s, ready after "
            f"{ready:.1f} s (median; most {max(self.start_ready_ms) / 1e3:.1f})",
            ("frames as", "kB", "frames", "engine", "and decoding", "HTTP", "HTTP adds", "to the engine alone"),
            [
                (
                    row.colour,
                    f"{row.body_bytes / 1e3:.0f}",
                    f"{row.frames}",
                    *map(short, (row.engine_ms, row.decoded_ms, row.http_ms)),
                    f"{row.share:+.1%}",
                    f"{row.share_of_engine:+.1%}",
                )
                for row in self.overhead
            ],
        )

    def _load_table(self) -> Table:
        return _table(
            f"Sessions at once, each streaming for {self.seconds:g} s: frames a second and session, ms p50 / p95 / p99",
            "light: of the tracked probe, harmonics and main light, asked after each frame; lost: dropped on the phone "
            f"because {IN_FLIGHT} were on their way, or overtaken; MB: resident memory a session, with so many "
            "keyframes; stated: what sessions say of themselves",
            ("sessions", "wanted", "held", "lost", "frame", "light", "/healthz", "most", "MB", "stated", "keyframes"),
            [
                (
                    f"{row.sessions}",
                    f"{row.wanted_fps:g}",
                    f"{row.held_fps:.2f}",
                    f"{row.lost:.0%}",
                    *map(_percentiles, (row.frame, row.light, row.health)),
                    _or_dash(row.health.most_ms),
                    _or_dash(row.memory_mb),
                    short(row.stated_mb),
                    short(row.keyframes),
                )
                for row in self.load
            ],
        )

    def _probes_table(self) -> Table:
        return _table(
            "Light at many points of one session: in one call, and in a call each, median ms",
            "harmonics and main light; followed: tracked from the first frame on, each frame takes them along; late: "
            "caught up from the keyframes when asked; x: a call each to one call",
            ("points", "", "keyframes", "a frame", "one call", "a call each", "x"),
            [
                (
                    f"{row.count}",
                    "followed" if row.followed else "late",
                    f"{row.keyframes}",
                    _or_dash(row.frame_ms),
                    short(row.batched_ms),
                    short(row.one_by_one_ms),
                    f"{row.one_by_one_ms / row.batched_ms:.2f}",
                )
                for row in self.probes
            ],
        )


def _table(title: str, caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Columns as wide as what stands in them: `print_table` widens the console for them."""
    table = Table(
        title=title,
        title_justify="left",
        caption=caption,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    for heading, *cells in zip(headings, *rows, strict=True):
        table.add_column(heading, justify="right", no_wrap=True, min_width=max(map(len, (heading, *cells))))
    for row in rows:
        table.add_row(*row)
    return table


def _percentiles(latencies: Latencies) -> str:
    return " / ".join(map(_or_dash, (latencies.p50_ms, latencies.p95_ms, latencies.p99_ms)))


def _or_dash(value: float | None) -> str:
    return "-" if value is None else short(value)
