"""The application: routes, middleware, start and stop."""

import asyncio
import logging
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, Final

from fastapi import Depends, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi_offline import FastAPIOffline
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import ClientDisconnect
from starlette.types import Receive, Scope, Send

from roomlight import __version__
from roomlight.errors import RoomLightError
from roomlight.wire import messages
from roomlight.wire.frame_header import FrameHeader
from roomlight_server.answers import composites, light_forms
from roomlight_server.answers.object_store import ObjectStore
from roomlight_server.base import problems
from roomlight_server.base.byte_budget import ByteBudget
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.request_context import REQUEST_ID_HEADER, RequestIdMiddleware
from roomlight_server.base.settings import ServerSettings
from roomlight_server.recordings.store import RecordingStore
from roomlight_server.routes import composites as composite_routes
from roomlight_server.routes import light as light_routes
from roomlight_server.routes import objects as object_routes
from roomlight_server.routes import page as page_routes
from roomlight_server.routes import pairing as pairing_routes
from roomlight_server.routes import recordings as recording_routes
from roomlight_server.routes import room as room_routes
from roomlight_server.routes import scene as scene_routes
from roomlight_server.routes import sessions as session_routes
from roomlight_server.routes import stream
from roomlight_server.routes.bodies import BodyMiddleware
from roomlight_server.routes.context import Context, ContextDep
from roomlight_server.sessions.registry import Clock, Registry
from roomlight_server.state.store import StateStore
from roomlight_server.transport.auth import DOCS_ASSETS, PHONES, AuthMiddleware, Tokens
from roomlight_server.transport.guard import ConnectionGuard
from roomlight_server.transport.head_requests import HeadMiddleware
from roomlight_server.transport.lan import PHONES_FILE
from roomlight_server.transport.phones import Phones, check_operator
from roomlight_server.transport.security_headers import SecurityHeadersMiddleware
from roomlight_server.transport.stop_middleware import StopMiddleware
from roomlight_server.transport.watchdog import Watchdog
from roomlight_server.work.compiling import compile_beside
from roomlight_server.work.workers import Workers

_log = logging.getLogger("roomlight.server")
_DESCRIPTION = """HDR light at any point of a room, from frames of a moving camera.

Open a session under an id of your choice, send frames (colour, depth, camera pose), request light. Positions are world
metres, y up. Light is linear RGB; 1.0 is white at the session's reference exposure. Errors are problem details
(RFC 9457) that name the field, its value and the rule. The document on the wire format describes the bytes of a frame
and the WebSocket `/v1/sessions/{id}/stream`.
"""
_WIRE_MODELS = (
    FrameHeader,
    messages.Problem,
    messages.LightCall,
    messages.Subscribe,
    messages.Track,
    messages.Untrack,
    messages.FrameEvent,
    messages.LightAnswer,
    messages.LightingUpdate,
    messages.ProbesEvent,
    messages.ProblemEvent,
)
"""Models of frames and of the WebSocket, added to the OpenAPI document although no HTTP body uses them."""

_ROUTES: Final = (
    session_routes,
    light_routes,
    object_routes,
    composite_routes,
    stream,
    room_routes,
    scene_routes,
    recording_routes,
    page_routes,
    pairing_routes,
)
_CORS_REQUEST_HEADERS: Final = (
    "Authorization",
    "Content-Type",
    "If-Match",
    "If-None-Match",
    "Prefer",
    "X-Session-Id",
    recording_routes.OFFSET_HEADER,
    REQUEST_ID_HEADER,
)
_CORS_ANSWER_HEADERS: Final = (
    "ETag",
    "Retry-After",
    REQUEST_ID_HEADER,
    light_routes.COVERAGE_HEADER,
    light_routes.FRAME_HEADER,
    composite_routes.POSES_HEADER,
    composite_routes.VISIBLE_HEADER,
    recording_routes.OFFSET_HEADER,
    room_routes.KEYFRAMES_HEADER,
)


