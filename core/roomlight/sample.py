"""The sample capture in the package: one generated room, 31 frames, three ground-truth probes."""

from importlib.resources import files
from pathlib import Path

from roomlight.errors import CaptureError


def sample_capture() -> Path:
    """Return the folder of the sample capture inside the installed package.

    Raises:
        CaptureError: The installation lacks it.

    Examples:
        >>> import roomlight as rl
        >>> rl.sample_capture().name
        'sample'
    """
    path = Path(str(files("roomlight") / "data" / "sample"))
    if not (path / "capture.json").is_file():
        raise CaptureError(f"{path}: the sample capture is missing from this install; install roomlight again")
    return path
