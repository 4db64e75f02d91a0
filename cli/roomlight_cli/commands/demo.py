"""`roomlight demo`: stream the sample room into the live page, or write pictures of it."""

from pathlib import Path
from typing import Annotated, Final

from annotated_types import Interval

from roomlight.captures import CaptureOptions
from roomlight.compositing.placement.scene import load_scene
from roomlight.engine.session import SessionOptions
from roomlight.errors import OptionError, OutputError
from roomlight.sample import sample_capture
from roomlight_cli.commands.replay import replay
from roomlight_cli.compositing import CompositeOptions, composite_recording
from roomlight_cli.console import say
from roomlight_cli.live_demo import find_browser, page_is_built, run_live_demo
from roomlight_cli.replays.replay_folder import holds_replay_of
from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_server.work.compiling import compile_beside

DEFAULT_OUT: Final = Path("roomlight-demo")
SCENE: Final = Path(__file__).parents[1] / "demo-scene.json"
"""A mirror sphere and a teapot on the low table, a chair, and two objects that move."""
FILM: Final = "composite.mp4"
FILM_RATE: Final = 6.0
"""Frames a second: the sample's 31 frames take five seconds."""


def demo(
    *,
    browser: bool = True,
    out: Path | None = None,
    port: Annotated[int, Interval(ge=0, le=65535)] | None = None,
) -> None:
    """Show the light of the sample room in a browser.

    The room comes with the package: no network is needed. A server on this machine streams it to a page, with a mirror
    sphere at each probe, until Ctrl-C. The first time, the kernels are compiled, which takes about a minute.

    With --no-browser or --out, and on a machine without a browser, it writes pictures, a report, and a film of the room
    with virtual objects instead, which takes about a minute.

    Args:
        browser: Open the live page, or write pictures.
        out: Write pictures to this folder (without a browser: roomlight-demo); an earlier demo is replaced.
        port: Port of the page (default: 8090, or a free one).
    """
    if port is not None and (not browser or out is not None):
        raise OptionError("`port` is of the live page: leave it out where pictures are written")
    capture = sample_capture()
    if browser and out is None:
        default = find_browser() if page_is_built() else None
        if default is not None:
            run_live_demo(capture, default, port=port)
            return
        say(f"No browser for the live page here: writing pictures to {DEFAULT_OUT} instead (as with --no-browser).")
    write_pictures(capture, out or DEFAULT_OUT)


def write_pictures(capture: Path, out: Path) -> None:
    """Light the sample room and write pictures, a report and a film with virtual objects.

    Raises:
        OutputError: `out` holds anything but an earlier demo.
    """
    if not holds_replay_of(capture, out) and any(out.glob("[!.]*")):
        raise OutputError(f"{out}: holds something else than a demo of this installation; choose another --out")
    compile_beside("preview")
    replay(capture, ReplayOptions(probes_from_capture=True, overwrite=True), out=out)
    film = CompositeOptions(out / FILM, quality="preview", fps=FILM_RATE, overwrite=True)
    done = composite_recording(capture, load_scene(SCENE), film, light=SessionOptions(), reading=CaptureOptions())
    say(f"A chair, a mirror sphere and two moving objects in the room: {done}")
    say(f"Compare the light with the room's ground truth: roomlight eval captures {capture}")
