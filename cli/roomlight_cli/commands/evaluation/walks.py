"""`roomlight eval-walks`: the recurrent networks on walks through rooms that no network was trained on."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.engine.session import SessionOptions, warm_up
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_evaluation.captures.tables import capture_tables
from roomlight_evaluation.datasets.walks import WalkModels, evaluate_walks

app = single_command_app()


@app.command("eval-walks")
def eval_walks(
    data: Annotated[list[Path], typer.Argument(help="Dataset folders (roomlight dataset generate --split test).")],
    split: Annotated[Split, typer.Option(help="Which rooms; no network is trained on those of test.")] = "test",
    limit: Annotated[int | None, typer.Option(min=1, help="Score this many walks of each, evenly spread.")] = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write every score as JSON.")] = None,
    weights: arguments.Weights = None,
    provider: arguments.Runtime = "auto",
) -> None:
    """Score the recurrent networks on walks through rooms that no network was trained on.

    The table compares them with each frame alone, a simple average, the single-view form, the classical model and
    baselines, with late probes and with depth as a phone measures it.
    """
    options = SessionOptions(model="video", weights=weights, provider=provider)
    models = WalkModels.load(options)
    with console.progress_bars() as bars:
        task = bars.add_task("compiling kernels (first run only)", total=None)
        warm_up()
        scores = evaluate_walks(
            [Dataset(folder, split) for folder in data],
            models,
            limit=limit,
            progress=lambda done, total: bars.update(task, description="scoring", completed=done, total=total),
        )
    for table in capture_tables(scores):
        console.print_table(console.out, table)
    if json_out:
        scores.write(json_out)
        console.say(f"Scores: {json_out}")
