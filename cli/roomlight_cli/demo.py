"""`roomlight demo`: the sample room that comes with the package."""

from pathlib import Path

from roomlight_cli.replay import ReplayOptions
from roomlight_evaluation.evaluate import evaluate_predictions


def demo_options() -> ReplayOptions:
    """The sample's own probes, every frame; run again, the demo starts afresh."""
    return ReplayOptions(probes_from_capture=True, overwrite=True)


def score_line(capture: Path, out: Path) -> str:
    """How close the replay came to the sample's ground truth, in one sentence."""
    evaluation = evaluate_predictions(capture, out)
    first, *_, last, _all = (cell.mean for cell in evaluation.cells("predictions", "log_l2"))
    return (
        f"Against the room's ground truth: log-L2 {first:.3f} over the first seven frames, {last:.3f} over the last six"
        f" (0 is perfect). Compare methods with: roomlight eval {capture}"
    )
