"""The WebSocket over a real socket: frames, their outcomes, light, and errors that keep the connection open."""

import json
from contextlib import contextmanager
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from http_servers import TOKEN, Held, HeldSession, RunningServer, frame
from roomlight.engine.session import Session
from roomlight.wire.light_message import parse_light
from roomlight.wire.messages import LightAnswer, LightingUpdate
from roomlight_server.sessions import live_session

POINT = [0.2, 1.2, -0.2]


class Stream:
    """A connection with messages as dicts."""

    def __init__(self, socket):
        self.socket = socket

    def send(self, message):
        self.socket.send(json.dumps(message) if isinstance(message, dict) else message)

    def receive(self):
        return self.socket.recv()

    def close_code(self):
        """Wait for the server to close the connection; return the code."""
        with pytest.raises(ConnectionClosed) as closed:
            self.receive()
        assert closed.value.rcvd is not None
        return closed.value.rcvd.code

    def next(self, kind):
        """Return the next message of a kind and drop those before it."""
        for _ in range(20):
            message = self.receive()
            if isinstance(message, str) and json.loads(message)["type"] == kind:
                return json.loads(message)
        raise AssertionError(f"no message of type {kind}")

    def rejected(self, message):
        self.send(message)
        return self.next("problem")["problem"]


@contextmanager
def streaming(server, name="room", **more):
    with server.stream(name, max_size=2**24, **more) as socket:
        yield Stream(socket)


def test_frames_are_answered_and_subscribed_light_is_sent(server):
    server.open("flow")
    with streaming(server, "flow") as stream:
        stream.send({"type": "track", "name": "table", "position": POINT})
        assert stream.next("probes")["probes"] == {"table": POINT}
        stream.send({"type": "subscribe", "forms": [{"format": "sh"}, {"format": "main_light"}]})
        update = stream.next("lighting")
        assert (update["frame"], update["results"][0]["coverage"]) == (-1, 0)
        for index in range(3):
            stream.send(frame(30 * index, index=index))
            outcome = stream.next("frame")
            assert (outcome["index"], outcome["status"]) == (index, "processed")
            update = stream.next("lighting")
            assert update["frame"] == index
            assert update["results"][0]["name"] == "table"
        over_http = server.call("GET", "/v1/sessions/flow/probes/table?format=sh").json
        assert update["results"][0]["forms"][0]["values"]["coefficients"] == over_http["coefficients"]
        stream.send({"type": "untrack", "name": "table"})
        assert stream.next("probes")["probes"] == {}
        stream.send({"type": "track", "name": "table", "position": POINT})
        assert stream.next("probes")["probes"] == {"table": POINT}
        assert server.call("DELETE", "/v1/sessions/flow/probes/table").status == 204  # as another client does
        stream.send(frame(90, index=3))
        assert stream.next("probes")["probes"] == {}
    assert server.state("flow")["frames"]["processed"] == 4


def test_binary_forms_are_sent_as_light_messages(server):
    server.open("binary")
    server.push(0, name="binary")
    with streaming(server, "binary") as stream:
        stream.send({"type": "light", "request": "r1", "probes": [{"position": POINT}], "forms": [{"format": "exr"}]})
        answer, parts = parse_light(stream.receive(), LightAnswer)
        assert (answer.type, answer.request, answer.frame) == ("light", "r1", 0)
        x, y, z = POINT
        assert parts[0][0] == server.call("GET", f"/v1/sessions/binary/probe?x={x}&y={y}&z={z}").body
        stream.send({"type": "track", "name": "table", "position": POINT})
        stream.next("probes")
        stream.send({"type": "subscribe", "forms": [{"format": "cube", "size": 16}]})
        update, parts = parse_light(stream.receive(), LightingUpdate)
        assert update.results[0].name == "table"
        assert len(parts[0][0] or b"") == 6 * 16 * 16 * 8


