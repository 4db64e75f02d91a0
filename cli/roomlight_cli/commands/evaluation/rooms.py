"""`roomlight eval walks`: light scored in generated rooms that no network was trained on."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from annotated_types import Ge

from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.engine.session import warm_up
from roomlight_cli.console import print_tables, say
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import ScoredNetworks, ScoresJson
from roomlight_evaluation.captures.tables import capture_tables
from roomlight_evaluation.walks import ImageModels, WalkModels, evaluate_walks


def walks(
    data: tuple[Path, ...],
    light: ScoredNetworks,
    *,
    images: bool = False,
    split: Split = "test",
    limit: Annotated[int, Ge(1)] | None = None,
    json: ScoresJson = None,
) -> None:
    """Score the networks on walks through rooms that no network was trained on.

    The table compares the recurrent networks with each frame alone, a simple average, the single-view form, the
    classical model and baselines, with late probes and with depth as a phone measures it.

    Args:
        data: Dataset folders (roomlight dataset generate --split test).
        light: How to estimate the light.
        images: Score the single-view networks on the first frame of each walk instead.
        split: Which rooms; no network is trained on those of test.
        limit: Score this many walks of each, evenly spread.
    """
    models = ImageModels.load(light) if images else WalkModels.load(replace(light, model="video"))
    with Progress("compiling kernels (first run only)") as progress:
        warm_up()
        progress.say("scoring")
        folders = [Dataset(folder, split) for folder in data]
        scores = evaluate_walks(folders, models, limit=limit, progress=progress.count)
    print_tables(*capture_tables(scores))
    if json:
        scores.write(json)
        say(f"Scores: {json}")
