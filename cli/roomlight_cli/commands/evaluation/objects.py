"""`roomlight eval-objects`: spheres and shadows in the light after a few frames, in many rooms with ground truth."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from roomlight.dataset.recording import Split
from roomlight.engine.session import SessionOptions, warm_up
from roomlight.files import write_atomic
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_evaluation.objects.evaluation import evaluate_objects
from roomlight_evaluation.objects.tables import object_markdown, object_table

app = single_command_app()


@app.command("eval-objects")
def eval_objects(
    sources: Annotated[list[Path], typer.Argument(help="Captures with ground-truth probes, and dataset folders.")],
    frames: Annotated[int, typer.Option(min=1, help="Show this many frames of each recording, evenly spread.")] = 6,
    split: Annotated[Split, typer.Option(help="Of dataset folders; no network is trained on test.")] = "test",
    limit: Annotated[int | None, typer.Option(min=1, help="Use this many walks of each dataset.")] = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write every room's errors as JSON.")] = None,
    markdown_out: Annotated[Path | None, typer.Option("--markdown", help="Also write the tables as Markdown.")] = None,
    model: arguments.Model = "auto",
    weights: arguments.Weights = None,
) -> None:
    """Score spheres and a sphere's shadow in the light after a few frames, in many rooms with ground truth.

    The table compares the model, as it is and as composites change it, with SH + directional light
    and other simple lights. Half a second to two seconds a room.
    """
    options = SessionOptions(model=model, weights=weights)
    with console.progress_bars() as bars:
        task = bars.add_task("compiling kernels (first run only)", total=None)
        warm_up()

        def show(name: str, done: int, total: int) -> None:
            bars.update(task, description=escape(f"scoring {name}"), completed=done, total=total)

        scores = evaluate_objects(sources, options, frames=frames, split=split, limit=limit, progress=show)
    console.print_table(console.out, object_table(scores))
    if json_out:
        scores.write(json_out)
        console.say(f"Scores: {json_out}")
    if markdown_out:
        write_atomic(markdown_out, object_markdown(scores).encode())