class _AllowedOriginsMiddleware(CORSMiddleware):
    """CORS for the origins that are allowed; the check of origins answers all others, preflights too."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        origin = Headers(scope=scope).get("origin") if scope["type"] == "http" else None
        allowed = origin is None or self.is_allowed_origin(origin)
        await (super().__call__ if allowed else self.app)(scope, receive, send)


def create_app(
    settings: ServerSettings, *, clock: Clock = time.monotonic, when_loaded: Callable[[], object] | None = None
) -> FastAPI:
    """Return the application of a server.

    Args:
        clock: Monotonic clock in seconds, for the expiry of sessions.
        when_loaded: Called once when everything is loaded: shortly after the server is ready for frames.
    """
    context = _make_context(settings, clock)

    def lifespan(app: FastAPI) -> AbstractAsyncContextManager[None]:
        return _running(app, context, when_loaded)

    app = FastAPIOffline(
        docs_url="/docs",
        redoc_url=None,
        static_url=DOCS_ASSETS,
        title="RoomLight",
        version=__version__,
        description=_DESCRIPTION,
        lifespan=lifespan,
        dependencies=[Depends(problems.refuse_unknown_parameters)],
        redirect_slashes=False,
        generate_unique_id_function=_operation_id,
        exception_handlers={
            problems.ProblemError: problems.on_problem,
            RequestValidationError: problems.on_invalid,
            HTTPException: problems.on_http_exception,
            ClientDisconnect: problems.on_disconnect,
            Exception: problems.on_error,
        },
    )
    app.state.context = context
    for module in _ROUTES:
        app.include_router(module.router)
    app.include_router(recording_routes.sample_router)
    _add_health(app)
    _add_middleware(app, context)
    app.openapi = lambda: _openapi(app, tokens=bool(settings.tokens))
    return app


def _make_context(settings: ServerSettings, clock: Clock) -> Context:
    metrics = Metrics()
    workers = Workers(settings, metrics)
    states, phones_file = None, settings.phones_file
    if settings.state_dir is not None:
        phones_file = phones_file or settings.state_dir / PHONES_FILE
        states = StateStore(settings.state_dir, settings, metrics, clock)
    phones = Phones(phones_file, expiry_s=settings.phone_expiry_s, clock=clock)
    registry = Registry(settings, workers, metrics, clock, states, phones_of=phones.owners)
    guard = ConnectionGuard(settings, metrics)
    budget = ByteBudget(settings.max_pending_bytes, guard.unsent_bytes, owner_limit=settings.owner_pending_bytes)
    metrics.pending_bytes.set_function(lambda: budget.used)
    objects = ObjectStore(settings, metrics, clock)
    recordings = RecordingStore(settings, registry, clock)
    tokens = Tokens(settings.tokens, phones)
    return Context(settings, metrics, workers, registry, guard, budget, objects, recordings, tokens, phones, states)


@asynccontextmanager
async def _running(app: FastAPI, context: Context, when_loaded: Callable[[], object] | None) -> AsyncGenerator[None]:
    """Run the tasks of a server; at the end, save the sessions and end all work."""
    registry, states = context.registry, context.states
    tasks = [
        asyncio.create_task(_prepare(app, context, when_loaded)),
        asyncio.create_task(Watchdog(context.metrics, context.guard, lambda: context.ready).run()),
        asyncio.create_task(_expire(context, every_s=min(5.0, context.settings.idle_expiry_s / 4))),
    ]
    if states is not None:
        tasks.append(asyncio.create_task(states.run(registry.items, registry.end_moved)))
        tasks.append(asyncio.create_task(states.run_expiry(registry.items)))
    try:
        yield
    finally:
        context.begin_stop()
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        await context.recordings.close()
        if states is not None:
            await states.close(registry.items)
        registry.close()
        await asyncio.to_thread(context.workers.stop)


def _add_middleware(app: FastAPI, context: Context) -> None:
    """Add the middleware, from the innermost to the outermost."""
    settings, metrics = context.settings, context.metrics
    app.add_middleware(BodyMiddleware, settings=settings, metrics=metrics)
    app.add_middleware(AuthMiddleware, settings=settings, tokens=context.tokens, metrics=metrics, guard=context.guard)
    if settings.allow_origins:
        app.add_middleware(
            _AllowedOriginsMiddleware,
            allow_origins=settings.allow_origins,
            allow_methods=["GET", "PUT", "POST", "DELETE"],
            allow_headers=_CORS_REQUEST_HEADERS,
            expose_headers=_CORS_ANSWER_HEADERS,
        )
    app.add_middleware(SecurityHeadersMiddleware)
    app.add_middleware(StopMiddleware, stopping=lambda: context.registry.stopping)
    app.add_middleware(HeadMiddleware)
    app.add_middleware(RequestIdMiddleware)  # answers of all others carry the id


def _operation_id(route: Any) -> str:  # an APIRoute, or FastAPI's private context of one
    return route.name


async def _prepare(app: FastAPI, context: Context, when_loaded: Callable[[], object] | None) -> None:
    """Load in the background what frames need, then what the first answers of light, composites and schemas need.

    What of the latter does not load is logged: its first answer tries again.
    """
    compile_beside("preview", "good")
    try:
        await context.workers.start()
        context.ready = True
        _log.info("ready")
    except Exception as error:
        context.failure = error
        _log.error("server cannot become ready: %s", error, exc_info=not isinstance(error, RoomLightError))
        return
    for load in (light_forms.warm_up, composites.load, app.openapi):  # unknown parameters look into the document
        try:
            await context.workers.run_in_encode_pool(load)
        except Exception:
            _log.exception("the server cannot load all of its parts")
    if when_loaded is not None:
        when_loaded()


async def _expire(context: Context, *, every_s: float) -> None:
    while True:
        await asyncio.sleep(every_s)
        context.registry.expire()
        context.objects.expire()
        context.recordings.expire()


def _add_health(app: FastAPI) -> None:
    @app.get("/healthz", tags=["server"], summary="Liveness")
    async def healthz() -> dict[str, str]:  # pyright: ignore[reportUnusedFunction]  (FastAPI calls it)
        """Return 200 while the process is alive, whatever the load of the engine."""
        return {"status": "ok", "version": __version__}

    @app.get(
        "/readyz",
        tags=["server"],
        summary="Readiness",
        responses={503: {"description": "The server is compiling kernels, loading weights or stopping"}},
    )
    async def readyz(context: ContextDep, response: Response) -> dict[str, str]:  # pyright: ignore[reportUnusedFunction]
        """Return 200 once the kernels and weights of frames are loaded. `state` says whether sessions can be saved."""
        response.status_code = 200 if context.ready else 503
        status = "stopping" if context.registry.stopping else "ready" if context.ready else "loading"
        if context.states is None:
            return {"status": status}
        failing = context.states.failing
        return {"status": status, "state": "saved" if failing is None else f"not saved: {failing}"}

    @app.get("/metrics", tags=["server"], summary="Metrics for Prometheus", response_class=Response)
    async def metrics(context: ContextDep, request: Request) -> Response:  # pyright: ignore[reportUnusedFunction]
        """Return counters and histograms. They contain no ids and no addresses."""
        check_operator(getattr(request.state, "owner", ""))
        return Response(context.metrics.text(), media_type=CONTENT_TYPE_LATEST)


def _complete(operation: dict[str, Any]) -> None:
    """Add to an operation what its responses imply: the schema of bytes, and the headers of an answer with an ETag."""
    responses: dict[str, Any] = operation["responses"]
    for response in responses.values():
        for media_type, content in response.get("content", {}).items():
            binary = {} if media_type.startswith("text/") else {"format": "binary"}
            content.setdefault("schema", {"type": "string", **binary})
    if "304" in responses:
        etag = {"description": "Identifies the content", "schema": {"type": "string"}}
        for status in ("200", "304"):
            responses[status].setdefault("headers", {}).setdefault("ETag", etag)
        known = {
            "name": "If-None-Match",
            "in": "header",
            "description": "ETag of the known content: 304 if it is the same.",
            "schema": {"type": "string"},
        }
        operation.setdefault("parameters", []).append(known)


def _openapi(app: FastAPI, *, tokens: bool) -> dict[str, Any]:
    """Return FastAPI's OpenAPI document with `_WIRE_MODELS`, and with bearer tokens if the server has any."""
    if app.openapi_schema is None:
        document = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes, tags=app.openapi_tags
        )
        components = document.setdefault("components", {})
        schemas = components.setdefault("schemas", {})
        for model in _WIRE_MODELS:
            schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
            for name, definition in schema.pop("$defs", {}).items():
                schemas.setdefault(name, definition)
            schemas.setdefault(model.__name__, schema)
        for unused in ("HTTPValidationError", "ValidationError"):
            schemas.pop(unused, None)
        for operations in document["paths"].values():
            for operation in operations.values():
                _complete(operation)
        if tokens:
            components["securitySchemes"] = {"bearer": {"type": "http", "scheme": "bearer"}}
            for path, operations in document["paths"].items():
                for method, operation in operations.items():
                    needs_token = path.startswith("/v1/") and (path, method) != (PHONES, "post")
                    operation["security"] = [{"bearer": []}] if needs_token else []
        app.openapi_schema = document
    return app.openapi_schema
