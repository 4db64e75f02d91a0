"""Frames over a real socket: order, replays, the queue, engine failures, multipart."""

import gc
import json
import logging
import threading

import cv2
import numpy as np
import pytest

from http_servers import SMALL, HeldSession, InThread, RunningServer, box_shot, frame, header_of, parts_of, with_parts
from roomlight.errors import FrameError
from roomlight_server.base.request_context import current_flow
from roomlight_server.sessions import live_session


@pytest.fixture
def held(monkeypatch):
    """Yield a server whose engine waits in every push."""
    HeldSession.serve(monkeypatch)
    with RunningServer(frames_in_flight=3, engine_threads=1) as running:
        running.open()
        yield running
        HeldSession.release(100)


def queued(server, index, **more):
    """Send a frame without waiting for the engine."""
    answer = server.push(index, headers={"Prefer": "respond-async"}, **more)
    assert (answer.status, answer.json["status"]) == (202, "queued")


def test_a_frame_is_processed_and_reported(server):
    server.open("one")
    answer = server.push(0, name="one")
    assert answer.status == 200
    result = answer.json
    assert (result["index"], result["status"], result["replay"], result["keyframe"]) == (0, "processed", False, True)
    assert {"prepare", "volume", "sglv", "mesh"} <= result["stage_ms"].keys()


def test_equal_bytes_are_a_replay_and_others_a_conflict(server):
    server.open("order")
    first = server.push(5, name="order")
    again = server.push(5, name="order")
    assert again.json == first.json | {"replay": True}
    other = server.push(5, frame(90), name="order")
    older = server.push(4, name="order")
    assert [(a.status, a.kind, a.json["field"]) for a in (other, older)] == [(409, "frame-conflict", "index")] * 2
    counts = server.state("order")["frames"]
    assert (counts["processed"], counts["replayed"], counts["refused"], counts["last_index"]) == (1, 1, 2, 5)


def test_a_frame_is_parsed_and_decoded_in_one_job():
    """And one that is not new is decoded in none."""
    with RunningServer() as server:
        server.open()
        assert [server.push(index).status for index in (0, 1, 1, 0, 2)] == [200, 200, 200, 409, 200]
        read = server.app.state.context.metrics.registry.get_sample_value
        assert read("roomlight_queue_seconds_count", {"pool": "decode"}) == 5
        assert read("roomlight_decode_seconds_count") == 3


def test_a_frame_without_tracking_is_skipped_and_counted(server):
    server.open("lost")
    server.open("brave", SMALL | {"use_limited_tracking": True})
    outcomes = {}
    for name in ("lost", "brave"):
        for index, state in enumerate(("normal", "limited", "not_available")):
            outcomes[name, state] = server.push(index, frame(tracking_state=state), name=name).json["status"]
    assert outcomes == {
        ("lost", "normal"): "processed", ("lost", "limited"): "skipped", ("lost", "not_available"): "skipped",
        ("brave", "normal"): "processed", ("brave", "limited"): "processed", ("brave", "not_available"): "skipped",
    }  # fmt: skip
    assert server.state("lost")["frames"]["skipped"] == 2


def test_the_newest_frame_supersedes_a_waiting_one(held):
    first = InThread(held.push, 0)
    HeldSession.wait_entered()
    second = InThread(held.push, 1, frame(1), headers={"X": "waits"})
    held.wait_until_accepted(1)
    third = InThread(held.push, 2, frame(2))
    assert second.result().json["status"] == "superseded"
    assert held.state()["frames"]["queued"] == 2
    HeldSession.release(2)
    assert [first.result().json["status"], third.result().json["status"]] == ["processed", "processed"]
    counts = held.state()["frames"]
    assert (counts["processed"], counts["superseded"], counts["accepted"], counts["gaps"]) == (2, 1, 3, 0)


