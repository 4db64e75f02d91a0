"""`roomlight demo` with and without a browser, and `roomlight serve --lan` as it is printed."""

import asyncio
import json
import logging
import webbrowser
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import pytest
from command_runner import RunCommand

from http_servers import RunningServer
from roomlight import sample_capture
from roomlight_cli import live_demo
from roomlight_cli.commands import demo as demo_command
from roomlight_cli.commands import serve as serve_command
from roomlight_server.transport.lan import ensure_token
from written_captures import edited_copy


class FakeBrowser(webbrowser.BaseBrowser):
    def __init__(self, opens: bool = True) -> None:
        super().__init__()
        self.opened: list[str] = []
        self._opens = opens

    def open(self, url: str, new: int = 0, autoraise: bool = True) -> bool:
        del new, autoraise
        self.opened.append(url)
        return self._opens


BROWSER = FakeBrowser()


@pytest.mark.parametrize(
    ("arguments", "browser", "built", "folder", "said"),
    [
        ("--port 0", BROWSER, True, None, ""),
        ("--no-browser", BROWSER, True, "roomlight-demo", ""),
        ("--out there", BROWSER, True, "there", ""),
        ("--no-browser --out a", BROWSER, True, "a", ""),
        ("", None, True, "roomlight-demo", "No browser for the live page here: writing pictures to roomlight-demo"),
        ("", BROWSER, False, "roomlight-demo", "No browser for the live page here: writing pictures to roomlight-demo"),
    ],
)
def test_the_demo_opens_the_page_or_writes_pictures(
    monkeypatch, roomlight: RunCommand, arguments, browser, built, folder, said
):
    live, pictures = Mock(), Mock()
    monkeypatch.setattr(demo_command, "run_live_demo", live)
    monkeypatch.setattr(demo_command, "write_pictures", pictures)
    monkeypatch.setattr(demo_command, "find_browser", lambda: browser)
    monkeypatch.setattr(demo_command, "page_is_built", lambda: built)
    result = roomlight("demo", *arguments.split())
    assert result.code == 0
    assert result.out.startswith(said)
    assert result.out.count("\n") == (1 if said else 0)
    sample = sample_capture()
    assert live.mock_calls == ([call(sample, browser, port=0)] if folder is None else [])
    assert pictures.mock_calls == ([] if folder is None else [call(sample, Path(folder))])


def test_a_browser_needs_a_display(monkeypatch):
    """Without one, only browsers for the terminal could be left."""
    monkeypatch.setattr(live_demo.sys, "platform", "linux")
    monkeypatch.setattr(webbrowser, "get", FakeBrowser)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    assert live_demo.find_browser() is None
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert isinstance(live_demo.find_browser(), FakeBrowser)
    monkeypatch.setattr(webbrowser, "get", Mock(side_effect=webbrowser.Error("could not locate runnable browser")))
    assert live_demo.find_browser() is None


@pytest.mark.parametrize(("opens", "lines"), [(True, 2), (False, 3)])
def test_the_live_demo_serves_and_streams(monkeypatch, capsys, opens, lines):
    browser, streamed = FakeBrowser(opens), []

    async def stream(capture: Path, address: str, token: str | None) -> int:
        streamed.append((capture, address, token))
        return 31

    class Now:
        """A thread that runs at once."""

        def __init__(self, target: Any, args: tuple[Any, ...], daemon: bool) -> None:
            assert daemon
            self.start = lambda: target(*args)

    def serve(settings: Any, *, listening: Any) -> None:
        assert settings.is_loopback
        assert settings.idle_expiry_s == live_demo.KEEP_S
        listening("http://127.0.0.1:8090")

    monkeypatch.setattr(live_demo, "serve", serve)
    monkeypatch.setattr(live_demo, "stream_sample", stream)
    monkeypatch.setattr(live_demo.threading, "Thread", Now)
    live_demo.run_live_demo(Path("room"), browser)
    assert browser.opened == ["http://127.0.0.1:8090/"]
    assert streamed == [(Path("room"), "http://127.0.0.1:8090", None)]
    printed = capsys.readouterr().out.strip().splitlines()
    assert len(printed) == lines
    assert printed[0] == "The live page: http://127.0.0.1:8090/ (stop with Ctrl-C)"
    assert printed[-1].startswith("All 31 frames")


