"""Limits below HTTP, over a real socket: connections, bytes of headers, slow requests, clients that do not read."""

import http.client
import json

import pytest

from http_servers import TOKEN, RunningServer, answer_of, flood, is_closed, with_small_buffer

GET = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"


def refusals(caplog, kind):
    return [r for r in caplog.records if r.getMessage() == "connection refused" and vars(r)["kind"] == kind]


@pytest.mark.parametrize("part", [b"X-Long: " + b"x" * 65_536, b"X-%d: x\r\n" * 10_000, b"X: " + b"x" * 2**20])
def test_headers_beyond_the_limit_are_refused(part, caplog):
    """Headers were unlimited: 300 MB were taken, and one header of 100 MB stalled the event loop for 12 s."""
    with RunningServer(max_header_bytes=16_384) as server, server.dial() as connection:
        connection.sendall(GET)
        flood(connection, part, len(part))
        answer = answer_of(connection)
        assert (answer.status, answer.kind) == (431, "headers-too-large")
        assert is_closed(connection)
        assert len(refusals(caplog, "headers-too-large")) == 1
        assert server.call("GET", "/healthz").status == 200


def test_a_long_url_is_refused():
    with RunningServer(max_header_bytes=4096) as server, server.dial() as connection:
        connection.sendall(b"GET /healthz?" + b"x" * 5000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert answer_of(connection).status == 431


@pytest.mark.parametrize(
    "start",
    [GET, b"PUT /v1/sessions/a HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n"],
    ids=["headers", "trailers"],
)
def test_endless_headers_and_trailers_close_the_connection(start):
    with RunningServer(max_header_bytes=4096) as server, server.dial() as connection:
        connection.sendall(start)
        assert flood(connection, b"X: " + b"x" * 2**16 + b"\r\n", 2**26)


def test_connections_of_one_address_are_limited(caplog):
    """1,100 idle connections of one client refused all others."""
    with RunningServer(max_connections_per_address=3) as server:
        held = [server.dial() for _ in range(3)]
        assert server.call("GET", "/healthz").status == 503
        with server.dial() as fourth:
            answer = answer_of(fourth)
            assert (answer.status, answer.json["rule"]) == (503, "at most 3 connections per address")
        assert len(refusals(caplog, "too-many-connections")) == 2
        for connection in held:
            connection.close()
        while server.call("GET", "/healthz").status != 200:  # until the server has seen the closed connections
            pass


BUSY = b"PUT /v1/sessions/room HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n"
"""A request whose body does not arrive."""


def wait_until_busy(server, count):
    guard = server.app.state.context.guard
    while guard.connections - len(guard._idle) < count:
        pass


def test_connections_are_limited_in_all():
    with RunningServer(max_connections=2) as server, server.dial() as first, server.dial() as second:
        for each in (first, second):
            each.sendall(BUSY)
        wait_until_busy(server, 2)
        with server.dial() as third:
            assert answer_of(third).json["rule"] == "at most 2 connections"


@pytest.mark.parametrize("before", [b"", GET + b"\r\n", GET], ids=["nothing", "answered", "headers"])
def test_an_idle_connection_makes_room(before, caplog):
    """Idle connections of several addresses refused all others for as long as they were kept."""
    with RunningServer(max_connections=2) as server, server.dial() as idle, server.dial() as busy:
        idle.sendall(before)
        if before.endswith(b"\r\n\r\n"):
            assert answer_of(idle).status == 200
        busy.sendall(BUSY)
        wait_until_busy(server, 1)
        assert server.call("GET", "/healthz").status == 200
        assert is_closed(idle)
        assert len(refusals(caplog, "idle")) == 1
        busy.sendall(b"x" * 100)
        assert answer_of(busy).status == 415


def test_the_address_with_most_connections_makes_room(caplog):
    with RunningServer(max_connections=3) as server, server.dial() as first:
        many = [server.dial("127.0.0.2") for _ in range(2)]
        wait_until_admitted(server, 3)
        assert server.call("GET", "/healthz").status == 200
        assert is_closed(many[0])
        assert [vars(r)["address"] for r in refusals(caplog, "idle")] == ["127.0.0.2"]
        first.sendall(GET + b"\r\n")
        assert answer_of(first).status == 200
        for each in many:
            each.close()


def wait_until_admitted(server, count):
    while server.app.state.context.guard.connections < count:
        pass


def test_a_websocket_is_counted_until_it_closes():
    with RunningServer(max_connections=2) as server:
        server.open()
        with server.stream(), server.stream(), server.dial() as third:
            assert answer_of(third).status == 503
        while server.call("GET", "/healthz").status != 200:
            pass


def test_a_connection_without_a_request_is_closed(caplog):
    """Connections without a request never closed."""
    with RunningServer(header_timeout_s=0.3) as server, server.dial() as connection:
        assert is_closed(connection)
        assert len(refusals(caplog, "no-request")) == 1


@pytest.mark.parametrize("before", [b"", GET + b"\r\n"])
def test_headers_that_stop_arriving_are_answered(before, caplog):
    """A first byte of the next request ended the limit of an idle connection."""
    with RunningServer(header_timeout_s=1.0) as server, server.dial() as connection:
        connection.sendall(before + GET)
        with connection.makefile("rb") as answers:  # both answers may arrive together
            text = answers.read().decode()
        assert text.count("HTTP/1.1 200 OK") == bool(before)
        assert "HTTP/1.1 408" in text
        assert "urn:roomlight:problem:header-timeout" in text
        assert len(refusals(caplog, "header-timeout")) == 1


def test_a_websocket_stays_open_beyond_the_limit_of_headers():
    with RunningServer(header_timeout_s=2.0) as server:
        server.open()
        with server.stream() as stream:
            with pytest.raises(TimeoutError):
                stream.recv(timeout=2.5)
            stream.send('{"type": "track", "name": "table", "position": [0, 0, -1]}')
            assert json.loads(stream.recv())["type"] == "probes"


def test_blank_lines_do_not_keep_a_connection():
    with RunningServer(header_timeout_s=1.0) as server, server.dial() as connection:
        connection.sendall(GET + b"\r\n")
        assert answer_of(connection).status == 200
        connection.sendall(b"\r\n")
        assert is_closed(connection)


def test_the_body_of_a_refused_request_is_not_read_on(caplog):
    """After a 401 the server read 8.8 GB of body."""
    with RunningServer(tokens=(TOKEN,)) as server, server.dial() as connection:
        connection.sendall(
            b"PUT /v1/sessions/room/frames/0 HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999999\r\n\r\n"
        )
        assert answer_of(connection).status == 401
        assert flood(connection, bytes(2**16), 2**27)
        assert len(refusals(caplog, "too-large")) == 1


def test_the_rest_of_a_small_refused_body_is_discarded():
    """A client with a wrong token sends the whole frame before it reads its 401, and the connection goes on."""
    with RunningServer(tokens=(TOKEN,)) as server:
        connection = http.client.HTTPConnection("127.0.0.1", server.port)
        for _ in range(3):
            connection.request("PUT", "/v1/sessions/room/frames/0", bytes(2**20))
            answer = connection.getresponse()
            assert answer.status == 401
            answer.read()
        connection.close()


def test_a_client_that_does_not_read_is_closed(caplog):
    """An unread answer was held in memory for as long as its client liked."""
    with RunningServer(send_timeout_s=0.1) as server:
        server.open(options={"model": "classical", "height": 512})
        with with_small_buffer() as connection:
            connection.connect(("127.0.0.1", server.port))
            connection.sendall(
                b"GET /v1/sessions/room/probe?x=0&y=0&z=0&format=npy HTTP/1.1\r\nHost: localhost\r\n\r\n" * 4
            )
            while not refusals(caplog, "slow-reader"):
                assert server.call("GET", "/healthz").status == 200


CHUNKED = b"PUT /v1/sessions/a HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"


@pytest.mark.parametrize(
    "request_bytes",
    [
        CHUNKED + b"Content-Length: 4\r\n\r\n",
        CHUNKED + b"\r\nZZ\r\n",
        GET + b"Content-Length: -1\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"GET http://[ HTTP/1.1\r\nHost: localhost\r\n\r\n",
    ],
    ids=["two lengths", "chunk size", "negative length", "HTTP/2", "target"],
)
def test_what_is_not_http_is_a_problem(server, request_bytes, caplog):
    """It was plain text without an id, and neither logged with its address nor counted."""
    caplog.clear()
    with server.dial() as connection:
        connection.sendall(request_bytes)
        answer = answer_of(connection)
        assert is_closed(connection)
    assert (answer.status, answer.kind) == (400, "bad-request"), answer
    assert len(answer.headers["x-request-id"]) == 32
    assert answer.headers["x-content-type-options"] == "nosniff"
    (line,) = refusals(caplog, "bad-request")
    assert vars(line)["address"] == "127.0.0.1"
    assert 'problems_total{kind="bad-request"}' in server.call("GET", "/metrics").body.decode()


@pytest.mark.parametrize(
    ("target", "host", "status"),
    [
        (b"http://evil.example/v1/sessions/none", b"localhost", 403),
        (b"http://localhost:1/v1/sessions/none", b"localhost", 404),
        (b"//localhost/v1/sessions/none", b"evil.example", 403),  # a path, whatever it looks like
    ],
)
def test_the_host_of_an_absolute_target_is_checked(server, target, host, status):
    """It was answered as its allowed header Host (RFC 9112, section 3.2.2)."""
    with server.dial() as connection:
        connection.sendall(b"GET " + target + b" HTTP/1.1\r\nHost: " + host + b"\r\n\r\n")
        assert answer_of(connection).status == status
