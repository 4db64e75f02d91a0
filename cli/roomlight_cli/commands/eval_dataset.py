"""`roomlight eval-dataset`: light from single images, scored on rooms that nothing was trained on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from roomlight.dataset.recording import Split
from roomlight_cli import arguments as given
from roomlight_cli import console

if TYPE_CHECKING:
    from roomlight.engine.session import SessionOptions
    from roomlight_evaluation.dataset_eval import Method


def eval_dataset(
    data: Annotated[Path, typer.Argument(help="A dataset folder (roomlight dataset generate --split test).")],
    split: Annotated[Split, typer.Option(help="Which rooms; nothing is trained on those of test.")] = "test",
    also: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=DIR: another model folder to score; rgb-alpha and no-rendering-loss are compared. Repeatable."
        ),
    ] = None,
    depth: Annotated[Literal["exact", "arkit", "both"], typer.Option(help="Depth as it is, as a phone's, or both.")] = (
        "both"
    ),
    limit: Annotated[int | None, typer.Option(min=1, help="Score so many sequences, spread evenly.")] = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write every score as JSON.")] = None,
    markdown_out: Annotated[Path | None, typer.Option("--markdown", help="Also write the tables as Markdown.")] = None,
    picture: Annotated[Path | None, typer.Option(help="PNG of some rooms: input, truth, every method.")] = None,
    pictured: Annotated[int, typer.Option(min=1, max=50, help="Rows of --picture.")] = 5,
    weights: given.Weights = None,
    provider: given.Runtime = "auto",
    allow_untrained: given.AllowUntrained = False,
) -> None:
    """Score single-image light on a dataset: log-L2 and rendering loss, intervals over rooms, ratios to targets."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from roomlight.dataset.loader import Dataset
    from roomlight.engine.session import SessionOptions
    from roomlight.files import write_json
    from roomlight.images import write_atomic
    from roomlight_evaluation.dataset_eval import DEPTHS, evaluate_dataset
    from roomlight_evaluation.dataset_picture import write_picture
    from roomlight_evaluation.dataset_tables import dataset_tables, markdown
    from roomlight_evaluation.tables import print_whole

    others = [_named_folder(text) for text in also or ()]
    session = SessionOptions(model="auto", weights=weights, provider=provider, allow_untrained=allow_untrained)
    methods = _methods(session, others)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console.err, transient=True) as bars:
        task = bars.add_task("scoring", total=None)
        scores, shown = evaluate_dataset(
            Dataset(data, split),
            methods,
            depths=DEPTHS if depth == "both" else (depth,),
            limit=limit,
            show=pictured if picture else 0,
            progress=lambda done, of: bars.update(task, completed=done, total=of),
        )
    for table in dataset_tables(scores):
        print_whole(console.out, table)
    for reason in scores.skipped[:5]:
        console.err.print(f"skipped {reason}", soft_wrap=True, markup=False)
    if json_out:
        write_json(json_out, scores.to_json())
    if markdown_out:
        write_atomic(markdown_out, markdown(scores).encode())
    if picture:
        write_picture(picture, shown)
        console.say(f"Look at {picture}")


def _methods(session: SessionOptions, others: list[tuple[str, Path]]) -> list[Method]:
    from roomlight.baselines import MeanColour, WarpAndFill
    from roomlight.engine.session import choose_graphs, warm_up
    from roomlight_evaluation.dataset_eval import ALONE, FULL, Baseline, Engine

    warm_up()
    classical = replace(session, model="classical", weights=None)
    methods: list[Method] = [Baseline(MeanColour), Baseline(WarpAndFill), Engine("classical", classical, None)]
    graphs = choose_graphs(session)
    if graphs is not None:
        methods.append(Engine(FULL, replace(session, model="single"), replace(graphs, form="single"), alone=ALONE))
    for name, folder in others:
        options = replace(session, model="single", weights=folder)
        methods.append(Engine(name, options, choose_graphs(options)))
    return methods


def _named_folder(text: str) -> tuple[str, Path]:
    name, given_one, folder = text.partition("=")
    taken = ("mean colour", "warp and fill", "classical", "full", "SGLV alone")
    if not given_one or not name or not folder:
        raise typer.BadParameter(f"--also takes NAME=DIR, e.g. rgb-alpha=weights/rgb-alpha; got {text!r}")
    if name in taken:
        raise typer.BadParameter(f"--also {text}: the name is one of {', '.join(taken)}, which are scored anyway")
    return name, Path(folder)
