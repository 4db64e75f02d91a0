"""Errors of composites as tables, and in sentences."""

from rich.table import Table

from roomlight.imaging.tables import figure_table
from roomlight_evaluation.composites.methods import HARMONICS, METHODS, NO_SHADOW, OURS, TRUE_LIGHT
from roomlight_evaluation.composites.regions import ELSEWHERE, OBJECT, REGIONS, SHADOW
from roomlight_evaluation.composites.scenes import MATERIALS
from roomlight_evaluation.composites.scores import CompositeScores
from roomlight_evaluation.confidence import mean_cell

TARGETS = {OBJECT: 0.72, SHADOW: 0.85}
"""Largest errors relative to SH + directional light's."""


def composite_tables(scores: CompositeScores) -> list[Table]:
    """Return tables of the errors, of the ratios to SH + directional light by material, and of the shadows' depth.

    Errors are those of all methods in all regions, with 95 % intervals over scenes.
    """
    tables = [
        figure_table(
            f"Composites against the truth, {title}, scenes: {len(scores.scenes)}",
            REGIONS,
            ([method, *(mean_cell(scores.mean(method, region, metric)) for region in REGIONS)] for method in METHODS),
            caption="mean over scenes (95 % bootstrap interval); linear light is clipped at white",
        )
        for metric, title in (
            ("rmse", "RMSE, linear light"),
            ("srgb", "RMSE, sRGB"),
            ("log", "mean absolute log error"),
        )
    ]
    compared = [(method, region) for method in (OURS, TRUE_LIGHT) for region in (OBJECT, SHADOW)]
    ratios = figure_table(
        f"RMSE relative to {HARMONICS}, by material",
        [f"{method}: {region}" for method, region in compared],
        (
            [
                material or "all",
                *(mean_cell(scores.ratio(method, region, "rmse", material), 2) for method, region in compared),
            ]
            for material in (None, *MATERIALS)
        ),
    )
    depth = figure_table(
        "Light in shadows, log", ["mean"], ([name, mean_cell(scores.darkening(name))] for name in ("truth", *METHODS))
    )
    return [*tables, ratios, depth]


def summary(scores: CompositeScores) -> list[str]:
    """Return sentences: each target with its ratio, and the gap to the true panorama."""
    ratios = {region: scores.ratio(OURS, region, "rmse") for region in TARGETS}
    lines = [
        f"{region}: {mean_cell(ratios[region], 2)} of {HARMONICS}'s error, target {target}: "
        + ("met" if ratios[region].mean <= target else "missed")
        + f"; {mean_cell(scores.ratio(OURS, region, 'rmse', to=TRUE_LIGHT), 2)} of the true panorama's"
        for region, target in TARGETS.items()
    ]
    lines.append(
        f"shadow: {mean_cell(scores.ratio(OURS, SHADOW, 'rmse', to=NO_SHADOW), 2)} of the error without shadows; "
        f"{ELSEWHERE}: {mean_cell(scores.mean(OURS, ELSEWHERE, 'rmse'))}"
    )
    return lines
