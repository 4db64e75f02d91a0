"""Work that one connection makes before there is a request, over real sockets: it is bounded, and the rest go on."""

import json
import logging
import ssl
import time

import pytest

from http_servers import RunningServer, flood, is_closed, metric
from roomlight_server.base import tls
from roomlight_server.serving import allow_files
from roomlight_server.transport import tls_listener
from roomlight_server.transport.guard import Allowance
from roomlight_server.transport.stream_protocol import StreamProtocol

GET = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
CHUNKED = b"PUT /v1/sessions/a HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
UPGRADE = (
    b"GET /v1/sessions/room/stream HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


pytestmark = pytest.mark.usefixtures("room")


@pytest.fixture
def connection(server):
    with server.dial() as made:
        yield made


def ws_frame(opcode, data=b""):
    return bytes([opcode, 0x80 | len(data)]) + bytes(4) + data


def upgraded(connection):
    """Open a WebSocket by hand: a client library would not send what follows."""
    connection.sendall(UPGRADE)
    head = b""
    while not head.endswith(b"\r\n\r\n"):
        head += connection.recv(1)
    assert head.startswith(b"HTTP/1.1 101")


def refused(server, kind):
    """Return how many connections were closed for this reason."""
    return metric(server, f'roomlight_connections_refused_total{{kind="{kind}"}}')


@pytest.mark.parametrize(
    ("kind", "head", "data"),
    [
        ("pipelining", b"", (GET + b"\r\n") * 2000),
        ("tiny-pieces", CHUNKED, b"1\r\n \r\n" * 9000),
        ("headers-too-large", b"", (GET + b"a:\r\n" * 4000 + b"\r\n") * 9),
    ],
)  # fmt: skip
def test_a_flood_of_http_is_closed_counted_and_logged(server, connection, caplog, kind, head, data):
    """25 MB of pipelined requests took 1.2 GB and 6.5 s of a neighbour's frame, and nothing was logged."""
    before = refused(server, kind)
    connection.sendall(head)
    assert flood(connection, data)
    assert refused(server, kind) == before + 1
    assert [vars(each)["address"] for each in caplog.records if vars(each).get("kind") == kind] == ["127.0.0.1"]


def test_requests_that_wait_are_all_answered_in_order(connection):
    """A client may pipeline up to 17 requests; reading stays paused until they are answered."""
    names = [f"missing-{number}" for number in range(16)]
    connection.sendall(b"".join(b"GET /v1/sessions/%s HTTP/1.1\r\nHost: localhost\r\n\r\n" % n.encode() for n in names))
    connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    with connection.makefile("rb") as answers:
        text = answers.read().decode()
    assert text.count("HTTP/1.1 404") == 16
    assert [text.index(f'"{name}"') for name in names] == sorted(text.index(f'"{name}"') for name in names)
    assert text.count("HTTP/1.1 200") == 1


def test_a_body_of_small_chunks_is_read(connection):
    """100 bytes a chunk is small, and still a client that streams."""
    body = json.dumps({"model": "classical"}).encode() + b" " * 60_000
    pieces = [body[at : at + 100] for at in range(0, len(body), 100)]
    head = b"PUT /v1/sessions/room HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    chunks = b"".join(b"%x\r\n%s\r\n" % (len(piece), piece) for piece in pieces)
    connection.sendall(head + b"Transfer-Encoding: chunked\r\n\r\n" + chunks + b"0\r\n\r\n")
    assert connection.recv(12) in (b"HTTP/1.1 200", b"HTTP/1.1 409")


@pytest.mark.parametrize(
    ("kind", "first", "data"),
    [
        ("fragments", ws_frame(0x02), ws_frame(0x00) * 10_000),
        ("fragments", ws_frame(0x02), ws_frame(0x00, b"x") * 10_000),
        ("control-frames", b"", ws_frame(0x89) * 10_000),
        ("control-frames", b"", ws_frame(0x89, bytes(125)) * 500),
        ("control-frames", b"", ws_frame(0x8A) * 10_000),
    ],
    ids=["empty fragments", "fragments of a byte", "pings", "large pings", "pongs"],
)
def test_a_flood_of_websocket_frames_is_closed_counted_and_logged(server, connection, kind, first, data):
    """Empty fragments and pings took 7 to 14 s of a neighbour's frame, for as long as they came."""
    before = refused(server, kind)
    upgraded(connection)
    connection.sendall(first)
    assert flood(connection, data)
    assert refused(server, kind) == before + 1


def test_the_answer_to_a_close_is_read_at_once(connection, monkeypatch):
    """uvicorn waits for it for 10 s; here the test would wait for ever."""
    monkeypatch.setattr(StreamProtocol, "close_timeout", property(lambda _: 1e6, lambda *_: None), raising=False)
    connection.sendall(UPGRADE.replace(b"/room/", b"/nobody/"))
    data = b""
    while b"session-not-found" not in data or b"\x11\x34" not in data:  # 4404, in the frame that closes
        data += connection.recv(4096)
    connection.sendall(ws_frame(0x88, b"\x11\x34"))
    while connection.recv(4096):
        pass


def test_a_fragmented_message_of_usual_pieces_is_read(server):
    with server.stream() as stream:
        text = '{"type": "track", "name": "table", "position": [0, 0, -1]}'
        stream.send([text, *([" " * 2048] * 20)])
        assert json.loads(stream.recv())["type"] == "probes"
        for _ in range(3):
            stream.ping().wait()


def test_messages_that_arrive_together_are_answered_one_after_the_other(server):
    with server.stream(max_queue=1000) as stream:
        names = [f"p{number}" for number in range(300)]
        for name in names:
            stream.send(json.dumps({"type": "untrack", "name": name}))
        problems = [json.loads(stream.recv())["problem"] for _ in names]
        assert [problem["value"] for problem in problems] == names


def test_an_allowance_grows_with_time_up_to_its_maximum():
    now_s = 0.0
    allowance = Allowance(10.0, 3, lambda: now_s)
    assert [allowance.try_take() for _ in range(5)] == [True, True, True, False, False]
    now_s = 0.2
    assert [allowance.try_take() for _ in range(3)] == [True, True, False]
    now_s = 100.0
    assert [allowance.take() for _ in range(5)] == pytest.approx([0.0, 0.0, 0.0, 0.1, 0.2])


@pytest.fixture(scope="module")
def secure_server(tmp_path_factory):
    certificate, key = tls.ensure_certificate(tmp_path_factory.mktemp("state"), ("127.0.0.1",))
    with RunningServer(tls_cert=certificate, tls_key=key, max_connections_per_address=4) as running:
        yield running


def secure_status(server):
    context = ssl.create_default_context(cafile=server.settings.tls_cert)
    with server.dial("127.0.0.9") as plain, context.wrap_socket(plain, server_hostname="127.0.0.1") as secure:
        secure.sendall(GET + b"\r\n")
        return secure.recv(12)


def test_unfinished_handshakes_count_as_connections(secure_server, caplog):
    """1,400 silent connections took all descriptors for 58 s: limits began after the handshake."""
    silent = [secure_server.dial() for _ in range(12)]
    assert all(is_closed(connection) for connection in silent[4:])
    assert secure_server.app.state.context.guard.connections == 4
    assert secure_status(secure_server) == b"HTTP/1.1 200"
    assert any(vars(each).get("kind") == "too-many-connections" for each in caplog.records)
    for connection in silent:
        connection.close()


def test_a_handshake_has_a_deadline(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(tls_listener, "HANDSHAKE_S", 0.2)
    certificate, key = tls.ensure_certificate(tmp_path, ("127.0.0.1",))
    with RunningServer(tls_cert=certificate, tls_key=key) as server, server.dial("127.0.0.7") as silent:
        assert is_closed(silent)
    # after the end of the server, which has then written its lines
    lines = [vars(record) for record in caplog.records if vars(record).get("address") == "127.0.0.7"]
    assert [line["kind"] for line in lines] == ["tls-handshake"]
    assert server.app.state.context.guard.connections == 0


def test_a_server_raises_its_limit_of_open_files(monkeypatch, caplog):
    limits = []
    monkeypatch.setattr("resource.getrlimit", lambda _: (256, 700))
    monkeypatch.setattr("resource.setrlimit", lambda _, values: limits.append(values))
    allow_files(100)
    allow_files(512)
    assert limits == [(484, 700), (700, 700)]
    assert [vars(each)["rule"] for each in caplog.records] == ["max_connections should be at most 316"]


def test_a_late_event_loop_is_measured_and_named(server, caplog):
    caplog.set_level(logging.WARNING)
    loop = server.loop
    loop.call_soon_threadsafe(time.sleep, 1.0)

    def lines():
        return [vars(each) for each in caplog.records if each.getMessage() == "the event loop is late"]

    while not lines():
        server.call("GET", "/healthz")
    assert lines()[0]["late_s"] >= 0.5
    assert metric(server, "roomlight_event_loop_lag_seconds") > 0.5
