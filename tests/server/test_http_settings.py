"""Settings: environment, flags, token files, and the address that needs a token."""

import contextlib
import http.client
import json
import logging
import os
import socket
import sys

import pytest

from http_servers import TOKEN, RunningServer
from roomlight.errors import ModelError, ServerError
from roomlight_server.base.logs import JsonLines
from roomlight_server.base.settings import ServerSettings, load_settings
from roomlight_server.serving import address_of, listen, serve


@pytest.fixture(autouse=True)
def no_variables(monkeypatch):
    for name in os.environ:
        if name.startswith("ROOMLIGHT_"):
            monkeypatch.delenv(name)


def test_the_defaults_are_loopback_without_a_token():
    settings = load_settings()
    assert (settings.host, settings.port, settings.tokens) == ("127.0.0.1", 8090, ())
    assert settings.is_loopback
    assert not settings.access_log


def test_options_override_the_environment(monkeypatch):
    for name, value in (("PORT", "9000"), ("MAX_SESSIONS", " 3 "), ("MAX_PROBES", " "), ("THREADS", "2")):
        monkeypatch.setenv(f"ROOMLIGHT_{name}", value)
    settings = load_settings(port=9001, max_sessions=None)
    assert (settings.port, settings.max_sessions, settings.max_probes) == (9001, 3, 16)


@pytest.mark.parametrize("more", [{"tokens": (TOKEN, f"{TOKEN}-two")}, {"public_url": "https://a.example"}])
def test_an_owner_gets_half_if_there_are_several(more):
    one, several = load_settings(tokens=(TOKEN,)), load_settings(**{"tokens": (TOKEN,)} | more)
    assert one.owner_pending_bytes == one.max_pending_bytes == 2 * several.owner_pending_bytes
    assert one.owner_sessions == one.max_sessions == 2 * several.owner_sessions


def test_lists_are_split_at_spaces_and_commas(monkeypatch):
    monkeypatch.setenv("ROOMLIGHT_ALLOW_ORIGINS", "https://a.example, https://b.example  https://c.example")
    assert load_settings().allow_origins == ("https://a.example", "https://b.example", "https://c.example")


def test_hosts_and_origins_are_taken_as_browsers_send_them():
    settings = load_settings(
        allow_origins=(
            "HTTP://LocalHost:8000/",
            "https://a.example:443",
            "http://[::1]:80",
            "capacitor://localhost",
            "*",
        ),
        allow_hosts=("Johns-MacBook.local", "[fe80::1]", "10.0.0.7"),
    )
    assert settings.allow_origins == (
        "http://localhost:8000",
        "https://a.example",
        "http://[::1]",
        "capacitor://localhost",
        "*",
    )
    assert settings.allow_hosts == ("johns-macbook.local", "fe80::1", "10.0.0.7")


def test_tokens_come_from_the_environment_and_a_file(monkeypatch, tmp_path):
    path = tmp_path / "tokens"
    path.write_text(f"# ours\n{TOKEN}-file  # the phone\n\n")
    monkeypatch.setenv("ROOMLIGHT_TOKENS", f"{TOKEN}-one, {TOKEN}-two")
    expected = (f"{TOKEN}-one", f"{TOKEN}-two", f"{TOKEN}-file")
    assert load_settings(token_file=path, host="0.0.0.0").tokens == expected
    monkeypatch.setenv("ROOMLIGHT_TOKEN_FILE", f" {path} ")
    assert load_settings().tokens == expected


def test_a_shared_state_needs_a_directory():
    with pytest.raises(ServerError, match="state_shared: there is no directory to share"):
        load_settings(state_shared=True)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.org"])
def test_an_address_beyond_loopback_needs_a_token(monkeypatch, host):
    with pytest.raises(ServerError, match="there is no token"):
        load_settings(host=host)
    monkeypatch.setenv("ROOMLIGHT_TOKENS", TOKEN)
    assert load_settings(host=host).host == host


