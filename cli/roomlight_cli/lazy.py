"""Groups of commands whose modules are imported when a command runs, so that `--help` of the group is quick."""

import gc
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from roomlight_cli.console import APP_OPTIONS


@dataclass(frozen=True)
class CommandEntry:
    """A command as its group lists it.

    Attributes:
        name: as typed.
        target: `module:name` of the command's function (see `roomlight_cli.options`) or `typer.Typer`.
        summary: the first paragraph of the command's own help; a test compares the two.
        panel: the heading under which the group's help lists the command.
    """

    name: str
    target: str
    summary: str
    panel: str | None = None


def lazy_app(entries: Sequence[CommandEntry], *, help_text: str, name: str | None = None) -> typer.Typer:
    """Return an application that lists `entries` in their order and imports a command's module on first use.

    Use is a run of the command, its own `--help`, or the shell's completion of its options.
    """
    targets = {entry.name: entry.target for entry in entries}

    class LazyGroup(TyperGroup):
        """Replaces the listed placeholder by the command itself once a command line names it."""

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            command_name, command, rest = super().resolve_command(ctx, args)
            if command_name in targets:
                command = load_command(targets[command_name])
            return command_name, command, rest

    app = typer.Typer(name=name, cls=LazyGroup, help=help_text, no_args_is_help=True, **APP_OPTIONS)
    for entry in entries:
        app.command(entry.name, help=entry.summary, rich_help_panel=entry.panel)(_placeholder)
    return app


def load_command(target: str) -> Any:
    """Import a command and return it as a click command. Raises ImportError as the import does."""
    gc.disable()  # what modules define stays: looking for garbage in it takes a tenth of the time of importing
    try:
        from roomlight_cli.options import command_app  # imports what only commands need

        module, _, name = target.partition(":")
        command = getattr(import_module(module), name)
    finally:
        gc.enable()
    return get_command(command if isinstance(command, typer.Typer) else command_app(command))


def _placeholder() -> None:
    raise AssertionError("a lazy command is replaced before it runs")
