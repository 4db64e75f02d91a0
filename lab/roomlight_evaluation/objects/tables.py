"""Errors of lit objects as tables: for a terminal, and as Markdown for the documentation."""

from rich.table import Table

from roomlight_evaluation.composites.methods import HARMONICS
from roomlight_evaluation.error_tables import cell, error_markdown, error_table
from roomlight_evaluation.objects.evaluation import ObjectScores
from roomlight_evaluation.objects.lit_objects import LOOKS


def object_table(scores: ObjectScores) -> Table:
    """Return each method's error relative to SH + directional light, with 95 % intervals over rooms."""
    probes = sum(room.probes for room in scores.rooms)
    return error_table(
        f"Lit objects, error relative to {HARMONICS}; rooms: {len(scores.rooms)}, probes: {probes}",
        "RMSE, ratio of means over rooms (95 % bootstrap interval)",
        LOOKS,
        {method: [cell(scores.ratio(method, look), 2) for look in LOOKS] for method in scores.methods},
    )


def object_markdown(scores: ObjectScores) -> str:
    """Return the errors, and their ratios to SH + directional light."""
    probes = sum(room.probes for room in scores.rooms)
    lines = [f"Rooms: {len(scores.rooms)}, probes: {probes}", ""]
    for title, figure, digits in ((f"Relative to {HARMONICS}", scores.ratio, 2), ("RMSE", scores.mean, 3)):
        rows = {method: [cell(figure(method, look), digits) for look in LOOKS] for method in scores.methods}
        lines += [*error_markdown(title, LOOKS, rows), ""]
    return "\n".join(lines)