@pytest.mark.parametrize(
    "host", ["127.0.0.1", "127.1.2.3", "::1", "[::1]", "localhost", "LOCALHOST", "::ffff:127.0.0.1", "::FFFF:7f00:1"]
)
def test_a_loopback_address_needs_no_token(host):
    assert load_settings(host=host).is_loopback


@pytest.mark.parametrize("host", ["127.0.0.1:8090", "[::1]:8090", "localhost:", "http://127.0.0.1", "127.0.0.1/"])
def test_a_host_with_a_port_or_a_scheme_is_refused_as_such(host):
    """It was said to be reached from other machines."""
    with pytest.raises(
        ServerError, match=r"--host: .*: give a name or an address, without scheme and path; --port has"
    ):
        load_settings(host=host)


def test_a_server_answers_for_the_loopback_address_that_it_listens_on():
    with RunningServer(host="127.1.2.3") as server:
        for host, status in (("127.1.2.3:8090", 200), ("127.0.0.1", 200), ("127.1.2.4", 403)):
            connection = http.client.HTTPConnection("127.1.2.3", server.port)
            with contextlib.closing(connection):
                connection.request("GET", "/v1/sessions", headers={"Host": host})
                assert connection.getresponse().status == status


def test_a_token_that_is_given_twice_is_one(monkeypatch, tmp_path):
    """The limits of a token were halved, as if there were two."""
    path = tmp_path / "tokens"
    path.write_text(f"{TOKEN}\n{TOKEN}\n")
    monkeypatch.setenv("ROOMLIGHT_TOKENS", TOKEN)
    settings = load_settings(token_file=path)
    assert settings.tokens == (TOKEN,)
    assert not settings.several_owners


def test_a_token_file_is_read_as_editors_write_it(tmp_path):
    path = tmp_path / "tokens"
    path.write_text(f"\ufeff{TOKEN}\n{TOKEN}#2 # the second\n\t# none\n", "utf-8")
    assert load_settings(token_file=path).tokens == (TOKEN, f"{TOKEN}#2")
    path.write_text(f"# ours\n{TOKEN}\n{TOKEN} two\n")
    with pytest.raises(ServerError, match=r"tokens, line 3: a token must be 16 to 512 of the signs") as caught:
        load_settings(token_file=path)
    assert TOKEN not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("PORT", "many", "ROOMLIGHT_PORT: 'many': input should be a valid integer"),
        ("MAX_SESSIONS", "0", "ROOMLIGHT_MAX_SESSIONS: '0': input should be greater than or equal to 1"),
        ("MODEL", "magic", "ROOMLIGHT_MODEL: 'magic': input should be 'auto', 'classical', 'single' or 'video'"),
        ("TOKENS", "short", "ROOMLIGHT_TOKENS or the token file: a token must be 16 to 512 of the signs"),
        ("TOKENS", "c2hvcnQ/dG9r/ZW4gb2Y=", "a token must be 16 to 512"),
        ("TOKEN_FILE", "/nowhere/tokens", "/nowhere/tokens: cannot read the token file"),
        ("IDLE_EXPIRY_S", "-1", "ROOMLIGHT_IDLE_EXPIRY_S: '-1': input should be greater than 0"),
        ("ACCESS_LOG", "maybe", "ROOMLIGHT_ACCESS_LOG: 'maybe': input should be a valid boolean"),
        ("MAX_SESSION", "4", "ROOMLIGHT_MAX_SESSION: unknown environment variable.*ROOMLIGHT_MAX_SESSIONS"),
        ("ALLOW_HOSTS", "box.lan:8090", "ROOMLIGHT_ALLOW_HOSTS: .*'box.lan:8090' is no host: .*without scheme, port"),
        ("ALLOW_HOSTS", "http://box.lan", "'http://box.lan' is no host"),
        ("ALLOW_ORIGINS", "localhost:8000", "ROOMLIGHT_ALLOW_ORIGINS: .*'localhost:8000' is no web origin"),
        ("ALLOW_ORIGINS", "http://*.example", "no web origin"),
        ("ALLOW_ORIGINS", "http://a.example/page", "no web origin"),
        ("ALLOW_ORIGINS", '["http://a.example"]', "no web origin"),
        ("PUBLIC_URL", "light.example.org", "ROOMLIGHT_PUBLIC_URL: 'light.example.org': must begin with https://"),
        ("PUBLIC_URL", "javascript:alert(1)", "must begin with https:// or http://"),
        ("PUBLIC_URL", "https://a.example/light", "give scheme, host and port alone"),
        ("THREADS", "abc", "ROOMLIGHT_THREADS: 'abc': must be a whole number from 1 on"),
        ("FRAMES_INFLIGHT", "4", "ROOMLIGHT_FRAMES_INFLIGHT: unknown.*ROOMLIGHT_FRAMES_IN_FLIGHT"),
        ("LAN", "1", "ROOMLIGHT_LAN: unknown environment variable; there is only the flag --lan"),
        ("XYZ", "1", "ROOMLIGHT_XYZ: unknown environment variable; roomlight serve --help names those"),
        ("PORT", "tcp://10.96.0.1:8090", "ROOMLIGHT_PORT is tcp://10.96.0.1:8090, which .*enableServiceLinks"),
    ],
)
def test_an_invalid_variable_is_named_with_its_rule(monkeypatch, name, value, message):
    monkeypatch.setenv(f"ROOMLIGHT_{name}", value)
    with pytest.raises(ServerError, match=message) as caught:
        load_settings()
    assert "\n" not in str(caught.value)
    assert "short" not in str(caught.value)  # a token stays secret


