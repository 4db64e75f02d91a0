"""`roomlight eval-views`: later frames of recordings predicted from the frames before them."""

from pathlib import Path
from typing import Annotated, Final

import typer
from rich.markup import escape

from roomlight.captures import CaptureOptions
from roomlight.engine.session import ModelName, SessionOptions, warm_up
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_evaluation.captures.view_tables import view_table
from roomlight_evaluation.captures.views import HEIGHT, evaluate_views

app = single_command_app()

_MODELS: Final[tuple[ModelName, ...]] = ("single", "video")


@app.command("eval-views")
def eval_views(
    captures: Annotated[list[Path], typer.Argument(help="Captures; they need no ground truth.")],
    model: Annotated[
        ModelName | None,
        typer.Option(
            rich_help_panel=arguments.MODEL_PANEL, help="Beside the classical one; default: single and video."
        ),
    ] = None,
    ahead: Annotated[int, typer.Option(min=1, help="How many frames after the last known one to predict.")] = 10,
    spacing: Annotated[int, typer.Option(min=1, help="Predict every n-th frame.")] = 5,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write every score as JSON.")] = None,
    weights: arguments.Weights = None,
    provider: arguments.Runtime = "auto",
    format_name: arguments.Format = None,
    max_frames: arguments.MaxFrames = None,
) -> None:
    """Predict later frames of recordings from the frames before them.

    Directions that the earlier frames have shown are scored apart from the others. Compared are mean colour,
    warp-and-fill, the classical model and, by default, the single-view and the recurrent networks.
    """
    names = _MODELS if model is None else (model,)
    sessions = [SessionOptions(model=name, weights=weights, provider=provider, height=HEIGHT) for name in names]
    with console.progress_bars() as bars:
        task = bars.add_task("compiling kernels (first run only)", total=None)
        warm_up()
        scores = evaluate_views(
            captures,
            sessions,
            ahead=ahead,
            spacing=spacing,
            options=CaptureOptions(format=format_name, max_frames=max_frames),
            progress=lambda name, done, total: bars.update(
                task, description=escape(f"scoring {name}"), completed=done, total=total
            ),
        )
    console.print_table(console.out, view_table(scores))
    if json_out:
        scores.write(json_out)
        console.say(f"Scores: {json_out}")
