"""Objects shared by the routes of a server, and the dependencies that provide them."""

from collections import OrderedDict
from collections.abc import AsyncGenerator
from dataclasses import dataclass, field
from typing import Annotated, Final

from fastapi import Depends, Path, Request

from roomlight.wire.messages import ID_PATTERN
from roomlight_server.answers.object_store import ObjectStore
from roomlight_server.base.byte_budget import ByteBudget, Reservation
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.settings import ServerSettings
from roomlight_server.recordings.store import RecordingStore
from roomlight_server.sessions.live_session import LiveSession
from roomlight_server.sessions.registry import Registry
from roomlight_server.state.store import StateStore
from roomlight_server.transport.auth import Tokens
from roomlight_server.transport.guard import ConnectionGuard
from roomlight_server.transport.phones import Phones
from roomlight_server.work.workers import Workers


@dataclass
class Context:
    """Shared objects of a server. `ready` is set once kernels are compiled and weights loaded."""

    settings: ServerSettings
    metrics: Metrics
    workers: Workers
    registry: Registry
    guard: ConnectionGuard
    budget: ByteBudget
    objects: ObjectStore
    recordings: RecordingStore
    tokens: Tokens
    phones: Phones
    states: StateStore | None = None
    ready: bool = False
    failure: Exception | None = None
    """Why the server cannot become ready."""
    public_url: str | None = None
    """Address on the local network, once the server listens."""
    meshes: OrderedDict[str, bytes] = field(default_factory=OrderedDict[str, bytes])
    """The meshes that were made last, by ETag."""

    def begin_stop(self) -> None:
        """Refuse new sessions and frames, and let paused work end; `/readyz` answers 503 from now on."""
        self.ready = False
        self.registry.stopping = True
        self.workers.release_paused()


_SCHEMA_PATTERN: Final = ID_PATTERN.removesuffix(r"\Z") + "$"  # JSON schema has no \Z
_ID_PATH: Final = Path(pattern=_SCHEMA_PATTERN, description="Chosen by the client: 1 to 64 of A-Z a-z 0-9 _ -.")
SessionId = Annotated[str, _ID_PATH]
ProbeName = Annotated[str, _ID_PATH]


async def context_of(request: Request) -> Context:
    """Return the shared objects of the server. Like all dependencies it is async: FastAPI runs others on a thread."""
    return request.app.state.context


async def owner_of(request: Request) -> str:
    """Return the owner of the request's token, as set by `AuthMiddleware`."""
    return request.scope["state"]["owner"]


async def session_owner(session_id: SessionId, request: Request) -> str:
    """Return whose session of the path it is: the owner's, or that of a phone that the owner has paired.

    Like those below it takes the request: FastAPI needs 0.03 ms of each request for a dependency on another one.
    """
    return (await context_of(request)).registry.owner_of(await owner_of(request), session_id)


async def live_session(session_id: SessionId, request: Request) -> AsyncGenerator[LiveSession]:
    """Yield the session of the path; it does not expire while the request runs.

    Raises:
        ProblemError: The session does not exist (404).
    """
    registry, owner = (await context_of(request)).registry, await session_owner(session_id, request)
    await registry.recall(owner, session_id)
    with registry.use(owner, session_id) as live:
        yield live


async def reservation(request: Request) -> AsyncGenerator[Reservation]:
    """Yield the request's reservation of memory, which is released when the answer is written."""
    with (await context_of(request)).budget.reservation() as reserved:
        yield reserved


ContextDep = Annotated[Context, Depends(context_of)]
OwnerDep = Annotated[str, Depends(owner_of)]
SessionOwnerDep = Annotated[str, Depends(session_owner)]
SessionDep = Annotated[LiveSession, Depends(live_session)]
ReservationDep = Annotated[Reservation, Depends(reservation)]
