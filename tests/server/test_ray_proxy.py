"""What is added to Ray Serve: its proxies' headers and errors, its settings; without Ray itself."""

import asyncio
import importlib
import json
import os
import signal
import stat
import sys
from pathlib import Path
from unittest.mock import AsyncMock, Mock

import pytest

from roomlight.errors import ServerError
from roomlight_server.base.settings import ServerSettings
from roomlight_server.replicas import replica
from roomlight_server.replicas import serving as ray_serving
from roomlight_server.replicas.proxy import SessionRouting, middlewares, routed_headers
from roomlight_server.work.workers import Workers


@pytest.mark.parametrize(
    ("path", "sent", "found"),
    [
        ("/v1/sessions/room/frames/1", [], b"room"),
        ("/v1/sessions/room", [(b"x-session-id", b"other"), (b"x_session_id", b"another")], b"room"),
        ("/v1/sessions/room/stream", [], b"room"),
        ("/v1/objects", [(b"x-session-id", b"chosen")], b"chosen"),
        ("/v1/pairing", [], b"none"),  # the next request belongs to its answer
        ("/healthz", [], None),
    ],
)
def test_the_session_of_the_path_chooses_the_replica(path, sent, found):
    headers = routed_headers(path, [(b"host", b"localhost"), *sent])
    assert (b"host", b"localhost") in headers
    assert [value for name, value in headers if b"session" in name] == ([] if found is None else [found])


def test_clients_cannot_set_the_options_of_ray():
    sent = [(b"x-request-timeout-seconds", b"0.001"), (b"x-request-disconnect-disabled", b"?1")]
    assert routed_headers("/v1/sessions/room", sent) == [(b"x-session-id", b"room")]


def answered(status, headers, body=b"body"):
    """Pass an answer through the middleware (status None: there is none); returns status, headers and body."""

    async def app(scope, receive, send):
        del scope, receive
        if status is None:
            return
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": body})

    scope, send = {"type": "http", "path": "/v1/sessions/room", "headers": []}, AsyncMock()
    asyncio.run(SessionRouting(app)(scope, AsyncMock(), send))
    sent = [call.args[0] for call in send.await_args_list]
    assert [message["type"] for message in sent] == ["http.response.start", "http.response.body"]
    return sent[0]["status"], sent[0]["headers"], sent[1]["body"]


@pytest.mark.parametrize("status", [404, 500, 502, 503])
def test_errors_of_ray_are_problems(status):
    headers = [(b"content-type", b"text/plain"), (b"x-request-id", b"r1")]
    found, headers, body = answered(status, headers, b"The actor died: Traceback of Ray")
    problem = json.loads(body)
    assert (found, problem["status"], problem["type"]) == (503, 503, "urn:roomlight:problem:session-moved")
    named = dict(headers)
    assert named[b"retry-after"] == b"1"
    assert named[b"x-request-id"] == b"r1"
    assert int(named[b"content-length"]) == len(body)
    assert b"Traceback" not in body


def test_a_request_that_ray_does_not_answer_is_a_problem():
    found, headers, body = answered(None, [])
    assert (found, json.loads(body)["status"], dict(headers)[b"retry-after"]) == (503, 503, b"1")


@pytest.mark.parametrize(
    ("status", "kind"), [(200, b"text/plain"), *((status, b"application/problem+json") for status in (404, 503))]
)
def test_answers_of_replicas_pass(status, kind):
    found = answered(status, [(b"content-type", kind), (b"X-Request-Id", b"r1"), (b"x-request-id", b"r1")])
    assert found == (status, [(b"content-type", kind), (b"X-Request-Id", b"r1")], b"body")


def test_the_proxies_import_the_middleware():
    module, _, name = ray_serving.VARIABLES["RAY_SERVE_HTTP_PROXY_CALLBACK_IMPORT_PATH"].rpartition(".")
    assert getattr(importlib.import_module(module), name) is middlewares
    assert middlewares()[0].cls is SessionRouting
    assert ray_serving.VARIABLES["RAY_USAGE_STATS_ENABLED"] == "0"


def test_replicas_share_an_absolute_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = ray_serving.shared_settings(ServerSettings(state_dir=Path("state")), 3)
    assert (settings.state_dir, settings.state_shared) == (tmp_path / "state", True)


