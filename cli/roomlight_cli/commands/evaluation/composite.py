"""`roomlight eval-composite`: virtual objects in pictures against the same rooms with the object really in them."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from roomlight.engine.session import SessionOptions, warm_up
from roomlight.files import write_atomic
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_evaluation.composites.evaluation import evaluate_composites, evaluate_mitsuba
from roomlight_evaluation.composites.scores import METRICS, write_line
from roomlight_evaluation.composites.tables import composite_markdown, composite_table, summary

app = single_command_app()


@app.command("eval-composite")
def eval_composite(
    out: Annotated[Path, typer.Argument(help="File of results, a JSON line a scene; a run continues where it ended.")],
    scenes: Annotated[int, typer.Option(min=1, help="Rooms, each with one object.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of rooms, walks and objects.")] = 0,
    keep: Annotated[
        Path | None, typer.Option(help="Folder of rendered scenes, to score several models on the same ones.")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Also write a PNG of each scene: truth, ours, true panorama, SH + directional.")
    ] = None,
    mitsuba: Annotated[
        bool,
        typer.Option("--mitsuba", help="Score six views rendered by Mitsuba instead (needs mitsuba)."),
    ] = False,
    markdown_out: Annotated[Path | None, typer.Option("--markdown", help="Also write the tables as Markdown.")] = None,
    model: arguments.Model = "auto",
    weights: arguments.Weights = None,
) -> None:
    """Compare virtual objects in pictures with the same rooms with the object really in them.

    A scene takes about a minute of processor time: the light of its room is solved three times.
    """
    options = SessionOptions(model=model, weights=weights)
    with console.progress_bars() as bars:
        task = bars.add_task("compiling kernels (first run only)", total=None)
        warm_up()

        def show(done: int, total: int, note: str) -> None:
            bars.update(task, description=escape(note), completed=done, total=total)

        if mitsuba:
            scores = evaluate_mitsuba(options=options, pictures=pictures)
        else:
            scores = evaluate_composites(
                scenes, out, seed=seed, options=options, keep=keep, pictures=pictures, progress=show
            )
    for metric in METRICS:
        console.print_table(console.out, composite_table(scores, metric))
    for line in summary(scores):
        console.say(line)
    if mitsuba:
        for score in scores.scenes:
            write_line(out, score)
    if markdown_out:
        write_atomic(markdown_out, composite_markdown(scores).encode())
