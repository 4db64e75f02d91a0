"""Fairness over real sockets: what one client does, or leaves behind, does not stop the others."""

import json
import logging
import os
import resource
import signal
import socket
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import AsyncMock, call

import pytest

from http_servers import LATE, SMALL, Held, InThread, RunningServer, answer_of, frame, metric, post, with_small_buffer
from roomlight.engine.probe import Probe
from roomlight.engine.session_view import SessionView
from roomlight.threads import parallel_for
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.light_message import parse_light
from roomlight.wire.messages import LightResponse
from roomlight_server.base import problems
from roomlight_server.routes import composites as composite_routes
from roomlight_server.routes import light as light_routes
from roomlight_server.sessions import live_session
from roomlight_server.work import fair_share
from roomlight_server.work.composite_processes import MAX_MEMORY_BYTES
from rooms import BoxRoom, camera_at

A, B = "token-of-the-hostile-client", "token-of-the-neighbour"
TALL = SMALL | {"height": 512}
BALL = {"shape": "sphere", "size_m": 0.2, "position": [0.2, 1.2, -0.2]}
COMPOSITE = "/v1/sessions/room/composite"


def late(count, *, form="sh", **form_options) -> dict[str, Any]:
    return {
        "probes": [{"position": [0.2, 1.2, -0.01 * number]} for number in range(count)],
        "forms": [{"format": form} | form_options],
    }


@pytest.fixture
def held_light(monkeypatch):
    held = Held(SessionView.lights_at)
    monkeypatch.setattr(SessionView, "lights_at", held)
    yield held
    held.release(1000)


@pytest.fixture
def server():
    """A server whose session `room` has seen a frame."""
    with RunningServer() as running:
        running.open()
        running.push(0)
        yield running


def late_points(server):
    return metric(server, "roomlight_late_points")


def abandoned(server):
    return metric(server, "roomlight_requests_abandoned_total")


def idle(server):
    """Whether no late probe is being computed or waiting."""
    return late_points(server) == 0


def test_the_rest_of_a_hung_up_post_is_not_computed(server, held_light, monkeypatch):
    """The 64 points of a client that is gone were all computed."""
    computed = []
    monkeypatch.setattr(Probe, "_begin", lambda *_: computed.append(1))
    connection = post(server, late(64))
    held_light.wait_entered()
    connection.close()
    server.wait_until(lambda: abandoned(server) == 1)
    held_light.release(64)
    server.wait_until(lambda: idle(server))
    assert (held_light.calls, computed) == (1, [])
    assert server.push(1, frame(1)).json["status"] == "processed"


def test_a_waiting_post_leaves_the_queue_when_it_hangs_up(server, held_light):
    first, second = post(server, late(1)), None
    held_light.wait_entered()
    second = post(server, late(64))
    server.wait_until(lambda: late_points(server) == 65)
    second.close()
    server.wait_until(lambda: late_points(server) == 1)  # at once, without the engine
    held_light.release(1)
    assert first.recv(12) == b"HTTP/1.1 200"
    first.close()
    assert held_light.calls == 1


def test_a_closed_stream_cancels_its_light(server, held_light):
    with server.stream() as stream:
        stream.send(json.dumps({"type": "light", "request": "r"} | late(64)))
        held_light.wait_entered()
        stream.socket.shutdown(socket.SHUT_RDWR)
        streams = server.app.state.context.guard
        server.wait_until(lambda: streams.connections == 1)  # the connection of this request
    held_light.release(64)
    server.wait_until(lambda: idle(server))
    assert held_light.calls == 1


def test_late_probes_of_an_owner_are_bounded(held_light):
    """All posts of 64 points waited in the queue."""
    with RunningServer(max_owner_late_probes=4) as server:
        server.open()
        server.push(0)
        waiting = [post(server, late(2)) for _ in range(2)]
        held_light.wait_entered()
        server.wait_until(lambda: late_points(server) == 4)
        for _ in range(2):
            refused = server.call("POST", LATE, late(2))
            assert (refused.status, refused.kind, refused.headers["retry-after"]) == (429, "owner-quota", "1")
            assert (refused.json["field"], "4 points" in refused.json["rule"]) == ("probes", True)
        for connection in waiting:
            connection.close()
        held_light.release(4)
        server.wait_until(lambda: idle(server))
        assert server.call("POST", LATE, late(2)).status == 200


def one_piece(*_):
    """A piece of a parallel loop."""


def endless(running, ended):
    """Return an engine call that computes until `ended` is set, as a late probe of 512 rows does for seconds."""

    def lights_at(self, positions):
        running.set()
        while not ended.is_set():
            parallel_for(one_piece, 1)
        return compute(self, positions)

    compute = SessionView.lights_at
    return lights_at


