"""The live form of `roomlight demo`: a server on this machine, the sample streamed into it, the page in a browser."""

import asyncio
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Awaitable, Callable
from contextlib import closing
from pathlib import Path
from typing import Final

from roomlight.captures import open_capture
from roomlight.errors import RoomLightError
from roomlight_cli.console import say
from roomlight_client import AsyncClient
from roomlight_server.base.settings import load_settings
from roomlight_server.routes.page import page_files, page_folder
from roomlight_server.serving import serve

SESSION: Final = "demo"
PORT: Final = 8090
FPS: Final = 3.0
"""Pace of the sample: about what two cores keep up with; its 31 frames take ten seconds."""
KEEP_S: Final = 1e6
"""Time for which the session stays without a request: until the demo is stopped."""
_DISPLAYS: Final = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def find_browser() -> webbrowser.BaseBrowser | None:
    """Return the default browser; None without a display, where those for the terminal lack the page's WebGL."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in _DISPLAYS):
        return None
    try:
        return webbrowser.get()
    except webbrowser.Error:
        return None


def page_is_built() -> bool:
    """Return whether this installation has the page."""
    return "/" in page_files(page_folder())


def run_live_demo(capture: Path, browser: webbrowser.BaseBrowser, *, port: int | None = None) -> None:
    """Serve on this machine, open the page and stream a recording into it, until Ctrl-C.

    Args:
        capture: The recording.
        browser: Opens the page.
        port: Port of the server; None takes 8090, or a free one if that is in use.

    Raises:
        ServerError: The server cannot listen on the port.
    """
    chosen = port if port is not None else PORT if _is_free(PORT) else 0
    settings = load_settings(host="127.0.0.1", port=chosen, log_level="warning", idle_expiry_s=KEEP_S)
    token = settings.tokens[0] if settings.tokens else None

    def start(address: str, phone: str | None = None) -> None:
        del phone
        page = f"{address}/" if token is None else f"{address}/#token={token}"
        say(f"The live page: {page} (stop with Ctrl-C)")
        if not browser.open(page):
            say("The browser did not open; open the address yourself.")
        threading.Thread(target=_stream, args=(capture, address, token), daemon=True).start()

    serve(settings, listening=start)


def _stream(capture: Path, address: str, token: str | None) -> None:
    try:
        frames = asyncio.run(stream_sample(capture, address, token))
    except RoomLightError as error:  # the page or Ctrl-C has ended the session
        say(f"The stream has ended: {error}")
    else:
        say(f"All {frames} frames of the sample are in the light. Drag the spheres; the page stays until Ctrl-C.")


async def stream_sample(
    capture: Path,
    address: str,
    token: str | None = None,
    *,
    sleep: Callable[[float], Awaitable[object]] = asyncio.sleep,
) -> int:
    """Stream a recording into the session `demo`, with its probes; return the number of frames. `sleep` waits seconds.

    Raises:
        RoomLightError: The server has stopped, or its session was deleted.
    """
    opened = open_capture(capture)
    async with AsyncClient(address, token=token) as client:
        while not await client.ready():
            await sleep(0.2)
        session = await client.open(SESSION, reference_exposure=1.0)
        for number, probe in enumerate(opened.probes, start=1):
            await session.track(f"probe-{number}", probe.position)
        loop, count = asyncio.get_running_loop(), 0
        began_s = loop.time()
        for frame in opened:
            await sleep(max(0.0, began_s + count / FPS - loop.time()))
            await session.push(frame, colour="jpeg")
            count += 1
    return count


def _is_free(port: int) -> bool:
    with closing(socket.socket()) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
