"""The sample capture that ships with the package: one generated room, 31 frames, three ground-truth probes."""

from importlib.resources import files
from pathlib import Path

from roomlight.errors import CaptureError


def sample_capture() -> Path:
    """The sample capture's folder inside the installed package. Raises CaptureError if the install lacks it."""
    path = Path(str(files("roomlight") / "data" / "sample"))
    if not (path / "capture.json").is_file():
        raise CaptureError(f"{path}: the sample capture is missing from this install; install roomlight again")
    return path