@pytest.mark.parametrize("tokens", [(A, B), ()])
def test_a_long_computation_is_paused_for_a_neighbour(tokens, monkeypatch):
    """Engine threads were given by turns: a neighbour waited for whole requests of another client."""
    hostile, neighbour = tokens or (None, None)
    running, ended = threading.Event(), threading.Event()
    monkeypatch.setattr(fair_share, "SLICE_S", 0.0)
    monkeypatch.setattr(SessionView, "lights_at", endless(running, ended))
    with RunningServer(tokens=tokens) as server:
        for name, token in (("room", hostile), ("home", neighbour)):
            server.open(name, token=token)
            server.push(0, name=name, token=token)
        connection = post(server, late(1), token=hostile)
        running.wait()
        for index in range(1, 4):
            answer = server.push(index, frame(index), name="home", token=neighbour)
            assert answer.json["status"] == "processed"
        ended.set()
        assert connection.recv(12) == b"HTTP/1.1 200"
        connection.close()


def test_late_points_do_not_hold_up_frames_of_their_session(server, monkeypatch):
    running, ended = threading.Event(), threading.Event()
    monkeypatch.setattr(SessionView, "lights_at", endless(running, ended))
    connection = post(server, late(2))
    running.wait()
    for index in range(1, 4):
        assert server.push(index, frame(index)).json["status"] == "processed"
    ended.set()
    answer = answer_of(connection)
    assert answer.status == 200
    assert parse_light(answer.body, LightResponse)[0].frame == 0  # that of the question
    connection.close()


def test_a_composite_ends_when_its_client_is_gone(server, monkeypatch):
    """A composite of high quality takes up to 50 s of CPU time."""
    running, never = threading.Event(), threading.Event()

    def make(*_):
        running.set()
        while not never.is_set():
            parallel_for(one_piece, 1)

    monkeypatch.setattr(composite_routes, "make", make)
    connection = post(server, {"objects": [BALL]}, COMPOSITE)
    running.wait()
    connection.close()
    server.wait_until(lambda: abandoned(server) == 1)
    assert server.push(1, frame(1)).json["status"] == "processed"  # it waited for the composite


def stopped_composite(server):
    """Wait for the process of a composite, and stop it; return its id."""
    processes = server.app.state.context.workers.composite_processes
    server.wait_until(lambda: processes.pids)
    (pid,) = processes.pids
    os.kill(pid, signal.SIGSTOP)
    return pid


