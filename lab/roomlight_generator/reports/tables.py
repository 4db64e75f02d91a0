"""The statistics of a dataset as tables for a terminal."""

from typing import Final

from rich.console import Console
from rich.markup import escape

from roomlight.tables import figure_table
from roomlight_generator.light_stats import TOLERANCE, LightComparison
from roomlight_generator.stats import DatasetStats, Spread

_LISTED: Final = 14
"""Most kinds listed per line; the JSON has all."""


def print_stats(console: Console, stats: DatasetStats) -> None:
    """Print measures with their spread, counts by kind, and bytes by part."""
    title = f"{stats.sequences} sequences, {stats.rooms} rooms"
    table = figure_table(title, ("mean", "sd", "5 %", "median", "95 %"))
    for name, spread in stats.spreads.items():
        table.add_row(name, *(_short(value) for value in _values(spread)))
    console.print(table)
    for title, counts in stats.counts.items():
        texts = [f"{escape(kind)} {count}" for kind, count in counts.items()]
        more = f", and {len(texts) - _LISTED} more kinds" if len(texts) > _LISTED else ""
        console.print(f"[bold]{escape(title)}[/]: {', '.join(texts[:_LISTED]) or 'unknown'}{more}", soft_wrap=True)
    total = sum(stats.mean_bytes.values())
    parts = ", ".join(f"{part} {size / 1e3:.0f}" for part, size in stats.mean_bytes.items())
    console.print(f"[bold]kB per sequence[/]: {total / 1e3:.0f} ({parts})", soft_wrap=True)
    if stats.probes_at_half_limit:
        console.print(f"{stats.probes_at_half_limit} probe pixels are dimmed to the largest half float (65504)")


def print_light(console: Console, light: LightComparison) -> None:
    """Print the quartiles of each measure of light, generated beside real, and mark those that are alike."""
    table = figure_table(
        f"first frames of {light.sequences} sequences with their probes, views of {light.panoramas} panoramas\n"
        "quartiles (25, 50, 75 %); the first frame's white is 1",
        ("generated", "real", "alike"),
    )
    for row in light.rows:
        generated, real = (" ".join(_two_digits(value) for value in values) for values in (row.generated, row.real))
        table.add_row(row.name, generated, real, "yes" if row.alike else "no")
    console.print(table)
    alike = sum(row.alike for row in light.rows)
    console.print(f"{alike} of {len(light.rows)} measures are alike: each quartile within {TOLERANCE:.0%} of the real")


def _values(spread: Spread) -> tuple[float, ...]:
    return (spread.mean, spread.deviation, spread.low, spread.median, spread.high)


def _short(value: float) -> str:
    """Format with three significant digits."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _two_digits(value: float) -> str:
    """Format with two significant digits, three or more above 99."""
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.2g}"