@pytest.mark.parametrize(
    ("settings", "replicas", "message"),
    [
        ({}, 2, "--ray needs --state-dir"),
        ({"state_dir": "state"}, 0, "--replicas: 0: must be at least 1"),
        ({"state_dir": "state", "on_lan": True}, 2, "unset on_lan"),
    ],
)
def test_unusable_settings_of_replicas_are_errors(settings, replicas, message):
    with pytest.raises(ServerError, match=message):
        ray_serving.shared_settings(ServerSettings(**settings), replicas)


def test_a_missing_extra_is_an_error_with_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setattr(os, "environ", {})
    with pytest.raises(ServerError, match=r"pip install 'roomlight\[ray\]'"):
        ray_serving.load_ray()


def test_the_token_of_ray_is_private(tmp_path, monkeypatch):
    variables = {}
    monkeypatch.setattr(os, "environ", variables)
    ray_serving._set_token(tmp_path / "state")
    path = tmp_path / "state" / "ray-token"
    assert variables == {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(path)}
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    token = path.read_text()
    assert len(token) == 64
    variables.clear()
    ray_serving._set_token(tmp_path / "state")
    assert path.read_text() == token  # the number of replicas is changed with it
    variables |= {"RAY_AUTH_TOKEN_PATH": "/own"}
    ray_serving._set_token(tmp_path / "other")
    assert variables["RAY_AUTH_TOKEN_PATH"] == "/own"
    assert not (tmp_path / "other").exists()


@pytest.fixture
def serve_without_ray(tmp_path, monkeypatch):
    """Return a function that serves with stand-ins for Ray, and returns the signals that stop it and the addresses."""
    serve, stopping, addresses = Mock(), set(), []
    fakes = {"load_ray": lambda: (Mock(), serve), "configure_logging": Mock(), "_deploy": Mock(), "threading": Mock()}
    for name, fake in fakes.items():
        monkeypatch.setattr(ray_serving, name, fake)
    monkeypatch.setattr(os, "environ", {})
    monkeypatch.setattr(signal, "signal", lambda number, _: stopping.add(number))

    def run(*applications):
        serve.status.return_value.applications = applications
        settings = ServerSettings(state_dir=tmp_path, port=0)
        ray_serving.serve_on_ray(settings, replicas=2, listening=addresses.append)
        return stopping, addresses

    return run


@pytest.mark.parametrize("before", [signal.SIG_DFL, signal.SIG_IGN])
def test_a_hangup_stops_the_replicas_unless_it_is_ignored(serve_without_ray, monkeypatch, before):
    monkeypatch.setattr(signal, "getsignal", lambda _: before)
    stopping, _ = serve_without_ray()
    assert stopping == {signal.SIGINT, signal.SIGTERM} | ({signal.SIGHUP} if before == signal.SIG_DFL else set())


def test_a_command_that_changes_the_number_of_replicas_names_no_address(serve_without_ray):
    assert len(serve_without_ray()[1]) == 1
    assert len(serve_without_ray(ray_serving.APPLICATION)[1]) == 1


@pytest.mark.parametrize(
    ("variables", "says"),
    [({}, "^Ray cannot be started"), ({"RAY_ADDRESS": "10.0.0.1:6379"}, r"^RAY_ADDRESS: 10\.0\.0\.1:6379: .* reached")],
)
def test_a_cluster_that_fails_is_an_error(monkeypatch, variables, says):
    monkeypatch.setattr(os, "environ", variables)
    ray = Mock(**{"init.side_effect": ConnectionError("no answer")})
    with pytest.raises(ServerError, match=f"{says}.*no answer"), ray_serving._cluster(ray, 2):
        pass


def test_a_replica_that_cannot_load_ends_at_once(monkeypatch):
    monkeypatch.setattr(replica, "configure_logging", Mock())
    monkeypatch.setattr(sys, "setswitchinterval", Mock())
    monkeypatch.setattr(Workers, "load", Mock())
    monkeypatch.setattr(Workers, "start", AsyncMock(side_effect=MemoryError("no room for the weights")))
    app = replica.replica_app(ServerSettings(), local=False)

    async def start():
        async with asyncio.timeout(30), app.router.lifespan_context(app):
            pass

    with pytest.raises(ServerError, match="no room for the weights"):
        asyncio.run(start())
