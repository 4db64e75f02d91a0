"""What is added to Ray Serve: its proxies' headers and errors, its settings; without Ray itself."""

import asyncio
import importlib
import json
import os
import stat
import sys
from pathlib import Path

import pytest

from roomlight.errors import ServerError
from roomlight_server.base.settings import ServerSettings
from roomlight_server.replicas import serving as ray_serving
from roomlight_server.replicas.proxy import SessionRouting, middlewares, routed_headers


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
    sent = []

    async def app(scope, receive, send):
        del scope, receive
        if status is None:
            return
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": body})

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.request"}

    scope = {"type": "http", "path": "/v1/sessions/room", "headers": []}
    asyncio.run(SessionRouting(app)(scope, receive, send))
    assert [message["type"] for message in sent] == ["http.response.start", "http.response.body"]
    return sent[0]["status"], sent[0]["headers"], sent[1]["body"]


@pytest.mark.parametrize("status", [500, 502, 503])
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
    ("status", "kind"), [(200, b"text/plain"), (404, b"text/plain"), (503, b"application/problem+json")]
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
