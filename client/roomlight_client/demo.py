"""`roomlight demo`: the sample room that comes with the package."""

from importlib.resources import files
from pathlib import Path

from roomlight.errors import CaptureError
from roomlight_client.evaluate import evaluate_predictions
from roomlight_client.replay import ReplayOptions


def sample_capture() -> Path:
    """The sample capture's folder inside the installed package. Raises CaptureError if the install lacks it."""
    path = Path(str(files("roomlight") / "data" / "sample"))
    if not (path / "capture.json").is_file():
        raise CaptureError(f"{path}: the sample capture is missing from this install; install roomlight again")
    return path


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
