"""The `roomlight` command. Commands import what they need when they run: `--help` is quick, and PyTorch is loaded by
`export` and the comparisons of `bench` alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from roomlight import __version__
from roomlight.errors import RoomLightError
from roomlight_cli import arguments as given
from roomlight_cli.commands import dataset as dataset_commands
from roomlight_cli.commands import eval_dataset as dataset_eval_command
from roomlight_cli.commands import light as light_command
from roomlight_cli.commands import serve as serve_command
from roomlight_cli.commands import stream as stream_command
from roomlight_cli.commands import train as train_command
from roomlight_cli.console import err as _err
from roomlight_cli.console import out as _out
from roomlight_cli.console import run
from roomlight_cli.console import say as _say

if TYPE_CHECKING:
    from roomlight_cli.replay import ReplayOptions

app = typer.Typer(
    name="roomlight",
    help="HDR indoor light at any point of a room, from colour, depth and camera poses.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
bench_app = typer.Typer(help="Measure speed: every figure as a ratio within one run.", no_args_is_help=True)
app.add_typer(bench_app, name="bench")
app.add_typer(dataset_commands.app, name="dataset")
app.command()(serve_command.serve)
app.command()(stream_command.stream)
app.command()(train_command.train)
app.command()(light_command.light)
app.command()(dataset_eval_command.eval_dataset)
bench_app.command("train")(train_command.bench_train)
bench_app.command("rendering")(train_command.bench_rendering)


@app.callback(invoke_without_command=True)
def _root(  # pyright: ignore[reportUnusedFunction]  (typer calls it)
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.", is_eager=True)] = False,
) -> None:
    if version:
        _out.print(f"roomlight {__version__}")
        raise typer.Exit


@app.command()
def replay(
    capture: Annotated[Path, typer.Argument(help="A recorded capture: a folder, or a Record3D .r3d file.")],
    out: Annotated[Path, typer.Option(help="Folder for panoramas, pictures and the report.")],
    probe: Annotated[
        list[str] | None, typer.Option(help="A point X,Y,Z in world metres (y up) to light; repeatable.")
    ] = None,
    probes_from_capture: Annotated[
        bool, typer.Option("--probes-from-capture", help="Use the positions of the capture's own probes.")
    ] = False,
    model: given.Model = "auto",
    weights: given.Weights = None,
    provider: given.Runtime = "auto",
    allow_untrained: given.AllowUntrained = False,
    unknown_depth: given.UnknownDepthOption = "rim",
    height: Annotated[
        int, typer.Option(min=16, max=2048, help="Panorama height in pixels; its width is twice that.")
    ] = 120,
    every: Annotated[int, typer.Option(min=1, help="Process every n-th frame only.")] = 1,
    interpolate: Annotated[
        bool, typer.Option("--interpolate", help="With --every: also write the frames in between, interpolated.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what --out holds of another replay.")] = False,
    server: stream_command.Server = None,
    token: stream_command.Token = None,
    format_name: given.Format = None,
    depth_key: given.DepthKey = None,
    depth_unit: given.DepthUnit = None,
    min_confidence: given.MinConfidence = None,
    camera_convention: given.CameraAxes = None,
    pose_direction: given.PoseMaps = None,
    world_up: given.WorldUp = None,
    max_frames: given.MaxFrames = None,
) -> None:
    """Replay a capture: an HDR panorama per frame at each probe, a contact sheet, a video and a report."""
    from roomlight_cli.replay import ReplayOptions

    if probe and probes_from_capture:
        raise typer.BadParameter("give --probe or --probes-from-capture, not both")
    if interpolate and every == 1:
        raise typer.BadParameter("--interpolate fills in what --every leaves out: give --every 2 or more with it")
    options = ReplayOptions(
        capture=given.capture_options(
            format_name=format_name,
            depth_key=depth_key,
            depth_unit=depth_unit,
            min_confidence=min_confidence,
            camera_convention=camera_convention,
            pose_direction=pose_direction,
            world_up=world_up,
            max_frames=max_frames,
        ),
        session=given.session_options(
            model=model,
            weights=weights,
            provider=provider,
            allow_untrained=allow_untrained,
            unknown_depth=unknown_depth,
            height=height,
        ),
        probes=tuple(given.parse_position(text) for text in probe or ()),
        probes_from_capture=probes_from_capture,
        every=every,
        interpolate=interpolate,
        overwrite=overwrite,
    )
    if server:
        stream_command.refuse_local_model(server, options.session)
    _replay_and_tell(capture, out, options, server=server, token=token)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("roomlight-demo"),
) -> None:
    """Replay the small room that comes with RoomLight and say where to look. Needs no arguments and no network."""
    from roomlight.sample import sample_capture
    from roomlight_cli.demo import demo_options, score_line

    path = sample_capture()
    _replay_and_tell(path, out, demo_options())
    _say(score_line(path, out))


@app.command(name="eval")
def evaluate(
    captures: Annotated[list[Path], typer.Argument(help="Captures with ground-truth probes.")],
    predictions: Annotated[
        Path | None, typer.Option(help="Score the panoramas that `roomlight replay` wrote here instead of the engine.")
    ] = None,
    late: Annotated[
        bool, typer.Option("--late", help="Also score probes first asked about at each frame, from keyframes alone.")
    ] = False,
    every: Annotated[
        int, typer.Option(min=1, help="Every n-th frame only, e.g. those that --predictions were made of.")
    ] = 1,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the scores as JSON.")] = None,
    model: given.Model = "auto",
    weights: given.Weights = None,
    provider: given.Runtime = "auto",
    allow_untrained: given.AllowUntrained = False,
    unknown_depth: given.UnknownDepthOption = "rim",
    format_name: given.Format = None,
    depth_key: given.DepthKey = None,
    depth_unit: given.DepthUnit = None,
    min_confidence: given.MinConfidence = None,
    camera_convention: given.CameraAxes = None,
    pose_direction: given.PoseMaps = None,
    world_up: given.WorldUp = None,
    max_frames: given.MaxFrames = None,
) -> None:
    """Score light against ground-truth probes, by the paper's intervals, beside mean colour and warp-and-fill."""
    from roomlight_evaluation.scoring import run_evaluation

    if late and predictions is not None:
        raise typer.BadParameter("--late asks the engine, --predictions scores files instead of it: give one of them")
    run_evaluation(
        captures,
        predictions=predictions,
        late=late,
        json_out=json_out,
        console=_out,
        session=given.session_options(
            model=model,
            weights=weights,
            provider=provider,
            allow_untrained=allow_untrained,
            unknown_depth=unknown_depth,
            height=120,
        ),
        capture=given.capture_options(
            format_name=format_name,
            depth_key=depth_key,
            depth_unit=depth_unit,
            min_confidence=min_confidence,
            camera_convention=camera_convention,
            pose_direction=pose_direction,
            world_up=world_up,
            max_frames=max_frames,
            every=every,
        ),
    )


