"""What the routes of one server share, and how they find it and the session they are about."""

from collections.abc import AsyncGenerator
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Path, Request

from roomlight.wire.messages import ID_PATTERN
from roomlight_server.live_session import LiveSession
from roomlight_server.metrics import Metrics
from roomlight_server.registry import Registry
from roomlight_server.settings import ServerSettings
from roomlight_server.workers import Workers


@dataclass
class Context:
    """One server's parts; `ready` once kernels and weights are loaded."""

    settings: ServerSettings
    metrics: Metrics
    workers: Workers
    registry: Registry
    ready: bool = False


SessionId = Annotated[
    str,
    Path(pattern=ID_PATTERN.removesuffix(r"\Z") + "$", description="Made by the client: A-Z a-z 0-9 _ -, up to 64."),
]
ProbeName = Annotated[str, Path(pattern=ID_PATTERN.removesuffix(r"\Z") + "$", description="As session ids.")]


def context_of(request: Request) -> Context:
    """The server's parts."""
    return request.app.state.context


def owner_of(request: Request) -> str:
    """Who asks, as `AuthMiddleware` found out."""
    return request.scope["state"]["owner"]


async def live_session(
    session_id: SessionId,
    context: Annotated[Context, Depends(context_of)],
    owner: Annotated[str, Depends(owner_of)],
) -> AsyncGenerator[LiveSession]:
    """The session of the address, held while the request runs. Raises ProblemError (404)."""
    with context.registry.use(owner, session_id) as live:
        yield live


In = Annotated[Context, Depends(context_of)]
Owner = Annotated[str, Depends(owner_of)]
Live = Annotated[LiveSession, Depends(live_session)]
