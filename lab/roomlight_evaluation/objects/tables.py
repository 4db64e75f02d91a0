"""Errors of lit objects as tables."""

from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight_evaluation.composites.methods import HARMONICS
from roomlight_evaluation.confidence import mean_cell
from roomlight_evaluation.objects.evaluation import ObjectScores
from roomlight_evaluation.objects.lit_objects import LOOKS, MEASURES


def object_tables(scores: ObjectScores) -> list[Table]:
    """Return each method's errors relative to SH + directional light, and the errors; 95 % intervals over rooms."""
    probes = sum(room.probes for room in scores.rooms)
    rooms = f"rooms: {len(scores.rooms)}, probes: {probes}"
    return [
        figure_table(
            f"Lit objects, error relative to {HARMONICS}; {rooms}",
            (*LOOKS, "diffuse,\nworst room"),
            (
                [
                    method,
                    *(mean_cell(scores.ratio(method, look), 2) for look in LOOKS),
                    f"{scores.worst(method, 'diffuse'):.2f}",
                ]
                for method in scores.methods
            ),
            caption=(
                "ratio of mean errors over rooms (95 % bootstrap interval); errors are RMSE, that of the brightness "
                "is the absolute logarithm of the irradiance from above"
            ),
        ),
        figure_table(
            f"Lit objects, errors; {rooms}",
            LOOKS,
            ([method, *(mean_cell(scores.mean(method, look)) for look in LOOKS)] for method in scores.methods),
        ),
        figure_table(
            f"Unseen directions in a mirror; {rooms}",
            MEASURES,
            (
                [method, *(mean_cell(scores.unseen(method, measure), 2) for measure in MEASURES)]
                for method in scores.rooms[0].unseen
            ),
        ),
    ]
