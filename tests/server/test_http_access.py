"""Who is answered: the `Host` of all paths, wrong tokens, and the warning of a server that is open to all pages."""

from types import SimpleNamespace
from unittest.mock import AsyncMock

import pytest

from http_servers import TOKEN, RunningServer, answer_of
from roomlight_server import serving
from roomlight_server.base.settings import ServerSettings
from roomlight_server.transport import auth


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/phone",
        "/assets/icon.png",
        "/metrics",
        "/docs",
        "/openapi.json",
        "/docs-assets/swagger-ui.css",
        "/v1/sessions/a",
    ],
)
def test_a_server_without_token_checks_the_host_of_every_path(server, path):
    """/metrics and /docs were answered for any `Host`, so that a page of another site could read them."""
    answer = server.call("GET", path, headers={"Host": "evil.example"})
    assert (answer.status, answer.kind, answer.json["field"]) == (403, "forbidden-origin", "Host")
    assert server.call("GET", path).status in (200, 404)


@pytest.mark.parametrize("path", ["/healthz", "/readyz"])
def test_probes_are_answered_for_every_host(server, path):
    assert server.call("GET", path, headers={"Host": "10.0.0.7:8090"}).status in (200, 503)


def test_a_server_with_tokens_answers_metrics_for_every_host():
    with RunningServer(tokens=(TOKEN,)) as server:
        assert server.call("GET", "/metrics", headers={"Host": "lights.example"}).status == 200


def test_wrong_tokens_are_counted_logged_and_slowed(monkeypatch, caplog):
    """A wrong token left no trace and could be guessed at the speed of the server."""
    sleep = AsyncMock()
    monkeypatch.setattr(auth, "asyncio", SimpleNamespace(sleep=sleep))
    with RunningServer(tokens=(TOKEN,), wrong_token_delay_s=1.5) as server:
        assert server.call("GET", "/v1/sessions/a").status == 401
        assert not sleep.called
        wrong = server.call("GET", "/v1/sessions/a", token="guess")
        assert (wrong.status, wrong.json["detail"]) == (401, "this server does not know the token")
        sleep.assert_awaited_once_with(1.5)
        assert server.call("GET", "/v1/sessions/a", token=TOKEN).status == 404
        text = server.call("GET", "/metrics").body.decode()
    assert 'roomlight_unauthorized_total{reason="wrong"} 1.0' in text
    assert 'roomlight_unauthorized_total{reason="missing"} 1.0' in text
    logged = [record for record in caplog.records if record.getMessage() == "wrong token"]
    assert [vars(record)["address"] for record in logged] == ["127.0.0.1"]
    assert "guess" not in caplog.text


@pytest.mark.parametrize(("tokens", "warns"), [((), True), ((TOKEN,), False)])
def test_all_origins_without_a_token_is_warned_about(monkeypatch, capfd, tokens, warns):
    class Stopped(serving.GracefulServer):
        def run(self, sockets=None):
            del sockets

    monkeypatch.setattr(serving, "GracefulServer", Stopped)
    serving.serve(ServerSettings(port=0, allow_origins=("*",), tokens=tokens), listening=lambda *_: None)
    assert ("any web page" in capfd.readouterr().err) is warns


@pytest.mark.parametrize("hosts", [b"", b"Host: localhost\r\nHost: localhost\r\n"], ids=["none", "two"])
@pytest.mark.parametrize("path", [b"/healthz", b"/v1/sessions"])
def test_a_request_has_exactly_one_host(server, path, hosts):
    """Both were answered with 200; caches and proxies in front do not agree on the host then (RFC 9112)."""
    with server.dial() as connection:
        connection.sendall(b"GET " + path + b" HTTP/1.1\r\n" + hosts + b"Connection: close\r\n\r\n")
        answer = answer_of(connection)
    assert answer.status == 400
    assert "exactly one header Host" in answer.json["detail"]


def test_answers_cannot_be_framed_and_pages_have_a_policy(server):
    docs, missing = server.call("GET", "/docs").headers, server.call("GET", "/v1/sessions/none").headers
    assert "script-src 'self'" in docs["content-security-policy"]
    assert missing["content-security-policy"] == "default-src 'none'; frame-ancestors 'none'"
    for headers in (docs, missing):
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["x-frame-options"] == "DENY"
        assert headers["x-content-type-options"] == "nosniff"


def test_the_metrics_need_a_token_on_the_local_network():
    with RunningServer(tokens=(TOKEN,), on_lan=True) as server:
        assert server.call("GET", "/metrics").status == 401
        assert server.call("GET", "/metrics", token=TOKEN).status == 200
