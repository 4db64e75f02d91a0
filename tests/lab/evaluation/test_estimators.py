"""The engine as a scored estimator, beside the baselines."""

import json

import numpy as np
import pytest

from roomlight.engine.session import SessionOptions
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


def test_the_engine_is_scored_beside_both_baselines(capture):
    scores = evaluate_engine([capture], OPTIONS)
    assert scores.methods == ("mean colour", "warp and fill", "classical")
    for track in scores.tracks:
        assert np.isfinite(np.concatenate([list(values) for values in track.scores.values()])).all()
    assert json.dumps(scores.to_json(), allow_nan=False)
    # it sees the wall ahead of the probe; the mean colour does not
    assert scores.means("classical", "log_l2")[-1].mean < scores.means("mean colour", "log_l2")[-1].mean
