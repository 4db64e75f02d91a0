"""The engine as an evaluated method, and what `roomlight eval` prints and writes."""

import json

import numpy as np
import pytest
from rich.console import Console

from roomlight.captures import CaptureOptions, CaptureWriter
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import SessionOptions
from roomlight.metrics import log_l2
from roomlight_evaluation.scoring import EngineEstimator, run_evaluation
from rooms import BoxRoom, pan

OPTIONS = SessionOptions(model="classical", height=32)
POINT = (0.3, 1.2, -0.5)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    path = tmp_path_factory.mktemp("scored") / "box"
    room = BoxRoom()
    with CaptureWriter(path) as writer:
        for frame in pan(room, 5, width=64, height=48, step_degrees=25.0):
            writer.add(
                srgb8=linear_to_srgb8(frame.image),
                depth_m=frame.depth_m,
                intrinsics=frame.intrinsics,
                camera_to_world=frame.camera_to_world,
            )
        writer.add_probe(POINT, room.panorama(POINT, height=32)[0])
    return path


def test_a_late_question_is_answered_nearly_as_a_tracked_one():
    tracked, late = EngineEstimator(OPTIONS, None), EngineEstimator(OPTIONS, None, late=True)
    for frame in pan(BoxRoom(), 5, width=64, height=48, step_degrees=25.0):
        for estimator in (tracked, late):
            estimator.push(frame)
        first, second = tracked.light_at(POINT), late.light_at(POINT)
    # every frame is a keyframe here: only the SGLV's part of the fill (weight 0.01) has another history
    assert log_l2(first, second) < 1e-4
    assert "late" in late.name


@pytest.mark.parametrize("late", [False, True])
def test_eval_scores_engine_and_baselines(capture, tmp_path, late):
    console = Console(width=160, record=True)
    scores = tmp_path / "scores.json"
    with console.capture() as printed:
        run_evaluation(
            [capture],
            predictions=None,
            late=late,
            json_out=scores,
            console=console,
            session=OPTIONS,
            capture=CaptureOptions(),
        )
    text = printed.get()
    for method in ("mean colour", "warp and fill", "classical"):
        assert method in text
    assert ("asked late" in text) is late
    written = json.loads(scores.read_text())
    assert np.isfinite([value for value in _numbers(written) if value is not None]).all()


def _numbers(node):
    if isinstance(node, dict):
        node = list(node.values())
    if isinstance(node, list):
        for part in node:
            yield from _numbers(part)
    elif isinstance(node, (int, float)):
        yield node
