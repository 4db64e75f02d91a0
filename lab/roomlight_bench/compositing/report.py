"""The figures of `roomlight bench composite`, as tables and JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from statistics import mean, median
from typing import Any, Final

import numpy as np
from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight_bench.reporting import Criterion, criteria_table, short_number

PREVIEW_MS: Final = 30.0
"""Limit of a preview of a sphere in 640 x 480 pixels, on two idle cores."""


@dataclass(frozen=True)
class PartTimes:
    """Milliseconds of one part of a frame over the measured frames.

    The mean matters where a part works in some frames only, as the light does: its median may be 0.
    """

    name: str
    wall_median_ms: float
    wall_p95_ms: float
    cpu_median_ms: float
    cpu_p95_ms: float
    cpu_mean_ms: float

    @classmethod
    def of(cls, name: str, wall_ms: Sequence[float], cpu_ms: Sequence[float]) -> "PartTimes":
        """Return the median, the 95th percentile and the mean of a value per frame."""
        high = [float(np.percentile(values, 95)) for values in (wall_ms, cpu_ms)]
        return cls(name, median(wall_ms), high[0], median(cpu_ms), high[1], mean(cpu_ms))


@dataclass(frozen=True)
class PresetTimes:
    """One object in one preset.

    Attributes:
        pixels: Pixels that show the object, mean.
        whole: Their sum, frame by frame.
        volume_ms: Median of the engine's stage `volume` in between: time passed, processor time.
    """

    preset: str
    object: str
    triangles: int
    pixels: float
    parts: tuple[PartTimes, ...]
    whole: PartTimes
    volume_ms: tuple[float, float]
    frames: int


@dataclass(frozen=True)
class CompositeReport:
    """All figures of a run.

    Attributes:
        denoiser: "oidn" if Open Image Denoise is installed, which `final` uses; else "none".
        image: Columns and rows of a frame.
        depth: Columns and rows of its depth.
    """

    times: tuple[PresetTimes, ...]
    denoiser: str
    image: tuple[int, int]
    depth: tuple[int, int]
    machine: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self) | {"criteria": [asdict(criterion) for criterion in self.criteria()]}

    def criteria(self) -> tuple[Criterion, ...]:
        """Return the limit on previews of spheres, for each of them."""
        spheres = [row for row in self.times if row.preset == "preview" and "sphere" in row.object]
        return tuple(
            Criterion(
                f"preview, {row.object}: median ms of a frame (at most {PREVIEW_MS:g} on two idle cores)",
                row.whole.wall_median_ms,
                PREVIEW_MS,
                row.whole.wall_median_ms <= PREVIEW_MS,
            )
            for row in spheres
        )

    def tables(self) -> list[Table]:
        """Return a table with a row per part, preset by preset and object by object; the criteria."""
        (width, height), (columns, rows) = self.image, self.depth
        missing = "not installed: final stays as it was sampled"
        denoiser = missing if self.denoiser == "none" else "installed: final is denoised"
        table = figure_table(
            f"A frame of {width} x {height} pixels with depth of {columns} x {rows}, milliseconds",
            ("median", "p95", "CPU median", "CPU p95", "CPU mean", "ratio"),
            caption="ratio: mean processor time / processor time of the engine's stage volume in the same run; "
            f"Open Image Denoise is {denoiser}",
        )
        for row in self.times:
            table.add_section()
            table.add_row(f"[bold]{row.preset}, {row.object}[/bold]")
            for part in (*row.parts, row.whole):
                values = (part.wall_median_ms, part.wall_p95_ms, part.cpu_median_ms, part.cpu_p95_ms, part.cpu_mean_ms)
                ratio = f"{part.cpu_mean_ms / row.volume_ms[1]:.2f}" if row.volume_ms[1] > 0 else ""
                table.add_row(part.name, *(short_number(value) for value in values), ratio)
            about = f"{row.frames} frames, {row.triangles} triangles, {row.pixels:.0f} pixels"
            table.add_row(f"[dim]{about}[/dim]")
        return [table, criteria_table(self.criteria())]
