"""`roomlight demo`: replay the sample room that comes with the package."""

from pathlib import Path
from typing import Annotated, Final

import typer

from roomlight.captures import CaptureOptions
from roomlight.engine.session import SessionOptions
from roomlight.sample import sample_capture
from roomlight_cli.compositing import Output, composite_recording
from roomlight_cli.console import say
from roomlight_cli.demo_scene import demo_scene
from roomlight_cli.lazy import single_command_app
from roomlight_cli.replay_options import ReplayOptions
from roomlight_cli.replay_run import run_replay
from roomlight_evaluation.capture_evaluation import evaluate_predictions

app = single_command_app()
FILM: Final = "composite.mp4"
FILM_RATE: Final = 6.0
"""Frames a second: the sample's 31 frames take five seconds."""


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results; an earlier demo there is replaced.")] = Path(
        "roomlight-demo"
    ),
) -> None:
    """Light the sample room and write pictures of it.

    The room comes with the package: no arguments and no network are needed. At the end there is a film of the room
    with virtual objects. It takes about a minute, and a little longer the first time, when the kernels are compiled.
    """
    capture = sample_capture()
    run_replay(capture, out, ReplayOptions(probes_from_capture=True, overwrite=True))
    say(score_line(capture, out))
    film = Output(out / FILM, overwrite=True)
    done = composite_recording(
        (capture, CaptureOptions()),
        demo_scene(),
        film,
        quality="preview",
        online=False,
        options=SessionOptions(),
        rate=lambda _: FILM_RATE,
    )
    say(f"A chair, a mirror sphere and two moving objects in the room: {done}")


def score_line(capture: Path, out: Path) -> str:
    """Return one sentence on how far the replay in `out` is from the sample's ground truth."""
    scores = evaluate_predictions([capture], out)
    first, *_, last, _all = (interval.mean for interval in scores.means("predictions", "log_l2"))
    return (
        f"Against the room's ground truth: log-L2 {first:.3f} over the first seven frames, {last:.3f} over the last six"
        f" (0 is perfect). Compare methods with: roomlight eval {capture}"
    )
