"""Captures damaged by a seeded generator: reading one must not end in a traceback, hang, or return bad frames.

Each of 6 seeds damages one to three things of each layout. The outcome must be a RoomLightError that names a file of
the capture, or sound frames with every other record and its file in `skipped`. Any other exception, or a warning,
fails the test; a hang ends in pytest's timeout. Six in ten are refused, a third lose frames, the others are damaged
where no reader looks.
"""

import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from builders import BUILDERS
from damage import damaged

from roomlight.camera import check_rigid
from roomlight.captures import open_capture
from roomlight.errors import RoomLightError


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", BUILDERS)
def test_a_damaged_capture_is_refused_or_loses_frames(
    name: str, seed: int, whole: Callable[[str], Path], tmp_path: Path
) -> None:
    rng = random.Random(f"{name} {seed}")
    path = damaged(whole(name), tmp_path, rng)
    refusal = None
    try:
        check_frames_and_skipped(path)
    except RoomLightError as error:
        refusal = error
    assert refusal is None or str(path) in str(refusal)


def check_frames_and_skipped(path: Path) -> None:
    capture = open_capture(path)
    frames = 0
    for frame in capture:
        frames += 1
        assert np.isfinite(frame.image).all()
        assert (frame.image >= 0).all()
        assert np.isfinite(frame.depth_m).all()
        assert 0.01 <= np.median(frame.depth_m[frame.depth_m > 0]) <= 100
        check_rigid(frame.camera_to_world)
        assert str(path) in frame.source
    assert frames >= 1
    assert frames + len(capture.skipped) == capture.frame_count
    for skipped in capture.skipped:
        assert str(path) in skipped.file
        assert str(path) in skipped.reason
