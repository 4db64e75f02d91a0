"""`roomlight demo`: replay the sample room that comes with the package."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight.sample import sample_capture
from roomlight_cli.console import say
from roomlight_cli.lazy import single_command_app
from roomlight_cli.replay_options import ReplayOptions
from roomlight_cli.replay_run import run_replay
from roomlight_evaluation.capture_evaluation import evaluate_predictions

app = single_command_app()


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results; an earlier demo there is replaced.")] = Path(
        "roomlight-demo"
    ),
) -> None:
    """Light the sample room and write pictures of it.

    The room comes with the package: no arguments and no network are needed. It takes about half a minute, and a
    little longer the first time, when the kernels are compiled.
    """
    capture = sample_capture()
    run_replay(capture, out, ReplayOptions(probes_from_capture=True, overwrite=True))
    say(score_line(capture, out))


def score_line(capture: Path, out: Path) -> str:
    """Return one sentence on how far the replay in `out` is from the sample's ground truth."""
    scores = evaluate_predictions([capture], out)
    first, *_, last, _all = (interval.mean for interval in scores.means("predictions", "log_l2"))
    return (
        f"Against the room's ground truth: log-L2 {first:.3f} over the first seven frames, {last:.3f} over the last six"
        f" (0 is perfect). Compare methods with: roomlight eval {capture}"
    )