def test_a_rejected_message_keeps_the_connection_open(server):
    server.open("patient")
    with streaming(server, "patient") as stream:
        assert stream.rejected(frame(0))["field"] == "index"  # required on a WebSocket
        assert stream.rejected(b"")["status"] == 422
        assert stream.rejected(b"garbage that is no frame")["field"] == "magic"
        assert stream.rejected("{")["status"] == 422
        assert stream.rejected("[]")["status"] == 422
        assert stream.rejected({"type": "dance"})["status"] == 422
        assert stream.rejected({"type": "track", "name": "a/b", "position": POINT})["field"] == "track.name"
        assert stream.rejected({"type": "untrack", "name": "nobody"})["status"] == 404
        assert (
            stream.rejected({"type": "subscribe", "forms": [{"format": "specular", "size": 256}] * 8})["status"] == 422
        )
        assert stream.rejected("x" * 70_000)["status"] == 413
        light = {"type": "light", "request": "r7", "probes": [{"position": POINT}], "forms": [{"format": "sh"}]}
        stream.send(light)
        early = stream.next("light")
        assert (early["request"], early["frame"], early["results"][0]["coverage"]) == ("r7", -1, 0)
        stream.send(light | {"probes": [{"name": "nobody"}]})
        nobody = stream.next("problem")
        assert (nobody["request"], nobody["problem"]["status"]) == ("r7", 404)
        for invalid in (light | {"probes": [{"position": [0, 2000, 0]}]}, light | {"forms": []}, light | {"more": 1}):
            stream.send(invalid)
            refused = stream.next("problem")
            assert (refused["request"], refused["problem"]["status"]) == ("r7", 422)
        for unusable in (7, "half of an emoji \ud83d"):
            stream.send(light | {"request": unusable})
            refused = stream.next("problem")
            assert ("request" in refused, refused["problem"]["status"]) == (False, 422)
        stream.send(frame(0, index=3))
        assert stream.next("frame")["status"] == "processed"
        stream.send(frame(1, index=2))
        assert stream.next("problem")["problem"]["status"] == 409
        stream.send(light)
        assert stream.next("light")["results"][0]["coverage"] > 0


def test_a_rejected_frame_is_named_if_its_index_is_readable(server):
    server.open("named")
    whole = frame(0, index=5)
    with streaming(server, "named") as stream:

        def index_of_problem(message):
            stream.send(message)
            return stream.next("problem").get("index")

        assert index_of_problem(whole[:-1]) == 5  # a part is missing
        assert index_of_problem(whole.replace(b'"exposure":1', b'"exposure":0')) == 5
        assert index_of_problem(whole.replace(b'"fx"', b'"xf"')) == 5
        assert index_of_problem(b"garbage") is None
        assert index_of_problem(whole.replace(b'"index":5', b'"index":-')) is None
        stream.send(whole)
        assert stream.next("frame")["status"] == "processed"
        assert index_of_problem(frame(1, index=5)) == 5  # a conflict
        server.call("DELETE", "/v1/sessions/named")
        assert "index" not in stream.next("problem")  # the end of the session, not of a frame


def fail_once(function, error):
    """Return the function with a first call that raises the error."""
    errors = [error]

    def wrapper(*args, **kwargs):
        if errors:
            raise errors.pop()
        return function(*args, **kwargs)

    return wrapper


def test_an_unexpected_error_of_a_frame_is_answered(server, monkeypatch, caplog):
    server.open("unexpected")
    decode = fail_once(live_session.decode_to_size, RuntimeError("decoder broke"))
    monkeypatch.setattr(live_session, "decode_to_size", decode)
    with streaming(server, "unexpected") as stream:
        stream.send(frame(0, index=3))
        event = stream.next("problem")
        assert (event["index"], event["problem"]["status"]) == (3, 500)
        assert event["problem"]["type"] == "urn:roomlight:problem:internal"
        assert "decoder broke" not in json.dumps(event)  # only in the log
        stream.send(frame(0, index=4))
        assert stream.next("frame")["status"] == "processed"
    logged = next(record for record in caplog.records if record.message == "unexpected error on a stream")
    assert (logged.session, logged.frame, str(logged.exc_info[1])) == ("unexpected", 3, "decoder broke")


def test_an_unexpected_error_of_a_light_is_answered(server, monkeypatch):
    server.open("dim")
    server.push(0, name="dim")
    monkeypatch.setattr(Session, "light", fail_once(Session.light, RuntimeError("engine broke")))
    with streaming(server, "dim") as stream:
        stream.send({"type": "subscribe", "forms": [{"format": "sh"}]})
        stream.send({"type": "track", "name": "table", "position": POINT})
        assert stream.next("problem")["problem"]["status"] == 500
        stream.send({"type": "track", "name": "table", "position": POINT})
        assert stream.next("probes")["probes"] == {"table": POINT}
        stream.send(frame(1, index=1))
        assert stream.next("lighting")["frame"] == 1


def test_a_frame_is_answered_if_the_engine_breaks_after_it(monkeypatch):
    """The engine's report of a frame is inconsistent: the frame is answered and the session has failed."""
    monkeypatch.setattr(Session, "handles", property(lambda _: ["no such probe"]))
    with RunningServer() as server:
        server.open()
        with streaming(server) as stream:
            stream.send(frame(0, index=0))
            event = stream.next("problem")
            assert (event["index"], event["problem"]["type"]) == (0, "urn:roomlight:problem:engine-failed")
            assert stream.next("problem")["problem"]["type"] == "urn:roomlight:problem:session-failed"
            assert stream.close_code() == 4410
        assert server.state()["status"] == "failed"


