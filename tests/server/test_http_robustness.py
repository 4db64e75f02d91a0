"""Requests that once were answered with 500, or filled the log: over a real socket."""

import json
import logging

import cv2
import numpy as np
import pytest
from websockets import Subprotocol
from websockets.exceptions import InvalidMessage, InvalidStatus
from websockets.sync.client import connect

from http_servers import SMALL, TOKEN, RunningServer, answer_of, frame, with_parts
from server_processes import Process

pytestmark = pytest.mark.usefixtures("room")


@pytest.fixture
def errors(caplog):
    """Log records at ERROR, or with a traceback, of the test so far."""
    caplog.set_level(logging.INFO)
    return lambda: [r for r in caplog.records if r.levelno >= logging.ERROR or r.exc_info]


def raw(server, request):
    """Send bytes and return the answer."""
    with server.dial() as connection:
        connection.sendall(request)
        return answer_of(connection)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://["}, 403),
        ({"Origin": "http://[::1"}, 403),
        ({"Host": "["}, 403),
        ({"Host": "[::1"}, 403),
        ({"Host": "[::1]:8090"}, 200),
    ],
)
def test_a_malformed_host_or_origin_is_refused(server, errors, headers, status):
    """`Origin: http://[` and `Host: [` were a ValueError of urlsplit and a 500."""
    lines = "".join(f"{name}: {value}\r\n" for name, value in ({"Host": "localhost"} | headers).items())
    answer = raw(server, f"GET /v1/sessions/room HTTP/1.1\r\n{lines}Connection: close\r\n\r\n".encode())
    assert answer.status == status, answer
    assert errors() == []


@pytest.mark.parametrize("digits", [16, 19, 5001])
def test_a_content_length_of_any_digits_is_refused(server, errors, digits):
    """5,001 digits were a ValueError, because Python converts at most 4,300, and a 500."""
    answer = raw(
        server, f"PUT /v1/sessions/room HTTP/1.1\r\nHost: localhost\r\nContent-Length: {'1' * digits}\r\n\r\n".encode()
    )
    assert answer.status in (400, 413), answer
    assert errors() == []


def heic(tmp_path, *, primary):
    """Return a HEIC file, or one whose primary image does not exist."""
    heif = pytest.importorskip("pillow_heif")
    file = heif.from_bytes(mode="RGB", size=(48, 36), data=b"\x80" * (48 * 36 * 3))
    path = tmp_path / "image.heic"
    file.save(path, quality=50)
    data = bytearray(path.read_bytes())
    if not primary:
        at = data.index(b"pitm")
        data[at + 8 : at + 10] = b"\x00\x63"
    return bytes(data)


@pytest.mark.parametrize("content_type", [None, "application/x-www-form-urlencoded", "text/plain"])
def test_json_of_another_content_type_is_refused_with_the_right_one(server, content_type):
    headers = {} if content_type is None else {"Content-Type": content_type}
    answer = server.call("PUT", "/v1/sessions/room/probes/table", b'{"position": [0, 1, 0]}', headers=headers)
    assert (answer.status, answer.kind) == (415, "unsupported-media-type")
    assert (answer.json["field"], answer.json.get("value")) == ("Content-Type", content_type)
    assert "application/json" in answer.json["detail"]


@pytest.mark.parametrize("path", ["/v1/sessions/room/frames/9", "/v1/sessions/room/probes/table", "/v1/objects"])
def test_a_compressed_body_is_refused_by_its_encoding(server, path):
    method = "POST" if path == "/v1/objects" else "PUT"
    headers = {"Content-Encoding": "gzip", "Content-Type": "application/json"}
    answer = server.call(method, path, b"\x1f\x8b\x08\x00", headers=headers)
    assert (answer.status, answer.kind) == (415, "unsupported-media-type")
    assert "Content-Encoding 'gzip'" in answer.json["detail"]


def test_a_form_is_no_object(server):
    body = b'--edge\r\nContent-Disposition: form-data; name="file"; filename="a.obj"\r\n\r\nv 0 0 0\r\n--edge--\r\n'
    answer = server.call(
        "POST", "/v1/objects?kind=obj", body, headers={"Content-Type": "multipart/form-data; boundary=edge"}
    )
    assert (answer.status, answer.kind, answer.json["field"]) == (415, "unsupported-media-type", "Content-Type")
    assert "--data-binary" in answer.json["detail"]


@pytest.mark.parametrize(
    ("method", "path", "name", "rule"),
    [
        ("GET", "/v1/sessions/room/probe?x=0&y=1&z=0&format=sh&height=64", "height", "must be one of x, y, z"),
        ("PUT", "/v1/sessions/other?model=classical", "model", "takes no query parameters"),
    ],
)
def test_an_unknown_query_parameter_is_refused(server, method, path, name, rule):
    answer = server.call(method, path, {} if method == "PUT" else None)
    assert (answer.status, answer.kind, answer.json["field"]) == (422, "invalid", name)
    assert rule in answer.json["rule"]
    assert server.call("GET", "/v1/sessions/other").status == 404


