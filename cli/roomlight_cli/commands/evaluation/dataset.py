"""`roomlight eval-dataset`: light from single images, scored on rooms that no network was trained on."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.engine.session import SessionOptions, choose_graphs, warm_up
from roomlight.files import write_atomic, write_json
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.datasets.evaluation import DEPTHS, evaluate_dataset
from roomlight_evaluation.datasets.methods import BLENDED, UNBLENDED, BaselineMethod, EngineMethod, Method
from roomlight_evaluation.datasets.picture import write_picture
from roomlight_evaluation.datasets.tables import dataset_markdown, dataset_tables

app = single_command_app()

_SCORED_ANYWAY: Final = ("mean colour", "warp and fill", "classical", BLENDED, UNBLENDED)


@app.command("eval-dataset")
def eval_dataset(
    data: Annotated[Path, typer.Argument(help="A dataset folder (roomlight dataset generate --split test).")],
    split: Annotated[Split, typer.Option(help="Which rooms; no network is trained on those of test.")] = "test",
    also: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=DIR: score another model folder too. Repeatable. Folders named rgb-alpha and no-rendering-loss "
            "are compared with the full model."
        ),
    ] = None,
    depth: Annotated[
        Literal["exact", "arkit", "both"],
        typer.Option(help="Depth as rendered, as a phone measures it, or both."),
    ] = "both",
    limit: Annotated[int | None, typer.Option(min=1, help="Score this many sequences, evenly spread.")] = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write every score as JSON.")] = None,
    markdown_out: Annotated[Path | None, typer.Option("--markdown", help="Also write the tables as Markdown.")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Also write a PNG of some rooms: input, truth, every method.")
    ] = None,
    pictured: Annotated[int, typer.Option(min=1, max=50, help="Rooms in --picture.")] = 5,
    weights: arguments.Weights = None,
    provider: arguments.Runtime = "auto",
) -> None:
    """Score light from single images on a dataset of rooms that no network was trained on.

    The tables show log-L2 and rendering loss, confidence intervals over rooms, and ratios to the targets.
    """
    others = [_named_folder(text) for text in also or ()]
    model = "single" if weights is None else "auto"
    session = SessionOptions(model=model, weights=weights, provider=provider)
    methods = _methods(session, others)
    with console.progress_bars() as bars:
        task = bars.add_task("scoring", total=None)
        scores, rows = evaluate_dataset(
            Dataset(data, split),
            methods,
            depths=DEPTHS if depth == "both" else (depth,),
            limit=limit,
            picture_rows=pictured if picture else 0,
            progress=lambda done, total: bars.update(task, completed=done, total=total),
        )
    for table in dataset_tables(scores):
        console.print_table(console.out, table)
    for reason in scores.skipped[:5]:
        console.err.print(f"skipped {reason}", soft_wrap=True, markup=False)
    if json_out:
        write_json(json_out, scores.to_json())
    if markdown_out:
        write_atomic(markdown_out, dataset_markdown(scores).encode())
    if picture:
        write_picture(picture, rows)
        console.say(f"Picture: {picture}")


def _methods(session: SessionOptions, others: list[tuple[str, Path]]) -> list[Method]:
    warm_up()
    classical = replace(session, model="classical", weights=None)
    methods: list[Method] = [
        BaselineMethod(MeanColour),
        BaselineMethod(WarpAndFill),
        EngineMethod("classical", classical, None),
    ]
    graphs = choose_graphs(session)
    if graphs is not None:
        methods.append(
            EngineMethod(
                BLENDED,
                replace(session, model="single"),
                replace(graphs, form="single"),
                unblended_name=UNBLENDED,
            )
        )
    for name, folder in others:
        options = replace(session, model="single", weights=folder)
        methods.append(EngineMethod(name, options, choose_graphs(options)))
    return methods


def _named_folder(text: str) -> tuple[str, Path]:
    name, equals, folder = text.partition("=")
    if not equals or not name or not folder:
        raise typer.BadParameter(f"--also takes NAME=DIR, e.g. rgb-alpha=weights/rgb-alpha; got {text!r}")
    if name in _SCORED_ANYWAY:
        raise typer.BadParameter(
            f"--also {text}: choose another name; {', '.join(_SCORED_ANYWAY)} are scored in any case"
        )
    return name, Path(folder)
