"""What all benchmark reports share: the project's criteria, a description of the machine, numbers in tables."""

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numba
import numpy as np
from annotated_types import Interval
from rich.table import Table

from roomlight.engine.networks.openvino_runtime import openvino_version
from roomlight.engine.networks.runtime import ort
from roomlight.imaging.tables import figure_table
from roomlight.threads import processor_name

Counts = tuple[Annotated[int, Interval(ge=1, le=1000)], ...]
"""Numbers of sessions or servers, a row of a table each."""


@dataclass(frozen=True)
class Criterion:
    """One of the project's demands on speed: the demand in words, the measured figure, and its limit."""

    demand: str
    measured: float
    limit: float
    holds: bool


def criteria_table(criteria: Sequence[Criterion]) -> Table:
    """Return a table with a row per criterion: demand, figure, verdict."""
    table = figure_table("Criteria", ("measured", ""))
    for criterion in criteria:
        verdict = "[green]holds[/green]" if criterion.holds else "[red]does not hold[/red]"
        table.add_row(criterion.demand, f"{criterion.measured:.3g}", verdict)
    return table


def describe_machine() -> dict[str, str]:
    """Return what a figure depends on besides the code: processor, system and versions of the libraries."""
    return {
        "processor": processor_name(),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "onnxruntime": ort.__version__,
        "openvino": openvino_version() or "not installed",
    }


def short_number(value: float | None) -> str:
    """Format with three digits, or as an integer from 100 on; a dash for None."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
