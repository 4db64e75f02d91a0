"""Where commands print, and how they end: an error of RoomLight is one line on standard error and exit code 1."""

import re
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol, runtime_checkable

import typer
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from roomlight.errors import OptionError, RoomLightError, SceneError
from roomlight.files import write_json
from roomlight.notes import Note

err = Console(stderr=True, highlight=False)
out = Console(highlight=False)

APP_OPTIONS: Final[dict[str, Any]] = {
    "pretty_exceptions_enable": False,
    "rich_markup_mode": "markdown",  # paragraphs flow to the terminal's width, and [brackets] are text
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""Options of every `typer.Typer` of the command line."""
EXTRAS: Final = {"torch": "train", "onnx": "train", "onnxscript": "train", "tensorboard": "train"}
"""Which extra of the package installs a module that a command needs."""


def print_notes(notes: Iterable[Note]) -> None:
    """Print what the files state and was left out, guessed or changed, a line each."""
    for note in notes:
        remark("note:", str(note))


def counted(number: int, noun: str) -> str:
    """Format a number of things: "1 frame", "2 frames"."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def print_skipped(reasons: Sequence[str]) -> None:
    """Print why frames of a recording were skipped, a line each for the first three, and how many more there are."""
    for reason in reasons[:3]:
        remark("skipped", reason)
    if len(reasons) > 3:
        remark("skipped", counted(len(reasons) - 3, "more frame"))


def remark(word: str, text: str, console: Console = err) -> None:
    """Print a line that begins with a yellow word: a note, a warning, what was skipped."""
    console.print(f"[yellow]{word}[/] {escape(text)}", soft_wrap=True)


@runtime_checkable  # the test run checks annotations with isinstance
class Scores(Protocol):
    """What an evaluation or a benchmark returns."""

    def to_json(self) -> Any:
        """Return what `write_json` writes."""
        ...


def say(text: str) -> None:
    """Print a line as it is, neither wrapped nor read as markup: it may name files."""
    out.print(text, soft_wrap=True, markup=False)


def run(app: typer.Typer) -> None:
    """Run an application on `sys.argv` and end the process. A missing extra is one line on standard error."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files that the console cannot show
    try:
        app()
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module in ("fcntl", "resource"):
            fail("this command needs Linux or macOS; on Windows use WSL 2")
        if module not in EXTRAS:
            raise
        fail(f"this command needs {module}: pip install 'roomlight[{EXTRAS[module]}]'")


def fail(message: str) -> NoReturn:
    """Print an error as one line on standard error, and end the process with exit code 1."""
    err.print(f"[red]error:[/] {escape(message)}", soft_wrap=True)
    sys.exit(1)


@contextmanager
def stopped_by_signals(kept: Callable[[], str]) -> Generator[None]:
    """At Ctrl-C or SIGTERM say what is kept and how to go on, and end with the signal's exit code.

    Raises:
        typer.Exit: A signal came.
    """
    if threading.current_thread() is not threading.main_thread():  # which alone has signals
        yield
        return
    received = int(signal.SIGINT)

    def stop(number: int, _: object) -> None:
        nonlocal received
        received = number
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        err.print(f"stopped; {kept()}", soft_wrap=True, markup=False)
        raise typer.Exit(128 + received) from None
    finally:
        signal.signal(signal.SIGTERM, before)


def with_flags(error: RoomLightError, flags: Mapping[str, str]) -> str:
    """Return the error's message with a command's flags in place of the names of Python's options.

    Names with an underscore, in backticks, or before "=" are replaced everywhere ("depth_unit_m=0.001" becomes
    "--depth-unit 0.001"). A name that is the first word of an OptionError is replaced too. A SceneError names the
    fields of a scene's file, which stay.
    """
    message = str(error)
    if isinstance(error, SceneError):
        return message
    if isinstance(error, OptionError):
        first, space, rest = message.partition(" ")
        message = flags.get(first, first) + space + rest
    names = "|".join(sorted(flags, key=len, reverse=True)) or "(?!)"

    def flag(match: re.Match[str]) -> str:
        quote, name, value, end = match.groups()
        if not quote and not value and "_" not in name:
            return match.group()
        quote, end = ("", "") if quote and end else (quote, end)
        return quote + flags[name] + (" " if value else "") + end

    return re.sub(rf"(?<![\w./-])(`?)({names})\b(=)?(`?)(?!/)", flag, message)


def print_table(console: Console, table: RenderableType) -> None:
    """Print a table at the width that it needs; columns that do not wrap show their cells whole.

    Rich cuts a table to the terminal's width, and to 80 columns in a pipe: numbers would become dots.
    """
    unlimited = console.options.update(max_width=1000)
    for column in table.columns if isinstance(table, Table) else ():
        if column.no_wrap:
            cells = (column.header, *column.cells)
            column.min_width = max(Measurement.get(console, unlimited, cell).maximum for cell in cells)
    console.width = max(console.width, Measurement.get(console, unlimited, table).minimum)
    console.print(table)


def print_tables(*tables: RenderableType) -> None:
    """Print tables on standard output."""
    for table in tables:
        print_table(out, table)


def show_scores(scores: Scores, json: Path | None, *tables: RenderableType) -> None:
    """Print tables, and write all figures as JSON where a file is given: first, as a reader of the tables may leave.

    Raises:
        OutputError: The file cannot be written.
    """
    if json:
        write_json(json, scores.to_json())
    print_tables(*tables)
    if json:
        say(f"Figures: {json}")
