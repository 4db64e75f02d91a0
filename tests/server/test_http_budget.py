"""Sizes of answers, and the memory budget of all requests, over a real socket."""

import json
from unittest.mock import Mock

import numpy as np
import pytest

from http_servers import LATE, RunningServer, frame, post, with_small_buffer
from roomlight.engine.session_view import SessionView
from roomlight.light.light import Light
from roomlight.wire.light_message import MEDIA_TYPE
from roomlight.wire.messages import CUBE_FORMATS, FACE_SIZES, LightForm
from roomlight_server.answers.light_forms import MEDIA_TYPES, encode, max_bytes
from roomlight_server.base.byte_budget import ByteBudget

TALL = {"model": "classical", "height": 512, "reference_exposure": 1.0}
BINARY = {"Accept": MEDIA_TYPE}


def noise(height):
    image = np.random.default_rng(height).gamma(0.5, 2.0, (height, 2 * height, 3)).astype(np.float32)
    return Light((0.0, 0.0, 0.0), image, (image[..., 0] > 1).astype(np.float32), 0.5, etag="")


@pytest.mark.slow
@pytest.mark.parametrize(("size", "height"), [(None, 16), (None, 120), (FACE_SIZES[-1], 120)])
@pytest.mark.parametrize("name", MEDIA_TYPES)
def test_the_estimate_bounds_incompressible_light(name, size, height):
    if name == "specular" and size not in (None, 16):
        return  # slow, and as large as `ktx2` with its mips
    form = LightForm(format=name, size=size)
    payload = encode(noise(height), form)
    found = len(payload.data) if payload.data is not None else len(json.dumps(payload.values))
    bound = max_bytes(form, height)
    assert found <= bound
    if payload.data is not None and name in {*CUBE_FORMATS, "npy"} - {"glb"}:  # its PNGs are compressed
        assert bound < 2 * found + 8192


@pytest.mark.parametrize("accept", [{}, BINARY])
def test_an_answer_is_bounded_by_the_height_of_the_session(accept):
    """The estimate took 1 MB for each panorama: 64 of a session of 512 rows were an answer of 504 MB."""
    with RunningServer() as server:
        server.open(options=TALL)
        body = {"probes": [{"position": [0, 0, -1]}] * 64, "forms": [{"format": "npy"}]}
        answer = server.call("POST", "/v1/sessions/room/probes", body, headers=accept)
        assert (answer.status, answer.json["field"]) == (422, "forms")
        body["probes"] = body["probes"][:7]
        assert server.call("POST", "/v1/sessions/room/probes", body, headers=accept).status == 200
        with server.stream() as stream:
            stream.send(json.dumps({"type": "subscribe", "forms": [{"format": "npy"}]}))
            assert json.loads(stream.recv())["problem"]["field"] == "forms"


def test_unread_answers_are_bounded():
    """Clients that read nothing filled the memory: 6.7 GB of answers."""
    body = {"probes": [{"position": [0, 0, -1]}] * 3, "forms": [{"format": "npy"}]}
    with RunningServer(max_pending_bytes=2**27) as server:
        server.open(options=TALL)
        budget = server.app.state.context.budget
        unread = [post(server, body, connection=with_small_buffer()) for _ in range(12)]
        heads = [connection.recv(12) for connection in unread]
        assert heads[0] == b"HTTP/1.1 200"
        assert b"HTTP/1.1 503" in heads
        assert budget.used <= 2**27
        busy = server.call("POST", LATE, body | {"probes": [{"position": [0, 0, 0]}] * 5})
        assert (busy.status, busy.kind, busy.headers["retry-after"]) == (503, "server-busy", "1")
        for connection in unread:
            connection.close()
        while budget.used:
            assert server.call("GET", "/healthz").status == 200


def test_frames_in_flight_are_bounded(monkeypatch):
    def tiny_budget(_, unsent_bytes, owner_limit):
        return ByteBudget(1000, unsent_bytes, owner_limit=owner_limit)

    monkeypatch.setattr("roomlight_server.app.ByteBudget", tiny_budget)
    with RunningServer() as server:
        server.open()
        answer = server.push(0)
        assert (answer.status, answer.kind) == (503, "server-busy")
        with server.stream() as stream:
            stream.send(frame(0, index=0))
            event = json.loads(stream.recv())
            assert (event["index"], event["problem"]["status"]) == (0, 503)
        assert server.app.state.context.budget.used == 0


def test_a_failed_answer_releases_its_memory(monkeypatch):
    with RunningServer() as server:
        server.open()
        assert server.push(0).status == 200
        monkeypatch.setattr(SessionView, "lights_at", Mock(side_effect=RuntimeError("engine broke")))
        assert server.call("GET", "/v1/sessions/room/probe?x=0&y=0&z=0").status == 500
        assert server.app.state.context.budget.used == 0
