"""`roomlight replay`: light at points of a recorded capture, frame by frame."""

from pathlib import Path
from typing import Any

from roomlight.engine.session import warm_up
from roomlight.notes import Note
from roomlight_cli.console import counted, print_notes, remark, say, stopped_by_signals
from roomlight_cli.console import out as terminal
from roomlight_cli.probe_notes import percent, position_text, probe_warnings
from roomlight_cli.progress import LOADING, Progress
from roomlight_cli.replays.pictures import SUMMARY, VIDEO
from roomlight_cli.replays.replay import replay as run_replay
from roomlight_cli.replays.replay_folder import REPORT, finished_report
from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_cli.replays.saved_replay import forget_replay, saved_frames
from roomlight_cli.shared_options import Token, print_recovery


def replay(capture: Path, options: ReplayOptions, *, out: Path, token: Token = None) -> None:
    """Light points of a recording: an HDR panorama per frame, pictures, a video, a report.

    Interrupted after its first frames (12, with `--interpolate` more), the same command goes on. Finished, it says so
    and returns at once, unless the recording, the weights or the results have changed since.

    Args:
        capture: A recorded capture: a folder or its zip, a file (.r3d, .sens, .bag, .mcap), or a video.
        options: What to replay.
        out: Folder for panoramas, pictures and the report.
        token: Of the server.

    Raises:
        RoomLightError: The recording, the options or the server do not allow it.
    """
    if not options.overwrite and (report := finished_report(capture, out, options)):
        forget_replay(out)  # a replay that was stopped between its last two steps
        say(f"{out} already holds this replay, finished; --overwrite makes it again")
        _print_result(out, report)
        return
    loading = Progress(LOADING)
    with stopped_by_signals(lambda: _next_run(out, options)), loading as progress:
        if options.server is None:
            warm_up()
        progress.say("replaying")
        report = run_replay(capture, out, options, token=token, progress=progress.count_of, on_recovery=print_recovery)
    _print_result(out, report)


def _next_run(folder: Path, options: ReplayOptions) -> str:
    if options.server is not None:
        return "the same command begins again, with a new session on the server"
    without = " without --overwrite" if options.overwrite else ""
    frames = saved_frames(folder)
    return f"the same command{without} " + (f"goes on after frame {frames} of this run" if frames else "begins again")


def _print_result(folder: Path, report: dict[str, Any]) -> None:
    print_notes(Note(**note) for note in report.get("notes", ()))
    stages = report["stage_ms_median"]
    say(
        counted(len(report["frames"]), "frame")
        + (f" and {report['interpolated']} interpolated" if report["interpolated"] else "")
        + f", {counted(len(report['probes']), 'probe')}, model {report['model']}, "
        f"{sum(stages.values()):.0f} ms per frame (median), {report['wall_s']:.0f} s in all"
    )
    for probe in report["probes"]:
        say(
            f"  {probe['folder']} at {position_text(tuple(probe['position']))}: "
            f"{percent(probe['coverage'])} of the sphere around it seen"
        )
        for warning in probe_warnings(probe["coverage"], inside_volume=not probe.get("outside_volume")):
            remark("    warning:", warning, terminal)
    for skipped in report["skipped"][:5]:
        remark("skipped", f"frame {skipped['index']}: {skipped['reason']}")
    if len(report["skipped"]) > 5:
        more = len(report["skipped"]) - 5
        remark("skipped", f"{more} more; all are in {folder / REPORT}")
    say(f"Pictures: {folder / SUMMARY} and {folder / VIDEO}")
    say(f"Panoramas: {folder}/probe-*/light.*.exr, as a USD stage light.usda; times and coverage: {folder / REPORT}")
