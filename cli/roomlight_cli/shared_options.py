"""Options that several commands share, each with its text."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final, Literal

from rich.markup import escape

from roomlight.engine.session import SessionOptions, warm_up
from roomlight.errors import OptionError
from roomlight_cli.console import counted, err, remark
from roomlight_cli.options import Check, Flag, Without
from roomlight_cli.progress import LOADING, Progress
from roomlight_client import RecoveryEvent

POINTS: Final = "Where to light"
"""Heading of the options that choose points."""

Token = Annotated[
    str | None,
    Flag(
        env="ROOMLIGHT_TOKEN",
        text="The server's bearer token; better set as ROOMLIGHT_TOKEN, which other users of the machine cannot see.",
    ),
]
FiguresJson = Annotated[Path | None, Flag(text="Also write the figures as JSON.")]
ScoresJson = Annotated[Path | None, Flag(text="Also write every score as JSON.")]
Device = Annotated[Literal["auto", "cpu", "cuda"], Flag(text="Where PyTorch runs; auto: a GPU if there is one.")]


def check_weights(session: SessionOptions) -> None:
    """Refuse weights for a model without networks, and note a prior that it does not use. Raises OptionError."""
    if session.model == "classical" and session.weights is not None:
        raise OptionError(
            f"leave out weights={session.weights}: model={session.model} does not run networks; "
            "or choose another `model`"
        )
    if session.model == "classical" and session.parts is not None and (session.parts / "prior").is_dir():
        remark("note:", f"{session.parts / 'prior'}: model classical does not use it")


def note_unused_objects(session: SessionOptions) -> None:
    """Note a network for the light of objects where reflections are scored, which it does not change."""
    if session.parts is not None and (session.parts / "objects").is_dir():
        remark(
            "note:", f"{session.parts / 'objects'}: reflections are scored, which it does not change; see eval objects"
        )


def refuse_local_model(server: str, session: SessionOptions) -> None:
    """Refuse weights, parts and a provider for a session on a server. Raises OptionError."""
    if session.weights is not None or session.parts is not None or session.provider != "auto":
        raise OptionError(
            f"`weights`, `parts` and `provider` are the server's own: give them to the `roomlight serve` at {server}"
        )


LightOptions = Annotated[SessionOptions, Without("hedge", "keyframes"), Check(check_weights)]
"""How to estimate the light, without what only experiments change."""

ScoredLight = Annotated[SessionOptions, Without("hedge", "keyframes", "height"), Check(check_weights)]
"""How to estimate light that is scored, at one height."""
ScoredNetworks = Annotated[SessionOptions, Without("model", "hedge", "keyframes", "height")]
"""How to estimate light where the command chooses the models."""


@contextmanager
def scoring_progress() -> Generator[Progress]:
    """Show the progress of an evaluation, whose kernels are loaded first."""
    with Progress(LOADING) as progress:
        warm_up()
        progress.say("scoring")
        yield progress


def print_recovery(event: RecoveryEvent) -> None:
    """Say on the terminal that a server is away, or that it is back."""
    if event.state == "waiting":
        line = f"the server is away; waiting for it ({event.error})"
    else:
        line = "the server is back"
        line += ": it had lost the session, which was opened again" if event.reopened else " with the session"
        line += f"; {counted(event.resent, 'frame')} sent again" if event.resent else ""
        lost = "; older frames are lost: the light differs from one without the interruption"
        line += lost if event.incomplete else ""
    err.print(f"[yellow]{escape(line)}[/]", soft_wrap=True)
