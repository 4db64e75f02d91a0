"""Frames without depth over a real socket: accepted, estimated, and said."""

import json

import numpy as np
import pytest

from depth_models import SIZE, write_depth_model
from http_servers import RunningServer, box_shot, header_of, parts_of
from roomlight.errors import ModelError
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import pack


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    depth_m = np.linspace(1.5, 3, SIZE[0] * SIZE[1]).reshape(1, *SIZE)
    model = write_depth_model(tmp_path_factory.mktemp("model") / "metric.onnx", {"depth": depth_m})
    with RunningServer(depth_model=model) as running:
        yield running


def bare(yaw_degrees=0, **changes):
    """Return a frame message whose header has no depth."""
    shot = box_shot(yaw_degrees)
    header = header_of(shot, **changes)
    del header["depth"]
    return pack(FrameHeader.model_validate_json(json.dumps(header)), parts_of(shot)[0])


def test_a_frame_without_depth_gives_light(server):
    server.open("bare")
    assert server.call("PUT", "/v1/sessions/bare/probes/lamp", {"position": [0.2, 1.2, 0]}).status in (200, 201)
    for index in range(2):
        answer = server.push(index, bare(3 * index), name="bare")
        assert (answer.status, answer.json["status"]) == (200, "processed")
        assert answer.json["depth_estimated"] is True
    measured = server.push(2, name="bare")
    assert measured.json["depth_estimated"] is False
    assert server.state("bare")["coverage"]["lamp"] > 0


def test_an_object_stands_on_estimated_depth(server):
    """What draws into the last frame needs its depth again."""
    server.open("drawn")
    assert server.push(0, bare(), name="drawn").status == 200
    picture = server.call("GET", "/v1/sessions/drawn/colour")
    assert picture.status == 200


def test_confidence_needs_depth(server):
    server.open("odd")
    shot = box_shot(0)
    header = header_of(shot)
    plane = {"format": "uint8", "encoding": "raw", "width": 48, "height": 36, "bytes": 48 * 36}
    del header["depth"]
    checked = FrameHeader.model_validate_json(json.dumps(header | {"confidence": plane}))
    answer = server.push(0, pack(checked, parts_of(shot)[0], None, bytes(48 * 36)), name="odd")
    assert (answer.status, answer.json["field"]) == (422, "confidence")
    assert "must come with depth" in answer.json["rule"]


def test_a_client_sends_frames_without_depth(server):
    from dataclasses import replace

    shot = box_shot(0)
    without = replace(shot, depth_m=np.zeros_like(shot.depth_m))
    server.open("client")
    for index, colour in enumerate(("exact", "jpeg")):
        answer = server.push(index, pack_frame(without, colour=colour), name="client")
        assert answer.json["depth_estimated"] is True, answer


def test_a_server_with_a_bad_depth_model_does_not_start(tmp_path):
    with pytest.raises(ModelError, match="there is no such depth model"):
        RunningServer(depth_model=tmp_path / "absent.onnx").app.state.context.workers.load()
