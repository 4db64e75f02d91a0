"""Settings: environment, flags, token files, and the address that needs a token."""

import json
import logging
import sys

import pytest

from http_servers import RunningServer
from roomlight.errors import ModelError, ServerError
from roomlight_server.serving import JsonLines, address_of, listen, serve
from roomlight_server.settings import ServerSettings, load_settings

TOKEN = "a-token-of-sixteen-or-more"


def test_defaults_are_loopback_without_a_token():
    settings = load_settings({})
    assert (settings.host, settings.port, settings.tokens) == ("127.0.0.1", 8090, ())
    assert settings.is_loopback
    assert not settings.access_log


def test_flags_go_before_the_environment():
    environment = {"ROOMLIGHT_PORT": "9000", "ROOMLIGHT_MAX_SESSIONS": "3", "ROOMLIGHT_THREADS": "2", "OTHER": "x"}
    settings = load_settings(environment, port=9001, max_sessions=None)
    assert (settings.port, settings.max_sessions) == (9001, 3)


def test_tokens_come_from_environment_and_file(tmp_path):
    path = tmp_path / "tokens"
    path.write_text(f"# ours\n{TOKEN}-file  # the phone's\n\n")
    settings = load_settings({"ROOMLIGHT_TOKENS": f"{TOKEN}-one, {TOKEN}-two"}, token_file=path, host="0.0.0.0")
    assert settings.tokens == (f"{TOKEN}-one", f"{TOKEN}-two", f"{TOKEN}-file")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.org"])
def test_other_addresses_need_a_token(host):
    with pytest.raises(ServerError, match="there is no token"):
        load_settings({}, host=host)
    assert load_settings({"ROOMLIGHT_TOKENS": TOKEN}, host=host).host == host


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "[::1]", "localhost"])
def test_loopback_does_not(host):
    assert load_settings({}, host=host).is_loopback


@pytest.mark.parametrize(
    ("environment", "named"),
    [
        ({"ROOMLIGHT_PORT": "many"}, "ROOMLIGHT_PORT"),
        ({"ROOMLIGHT_MAX_SESSIONS": "0"}, "--max-sessions"),
        ({"ROOMLIGHT_MODEL": "magic"}, "ROOMLIGHT_MODEL"),
        ({"ROOMLIGHT_TOKENS": "short"}, "ROOMLIGHT_TOKENS"),
        ({"ROOMLIGHT_TOKEN_FILE": "/nowhere/tokens"}, "/nowhere/tokens"),
        ({"ROOMLIGHT_IDLE_EXPIRY_S": "-1"}, "idle_expiry_s"),
    ],
)
def test_a_wrong_setting_is_named(environment, named):
    with pytest.raises(ServerError, match=named):
        load_settings(environment)


def test_an_empty_token_file_is_no_permission(tmp_path):
    path = tmp_path / "tokens"
    path.write_text("# none yet\n")
    with pytest.raises(ServerError, match="holds no token"):
        load_settings({}, token_file=path)


def test_missing_weights_are_an_error_before_a_socket_is_opened():
    with pytest.raises(ModelError, match="no trained weights"):
        serve(ServerSettings(model="video", port=0), listening=print)


def test_an_address_that_is_taken_or_none_is_named():
    free = ServerSettings(port=0)
    with listen(free) as first:
        port = first.getsockname()[1]
        assert address_of(free, first) == f"http://127.0.0.1:{port}"
        with pytest.raises(ServerError, match=rf"127\.0\.0\.1:{port}.*Address already in use.*--port"):
            listen(ServerSettings(port=port))
    with pytest.raises(ServerError, match=r"192\.0\.2\.1"):  # an address kept for documentation
        listen(ServerSettings(host="192.0.2.1", port=0))
    with pytest.raises(ServerError, match="no address"):
        listen(ServerSettings(host="no such host", port=0))


def test_logs_are_lines_of_json():
    try:
        raise ValueError("two\nlines")
    except ValueError:
        record = logging.LogRecord("a", logging.INFO, "f", 1, "frame %s\n", (7,), sys.exc_info())
    record.session = "room\n"
    text = JsonLines().format(record)
    assert "\n" not in text
    line = json.loads(text)
    assert (line["event"], line["session"], line["level"]) == ("frame 7\n", "room\n", "info")
    assert "ValueError" in line["traceback"]


def test_the_server_gets_ready_and_counts():
    with RunningServer() as server:
        for _ in range(10_000):
            if server.call("GET", "/readyz").status == 200:
                break
        assert server.call("GET", "/readyz").json == {"status": "ready"}
        server.open()
        server.push(0)
        server.push(0, b"garbage")
        metrics = server.call("GET", "/metrics")
        assert metrics.headers["content-type"].startswith("text/plain")
        text = metrics.body.decode()
        for line in (
            'roomlight_frames_total{status="processed"} 1.0',
            'roomlight_frames_refused_total{kind="bad-frame"} 1.0',
            "roomlight_sessions 1.0",
            'roomlight_frame_stage_seconds_count{stage="mesh"} 1.0',
            'roomlight_request_seconds_count{method="PUT",route="/v1/sessions/{session_id}/frames/{index}",status="422"}',
        ):
            assert line in text, line
        assert "room" not in text.replace("roomlight", "")
