"""What several test files of captures share."""

import json
from collections.abc import Callable
from pathlib import Path

from roomlight.captures import Capture, open_capture


def edit(path: Path, change: Callable[[dict], object]) -> None:
    """Change the JSON index of a capture."""
    index = json.loads(path.read_bytes())
    change(index)
    path.write_text(json.dumps(index))


def one_skipped(path: Path, index: int, *parts: str) -> Capture:
    """Check that the other three frames are read and this one is skipped with file and reason."""
    capture = open_capture(path)
    assert [frame.index for frame in capture] == [number for number in range(4) if number != index]
    (skipped,) = capture.skipped
    assert skipped.index == index
    assert str(path) in skipped.file
    for part in (str(path), *parts):
        assert part in skipped.reason
    return capture
