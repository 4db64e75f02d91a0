"""A replay on a terminal: progress while it runs, and at the end what was found and where the files are."""

from pathlib import Path
from typing import Any

import typer
from rich.markup import escape

from roomlight.engine.session import warm_up
from roomlight.notes import Note
from roomlight_cli.console import err, out, print_notes, say
from roomlight_cli.probe_notes import percent, position_text, probe_warnings
from roomlight_cli.progress import Progress
from roomlight_cli.replays.pictures import SUMMARY, VIDEO
from roomlight_cli.replays.remote_replay import replay_through
from roomlight_cli.replays.replay import replay
from roomlight_cli.replays.replay_folder import REPORT, finished_report
from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_cli.replays.saved_replay import forget_replay, saved_frames
from roomlight_cli.shared_options import recovery_line
from roomlight_client import RecoveryEvent


def run_replay(capture: Path, folder: Path, options: ReplayOptions, *, token: str | None = None) -> None:
    """Replay `capture` into `folder` and print the result; return at once if it is there already.

    Raises:
        typer.Exit: Ctrl-C stopped it (code 130).
        RoomLightError: As `replay` and `replay_through` raise it.
    """
    if not options.overwrite and (report := finished_report(capture, folder, options)):
        forget_replay(folder)  # a replay that was stopped between its last two steps
        say(f"{folder} already holds this replay, finished; --overwrite makes it again")
        _print_result(folder, report)
        return
    with Progress("compiling kernels (first run only)") as progress:
        if options.server is None:
            warm_up()
        progress.say("replaying")

        def tell(event: RecoveryEvent) -> None:
            err.print(f"[yellow]{escape(recovery_line(event))}[/]", soft_wrap=True)

        try:
            if options.server is None:
                result = replay(capture, folder, options, progress=progress.count_of)
            else:
                result = replay_through(
                    options.server, capture, folder, options, token=token, progress=progress.count_of, on_recovery=tell
                )
        except KeyboardInterrupt:
            err.print(f"stopped; {_next_run(folder, options)}", soft_wrap=True)
            raise typer.Exit(130) from None
    _print_result(folder, result.report)


def _next_run(folder: Path, options: ReplayOptions) -> str:
    """Return what the next run does after an interruption."""
    if options.server is not None:
        return "the same command begins again, with a new session on the server"
    without = " without --overwrite" if options.overwrite else ""
    frames = saved_frames(folder)
    return f"the same command{without} " + (f"goes on after frame {frames} of this run" if frames else "begins again")


def _print_result(folder: Path, report: dict[str, Any]) -> None:
    print_notes(Note(**note) for note in report.get("notes", ()))
    stages = report["stage_ms_median"]
    say(
        _count(len(report["frames"]), "frame")
        + (f" and {report['interpolated']} interpolated" if report["interpolated"] else "")
        + f", {_count(len(report['probes']), 'probe')}, model {report['model']}, "
        f"{sum(stages.values()):.0f} ms per frame (median), {report['wall_s']:.0f} s in all"
    )
    for probe in report["probes"]:
        say(
            f"  {probe['folder']} at {position_text(tuple(probe['position']))}: "
            f"{percent(probe['coverage'])} of the sphere around it seen"
        )
        for warning in probe_warnings(probe["coverage"], inside_volume=not probe.get("outside_volume")):
            out.print(f"    [yellow]warning:[/] {escape(warning)}", soft_wrap=True)
    for skipped in report["skipped"][:5]:
        err.print(f"[yellow]skipped[/] frame {skipped['index']}: {escape(skipped['reason'])}", soft_wrap=True)
    if len(report["skipped"]) > 5:
        more = len(report["skipped"]) - 5
        err.print(f"[yellow]skipped[/] {more} more; all are in {escape(str(folder / REPORT))}", soft_wrap=True)
    say(f"Pictures: {folder / SUMMARY} and {folder / VIDEO}")
    say(f"Panoramas: {folder}/probe-*/light.*.exr, as a USD stage light.usda; times and coverage: {folder / REPORT}")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
