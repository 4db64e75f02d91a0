"""What all Typer applications of the command line have in common."""

from typing import Any, Final

APP_OPTIONS: Final[dict[str, Any]] = {
    "pretty_exceptions_enable": False,
    "rich_markup_mode": "markdown",  # paragraphs flow to the terminal's width, and [brackets] are text
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""Options of every `typer.Typer` of the command line."""