def has_ended(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.slow
def test_previews_and_frames_do_not_wait_for_a_final_composite():
    """Finals of one token took a neighbour's preview 26 s and its frames 26 s."""
    with RunningServer(tokens=(A, B)) as server:
        for token in (A, B):
            server.open(token=token)
            server.push(0, token=token)
        final = {"objects": [BALL], "quality": "final"}
        held = InThread(server.call, "POST", COMPOSITE, final, token=A)
        pid = stopped_composite(server)
        assert server.call("POST", COMPOSITE, {"objects": [BALL]}, token=B).status == 200
        for token in (A, B):  # its own frames too: it works on a copy
            assert server.push(1, frame(1), token=token).json["status"] == "processed"
        os.kill(pid, signal.SIGCONT)
        answer = held.result()
        assert (answer.status, answer.headers["roomlight-frame"]) == (200, "0")


@pytest.mark.slow
def test_a_final_composite_is_killed_when_its_client_is_gone(server, caplog):
    caplog.set_level(logging.INFO, "roomlight.server")
    connection = post(server, {"objects": [BALL], "quality": "final"}, COMPOSITE)
    pid = stopped_composite(server)
    connection.close()
    server.wait_until(lambda: has_ended(pid) and "composite process killed" in caplog.messages)
    killed = caplog.records[caplog.messages.index("composite process killed")]
    assert (killed.levelname, vars(killed)["reason"]) == ("INFO", "its client has left")  # it has not crashed
    assert server.call("POST", COMPOSITE, {"objects": [BALL], "quality": "final"}).status == 200  # another process


def test_an_object_holds_up_no_frame_and_is_ended_when_its_client_is_gone(caplog):
    """Two large files stopped the frames of all for 20 s, also when their clients had left."""
    caplog.set_level(logging.INFO, "roomlight.server")
    with RunningServer(decode_threads=1) as server:
        server.open()
        workers = server.app.state.context.workers
        share = workers._object_share
        workers.decode_processes.start(1)
        (pid,) = workers.decode_processes.pids
        os.kill(pid, signal.SIGSTOP)
        connection = post(server, "no object", "/v1/objects?kind=obj")
        server.wait_until(lambda: share._running)
        assert server.push(0).json["status"] == "processed"
        connection.close()
        server.wait_until(lambda: has_ended(pid) and not share._running)
        killed = [vars(record)["reason"] for record in caplog.records if record.message == "decoding process killed"]
        assert killed == ["its client has left"]  # and not a second one, for another attempt


@pytest.mark.slow
def test_a_composite_beyond_the_memory_of_its_process_is_refused(server):
    """It ran on a thread of the server, where only an estimate bounded its memory."""
    good = {"objects": [BALL | {"material": {"kind": "glass"}}], "quality": "good"}
    assert server.call("POST", COMPOSITE, good).status == 200
    processes = server.app.state.context.workers.composite_processes
    (pid,) = processes.pids
    assert resource.prlimit(pid, resource.RLIMIT_AS) == (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES)
    size = int(Path(f"/proc/{pid}/statm").read_text("utf-8").split()[0]) * resource.getpagesize()
    resource.prlimit(pid, resource.RLIMIT_AS, (size + 2**23, MAX_MEMORY_BYTES))
    large = BoxRoom().frame(camera_at((0.2, 1.4, 0.8)), width=1280, height=960, depth_size=(64, 48))
    assert server.push(1, pack_frame(large, colour="jpeg")).json["status"] == "processed"
    answer = server.call("POST", COMPOSITE, good)
    assert (answer.status, answer.kind, answer.json["field"]) == (422, "invalid", "objects")
    assert f"at most {MAX_MEMORY_BYTES} bytes for its process" in answer.json["rule"]
    assert server.push(2, frame(2)).json["status"] == "processed"
    assert server.call("POST", COMPOSITE, {"objects": [BALL]}).status == 200
    processes.close_unused(0.0)
    assert processes.pids == []
    assert server.call("POST", COMPOSITE, good).status == 200


def test_a_composite_has_a_deadline():
    with RunningServer(composite_timeout_s=0.5) as server:
        server.open()
        server.push(0)
        answer = server.call("POST", COMPOSITE, {"objects": [BALL], "quality": "final"})
        assert (answer.status, answer.kind) == (503, "composite-late")
        assert "in 0.5 s, its waiting included" in answer.json["rule"]
        assert server.push(1, frame(1)).json["status"] == "processed"


def test_slow_decoding_of_one_owner_leaves_a_thread(monkeypatch):
    """Two frames that took seconds to decode held the frames of all others."""
    decode = Held(live_session.decode_to_size, lambda _, index, *__: index >= 100)
    monkeypatch.setattr(live_session, "decode_to_size", decode)
    with RunningServer(tokens=(A, B), decode_threads=2) as server:
        for number in range(3):
            server.open(f"bomb{number}", token=A)
        server.open(token=B)
        bombs = [InThread(server.push, 100, name=f"bomb{number}", token=A) for number in range(3)]
        decode.wait_entered()
        for index in range(3):
            assert server.push(index, frame(index), token=B).json["status"] == "processed"
        decode.release(3)
        assert [bomb.result().status for bomb in bombs] == [200, 200, 200]


def test_encoding_holds_neither_frames_nor_neighbours(monkeypatch):
    """Forty answers of `specular` 256 held the threads that decode frames."""
    encode = Held(light_routes.encode_all, lambda _, forms: forms[0].format == "specular")
    monkeypatch.setattr(light_routes, "encode_all", encode)
    with RunningServer(tokens=(A, B), encode_threads=2) as server:
        for token in (A, B):
            server.open(token=token)
            server.push(0, token=token)
        hostile = [post(server, late(1, form="specular", size=16), token=A) for _ in range(40)]
        encode.wait_entered()
        assert server.push(1, frame(1), token=A).json["status"] == "processed"
        assert server.push(1, frame(1), token=B).json["status"] == "processed"
        assert server.call("POST", LATE, late(1), token=B).status == 200
        for connection in hostile:
            connection.close()
        encode.release(40)


@pytest.mark.parametrize(("tokens", "delay_s"), [((A, B), 0.5), ((A,), 0.0)])
def test_refusals_by_limits_of_a_token_are_held_back(tokens, delay_s, monkeypatch):
    """Forty connections that repeated a refused request at once kept the event loop busy."""
    sleep = AsyncMock()
    monkeypatch.setattr(problems, "asyncio", SimpleNamespace(sleep=sleep))
    with RunningServer(tokens=tokens, refusal_delay_s=0.5, max_owner_late_probes=2) as server:
        server.open(token=A)
        server.push(0, token=A)
        assert server.call("POST", LATE, late(2), token=A).status == 200
        assert server.call("GET", "/v1/sessions/none", token=A).kind == "session-not-found"
        assert not sleep.called
        assert server.call("POST", LATE, late(3), token=A).kind == "owner-quota"
        sleep.assert_awaited_once_with(delay_s)
        with server.stream(token=A) as stream:
            stream.send(json.dumps({"type": "light", "request": "r"} | late(3)))
            assert "owner-quota" in str(stream.recv(60))
        assert sleep.await_args_list == [call(delay_s), call(delay_s)]


def test_sessions_of_an_owner_are_bounded():
    """One client opened all sessions of the server."""
    with RunningServer(tokens=(A, B), max_sessions=4) as server:
        answers = [server.call("PUT", f"/v1/sessions/s{number}", SMALL, token=A) for number in range(5)]
        assert [answer.status for answer in answers[:2]] == [201, 201]
        for answer in answers[2:]:
            assert (answer.status, answer.kind, answer.json["field"]) == (429, "owner-quota", "session")
            assert 1 <= int(answer.headers["retry-after"]) <= 60
        assert [server.open(f"s{number}", token=B).status for number in range(2)] == [201, 201]
        server.call("DELETE", "/v1/sessions/s0", token=A)
        assert server.open("s9", token=A).status == 201


def test_memory_of_an_owners_sessions_is_bounded():
    with RunningServer(max_owner_session_bytes=2**30) as server:
        opened = 0
        while (answer := server.call("PUT", f"/v1/sessions/s{opened}", TALL)).status == 201:
            opened += 1
        assert (answer.status, answer.kind, answer.json["field"]) == (429, "owner-quota", "height")
        assert sum(server.state(f"s{number}")["memory"]["bound_bytes"] for number in range(opened)) <= 2**30
        assert 1 <= opened < 16
        server.call("DELETE", "/v1/sessions/s0")
        assert server.open("again", TALL).status == 201


def track(server, number, session, token=None):
    path = f"/v1/sessions/{session}/probes/p{number}"
    return server.call("PUT", path, {"position": [0.0, 0.0, -1.0]}, token=token)


def test_probes_of_an_owner_are_bounded():
    with RunningServer(tokens=(A, B), max_owner_probes=3) as server:
        for name, token in (("one", A), ("two", A), ("three", B)):
            server.open(name, token=token)
        statuses = [track(server, number, name, A).status for number in range(2) for name in ("one", "two")]
        assert statuses == [201, 201, 201, 429]
        refused = track(server, 7, "one", A)
        assert (refused.kind, refused.json["field"], refused.headers["retry-after"]) == ("owner-quota", "name", "1")
        assert track(server, 0, "one", A).status == 200  # an existing one
        assert track(server, 0, "three", B).status == 201
        server.call("DELETE", "/v1/sessions/one/probes/p0", token=A)
        assert track(server, 7, "two", A).status == 201


def test_rows_of_an_owners_probes_are_bounded():
    """Sixteen probes of 512 rows in each session."""
    with RunningServer(max_owner_rows=1200) as server:
        server.open("tall", TALL)
        server.open("small")
        assert [track(server, number, "tall").status for number in range(3)] == [201, 201, 429]
        assert [track(server, number, "small").status for number in range(11)] == [201] * 11
        refused = track(server, 11, "small")
        assert (refused.kind, "1200 rows" in refused.json["rule"]) == ("owner-quota", True)


def test_unread_answers_of_one_owner_leave_memory_for_others():
    """Unread answers of one client filled the memory budget of all."""
    with RunningServer(tokens=(A, B), max_pending_bytes=2**28, max_owner_pending_bytes=2**27) as server:
        for token in (A, B):
            server.open(options=TALL, token=token)
        unread = [post(server, late(2, form="npy"), token=A, connection=with_small_buffer()) for _ in range(20)]
        heads = [connection.recv(12) for connection in unread]
        assert {b"HTTP/1.1 200", b"HTTP/1.1 429"} == set(heads)
        assert server.app.state.context.budget.used <= 2**27
        assert server.call("POST", LATE, late(2, form="npy"), token=B).status == 200
        for connection in unread:
            connection.close()


@pytest.mark.slow
def test_unread_messages_stop_the_reading_of_a_stream():
    """15,000 messages whose answers nobody reads: the server stops reading, and others are served."""
    with RunningServer(tokens=(A, B)) as server:
        for token in (A, B):
            server.open(token=token)
        raw = with_small_buffer()
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        raw.connect(("127.0.0.1", server.port))
        message = json.dumps({"type": "light", "request": "r"} | late(4, form="npy"))
        with server.stream(token=A, sock=raw, close_timeout=0) as stream:
            raw.settimeout(None)
            sent = threading.Thread(target=_send_all, args=(stream, message, 15_000), daemon=True)
            sent.start()
            guard = server.app.state.context.guard
            server.wait_until(lambda: guard.unsent_bytes() > 0)
            for index in range(3):
                assert server.push(index, frame(index), token=B).json["status"] == "processed"
            assert server.app.state.context.budget.used < 2**24
            raw.shutdown(socket.SHUT_RDWR)
            sent.join()


def _send_all(stream, message, count):
    try:
        for _ in range(count):
            stream.send(message)
    except Exception:  # the connection is closed in the middle
        return