def test_too_many_frames_in_flight_are_answered_with_429(held):
    waiting = [InThread(held.push, 0)]
    HeldSession.wait_entered()
    waiting.append(InThread(held.push, 1, frame(1)))
    held.wait_until_accepted(1)
    waiting.append(InThread(held.push, 1, frame(1)))  # a retry takes a slot too
    held.wait_until(lambda: held.state()["frames"]["replayed"])
    full = held.push(2)
    assert (full.status, full.kind, full.headers["retry-after"]) == (429, "session-full", "1")
    assert held.state()["frames"]["last_index"] == 1
    HeldSession.release(2)
    assert [call.result().json["status"] for call in waiting] == ["processed"] * 3
    assert waiting[2].result().json["replay"]
    HeldSession.release()
    assert held.push(2).status == 200


def test_health_is_answered_during_a_frame(held):
    held.wait_until_ready()
    queued(held, 0)
    HeldSession.wait_entered()
    for path in ("/healthz", "/readyz", "/metrics", "/v1/sessions/room"):
        assert held.call("GET", path).status == 200
    HeldSession.release()


@pytest.mark.parametrize("failure", [MemoryError("no room"), RuntimeError("ONNX Runtime: bad alloc")])
def test_an_engine_failure_ends_only_its_own_session(held, failure):
    held.open("neighbour")
    HeldSession.broken = {1: failure}
    HeldSession.release(2)
    assert held.push(0).status == 200
    broken = held.push(1)
    assert (broken.status, broken.kind) == (500, "engine-failed")
    assert str(failure) not in broken.body.decode()
    for answer in (held.push(2), held.call("GET", "/v1/sessions/room/probe?x=0&y=1&z=0")):
        assert (answer.status, answer.kind) == (409, "session-failed")
    state = held.state()
    assert (state["status"], state["memory"]["bytes"]) == ("failed", 0)
    HeldSession.broken = {}
    HeldSession.release()
    assert held.push(0, name="neighbour").status == 200
    assert held.call("DELETE", "/v1/sessions/room").status == 204
    assert held.open().status == 201


def test_a_frame_rejected_by_the_engine_frees_its_index(held):
    HeldSession.broken = {3: FrameError("frame 3: too close to be a room")}
    HeldSession.release(4)
    assert held.push(0).status == 200
    refused = held.push(3)
    assert (refused.status, refused.kind) == (422, "bad-frame")
    HeldSession.broken = {}
    counts = held.state()["frames"]
    assert (counts["last_index"], counts["gaps"], counts["refused"], counts["accepted"]) == (0, 0, 1, 1)
    assert held.push(0).json["replay"]
    assert held.push(3, frame(9)).json["status"] == "processed"


def test_deleting_a_session_answers_waiting_requests_and_logs_no_error(held, caplog):
    first = InThread(held.push, 0)
    HeldSession.wait_entered()
    second = InThread(held.push, 1, frame(1))
    held.wait_until_accepted(1)
    assert held.call("DELETE", "/v1/sessions/room").status == 204
    assert [(call.result().status, call.result().kind) for call in (first, second)] == [(410, "session-closed")] * 2
    HeldSession.release()
    held.open()
    HeldSession.release()
    assert held.push(0).status == 200
    gc.collect()  # errors that nobody has asked for
    assert [record for record in caplog.records if record.levelno >= logging.ERROR] == []


def multipart(parts):
    """Return the body that `curl -F header=... -F colour=@... -F depth=@...` sends."""
    body = b""
    for name, data in parts.items():
        file = "" if name == "header" else f'; filename="{name}"\r\nContent-Type: application/octet-stream'
        body += f'--edge\r\nContent-Disposition: form-data; name="{name}"{file}\r\n\r\n'.encode() + data + b"\r\n"
    return body + b"--edge--\r\n", {"Content-Type": "multipart/form-data; boundary=edge"}


def curl_parts(**changes):
    header = header_of(box_shot(0))
    for part in ("colour", "depth"):
        del header[part]["bytes"]
    colour, depth = parts_of(box_shot(0))
    return {"header": json.dumps(header).encode(), "colour": colour, "depth": depth} | changes


def test_a_multipart_frame_equals_a_binary_one(server):
    server.open("curl")
    body, headers = multipart(curl_parts())
    assert server.push(0, body, name="curl", headers=headers).json["status"] == "processed"
    assert server.push(0, frame(0), name="curl").json["replay"]


