"""What a benchmark run found: rows, the machine's ceilings, the project's speed criteria, as a table and as JSON."""

import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
import onnxruntime
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table

from roomlight.threads import thread_count
from roomlight_bench.roofline import Ceilings
from roomlight_bench.timing import Timing

MARCH_FASTER: Final = 30.0
"""SGLV ray tracing against `grid_sample` in PyTorch, at least."""
INITIALISATION_FASTER: Final = 5.0
"""Volume initialisation against plain NumPy, at least."""
PANORAMA_SHARE: Final = 1 / 3
"""Partial-mesh panorama against the networks of a frame, at most."""
_PAPER: Final = "the paper's times are on its GPU, an RTX 2080 Ti: 77 ms together"


@dataclass(frozen=True)
class StageRow:
    """One stage, timed. Milliseconds; `roof_ms` is the least that the machine's ceilings allow."""

    name: str
    ours: Timing
    reference: Timing | None
    torch: Timing | None
    paper_ms: float | None
    flops: float
    bytes: float
    roof_ms: float
    note: str
    differences: dict[str, float]

    def ratio(self, other: Timing | None) -> float | None:
        """How many times as long the other way takes: least time to least time."""
        return None if other is None else other.least_ms / self.ours.least_ms


@dataclass(frozen=True)
class Criterion:
    """One of the project's demands on speed, and what this run measured."""

    demand: str
    measured: float
    limit: float
    holds: bool


@dataclass(frozen=True)
class StagesReport:
    """A run of `roomlight bench stages`."""

    rows: tuple[StageRow, ...]
    ceilings: Ceilings
    criteria: tuple[Criterion, ...]
    machine: dict[str, str]
    threads: int
    repeats: int
    networks: str
    torch: bool

    @classmethod
    def of(
        cls, rows: Sequence[StageRow], ceilings: Ceilings, *, repeats: int, networks: str, torch: bool
    ) -> "StagesReport":
        """The report of these rows, with the criteria judged and the machine described."""
        return cls(tuple(rows), ceilings, judge(rows), machine_here(), thread_count(), repeats, networks, torch)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; `from_json` gives an equal report back."""
        return asdict(self) | {"rows": [asdict(row) for row in self.rows], "criteria": list(map(asdict, self.criteria))}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "StagesReport":
        """Read what `to_json` wrote."""

        def timing(entry: dict[str, Any] | None) -> Timing | None:
            return None if entry is None else Timing(**entry)

        rows = [
            StageRow(
                **row
                | {"ours": Timing(**row["ours"]), "reference": timing(row["reference"]), "torch": timing(row["torch"])}
            )
            for row in values["rows"]
        ]
        criteria = tuple(Criterion(**entry) for entry in values["criteria"])
        parts: dict[str, Any] = {"rows": tuple(rows), "criteria": criteria, "ceilings": Ceilings(**values["ceilings"])}
        return cls(**{**values, **parts})

    def table(self, *, width: int = 120) -> RenderableType:
        """The stages, then what the criteria say; below 120 columns without the figures behind the roofline."""
        return Group(self._stages_table(brief=width < 120), criteria_table(self.criteria))

    def _stages_table(self, *, brief: bool) -> Table:
        table = Table(
            title=f"Stages of one frame and one probe in ms: ours least / median of {self.repeats}, others least",
            title_justify="left",
            caption=(
                f"{self.threads} threads (ours, ONNX Runtime, PyTorch), {self.machine['processor']}; networks: "
                f"{self.networks}; {'' if self.torch else 'torch not installed: nothing to compare with; '}"
                f"ceilings: {self.ceilings.flops_per_s / 1e9:.0f} GFLOP/s (fp32 matrix product), "
                f"{self.ceilings.bytes_per_s / 1e9:.1f} GB/s (copy); x: times as long as ours, least to least; "
                f"roof: the least these ceilings allow; {_PAPER}"
            ),
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            padding=0,
            show_edge=False,
        )
        table.add_column("stage", min_width=22)
        table.add_column("ours", justify="right", no_wrap=True)
        table.add_column("NumPy", justify="right", no_wrap=True)
        table.add_column("PyTorch", justify="right", no_wrap=True)
        for heading in (*(() if brief else ("max diff", "MFLOP", "MB")), "roof", "ours/roof", "paper"):
            table.add_column(heading, justify="right", no_wrap=True)
        for row in self.rows:
            largest = max(row.differences.values(), default=None)
            table.add_row(
                f"{row.name}\n[dim]{row.note}[/dim]" if row.note else row.name,
                f"{short(row.ours.least_ms)} / {short(row.ours.median_ms)}",
                _other(row, row.reference),
                _other(row, row.torch),
                *(() if brief else ("-" if largest is None else f"{largest:.1e}", *_millions(row.flops, row.bytes))),
                short(row.roof_ms),
                short(row.ours.least_ms / row.roof_ms),
                "-" if row.paper_ms is None else f"{row.paper_ms:g}",
            )
        return table


def judge(rows: Sequence[StageRow]) -> tuple[Criterion, ...]:
    """The criteria that these rows can answer, on least times."""
    found: list[Criterion] = []

    def at_least(row: StageRow, other: Timing | None, limit: float, demand: str) -> None:
        ratio = row.ratio(other)
        if ratio is not None:
            found.append(Criterion(demand, ratio, limit, ratio >= limit))

    for row in rows:
        if row.name.startswith("ray tracing"):
            demand = f"{row.name}: at least {MARCH_FASTER:g} x faster than grid_sample in PyTorch"
            at_least(row, row.torch, MARCH_FASTER, demand)
        if row.name == "volume initialisation":
            demand = f"{row.name}: at least {INITIALISATION_FASTER:g} x faster than plain NumPy"
            at_least(row, row.reference, INITIALISATION_FASTER, demand)
    least = {row.name: row.ours.least_ms for row in rows}
    network = [ms for name, ms in least.items() if name.startswith("SGLV network")]
    if network:
        for name, ms in (
            ("partial-mesh panorama", least["partial-mesh panorama"]),
            ("mesh building and panorama together", least["mesh building"] + least["partial-mesh panorama"]),
        ):
            share = ms / min(network)  # the fastest runtime's: the hardest reading
            found.append(
                Criterion(
                    f"{name}: under a third of the SGLV network's time", share, PANORAMA_SHARE, share < PANORAMA_SHARE
                )
            )
    return tuple(found)


def criteria_table(criteria: Sequence[Criterion]) -> Table:
    """Demands, figures and verdicts."""
    table = Table(title="Criteria", title_justify="left")
    for heading in ("demand", "measured", ""):
        table.add_column(heading)
    for criterion in criteria:
        verdict = "[green]holds[/green]" if criterion.holds else "[red]does not hold[/red]"
        table.add_row(criterion.demand, f"{criterion.measured:.3g}", verdict)
    return table


def machine_here() -> dict[str, str]:
    """What a figure depends on besides the code."""
    return {
        "processor": _processor(),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "onnxruntime": onnxruntime.__version__,
    }


def _other(row: StageRow, timing: Timing | None) -> str:
    ratio = row.ratio(timing)
    return "-" if timing is None or ratio is None else f"{short(timing.least_ms)}\n[bold]{short(ratio)} x[/bold]"


def _millions(*values: float) -> tuple[str, ...]:
    return tuple(short(value / 1e6) for value in values)


def short(value: float) -> str:
    """Three digits, or all before the point."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def _processor() -> str:
    listed = Path("/proc/cpuinfo")  # Python's own `platform.processor` is empty on Linux
    lines = listed.read_text(encoding="utf-8").splitlines() if listed.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