@app.command()
def export(
    checkpoint: Annotated[Path, typer.Argument(help="A PyTorch checkpoint of RoomLight's training.")],
    out: Annotated[Path, typer.Option(help="Model folder to write.")],
    ort: Annotated[bool, typer.Option("--ort/--no-ort", help="Also write .ort files for phones.")] = True,
) -> None:
    """Export a checkpoint as verified ONNX graphs (needs the `train` extra)."""
    try:
        from roomlight_export.exporting import export_checkpoint
    except ModuleNotFoundError as error:
        raise _missing_extra(error, "train") from error
    with _err.status("exporting and verifying the graphs") as status:
        report = export_checkpoint(checkpoint, out, ort=ort, progress=status.update)
    _say(
        f"{report.form} model, {report.parameters / 1e6:.2f} M parameters: {len(report.graphs)} graphs in {out}, "
        f"{report.onnx_bytes / 1e6:.1f} MB of ONNX" + (f", {report.ort_bytes / 1e6:.1f} MB of .ort" if ort else "")
    )
    for network, parity in report.parity.items():
        _out.print(
            f"  {network}: largest difference to PyTorch {parity.largest:.2e} over {parity.steps} recurrent steps "
            f"(tolerance {report.tolerance:.0e})",
            soft_wrap=True,
        )


@bench_app.command("stages")
def bench_stages(
    repeats: Annotated[int, typer.Option(min=1, help="Interleaved repeats of each stage.")] = 7,
    weights: given.Weights = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the figures as JSON.")] = None,
) -> None:
    """Each stage beside its readable reference, the plain PyTorch way, and the roofline of this machine."""
    from roomlight.files import write_json
    from roomlight_bench.stages import run_stages
    from roomlight_evaluation.tables import print_whole

    with _err.status("measuring") as status:
        report = run_stages(repeats=repeats, model=weights, progress=status.update)
    print_whole(_out, report.table(width=_out.width))
    if json_out:
        write_json(json_out, report.to_json())


