"""The `roomlight` command: which commands there are, in the order in which a newcomer needs them."""

import logging
import os
import sys
from collections.abc import Iterable
from typing import Annotated, Final

import typer

from roomlight import __version__
from roomlight_cli import console
from roomlight_cli.lazy import CommandEntry, lazy_app

_TRY: Final = "Try it"
_LIGHT: Final = "Light a recording"
_SERVE: Final = "Serve"
_MEASURE: Final = "Measure"
_TRAIN: Final = "Train"

_COMMANDS: Final = "roomlight_cli.commands"

COMMANDS: Final = (
    CommandEntry("demo", f"{_COMMANDS}.demo:demo", "Show the light of the sample room in a browser.", _TRY),
    CommandEntry(
        "light",
        f"{_COMMANDS}.light:light",
        "Light points of one photograph, or of a video without poses; what is not given is estimated.",
        _LIGHT,
    ),
    CommandEntry(
        "replay",
        f"{_COMMANDS}.replay:replay",
        "Light points of a recording: an HDR panorama per frame, pictures, a video, a report.",
        _LIGHT,
    ),
    CommandEntry(
        "composite",
        f"{_COMMANDS}.composite:composite",
        "Put virtual objects into a recording: lit by the room, with shadows, hidden by real things in front.",
        _LIGHT,
    ),
    CommandEntry(
        "stream",
        f"{_COMMANDS}.stream:stream",
        "Play a recording to a server as a phone would stream it; show rate, latency and light.",
        _LIGHT,
    ),
    CommandEntry(
        "serve",
        f"{_COMMANDS}.serve:app",
        "Serve lighting sessions over HTTP and WebSocket: frames in, light out.",
        _SERVE,
    ),
    CommandEntry("eval", f"{_COMMANDS}.evaluation:app", "Score light against ground truth.", _MEASURE),
    CommandEntry("bench", f"{_COMMANDS}.bench:app", "Measure speed: every figure as a ratio within one run.", _MEASURE),
    CommandEntry(
        "dataset",
        f"{_COMMANDS}.dataset:app",
        "Generate, view, measure and extract datasets of path-traced rooms.",
        _TRAIN,
    ),
    CommandEntry(
        "train",
        f"{_COMMANDS}.train:train",
        "Train networks by a recipe: its data, its stages, the export (needs the `train` extra).",
        _TRAIN,
    ),
    CommandEntry(
        "export",
        f"{_COMMANDS}.export:export",
        "Export a checkpoint as verified ONNX graphs (needs the `train` extra).",
        _TRAIN,
    ),
)

app = lazy_app(
    COMMANDS,
    name="roomlight",
    help_text="HDR indoor light at any point of a room, from colour, depth and camera poses.",
)


@app.callback(invoke_without_command=True)
def _root(  # pyright: ignore[reportUnusedFunction]  (typer calls it)
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if version:
        console.say(f"roomlight {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command of `sys.argv`. A RoomLightError is one line on standard error and exit code 1."""
    if sys.argv[1:2] == ["serve"]:
        _log_starting([*sys.argv[2:], os.environ.get("ROOMLIGHT_LOG_LEVEL", "")])
    console.run(app)


def _log_starting(words: Iterable[str]) -> None:
    """Log that a server starts: its imports alone take 20 s on busy cores. Not for help, or a log of warnings alone."""
    if any(word.removeprefix("--log-level=") in ("-h", "--help", "warning", "error") for word in words):
        return
    from roomlight_server.base.logs import JsonLines

    console.err.file.write(JsonLines().format(logging.makeLogRecord({"levelname": "INFO", "msg": "starting"})) + "\n")