def test_a_dropped_connection_frees_its_frame_slots(monkeypatch):
    HeldSession.serve(monkeypatch)
    with RunningServer(frames_in_flight=2) as server:
        server.open()
        with streaming(server) as stream:
            stream.send(frame(0, index=0))
            stream.send(frame(1, index=1))
            HeldSession.wait_entered()
            stream.socket.socket.close()
        HeldSession.release(3)
        with streaming(server) as stream:
            stream.send(frame(2, index=2))
            assert stream.next("frame")["index"] == 2


def test_the_newest_frame_of_a_stream_wins(monkeypatch):
    HeldSession.serve(monkeypatch)
    with RunningServer(frames_in_flight=3) as server:
        server.open()
        with streaming(server) as stream:
            stream.send(frame(0, index=0))
            HeldSession.wait_entered()
            for index in (1, 2, 3, 4):  # more than there are slots: the server stops reading
                stream.send(frame(index, index=index))
            assert stream.next("frame") | {"coverage": {}} == {
                "type": "frame", "index": 1, "status": "superseded", "replay": False, "stage_ms": {}, "coverage": {},
                "depth_estimated": False,
            }  # fmt: skip
            HeldSession.release(10)
            outcomes = {}
            while not outcomes.keys() >= {0, 2, 3, 4}:
                outcome = stream.next("frame")
                outcomes[outcome["index"]] = outcome["status"]
            assert (outcomes[0], outcomes[4]) == ("processed", "processed")
        counts = server.state()["frames"]
        assert counts["accepted"] == counts["processed"] + counts["superseded"] == 5


def test_a_connection_ends_with_its_session(server):
    server.open("mortal")
    with streaming(server, "mortal") as stream:
        server.call("DELETE", "/v1/sessions/mortal")
        assert stream.next("problem")["problem"]["status"] == 410
        assert stream.close_code() == 4410


@pytest.mark.parametrize(("name", "status", "code"), [("nobody", 404, 4404), ("a.b", 422, 4422)])
def test_a_stream_without_a_session_is_closed_with_its_code(server, name, status, code):
    with streaming(server, name) as stream:
        assert stream.next("problem")["problem"]["status"] == status
        assert stream.close_code() == code


def test_a_handshake_that_misses_the_stream_says_why(server, caplog):
    answer = server.call("GET", "/v1/sessions/room/stream?v=1")  # what is left if a proxy drops Upgrade
    assert (answer.status, answer.kind, answer.headers["upgrade"]) == (426, "upgrade-required", "websocket")
    assert "a proxy must pass Upgrade and Connection" in answer.json["detail"]
    with pytest.raises(InvalidStatus) as refused, connect(f"ws://127.0.0.1:{server.port}/v1/session/room/stream"):
        pass
    response = refused.value.response
    assert (response.status_code, response.headers["Content-Type"]) == (404, "application/problem+json")
    assert "X-Request-Id" in response.headers
    assert "streams are at /v1/sessions/{id}/stream" in json.loads(response.body or b"")["detail"]
    server.call("GET", "/healthz")  # by then the connection has ended
    assert "handshake" not in caplog.text


def test_a_stream_needs_a_token_and_an_allowed_origin(server):
    server.open("guarded")
    with pytest.raises(InvalidStatus, match="403"), streaming(server, "guarded", origin="https://evil.example"):
        pass
    with RunningServer(tokens=(TOKEN,)) as locked:
        locked.open(token=TOKEN)
        assert locked.call("GET", "/v1/sessions/room/stream").status == 426  # a browser's token is a subprotocol
        ways: list[dict[str, Any]] = [{"token": TOKEN}, {"subprotocols": ["roomlight.v1", f"bearer.{TOKEN}"]}]
        for way in ways:
            with streaming(locked, **way) as stream:
                stream.send(frame(0, index=0))
                assert stream.next("frame")["status"] == "processed"
        with (
            pytest.raises(InvalidStatus, match="401"),
            streaming(locked, subprotocols=["roomlight.v1", "bearer.wrong"]),
        ):
            pass


def test_a_client_that_disconnects_while_it_tracks_leaves_no_nameless_probe(server, monkeypatch):
    """The cancelled task left a probe in the engine that every frame paid for and nobody could delete."""
    track = Held(Session.track)
    monkeypatch.setattr(Session, "track", track)
    server.open("left")
    with streaming(server, "left") as stream:
        stream.send({"type": "track", "name": "table", "position": POINT})
        track.wait_entered()
    track.release()
    server.wait_until(lambda: "table" in server.state("left")["probes"])
    assert server.call("DELETE", "/v1/sessions/left/probes/table").status == 204
