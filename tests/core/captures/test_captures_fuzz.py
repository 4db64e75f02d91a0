"""Broken captures, made from whole ones by a seeded generator: none may end in a traceback, hang or pass unnoticed.

Each of 8 formats x 48 seeds damages one to three things. The outcome must be a RoomLightError that names a file of
the capture, or frames that are sound with every other record on `skipped`, with its file. Any other exception, or a
warning, fails the test. Of the 384, about 225 are refused, 128 lose frames and 31 are hit where it does not matter.
"""

import random
import time
from collections.abc import Callable
from pathlib import Path

import formats
import numpy as np
import pytest
from damage import damaged

from roomlight.camera import check_rigid
from roomlight.captures import open_capture
from roomlight.errors import RoomLightError

SEEDS = 48
LIMIT_S = 60.0
"""Per variant, against hangs; the slowest takes 0.1 s alone on one core."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    root, built = tmp_path_factory.mktemp("whole"), {}

    def build(name: str) -> Path:
        if name not in built:
            built[name] = formats.BUILDERS[name](root / name, formats.scene())
        return built[name]

    return build


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("name", formats.BUILDERS)
def test_a_broken_capture_is_refused_or_its_bad_frames_are_skipped(
    name: str, seed: int, whole: Callable[[str], Path], tmp_path: Path
) -> None:
    rng = random.Random(f"{name} {seed}")
    path = damaged(whole(name), tmp_path, rng)
    started = time.monotonic()
    refusal = None
    try:
        frames_are_sound_and_the_others_named(path)
    except RoomLightError as error:
        refusal = error
    assert refusal is None or str(path) in str(refusal)
    assert time.monotonic() - started < LIMIT_S


def frames_are_sound_and_the_others_named(path: Path) -> None:
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
