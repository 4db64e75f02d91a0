"""Where commands print, and how they end: an error of RoomLight is one line on standard error and exit code 1."""

import re
import sys
from collections.abc import Iterable
from typing import Final, NoReturn

import typer
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from roomlight.errors import OptionError, RoomLightError
from roomlight.notes import Note

err = Console(stderr=True, highlight=False)
out = Console(highlight=False)

EXTRAS: Final = {"torch": "train", "onnx": "train", "onnxscript": "train", "tensorboard": "train"}
"""Which extra of the package installs a module that a command needs."""

FLAGS: Final = {
    "above_m": "--above",
    "camera_convention": "--camera-convention",
    "depth_key": "--depth-key",
    "depth_orientation": "--depth-orientation",
    "depth_unit_m": "--depth-unit",
    "device": "--device",
    "every": "--every",
    "format": "--format",
    "fov_deg": "--fov",
    "fps": "--fps",
    "height": "--height",
    "in_flight": "--in-flight",
    "max_frames": "--max-frames",
    "min_confidence": "--min-confidence",
    "model": "--model",
    "pixel": "--pixel",
    "pose_direction": "--pose-direction",
    "provider": "--provider",
    "seed": "--seed",
    "unknown_depth": "--unknown-depth",
    "weights": "--weights",
    "workers": "--workers",
    "world_up": "--world-up",
}
"""Flags of the options that the library's messages name as Python does."""


def say(text: str) -> None:
    """Print a line as it is, neither wrapped nor read as markup: it may name files."""
    out.print(text, soft_wrap=True, markup=False)


def print_notes(notes: Iterable[Note]) -> None:
    """Print what the files state and was left out, guessed or changed, a line each."""
    for note in notes:
        err.print(f"[yellow]note:[/] {escape(str(note))}", soft_wrap=True)


def run(app: typer.Typer) -> None:
    """Run an application on `sys.argv` and end the process.

    This is the one place where errors of RoomLight and missing extras become a line on standard error.
    """
    try:
        app()
    except RoomLightError as error:
        _fail(with_flags(error))
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in EXTRAS:
            raise
        _fail(f"this command needs {module}: pip install 'roomlight[{EXTRAS[module]}]'")


def with_flags(error: RoomLightError) -> str:
    """Return the error's message with the command line's flags for Python's options.

    Names with an underscore, in backticks, or before "=" are replaced everywhere ("max_frames" becomes "--max-frames").
    A name that is the first word of an OptionError is replaced too.
    """
    message = str(error)
    if isinstance(error, OptionError):
        first, space, rest = message.partition(" ")
        message = FLAGS.get(first, first) + space + rest
    names = "|".join(FLAGS)

    def flag(match: re.Match[str]) -> str:
        quote, name, value = match.groups()
        if not quote and not value and "_" not in name:
            return match.group()
        return quote + FLAGS[name] + (" " if value == "=" else "")

    return re.sub(rf"(?<![\w./-])(`?)({names})\b(=)?(?!/)", flag, message)


def progress_bars() -> Progress:
    """Return a progress display on standard error; it shows nothing unless that is a terminal."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=err,
        transient=True,
        disable=not err.is_terminal,
    )


def print_table(console: Console, table: RenderableType) -> None:
    """Print a table at the width that it needs.

    Rich cuts a table to the terminal's width, and to 80 columns in a pipe: numbers would become dots.
    """
    unlimited = console.options.update(max_width=1000)
    console.width = max(console.width, Measurement.get(console, unlimited, table).minimum)
    console.print(table)


def _fail(message: str) -> NoReturn:
    err.print(f"[red]error:[/] {escape(message)}", soft_wrap=True)
    sys.exit(1)
