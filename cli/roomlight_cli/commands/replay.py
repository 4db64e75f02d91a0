"""`roomlight replay`: light at points of a recorded capture, frame by frame."""

from pathlib import Path

from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_cli.replays.replay_run import run_replay
from roomlight_cli.shared_options import Token


def replay(capture: Path, options: ReplayOptions, *, out: Path, token: Token = None) -> None:
    """Light points of a recording: an HDR panorama per frame, pictures, a video, a report.

    Interrupted after its first frames (12, with `--interpolate` more), the same command goes on. Finished, it says so
    and returns at once, unless the recording, the weights or the results have changed since.

    Args:
        capture: A recorded capture: a folder, a Record3D .r3d file, or a video.
        options: What to replay.
        out: Folder for panoramas, pictures and the report.
        token: Of the server.
    """
    run_replay(capture, out, options, token=token)
