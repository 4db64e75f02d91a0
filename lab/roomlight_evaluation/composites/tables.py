"""Errors of composites as tables: for a terminal, and as Markdown for the documentation."""

from rich.table import Table

from roomlight_evaluation.composites.methods import HARMONICS, METHODS, NO_SHADOW, OURS, TRUE_LIGHT
from roomlight_evaluation.composites.regions import ELSEWHERE, OBJECT, REGIONS, SHADOW
from roomlight_evaluation.composites.scenes import MATERIALS
from roomlight_evaluation.composites.scores import CompositeScores
from roomlight_evaluation.error_tables import cell, error_markdown, error_table

TARGET = 0.6
"""Largest error in the object and in the shadow, relative to SH + directional light's."""


def composite_table(scores: CompositeScores, metric: str) -> Table:
    """Return the mean errors of all methods in all regions with 95 % intervals over scenes."""
    return error_table(
        f"Composites against the truth, {metric}, scenes: {len(scores.scenes)}",
        "mean over scenes (95 % bootstrap interval); linear light is clipped at white",
        REGIONS,
        {method: [cell(scores.mean(method, region, metric)) for region in REGIONS] for method in METHODS},
    )


def composite_markdown(scores: CompositeScores) -> str:
    """Return tables of the errors, of the ratios to SH + directional light by material, and of the shadows' depth."""
    lines = [f"Scenes: {len(scores.scenes)}", ""]
    for metric, title in (("rmse", "RMSE, linear light"), ("srgb", "RMSE, sRGB"), ("log", "mean absolute log error")):
        rows = {method: [cell(scores.mean(method, region, metric)) for region in REGIONS] for method in METHODS}
        lines += [*error_markdown(title, REGIONS, rows), ""]
    lines += [f"| RMSE of {OURS} / {HARMONICS} | object | shadow | true panorama: object | shadow |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    for material in (None, *MATERIALS):
        cells = [
            cell(scores.ratio(method, region, "rmse", material), 2)
            for method in (OURS, TRUE_LIGHT)
            for region in (OBJECT, SHADOW)
        ]
        lines.append(f"| {material or 'all'} | " + " | ".join(cells) + " |")
    lines += ["", "| Light in shadows, log | mean |", "| --- | --- |"]
    lines += [f"| {name} | {cell(scores.darkening(name))} |" for name in ("truth", *METHODS)]
    return "\n".join(lines) + "\n"


def targets_met(scores: CompositeScores) -> dict[str, bool]:
    """Return for object and shadow whether our linear RMSE is at most `TARGET` of SH + directional light's."""
    return {region: scores.ratio(OURS, region, "rmse").mean <= TARGET for region in (OBJECT, SHADOW)}


def summary(scores: CompositeScores) -> list[str]:
    """Return sentences: each target with its ratio, and the gap to the true panorama."""
    met = targets_met(scores)
    lines = [
        f"{region}: {cell(scores.ratio(OURS, region, 'rmse'), 2)} of {HARMONICS}'s error, target {TARGET}: "
        + ("met" if met[region] else "missed")
        + f"; {cell(scores.ratio(OURS, region, 'rmse', to=TRUE_LIGHT), 2)} of the true panorama's"
        for region in (OBJECT, SHADOW)
    ]
    lines.append(
        f"shadow: {cell(scores.ratio(OURS, SHADOW, 'rmse', to=NO_SHADOW), 2)} of the error without shadows; "
        f"{ELSEWHERE}: {cell(scores.mean(OURS, ELSEWHERE, 'rmse'))}"
    )
    return lines
