"""Errors of lit objects as tables: for a terminal, and as Markdown for the documentation."""

from rich import box
from rich.table import Table

from roomlight_evaluation.composite_methods import HARMONICS
from roomlight_evaluation.confidence import MeanWithInterval
from roomlight_evaluation.lit_objects import LOOKS
from roomlight_evaluation.object_evaluation import ObjectScores


def object_table(scores: ObjectScores) -> Table:
    """Return each method's error relative to SH + directional light, with 95 % intervals over rooms."""
    probes = sum(room.probes for room in scores.rooms)
    table = Table(
        title=f"Lit objects, error relative to {HARMONICS}; rooms: {len(scores.rooms)}, probes: {probes}",
        title_justify="left",
        caption="RMSE, ratio of means over rooms (95 % bootstrap interval)",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for look in LOOKS:
        table.add_column(look, justify="right", no_wrap=True)
    for method in scores.methods:
        table.add_row(method, *(_cell(scores.ratio(method, look)) for look in LOOKS))
    return table


def object_markdown(scores: ObjectScores) -> str:
    """Return the errors, and their ratios to SH + directional light."""
    probes = sum(room.probes for room in scores.rooms)
    lines = [f"Rooms: {len(scores.rooms)}, probes: {probes}", ""]
    for title, figure, digits in ((f"Relative to {HARMONICS}", scores.ratio, 2), ("RMSE", scores.mean, 3)):
        lines += [f"| {title} | " + " | ".join(LOOKS) + " |", "| --- |" + " --- |" * len(LOOKS)]
        lines += [
            f"| {method} | " + " | ".join(_cell(figure(method, look), digits) for look in LOOKS) + " |"
            for method in scores.methods
        ]
        lines.append("")
    return "\n".join(lines)


def _cell(value: MeanWithInterval, digits: int = 2) -> str:
    return f"{value.mean:.{digits}f} ({value.low:.{digits}f} to {value.high:.{digits}f})"
