"""Frames without depth over a real socket: accepted, estimated, and said."""

import numpy as np
import pytest

from depth_models import SIZE, write_depth_model
from http_servers import RunningServer, with_parts
from roomlight.errors import ModelError
from roomlight.monocular.stream import open_depth_stream
from roomlight_server.state.live_state import DepthScale


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    depth_m = np.linspace(1.5, 3, SIZE[0] * SIZE[1]).reshape(1, *SIZE)
    return write_depth_model(tmp_path_factory.mktemp("model") / "metric.onnx", {"depth": depth_m})


@pytest.fixture(scope="module")
def server(model):
    with RunningServer(depth_model=model) as running:
        yield running


UNTRUSTED = {"confidence": ({}, bytes(48 * 36))}
"""Depth whose confidence is low everywhere, as a phone's is that has just started."""


@pytest.mark.parametrize("parts", [{"depth": False}, UNTRUSTED], ids=["no depth", "untrusted depth"])
def test_a_frame_without_depth_gives_light(server, parts):
    server.open("bare")
    assert server.call("PUT", "/v1/sessions/bare/probes/lamp", {"position": [0.2, 1.2, 0]}).status in (200, 201)
    for index in range(2):
        answer = server.push(index, with_parts(**parts, timestamp_s=0.1 * index), name="bare")
        assert (answer.status, answer.json["status"]) == (200, "processed")
        assert answer.json["depth_estimated"] is True
    measured = server.push(2, name="bare")
    assert measured.json["depth_estimated"] is False
    refused = server.push(3, with_parts(**UNTRUSTED), name="bare")  # an estimate would have another scale
    assert (refused.status, "no pixel of its depth is usable" in refused.json["detail"]) == (422, True)
    assert server.state("bare")["coverage"]["lamp"] > 0
    server.call("DELETE", "/v1/sessions/bare")


@pytest.mark.slow
def test_an_object_stands_on_estimated_depth_which_a_restart_restores(model, tmp_path):
    """What draws into the last frame needs its depth again, and so does late light from keyframes."""
    settings = {"depth_model": model, "state_dir": tmp_path, "state_interval_s": 0.1}
    body = {"objects": [{"shape": "sphere", "size_m": 0.2, "pixel": [24, 24]}], "quality": "preview"}
    frames, depths_m = (with_parts(depth=False), with_parts(**UNTRUSTED), with_parts(**UNTRUSTED)), []

    def answers():
        light = server.call("GET", "/v1/sessions/room/probe?x=0.1&y=1.1&z=-0.2&format=npy")
        composite = server.call("POST", "/v1/sessions/room/composite", body)
        assert (light.status, composite.status) == (200, 200), (light, composite)
        return light.body, composite.headers["roomlight-poses"]

    before = None
    for indices in ((0, 1), (2,), ()):  # 1 is a keyframe, 2 is none
        with RunningServer(**settings) as server:
            server.open()
            live = dict(server.registry.items())["anyone", "room"]
            assert before is None or answers() == before
            for index in indices:
                assert server.push(index, frames[index]).json["keyframe"] == (index < 2)
                depths_m.append(live.latest.depth_m)
                live._depth.state.per_metre, live._depth.state.unmoved = 0.5, False  # as if features had told it
            before = answers()
    assert np.array_equal(*depths_m[1:])


def test_the_scale_of_another_depth_model_is_not_taken_over(model, tmp_path):
    before = open_depth_stream(model)
    before.state.per_metre = 0.5
    other = write_depth_model(tmp_path / "other.onnx", {"depth": np.ones((1, *SIZE))})
    for path, per_metre in ((model, 0.5), (other, 1.0), (None, 1.0)):
        stream = open_depth_stream(path)
        DepthScale.of(before).give(stream)
        assert stream.state.per_metre == per_metre


def test_confidence_needs_depth(server):
    server.open("odd")
    answer = server.push(0, with_parts(depth=False, confidence=({}, bytes(48 * 36))), name="odd")
    assert (answer.status, answer.json["field"]) == (422, "confidence")
    assert "must come with depth" in answer.json["rule"]


def test_a_server_with_a_bad_depth_model_does_not_start(tmp_path):
    with pytest.raises(ModelError, match="there is no such depth model"):
        RunningServer(depth_model=tmp_path / "absent.onnx").app.state.context.workers.load()
