"""The engine as a scored estimator, with tracked and with late probes."""

import json

import numpy as np
import pytest

from roomlight.engine.session import SessionOptions
from roomlight.metrics import log_l2
from roomlight_evaluation.captures.estimators import EngineEstimator
from roomlight_evaluation.captures.evaluation import evaluate_engine
from rooms import BoxRoom, pan
from written_captures import write_capture

OPTIONS = SessionOptions(model="classical", height=32)
POINT = (0.3, 1.2, -0.5)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    room = BoxRoom()
    frames = pan(room, 3, width=64, height=48, step_degrees=25.0)
    probes = [(POINT, room.panorama(POINT, height=32)[0])]
    return write_capture(tmp_path_factory.mktemp("scored") / "box", frames, probes=probes)


def test_a_late_probe_is_lit_nearly_as_a_tracked_one():
    tracked, late = EngineEstimator(OPTIONS, None), EngineEstimator(OPTIONS, None, late=True)
    tracked_light = late_light = np.zeros((32, 64, 3), np.float32)
    for frame in pan(BoxRoom(), 5, width=64, height=48, step_degrees=25.0):
        for estimator in (tracked, late):
            estimator.push(frame)
        tracked_light, late_light = tracked.light_at(POINT), late.light_at(POINT)
    # the tracked probe blends five estimates, one a keyframe; the late one estimates once, from all views: 2.5e-4 apart
    truth = BoxRoom().panorama(POINT, height=32)[0]
    assert log_l2(tracked_light, late_light) < 5e-4
    assert log_l2(late_light, truth) <= log_l2(tracked_light, truth) < 0.025
    assert (tracked.name, late.name) == ("classical", "classical, late probe")


def test_the_engine_is_scored_beside_both_baselines(capture):
    scores = evaluate_engine([capture], OPTIONS, late=True)
    assert scores.methods == ("mean colour", "warp and fill", "classical", "classical, late probe")
    for track in scores.tracks:
        assert np.isfinite(np.concatenate([list(values) for values in track.scores.values()])).all()
    assert json.dumps(scores.to_json(), allow_nan=False)
    # it sees the wall ahead of the probe; the mean colour does not
    assert scores.means("classical", "log_l2")[-1].mean < scores.means("mean colour", "log_l2")[-1].mean