def test_a_multipart_frame_may_exceed_a_megabyte(server):
    server.open("big")
    shot = box_shot(0)
    noise = np.random.default_rng(1).integers(0, 255, (720, 960, 3), np.uint8)
    png = cv2.imencode(".png", noise)[1].tobytes()
    assert len(png) > 2**20
    header = header_of(shot, colour={"encoding": "png"})
    header["intrinsics"] = {"fx": 900.0, "fy": 900.0, "cx": 480.0, "cy": 360.0, "width": 960, "height": 720}
    body, headers = multipart(curl_parts(header=json.dumps(header).encode(), colour=png))
    assert server.push(0, body, name="big", headers=headers).json["status"] == "processed"


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"header": b"{"}, "header"),
        ({"header": b"[]"}, None),
        ({"header": b"[" * 9000}, "header"),
        ({"header": b'{"colour": 3}'}, "colour"),
        ({"depth": b""}, "depth.bytes"),
        ({"surprise": b"x"}, None),
        ({"confidence": b"xxxx"}, "confidence.bytes"),
    ],
)
def test_a_multipart_frame_is_validated(server, changes, field):
    server.open("curl-checked")
    body, headers = multipart(curl_parts(**changes))
    answer = server.push(0, body, name="curl-checked", headers=headers)
    assert (answer.status, answer.kind, answer.json.get("field")) == (422, "bad-frame", field)
    assert server.state("curl-checked")["frames"]["accepted"] == 0


def test_a_multipart_frame_needs_no_depth(server):
    server.open("curl-flat")
    parts = curl_parts()
    header = json.loads(parts["header"])
    body, headers = multipart({"header": parts["header"], "colour": parts["colour"]})
    answer = server.push(0, body, name="curl-flat", headers=headers)
    assert (answer.kind, answer.json["field"], answer.json["value"]) == ("bad-frame", "depth", "no such part")
    del header["depth"]
    body, headers = multipart({"header": json.dumps(header).encode(), "colour": parts["colour"]})
    answer = server.push(0, body, name="curl-flat", headers=headers)
    assert (answer.json["status"], answer.json["depth_estimated"]) == ("processed", True)


@pytest.mark.parametrize("size", [100, 30_000])
def test_images_sent_as_text_are_refused_with_what_to_do(server, size):
    """Python's requests sends `(None, data)` without a file name: as text, and its bytes are damaged."""
    server.open("curl-text")
    parts = curl_parts(colour=curl_parts()["colour"][:size])
    body, headers = multipart(parts)
    body = body.replace(b'name="colour"; filename="colour"', b'name="colour"', 1)
    body = body.replace(b"\r\nContent-Type: application/octet-stream", b"", 1)
    answer = server.push(0, body, name="curl-text", headers=headers)
    assert (answer.status, answer.kind) == (400, "bad-request")
    assert "must be sent as a file, with a file name" in answer.json["detail"]


def test_a_part_that_is_given_twice_is_refused(server):
    server.open("curl-twice")
    body, headers = multipart(curl_parts())
    second = multipart({"colour": b"junk"})[0]
    answer = server.push(0, body.removesuffix(b"--edge--\r\n") + second, name="curl-twice", headers=headers)
    assert (answer.status, answer.json["field"]) == (400, "colour")


@pytest.mark.parametrize(
    "charset", ["undefined", "utf-7", "unicode_escape", "raw_unicode_escape", "punycode", "utf-16"]
)
def test_a_multipart_charset_must_be_utf8(server, caplog, charset):
    """Starlette decodes with any codec of Python; `undefined` and others raised a UnicodeError and a 500."""
    server.open("curl")
    body, headers = multipart(curl_parts())
    headers["Content-Type"] += f"; charset={charset}"
    answer = server.push(0, body, name="curl", headers=headers)
    assert (answer.status, answer.kind, answer.json["field"]) == (400, "bad-request", "Content-Type")
    assert not [record for record in caplog.records if record.exc_info]


