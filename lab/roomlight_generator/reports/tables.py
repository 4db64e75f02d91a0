"""The light of a dataset beside real panoramas, as a table for a terminal."""

from rich.console import Console

from roomlight.imaging.tables import figure_table
from roomlight_generator.light_stats import TOLERANCE, LightComparison


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


def _two_digits(value: float) -> str:
    """Format with two significant digits, three or more above 99."""
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.2g}"