@pytest.mark.parametrize("path", ["/healthz", "/", "/docs", "/metrics", "/v1/sessions/room", "/v1/sessions/nobody"])
def test_head_is_answered_as_get_without_a_body(server, path):
    got, head = server.call("GET", path), server.call("HEAD", path)
    assert (head.status, head.headers["content-type"], head.body) == (got.status, got.headers["content-type"], b"")


def test_a_heic_without_a_primary_image_is_invalid(server, errors, tmp_path):
    """pillow_heif raised an IndexError, which was a 500."""
    server.open("heic")
    assert server.push(0, with_parts(({"encoding": "heic"}, heic(tmp_path, primary=True))), name="heic").status == 200
    answer = server.push(1, with_parts(({"encoding": "heic"}, heic(tmp_path, primary=False))), name="heic")
    assert (answer.status, answer.json.get("field")) == (422, "colour"), answer.json
    assert errors() == []


def test_a_client_that_hangs_up_is_no_error(server, errors, caplog):
    """Broken uploads were logged as ERROR with a traceback, 517 in one run."""
    for _ in range(3):
        with server.dial() as connection:
            connection.sendall(
                b"PUT /v1/sessions/room/frames/8 HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9999\r\n\r\n"
                + bytes(99)
            )
    server.wait_until(lambda: sum("disconnected" in record.getMessage() for record in caplog.records) == 3)
    assert errors() == []


def test_websocket_messages_are_not_compressed(server):
    """permessage-deflate was on: 6.9 MB on the wire became 3.8 GB of memory."""
    with server.stream(compression="deflate") as websocket:
        assert websocket.protocol.extensions == []


@pytest.mark.parametrize("length", [9_000, 20_000])
def test_a_websocket_with_a_long_header_is_refused(server, errors, length):
    with pytest.raises((InvalidStatus, InvalidMessage, ConnectionError)):
        server.stream(headers={"X-Long": "x" * length})
    assert errors() == []


def test_text_that_is_not_utf8_closes_without_traceback(server, errors):
    with server.stream() as websocket:
        websocket.send(b"\xff\xfe", text=True)
        with pytest.raises(Exception, match="1007"):
            websocket.recv()
    assert errors() == []


@pytest.mark.slow
def test_every_line_of_the_log_is_json_without_tokens():
    """libjpeg wrote plain lines between those of the log; websockets logged the token of a connection at debug."""
    damaged = bytearray(cv2.imencode(".jpg", np.random.default_rng(1).integers(0, 255, (36, 48, 3), np.uint8))[1])
    damaged[len(damaged) // 2 : len(damaged) // 2 + 40] = bytes(40)
    token, path = {"Authorization": f"Bearer {TOKEN}"}, "/v1/sessions/room"
    with Process("--log-level", "debug", "--access-log", ROOMLIGHT_TOKENS=TOKEN) as server:
        assert server.call("PUT", path, SMALL, token)[0] == 201
        server.call("PUT", f"{path}/frames/0", with_parts(({"encoding": "jpeg"}, bytes(damaged))), token)
        server.call("PUT", f"{path}/frames/1", frame(1), token)
        address = f"ws://127.0.0.1:{server.port}{path}/stream"
        offered = [Subprotocol("roomlight.v1"), Subprotocol(f"bearer.{TOKEN}")]
        for websocket in (connect(address, additional_headers=token), connect(address, subprotocols=offered)):
            with websocket:
                websocket.send(frame(2, index=2))
                websocket.recv()
        server.stop()
        lines = server.lines
    assert json.loads(lines[0])["event"] == "starting"
    assert any("Corrupt JPEG" in json.loads(line)["event"] for line in lines)
    assert not any(TOKEN in line for line in lines)


def test_json_of_many_unknown_names_is_refused_before_it_is_checked():
    """Each unknown name became an error with a text: eight connections held the event loop for 1.4 s."""
    with RunningServer() as server:
        many = {f"k{number}": 1 for number in range(5000)}
        answer = server.call("PUT", "/v1/sessions/room", many)
        assert (answer.status, answer.kind) == (413, "too-large")
        assert "more than 2048 names" in answer.json["detail"]
        server.open()
        with server.stream() as stream:
            stream.send(json.dumps({"type": "track"} | many))
            assert json.loads(stream.recv())["problem"]["detail"] == answer.json["detail"]
        few = server.call("PUT", "/v1/sessions/room", {f"k{number}": 1 for number in range(2000)})
        assert (few.status, few.kind) == (422, "invalid")
