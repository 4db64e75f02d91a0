"""Operating a server: request ids, metrics, readiness, and a stop that loses no frame in progress."""

import asyncio
import json
import logging
import re
import threading
from unittest.mock import AsyncMock, Mock

import pytest
from websockets.exceptions import InvalidStatus

from http_servers import HeldSession, InThread, RunningServer, frame, metric
from roomlight.errors import ModelError
from roomlight_server import serving
from roomlight_server.answers import light_forms
from roomlight_server.app import _prepare
from roomlight_server.base.logs import JsonLines

ID = "X-Request-Id"


pytestmark = pytest.mark.usefixtures("room")


def test_frames_are_answered_before_all_forms_of_light_are_loaded(monkeypatch):
    loaded = threading.Event()
    monkeypatch.setattr(light_forms, "warm_up", loaded.wait)
    with RunningServer() as server:
        server.wait_until_ready()
        server.open()
        assert server.push(0).status == 200
        loaded.set()


def test_a_part_that_cannot_be_loaded_is_named_and_the_others_are_loaded(caplog):
    workers, when_loaded = AsyncMock(), Mock()
    workers.run_in_encode_pool.side_effect = [None, ModelError("damaged"), None]
    asyncio.run(_prepare(Mock(), Mock(workers=workers), when_loaded))
    assert workers.run_in_encode_pool.await_count == 3
    when_loaded.assert_called_once()
    assert "the server cannot load all of its parts" in caplog.text
    assert "cannot become ready" not in caplog.text


def test_a_request_id_is_returned(server):
    answer = server.call("GET", "/v1/sessions/room", headers={ID: "trace-7.a_b"})
    assert answer.headers["x-request-id"] == "trace-7.a_b"


@pytest.mark.parametrize("given", [{}, {ID: ""}, {ID: "a" * 65}, {ID: "two words"}, {ID: 'a","level":"x'}])
def test_a_request_without_a_usable_id_gets_one(server, given):
    ids = [server.call("GET", "/healthz", headers=given).headers["x-request-id"] for _ in range(2)]
    assert all(re.fullmatch("[0-9a-f]{32}", each) for each in ids)
    assert ids[0] != ids[1]


def test_problems_carry_the_request_id(server, monkeypatch):
    assert server.call("GET", "/v1/sessions/none", headers={ID: "r1"}).headers["x-request-id"] == "r1"
    assert server.call("GET", "/nowhere", headers={ID: "r2", "Origin": "http://x"}).headers["x-request-id"] == "r2"
    monkeypatch.setattr(type(server.registry), "use", None)
    broken = server.call("GET", "/v1/sessions/room", headers={ID: "r3"})
    assert (broken.status, broken.headers["x-request-id"]) == (500, "r3")


def test_a_stream_returns_its_request_id(server):
    with server.stream(headers={ID: "stream-1"}) as stream:
        assert stream.response is not None
        assert stream.response.headers["X-Request-Id"] == "stream-1"


class Lines(logging.Handler):
    """Collects log records as the server writes them."""

    def __init__(self):
        super().__init__()
        self.setFormatter(JsonLines())
        self.lines: list[dict[str, object]] = []

    def emit(self, record):
        self.lines.append(json.loads(self.format(record)))


@pytest.fixture
def lines():
    handler, log = Lines(), logging.getLogger("roomlight.server")
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    yield handler.lines
    log.removeHandler(handler)
    log.setLevel(level)


def test_log_lines_name_their_request(server, lines):
    server.call("PUT", "/v1/sessions/logged", {"height": 16}, headers={ID: "opens-it"})
    server.call("DELETE", "/v1/sessions/logged", headers={ID: "ends-it"})
    found = {line["event"]: line.get("request") for line in lines}
    assert found == {"session opened": "opens-it", "session ended": "ends-it"}


