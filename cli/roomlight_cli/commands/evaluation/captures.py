"""`roomlight eval`: light against the ground-truth probes of recordings."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from roomlight.engine.session import warm_up
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_evaluation.captures.evaluation import evaluate_engine, evaluate_predictions
from roomlight_evaluation.captures.main_light import MainLightScores, evaluate_main_lights
from roomlight_evaluation.captures.main_light_tables import main_light_table
from roomlight_evaluation.captures.ship_rule import ShipRule, apply_ship_rule, ship_rule_table, write_rule
from roomlight_evaluation.captures.tables import capture_tables

app = single_command_app()


@app.command("eval")
def evaluate(
    captures: Annotated[list[Path], typer.Argument(help="Captures that have ground-truth probes.")],
    predictions: Annotated[
        Path | None, typer.Option(help="Score the panoramas that `roomlight replay` wrote here instead of the engine.")
    ] = None,
    late: Annotated[
        bool,
        typer.Option(
            "--late", help="Also score probes that are added at each frame and see the earlier keyframes alone."
        ),
    ] = False,
    main_light: Annotated[
        bool,
        typer.Option(
            "--main-light", help="Score the direction of the main light instead; captures need no ground truth."
        ),
    ] = False,
    ship_rule: Annotated[
        bool,
        typer.Option(
            "--ship-rule",
            help="Compare the model with the classical one on every capture and interval, and fail if it is worse.",
        ),
    ] = False,
    every: Annotated[
        int,
        typer.Option(min=1, help="Score every n-th frame only; with --predictions, the n they were replayed with."),
    ] = 1,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the scores as JSON.")] = None,
    model: arguments.Model = "auto",
    weights: arguments.Weights = None,
    provider: arguments.Runtime = "auto",
    unknown_depth: arguments.UnknownDepthOption = "rim",
    parts: arguments.Parts = None,
    format_name: arguments.Format = None,
    depth_key: arguments.DepthKey = None,
    depth_unit: arguments.DepthUnit = None,
    min_confidence: arguments.MinConfidence = None,
    camera_convention: arguments.CameraAxes = None,
    pose_direction: arguments.PoseMaps = None,
    world_up: arguments.WorldUp = None,
    max_frames: arguments.MaxFrames = None,
) -> None:
    """Score light against the ground-truth probes of recordings.

    The tables have the paper's intervals of frames as columns, and two baselines: mean colour, and warp-and-fill.
    """
    if late and predictions is not None:
        raise typer.BadParameter("--late runs the engine, --predictions scores files instead: give one of the two")
    if ship_rule and (late or main_light or predictions is not None):
        raise typer.BadParameter("--ship-rule scores tracked probes: leave out --late, --main-light and --predictions")
    if main_light and (late or predictions is not None):
        raise typer.BadParameter("--main-light scores tracked probes: leave out --late and --predictions")
    session = arguments.session_options(
        model=model,
        weights=weights,
        provider=provider,
        unknown_depth=unknown_depth,
        parts=parts,
        height=120,
    )
    capture = arguments.capture_options(
        format_name=format_name,
        depth_key=depth_key,
        depth_unit=depth_unit,
        min_confidence=min_confidence,
        camera_convention=camera_convention,
        pose_direction=pose_direction,
        world_up=world_up,
        max_frames=max_frames,
        every=every,
    )
    rule: ShipRule | None = None
    with console.progress_bars() as bars:
        task = bars.add_task("compiling kernels (first run only)", total=None)
        warm_up()

        def show(name: str, done: int, total: int) -> None:
            bars.update(task, description=escape(f"scoring {name}"), completed=done, total=total)

        if main_light:
            lights = evaluate_main_lights(captures, session, options=capture, progress=show)
            _show_main_lights(lights, json_out)
            return
        if ship_rule:
            rule, scores = apply_ship_rule(captures, session, options=capture, progress=show)
        elif predictions is None:
            scores = evaluate_engine(captures, session, late=late, options=capture, progress=show)
        else:
            scores = evaluate_predictions(captures, predictions, baselines=True, options=capture, progress=show)
    if rule is None:
        for table in capture_tables(scores, per_capture=True):
            console.print_table(console.out, table)
    if json_out:
        if rule is None:
            scores.write(json_out)
        else:
            write_rule(json_out, rule, scores)
        console.say(f"Scores: {json_out}")
    if rule is not None:
        console.print_table(console.out, ship_rule_table(rule))
        for line in (failures := rule.failures()):
            console.say(f"  {line}")
        console.say(f"{model} {'fails' if failures else 'passes'}: {len(failures)} of its figures break the rule")
        raise typer.Exit(1 if failures else 0)


def _show_main_lights(scores: MainLightScores, json_out: Path | None) -> None:
    console.print_table(console.out, main_light_table(scores))
    if json_out:
        scores.write(json_out)
        console.say(f"Directions: {json_out}")
