"""What several test files of captures share."""

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import formats
import numpy as np
import pytest

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.errors import CaptureError, RoomLightError
from roomlight.frame import Frame


def edit(path: Path, change: Callable[[dict], object]) -> None:
    """Change the JSON index of a capture."""
    index = json.loads(path.read_bytes())
    change(index)
    path.write_text(json.dumps(index))


def first_of(path: Path, options: CaptureOptions | None = None) -> Frame:
    return next(iter(open_capture(path, options)))


def notes_of(path: Path, options: CaptureOptions | None = None, *, frames: int | None = None) -> list[str]:
    """Read a capture to its end, of this many frames if a number is given; returns its notes."""
    count = len(list(capture := open_capture(path, options)))
    assert frames in (None, count)
    return [str(note) for note in capture.notes]


def same_views(
    frames: Iterable[Frame], views: Sequence[formats.View], *, atol: float = 1e-6, depth_atol: float | None = None
) -> None:
    """Check the frames' poses, and their depth if it is said how exactly."""
    for frame, view in zip(frames, views, strict=True):
        np.testing.assert_allclose(frame.camera_to_world, view.pose, atol=atol)
        if depth_atol is not None:
            np.testing.assert_allclose(frame.depth_m, view.depth_m, atol=depth_atol)


def refused(
    path: Path, says: str, options: CaptureOptions | None = None, *, error: type[RoomLightError] = CaptureError
) -> None:
    """Check that a capture is refused when it is opened."""
    with pytest.raises(error, match=says):
        open_capture(path, options)


def unreadable(path: Path, says: str, options: CaptureOptions | None = None) -> None:
    """Check that a capture is refused when its frames are read, if not before."""
    with pytest.raises(CaptureError, match=says):
        list(open_capture(path, options))


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