@bench_app.command("widths")
def bench_widths(
    rounds: Annotated[int, typer.Option(min=1, help="Interleaved rounds over all widths.")] = 15,
) -> None:
    """What each width of the networks costs: parameters, GMAC, milliseconds (needs the `train` extra; minutes)."""
    try:
        from roomlight_export.widths import format_widths, measure_widths
    except ModuleNotFoundError as error:
        raise _missing_extra(error, "train") from error
    with _err.status("measuring") as status:
        rows = measure_widths(rounds=rounds, progress=status.update)
    _out.print(format_widths(rows), soft_wrap=True)


@bench_app.command("server")
def bench_server(
    sessions: Annotated[str, typer.Option(help="Numbers of sessions at once, one row each.")] = "1,4,16,64",
    seconds: Annotated[float, typer.Option(min=0.5, max=3600, help="How long phones stream, for each row.")] = 12.0,
    fps: Annotated[float, typer.Option(min=0.1, max=60, help="Frames a second that each phone sends.")] = 3.0,
    mode: given.Model = "auto",
    weights: given.Weights = None,
    allow_untrained: given.AllowUntrained = False,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the figures as JSON.")] = None,
) -> None:
    """A real server on this machine under 1 to 64 streaming phones, beside the engine called directly (3 minutes)."""
    from roomlight.files import write_json
    from roomlight_bench.server import ServerBenchOptions, run_server_bench
    from roomlight_evaluation.tables import print_whole

    options = ServerBenchOptions(
        sessions=given.parse_counts(sessions),
        seconds=seconds,
        fps=fps,
        mode=mode,
        weights=weights,
        allow_untrained=allow_untrained,
    )
    with _err.status("measuring") as status:
        report = run_server_bench(options, progress=status.update)
    print_whole(_out, report.table())
    if json_out:
        write_json(json_out, report.to_json())


def _replay_and_tell(
    capture: Path, out: Path, options: ReplayOptions, *, server: str | None = None, token: str | None = None
) -> None:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from roomlight.engine.session import warm_up
    from roomlight_cli.remote_replay import replay_through
    from roomlight_cli.replay import replay as run

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_err, transient=True) as bars:
        task = bars.add_task("compiling kernels (first run only)", total=None)
        if server is None:
            warm_up()
        bars.update(task, description="replaying")

        def show(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total)

        try:
            if server is None:
                result = run(capture, out, options, progress=show)
            else:
                result = replay_through(server, capture, out, options, token=token, progress=show)
        except KeyboardInterrupt:
            bars.stop()
            afresh = "starts afresh" if options.overwrite else "continues where it was"
            _err.print(f"stopped; the same command {afresh}", soft_wrap=True)
            raise typer.Exit(130) from None
    report = result.report
    stages = report["stage_ms_median"]
    _out.print(
        f"{_count(len(report['frames']), 'frame')}"
        + (f" and {report['interpolated']} interpolated" if report["interpolated"] else "")
        + f", {_count(len(report['probes']), 'probe')}, model {report['model']}, "
        f"{sum(stages.values()):.0f} ms a frame (median), {report['wall_s']:.0f} s in all",
        soft_wrap=True,
    )
    for probe in report["probes"]:
        x, y, z = probe["position"]
        note = "  [yellow](outside the lighting volume: distant light only)[/]" if probe.get("outside_volume") else ""
        _out.print(
            f"  {probe['folder']} at ({x:.2f}, {y:.2f}, {z:.2f}) m: {probe['coverage']:.0%} of the sphere seen{note}",
            soft_wrap=True,
        )
    for skipped in report["skipped"][:5]:
        _err.print(f"[yellow]skipped[/] frame {skipped['index']}: {escape(skipped['reason'])}", soft_wrap=True)
    if len(report["skipped"]) > 5:
        more = len(report["skipped"]) - 5
        _err.print(f"[yellow]skipped[/] {more} more; all are in {escape(str(out / 'report.json'))}", soft_wrap=True)
    _say(f"Look at {out / 'summary.png'} and {out / 'replay.mp4'}")
    _say(f"The panoramas are {out}/probe-*/*.exr; times and coverage are in {out / 'report.json'}")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _missing_extra(error: ModuleNotFoundError, extra: str) -> RoomLightError:
    from roomlight.errors import ModelError

    return ModelError(f"this command needs {error.name}: pip install 'roomlight[{extra}]'")


def main() -> None:
    """Entry point: errors of RoomLight as one line on standard error, exit code 1."""
    run(app)
