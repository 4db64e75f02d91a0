"""Options of the commands that reach a server."""

from typing import Annotated

import typer

from roomlight.engine.session import SessionOptions
from roomlight_client import RecoveryEvent

Server = Annotated[
    str | None,
    typer.Option(metavar="URL", help="Let the `roomlight serve` at this address do the work, e.g. http://host:8090."),
]
Token = Annotated[
    str | None,
    typer.Option(
        envvar="ROOMLIGHT_TOKEN",
        show_default=False,
        help="The server's bearer token; better set as ROOMLIGHT_TOKEN, which other users of the machine cannot see.",
    ),
]


def refuse_local_model(server: str, session: SessionOptions) -> None:
    """Refuse options of the engine here for a session on a server.

    Raises:
        typer.BadParameter: Weights or provider are set.
    """
    if session.weights is not None or session.provider != "auto":
        raise typer.BadParameter(
            f"--weights and --provider are the server's own: give them to the `roomlight serve` at {server}"
        )


def recovery_line(event: RecoveryEvent) -> str:
    """Return what the terminal says about a server that is away, or that is back."""
    if event.state == "waiting":
        return f"the server is away; waiting for it ({event.error})"
    again = "the server is back"
    again += ": it had lost the session, which was opened again" if event.reopened else " with the session"
    frames = f"{event.resent} frame" + ("" if event.resent == 1 else "s")
    again += f"; {frames} sent again" if event.resent else ""
    lost = "; older frames are lost: the light differs from one without the interruption"
    return again + (lost if event.incomplete else "")
