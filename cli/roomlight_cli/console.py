"""Where commands print, and how they end: errors of RoomLight are one line on standard error and exit code 1."""

import sys

import typer
from rich.console import Console
from rich.markup import escape

from roomlight.errors import RoomLightError

err = Console(stderr=True, highlight=False)
out = Console(highlight=False)


def say(text: str) -> None:
    """A line that names files: as it is, neither wrapped nor read as markup."""
    out.print(text, soft_wrap=True, markup=False)


def run(app: typer.Typer) -> None:
    """Run an application of commands as the process's own."""
    try:
        app()
    except RoomLightError as error:
        err.print(f"[red]error:[/] {escape(str(error))}", soft_wrap=True)
        sys.exit(1)