def test_what_kubernetes_and_docker_set_beside_a_service_of_this_name_is_passed_over(monkeypatch):
    for name in (
        "SERVICE_HOST",
        "SERVICE_PORT_HTTP",
        "PORT_8090_TCP",
        "PORT_8090_TCP_ADDR",
        "NAME",
        "REDIS_PORT",
        "SERVER_SERVICE_HOST",
    ):
        monkeypatch.setenv(f"ROOMLIGHT_{name}", "tcp://10.96.0.1:8090")
    monkeypatch.setenv("ROOMLIGHT_PORT", "tcp://10.96.0.1:8090")
    assert load_settings(port=0).port == 0


def test_an_invalid_option_is_named_with_its_rule():
    with pytest.raises(ServerError, match="--max-sessions: 0: input should be greater than or equal to 1"):
        load_settings(max_sessions=0)


def test_an_empty_token_file_is_an_error(tmp_path):
    path = tmp_path / "tokens"
    path.write_text("# none yet\n")
    with pytest.raises(ServerError, match="contains no token"):
        load_settings(token_file=path)


def test_unusable_weights_are_reported_before_listening(untrained_video):
    with pytest.raises(ModelError, match="never trained"):
        serve(ServerSettings(model="video", weights=untrained_video, port=0), listening=print)
    with pytest.raises(ModelError, match="has none of the folders clipping, objects, prior"):
        serve(ServerSettings(parts=untrained_video, port=0), listening=print)


def test_a_port_that_needs_rights_is_not_said_to_be_in_use(monkeypatch):
    class Denied(socket.socket):
        def bind(self, _):
            raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("roomlight_server.serving.socket.socket", Denied)
    with pytest.raises(ServerError, match=r"127\.0\.0\.1:80 \(Permission denied\); use a --port from 1024 on"):
        listen(ServerSettings(port=80))


def test_an_unusable_address_is_named():
    free = ServerSettings(port=0)
    with listen(free) as first:
        port = first.getsockname()[1]
        assert address_of(free, port) == f"http://127.0.0.1:{port}"
        with pytest.raises(ServerError, match=rf"127\.0\.0\.1:{port}.*Address already in use.*--port"):
            listen(ServerSettings(port=port))
    with pytest.raises(ServerError, match=r"host: '192\.0\.2\.1' is not an address of .*--host"):  # of documentation
        listen(ServerSettings(host="192.0.2.1", port=0))
    with pytest.raises(ServerError, match="not an address"):
        listen(ServerSettings(host="no such host", port=0))


def test_a_log_record_is_one_line_of_json():
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


def test_the_server_becomes_ready_and_counts():
    with RunningServer() as server:
        server.wait_until_ready()
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
