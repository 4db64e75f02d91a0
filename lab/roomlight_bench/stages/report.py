"""Report of `roomlight bench stages`: timed rows, the machine's peak and the speed criteria, as table and JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight_bench.reporting import Criterion, criteria_table, short_number
from roomlight_bench.stages.sessions import FURTHER, LATE
from roomlight_bench.timing import Timing

MARCH_FASTER: Final = 30.0
"""Least speed-up of SGLV ray tracing over `grid_sample` in PyTorch."""
INITIALISATION_FASTER: Final = 5.0
"""Least speed-up of volume initialisation over plain NumPy."""
PANORAMA_SHARE: Final = 1 / 3
"""Limit on the time of the partial-mesh panorama as a share of the SGLV network's."""
FURTHER_PROBE_MS: Final = 8.0
"""Limit on what a further tracked probe adds to a frame."""
LATE_RATIO: Final = 4.0
"""Limit on the time of `LATE` late points in one call, relative to one."""
_PAPER: Final = "the paper's times are on its GPU, an RTX 2080 Ti: 77 ms together"


@dataclass(frozen=True)
class StageRow:
    """One timed `BenchStage`; `flops` of a network are None where PyTorch, which counts them, is not installed."""

    name: str
    ours: Timing
    reference: Timing | None
    torch: Timing | None
    paper_ms: float | None
    flops: float | None
    note: str
    differences: dict[str, float]

    def ratio(self, other: Timing | None) -> float | None:
        """Return how many times as long the other implementation takes, by least times; None if it was not timed."""
        return None if other is None else other.least_ms / self.ours.least_ms


@dataclass(frozen=True)
class StagesReport:
    """A run of `roomlight bench stages`.

    Attributes:
        peak_flops_per_s: Speed of a float32 matrix product, measured in the same run.
        criteria: The project's demands that these rows can answer.
        threads: Of our kernels, ONNX Runtime and PyTorch.
        networks: Which networks were timed, in words.
    """

    rows: tuple[StageRow, ...]
    peak_flops_per_s: float
    criteria: tuple[Criterion, ...]
    machine: dict[str, str]
    threads: int
    repeats: int
    networks: str
    torch: bool

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self) | {"rows": [asdict(row) for row in self.rows], "criteria": list(map(asdict, self.criteria))}

    def tables(self) -> list[Table]:
        """Return the stages and the criteria."""
        table = figure_table(
            f"Stages of one frame and one probe, ms; ours: least / median of {self.repeats} runs, others: least",
            ("ours", "NumPy", "PyTorch", "max diff", "GFLOP", "of peak", "paper"),
            caption=(
                f"{self.threads} threads (ours, ONNX Runtime, PyTorch), {self.machine['processor']}; networks: "
                f"{self.networks}; {'' if self.torch else 'no comparison with PyTorch, which is not installed; '}"
                f"x: times as long as ours, by least times; of peak: a network's operations per second relative to "
                f"{self.peak_flops_per_s / 1e9:.0f} GFLOP/s, a fp32 matrix product; {_PAPER}"
            ),
        )
        for row in self.rows:
            largest = max(row.differences.values(), default=None)
            table.add_row(
                f"{row.name}\n[dim]{row.note}[/dim]" if row.note else row.name,
                f"{short_number(row.ours.least_ms)} / {short_number(row.ours.median_ms)}",
                _time_and_ratio(row, row.reference),
                _time_and_ratio(row, row.torch),
                "-" if largest is None else f"{largest:.1e}",
                "-" if row.flops is None else short_number(row.flops / 1e9),
                "-" if row.flops is None else f"{1e3 * row.flops / row.ours.least_ms / self.peak_flops_per_s:.0%}",
                "-" if row.paper_ms is None else f"{row.paper_ms:g}",
            )
        return [table, criteria_table(self.criteria)]


def judge(rows: Sequence[StageRow]) -> tuple[Criterion, ...]:
    """Judge the criteria that these rows can answer, on least times."""
    criteria: list[Criterion] = []

    def at_least(row: StageRow, other: Timing | None, limit: float, demand: str) -> None:
        ratio = row.ratio(other)
        if ratio is not None:
            criteria.append(Criterion(demand, ratio, limit, ratio >= limit))

    for row in rows:
        if row.name.startswith("ray tracing"):
            demand = f"{row.name}: at least {MARCH_FASTER:g} x faster than grid_sample in PyTorch"
            at_least(row, row.torch, MARCH_FASTER, demand)
        if row.name == "volume initialisation":
            demand = f"{row.name}: at least {INITIALISATION_FASTER:g} x faster than plain NumPy"
            at_least(row, row.reference, INITIALISATION_FASTER, demand)
    least = {row.name: row.ours.least_ms for row in rows}
    for name, ms in least.items():
        kind, _, model = name.partition(", ")
        if kind == f"frame with {FURTHER} further probes":
            further_ms = (ms - least[f"frame, {model}"]) / FURTHER
            demand = f"a further probe, {model}: at most {FURTHER_PROBE_MS:g} ms"
            criteria.append(Criterion(demand, further_ms, FURTHER_PROBE_MS, further_ms <= FURTHER_PROBE_MS))
        if kind == f"{LATE} late points":
            ratio = ms / least[f"late point, {model}"]
            demand = f"{name}: at most {LATE_RATIO:g} x the time of one"
            criteria.append(Criterion(demand, ratio, LATE_RATIO, ratio <= LATE_RATIO))
    network = [ms for name, ms in least.items() if name.startswith("SGLV network")]
    if network:
        for name, ms in (
            ("partial-mesh panorama", least["partial-mesh panorama"]),
            ("mesh building and panorama together", least["mesh building"] + least["partial-mesh panorama"]),
        ):
            share = ms / min(network)  # of the fastest runtime: the strictest comparison
            criteria.append(
                Criterion(
                    f"{name}: under a third of the SGLV network's time", share, PANORAMA_SHARE, share < PANORAMA_SHARE
                )
            )
    return tuple(criteria)


def _time_and_ratio(row: StageRow, timing: Timing | None) -> str:
    ratio = row.ratio(timing)
    if timing is None or ratio is None:
        return "-"
    return f"{short_number(timing.least_ms)}\n[bold]{short_number(ratio)} x[/bold]"


@dataclass(frozen=True)
class AgainstRow:
    """Whole frames or late points of two checkouts: milliseconds, least of their rounds."""

    name: str
    here_ms: float
    there_ms: float


@dataclass(frozen=True)
class AgainstReport:
    """A run of `roomlight bench stages --against`."""

    rows: tuple[AgainstRow, ...]
    other: str
    machine: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self)

    def tables(self) -> list[Table]:
        """Return a row for each measurement."""
        rows = (
            (row.name, short_number(row.here_ms), short_number(row.there_ms), f"{row.here_ms / row.there_ms:.2f}")
            for row in self.rows
        )
        return [figure_table(f"This checkout against {self.other}", ("here, ms", "there, ms", "ratio"), rows)]