def test_malformed_multipart_is_rejected(server):
    server.open("curl-broken")
    for headers, body in (
        ({"Content-Type": "multipart/form-data"}, b"x"),
        ({"Content-Type": "multipart/form-data; boundary=edge"}, b"--other\r\n"),
        multipart({f"part{n}": b"" for n in range(20)})[::-1],
    ):
        answer = server.push(0, body, name="curl-broken", headers=headers)
        assert answer.status in (400, 422)
        assert answer.kind in ("bad-request", "bad-frame")


def test_light_of_a_named_probe_waits_for_no_other_session(held):
    """The session's next frame waits behind another session's: the light is that of the frame before."""
    held.call("PUT", "/v1/sessions/room/probes/table", {"position": [0.2, 1.2, -0.2]})
    HeldSession.release()
    assert held.push(0).status == 200
    HeldSession.wait_entered()
    held.open("other")
    other = InThread(held.push, 0, name="other")
    HeldSession.wait_entered()
    queued(held, 1, body=frame(1))
    light = held.call("GET", "/v1/sessions/room/probes/table?format=sh")
    assert (light.status, light.headers["roomlight-frame"]) == (200, "0")
    HeldSession.release(2)
    assert other.result().status == 200
    assert held.push(1, frame(1)).json["replay"]
    light = held.call("GET", "/v1/sessions/room/probes/table?format=sh")
    assert light.headers["roomlight-frame"] == "1"


def test_a_replacing_frame_is_decoded_when_it_is_taken(held, monkeypatch):
    decoded = []
    decode = live_session.decode_to_size
    monkeypatch.setattr(live_session, "decode_to_size", lambda *given: decoded.append(given[1]) or decode(*given))
    queued(held, 0)
    HeldSession.wait_entered()
    for index in (1, 2, 3):
        queued(held, index, body=frame(index))
    fourth = InThread(held.push, 4, frame(4))
    held.wait_until_accepted(4)
    assert decoded == [0, 1]
    HeldSession.release(2)
    assert fourth.result().json["status"] == "processed"
    assert decoded == [0, 1, 4]
    assert held.state()["frames"]["superseded"] == 3


def test_the_frame_of_the_next_session_is_decoded_while_the_engine_works(held, monkeypatch):
    decoded, done = [], threading.Semaphore(0)
    decode = live_session.decode_to_size

    def noted(message, index, *more):
        decoded.append((index, current_flow.get().session))
        done.release()
        return decode(message, index, *more)

    monkeypatch.setattr(live_session, "decode_to_size", noted)
    for name in ("second", "third"):
        held.open(name)
    queued(held, 0)
    HeldSession.wait_entered()
    for name in ("second", "third"):
        queued(held, 0, name=name)
    queued(held, 1, body=frame(1), name="third")
    for _ in range(3):
        done.acquire()
    newest = InThread(held.push, 2, frame(2), name="third")
    held.wait_until_accepted(2, "third")
    assert [index for index, _ in decoded] == [0, 0, 0]
    HeldSession.release()
    HeldSession.wait_entered()  # of the second session: the third is next
    done.acquire()
    assert decoded[-1] == (2, "third")
    HeldSession.release(2)
    assert newest.result().json["status"] == "processed"
    assert len(decoded) == 4


def test_a_frame_that_fails_to_decode_late_is_rejected(held):
    HeldSession.release()
    assert held.push(0).status == 200
    HeldSession.wait_entered()
    queued(held, 1, body=frame(1))
    HeldSession.wait_entered()
    queued(held, 2, body=frame(2))
    png = cv2.imencode(".png", np.random.default_rng(1).integers(0, 255, (36, 48, 3), np.uint8))[1].tobytes()
    torn = png[:60] + bytes(len(png) - 72) + png[-12:]  # complete by its header and end marker
    broken = InThread(held.push, 3, with_parts(({"encoding": "png"}, torn)))
    held.wait_until_accepted(3)
    HeldSession.release()
    refused = broken.result()
    assert (refused.status, refused.kind, refused.json["field"]) == (422, "bad-frame", "colour")
    counts = held.state()["frames"]
    assert (counts["last_index"], counts["superseded"], counts["refused"], counts["gaps"]) == (2, 1, 1, 0)
    HeldSession.release()
    assert held.push(3, frame(3)).json["status"] == "processed"