@pytest.mark.slow
def test_the_sample_is_streamed_with_its_probes(tmp_path: Path):
    folder = edited_copy(sample_capture(), tmp_path / "sample", lambda index: index.update(frames=index["frames"][:3]))
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)
        await asyncio.sleep(0)

    with RunningServer() as server:
        address = f"http://127.0.0.1:{server.port}"
        assert asyncio.run(live_demo.stream_sample(folder, address, sleep=sleep)) == 3
        state = server.state(live_demo.SESSION)
        entries = server.call("GET", f"/v1/sessions/{live_demo.SESSION}/history").json["entries"]
    assert state["frames"]["processed"] == 3
    assert set(state["probes"]) == {"probe-1", "probe-2", "probe-3"}
    assert [len(entry["probes"]) for entry in entries] == [3, 3, 3]
    assert all(0 <= wait <= 1.0 for wait in waits)


PHONE = "https://127.0.0.1:8443/phone#pair=a-code"


def announce(_: object, *, listening: Any, read_tokens: Any) -> None:
    """Stand in for a server that listens."""
    del read_tokens
    listening("https://127.0.0.1:8443", PHONE)


@pytest.fixture
def state(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The folder of certificate and token."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "roomlight"


def test_serving_the_network_says_how_to_reach_it(monkeypatch, roomlight: RunCommand, state: Path, caplog):
    caplog.set_level(logging.INFO, "roomlight.server")

    def serve(settings: Any, *, listening: Any, read_tokens: Any) -> None:
        assert (settings.host, settings.port, settings.on_lan) == ("127.0.0.1", 8443, True)
        assert settings.phones_file == state / "phones.json"
        assert read_tokens is None  # there is no token file
        listening("https://127.0.0.1:8443", PHONE)

    monkeypatch.setattr(serve_command, "run_server", serve)
    result = roomlight("serve", "--lan", "--host", "127.0.0.1", "--port", "8443")
    assert result.code == 0, result.err
    token = ensure_token(state)
    line = vars(caplog.records[-1])  # without a terminal there are lines of JSON only
    assert line["phone"] is None  # which could not open it
    assert line["url"] == f"https://127.0.0.1:8443/#token={token}"
    assert line["fingerprint"].count(":") == 31
    assert [json.loads(line)["event"] for line in result.err.splitlines()] == ["starting"]


@pytest.mark.usefixtures("state")
@pytest.mark.parametrize(("host", "says"), [("192.168.1.7", "On this network: "), ("127.0.0.1", "Only this computer")])
def test_a_terminal_shows_the_qr_code(monkeypatch, roomlight: RunCommand, host: str, says: str):
    monkeypatch.setattr(serve_command, "run_server", announce)
    monkeypatch.setattr(type(serve_command.err), "is_terminal", True)
    result = roomlight("serve", "--lan", "--host", host)
    assert ("█▀▀" in result.err or "▄▄▄" in result.err or PHONE in result.err) == (host != "127.0.0.1")
    assert says in result.err


def test_serving_the_network_keeps_configured_tokens(monkeypatch, roomlight: RunCommand, state: Path, caplog):
    caplog.set_level(logging.INFO, "roomlight.server")
    monkeypatch.setenv("ROOMLIGHT_TOKENS", "a-token-of-sixteen-or-more")
    monkeypatch.setattr(serve_command, "run_server", announce)
    assert roomlight("serve", "--lan", "--host", "127.0.0.1").code == 0
    assert vars(caplog.records[-1])["url"].endswith("/#token=a-token-of-sixteen-or-more")
    assert not (state / "lan-token").exists()
    assert (state / "lan-key.pem").exists()
