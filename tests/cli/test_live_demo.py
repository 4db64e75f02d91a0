"""`roomlight demo` with and without a browser, and `roomlight serve --lan` as it is printed."""

import asyncio
import json
import logging
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_runner import RunCommand

from http_servers import RunningServer
from roomlight import sample_capture
from roomlight_cli import live_demo
from roomlight_cli.commands import demo as demo_command
from roomlight_cli.commands import serve as serve_command
from roomlight_server.transport.lan import ensure_token


class FakeBrowser:
    def __init__(self, opens: bool = True) -> None:
        self.opened: list[str] = []
        self._opens = opens

    def open(self, url: str) -> bool:
        self.opened.append(url)
        return self._opens


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders that the demo wrote pictures to."""
    folders: list[Path] = []
    monkeypatch.setattr(demo_command, "write_pictures", lambda _, out: folders.append(out))
    return folders


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Calls of the live demo."""
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr(
        demo_command, "run_live_demo", lambda capture, browser, *, port: calls.append((capture, browser, port))
    )
    return calls


def use_browser(monkeypatch: pytest.MonkeyPatch, browser: object, *, built: bool = True) -> None:
    monkeypatch.setattr(demo_command, "find_browser", lambda: browser)
    monkeypatch.setattr(demo_command, "page_is_built", lambda: built)


def test_the_demo_opens_the_page_in_the_browser(monkeypatch, roomlight: RunCommand, written, shown):
    browser = FakeBrowser()
    use_browser(monkeypatch, browser)
    assert roomlight("demo", "--port", "0").code == 0
    assert shown == [(sample_capture(), browser, 0)]
    assert written == []


@pytest.mark.parametrize(
    ("arguments", "folder"),
    [(("--no-browser",), "roomlight-demo"), (("--out", "there"), "there"), (("--no-browser", "--out", "a"), "a")],
)
def test_the_demo_writes_pictures_on_request(monkeypatch, roomlight: RunCommand, written, shown, arguments, folder):
    use_browser(monkeypatch, FakeBrowser())
    result = roomlight("demo", *arguments)
    assert (result.code, result.out, shown, written) == (0, "", [], [Path(folder)])


@pytest.mark.parametrize(("browser", "built"), [(None, True), (FakeBrowser(), False)])
def test_the_demo_without_a_browser_says_so(monkeypatch, roomlight: RunCommand, written, shown, browser, built):
    use_browser(monkeypatch, browser, built=built)
    result = roomlight("demo")
    (line,) = result.out.strip().splitlines()
    assert line.startswith("No browser for the live page here: writing pictures to roomlight-demo")
    assert (shown, written) == ([], [Path("roomlight-demo")])


def test_no_browser_is_found_without_a_display(monkeypatch):
    """Only browsers for the terminal could be left."""
    monkeypatch.setattr(live_demo.sys, "platform", "linux")
    monkeypatch.setattr(live_demo.webbrowser, "get", FakeBrowser)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    assert live_demo.find_browser() is None
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert isinstance(live_demo.find_browser(), FakeBrowser)


def test_a_display_without_a_browser_is_none(monkeypatch):
    def fail() -> None:
        raise live_demo.webbrowser.Error("could not locate runnable browser")

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(live_demo.webbrowser, "get", fail)
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
    folder = tmp_path / "sample"
    shutil.copytree(sample_capture(), folder)
    index = json.loads((folder / "capture.json").read_text())
    index["frames"] = index["frames"][:3]
    (folder / "capture.json").write_text(json.dumps(index))
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)
        await asyncio.sleep(0)

    with RunningServer() as server:
        address = f"http://127.0.0.1:{server.port}"
        assert asyncio.run(live_demo.stream_sample(folder, address, pace=live_demo.Pace(3.0, sleep))) == 3
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
    assert line["phone"] == PHONE
    assert line["url"] == f"https://127.0.0.1:8443/#token={token}"
    assert line["fingerprint"].count(":") == 31
    assert result.err == ""


@pytest.mark.usefixtures("state")
def test_a_terminal_shows_the_qr_code(monkeypatch, roomlight: RunCommand):
    monkeypatch.setattr(serve_command, "run_server", announce)
    monkeypatch.setattr(type(serve_command.err), "is_terminal", True)
    result = roomlight("serve", "--lan", "--host", "127.0.0.1")
    assert "█▀▀" in result.err or "▄▄▄" in result.err


def test_serving_the_network_keeps_configured_tokens(monkeypatch, roomlight: RunCommand, state: Path, caplog):
    caplog.set_level(logging.INFO, "roomlight.server")
    monkeypatch.setenv("ROOMLIGHT_TOKENS", "a-token-of-sixteen-or-more")
    monkeypatch.setattr(serve_command, "run_server", announce)
    assert roomlight("serve", "--lan", "--host", "127.0.0.1").code == 0
    assert vars(caplog.records[-1])["url"].endswith("/#token=a-token-of-sixteen-or-more")
    assert not (state / "lan-token").exists()
    assert (state / "lan-key.pem").exists()