def test_the_line_of_a_failed_frame_names_its_request(monkeypatch, lines):
    """The task that processes frames was started by an earlier request."""
    HeldSession.serve(monkeypatch)
    HeldSession.broken = {1: RuntimeError("broke")}
    with RunningServer() as server:
        server.open()
        first = InThread(server.push, 0, headers={ID: "first"})
        HeldSession.wait_entered()
        second = InThread(server.push, 1, headers={ID: "second"})
        while server.state()["frames"]["queued"] < 2:
            pass
        HeldSession.release(2)
        assert (first.result().status, second.result().status) == (200, 500)
    (line,) = [line for line in lines if line["event"] == "engine failed"]
    assert (line["request"], line["frame"]) == ("second", 1)


def test_metrics_show_queues_refusals_and_memory(monkeypatch):
    HeldSession.serve(monkeypatch)
    with RunningServer(engine_threads=1) as server:
        server.open()
        server.open("other")
        pushes = [InThread(server.push, 0)]
        HeldSession.wait_entered()
        for index in (1, 2):
            pushes.append(InThread(server.push, index))
            server.wait_until_accepted(index)
        pushes.append(InThread(server.push, 0, name="other"))
        while metric(server, 'roomlight_queued_jobs{pool="engine"}') != 1:
            pass
        HeldSession.release(3)
        statuses = [push.result().json["status"] for push in pushes]
        assert statuses == ["processed", "superseded", "processed", "processed"]
        assert metric(server, 'roomlight_frames_total{status="superseded"}') == 1
        assert server.call("GET", "/v1/sessions/none").status == 404
        assert metric(server, 'roomlight_problems_total{kind="session-not-found"}') == 1
        assert metric(server, "roomlight_decode_seconds_count") == 4
        assert metric(server, 'roomlight_queue_seconds_count{pool="decode"}') >= 4
        with server.stream() as stream:
            stream.send(json.dumps({"type": "track", "name": "table", "position": [0, 0, 0]}))
            stream.recv()
        assert metric(server, 'roomlight_stream_messages_total{direction="received",type="track"}') == 1
        assert metric(server, 'roomlight_stream_messages_total{direction="sent",type="probes"}') == 1
        assert metric(server, "process_resident_memory_bytes") > 2**24


def test_a_stop_finishes_frames_and_refuses_new_ones(monkeypatch):
    """The server closed its socket first: a load balancer saw no /readyz, and streams lost their frames."""
    HeldSession.serve(monkeypatch)
    with RunningServer(engine_threads=1) as server:
        server.open()
        server.open("streamed")
        push = InThread(server.push, 0)
        with server.stream("streamed") as stream:
            stream.send(frame(0, index=0))
            HeldSession.wait_entered()
            while metric(server, 'roomlight_queued_jobs{pool="engine"}') != 1:
                pass
            server.begin_stop()
            while (answer := server.call("GET", "/readyz")).json["status"] != "stopping":
                pass
            assert answer.status == 503
            refused = server.push(1)
            assert (refused.status, refused.kind, refused.headers["retry-after"]) == (503, "stopping", "5")
            assert server.call("PUT", "/v1/sessions/new", {}).kind == "stopping"
            with pytest.raises(InvalidStatus, match="503"):
                server.stream("streamed")
            stream.send(frame(1, index=1))
            event = json.loads(stream.recv())
            assert (event["index"], event["problem"]["status"]) == (1, 503)
            HeldSession.release(2)
            assert push.result().json["status"] == "processed"
            assert json.loads(stream.recv())["status"] == "processed"


@pytest.mark.slow
def test_a_stop_waits_no_longer_than_its_limit(monkeypatch):
    monkeypatch.setattr(serving, "DRAIN_LIMIT_S", 0.1)
    monkeypatch.setattr("roomlight_server.work.workers.STOP_S", 0.1)
    HeldSession.serve(monkeypatch)
    with RunningServer() as server:
        server.open()
        push = InThread(server.push, 0)
        HeldSession.wait_entered()
        server.stop()  # although the engine is still at work
        HeldSession.release(1)
        del push
