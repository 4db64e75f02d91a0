"""Authentication by bearer token, of the settings or of a paired phone, and the check of web origins."""

import asyncio
import hashlib
import hmac
import logging
import re
from collections.abc import Iterable
from typing import Final

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import ProblemError, problem_response
from roomlight_server.base.request_context import Flow, current_flow
from roomlight_server.base.settings import ServerSettings
from roomlight_server.base.web_origins import host_name
from roomlight_server.transport.guard import TRANSPORT, ConnectionGuard
from roomlight_server.transport.phones import Phones

_log = logging.getLogger("roomlight.server")

PROBE_PATHS: Final = ("/healthz", "/readyz")
"""Paths that are answered for every `Host`: a load balancer calls them by address."""
METRICS_PATH: Final = "/metrics"
OPEN_PATHS: Final = (*PROBE_PATHS, METRICS_PATH, "/openapi.json", "/docs", "/", "/phone")
DOCS_ASSETS: Final = "/docs-assets"
PAGE_ASSETS: Final = "/assets"
"""Paths that need no token: their answers contain nothing about any room."""
LOOPBACK_HOSTS: Final = ("localhost", "127.0.0.1", "::1")
"""Values of `Host` by which only this machine reaches the server."""
PHONES: Final = "/v1/phones"
"""Path to which a phone that has no token yet sends its code."""
SUBPROTOCOL: Final = "roomlight.v1"
_BEARER_SUBPROTOCOL: Final = "bearer."
SESSION_PATH: Final = re.compile(r"/v1/sessions/([^/]+)")
_STREAM_PATH: Final = re.compile(r"/v1/sessions/[^/]+/stream")


class Tokens:
    """The bearer tokens of a server. Tokens are kept and compared as digests; a digest also names the owner."""

    def __init__(self, tokens: Iterable[str], phones: Phones) -> None:
        """Store the digests of the tokens. Without tokens, all clients are the same owner."""
        self._phones = phones
        self.replace(tokens)

    def replace(self, tokens: Iterable[str]) -> None:
        """Use these tokens from now on; phones whose operator's token is gone are refused."""
        self._digests = [hashlib.sha256(token.encode()).digest() for token in tokens]

    @property
    def owners(self) -> list[str]:
        """Owners of the tokens, in their order, without phones."""
        return [digest.hex()[:16] for digest in self._digests]

    def owner(self, token: str | None) -> str | None:
        """Return the token's owner, or None if the token is unknown.

        The token is compared with every known token, each in constant time.
        """
        if not self._digests:
            return "anyone"
        received = hashlib.sha256((token or "").encode()).digest()
        owner = None
        for digest in self._digests:
            if hmac.compare_digest(digest, received):
                owner = digest.hex()[:16]
        phone = self._phones.find(token or "") if owner is None else None
        return phone.owner if phone is not None and phone.operator in self.owners else owner


class AuthMiddleware:
    """Sets `scope["state"]["owner"]`, or answers 401, 403 or 426 before the body is read."""

    def __init__(
        self, app: ASGIApp, *, settings: ServerSettings, tokens: Tokens, metrics: Metrics, guard: ConnectionGuard
    ) -> None:
        """Wrap an application; the guard counts unsent answers by owner."""
        self._app, self._tokens, self._metrics, self._guard = app, tokens, metrics, guard
        # origins of other sites that may call, `*` for all
        self._wrong_token_delay_s, self._origins = settings.wrong_token_delay_s, settings.allow_origins
        # A page of another site whose name resolves to this machine (DNS rebinding) has another host. Empty: any.
        self._hosts = settings.allow_hosts if settings.tokens else _hosts_without_token(settings)
        self._metrics_open = not settings.on_lan  # anyone in the house could watch who is at home

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        problem = _host_problem(scope, headers)
        if problem is None and scope["path"] in PROBE_PATHS:
            await self._app(scope, receive, send)
            return
        problem = problem or self._check(scope, headers)
        if problem is None:
            self._count_for_owner(scope)
            await self._app(scope, receive, send)
            return
        self._metrics.problems.labels(problem.kind).inc()
        if problem.kind == "unauthorized":
            await self._record_unauthorized(scope, headers)
        if scope["type"] == "websocket" and "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008, "reason": problem.kind})
        else:  # a WebSocket is answered over HTTP until it is accepted
            await problem_response(problem)(scope, receive, send)

    def _check(self, scope: Scope, headers: Headers) -> ProblemError | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if self._hosts and host_name(host) not in self._hosts:
            rule = f"must be one of {', '.join(self._hosts)}"
            detail = f"the server does not answer for the host {host[:100]!r}; add it to allow_hosts if it is yours"
            return ProblemError("forbidden-origin", detail, field="Host", value=host, rule=rule)
        if _is_open(scope["path"]) and (self._metrics_open or scope["path"] != METRICS_PATH):
            return None
        if origin is not None and not self._allowed(origin, host):
            detail = f"{origin[:100]} is not in allow_origins, and this server is {host[:100]} to its clients"
            rule = "a proxy must pass Host as it came, with its port"
            return ProblemError("forbidden-origin", detail, field="Origin", value=origin, rule=rule)
        if origin is None and not self._origins and headers.get("sec-fetch-site") in ("cross-site", "same-site"):
            # browsers send no Origin with a GET for <img>, <script> or a link
            return ProblemError("forbidden-origin", "a page of another site sent this request", field="Sec-Fetch-Site")
        if scope["path"] == PHONES and scope.get("method") == "POST":
            return None
        if scope["type"] == "http" and _STREAM_PATH.fullmatch(scope["path"]):  # a browser's token is a subprotocol
            detail = "the path needs a WebSocket handshake; a proxy must pass Upgrade and Connection"
            return ProblemError("upgrade-required", detail, field="Upgrade")
        token = token_of(scope, headers)
        owner = self._tokens.owner(token)
        if owner is None:
            detail = "header Authorization: Bearer TOKEN is required"
            detail = detail if token is None else "this server does not know the token"
            return ProblemError("unauthorized", detail, field="Authorization")
        scope.setdefault("state", {})["owner"] = owner
        return None

    def _count_for_owner(self, scope: Scope) -> None:
        """Count the work and the unsent answers of the request for its owner and session."""
        state = scope.get("state", {})
        owner = state.get("owner", "")
        path = SESSION_PATH.match(scope["path"])
        current_flow.set(Flow(owner, path[1] if path else ""))
        if owner and TRANSPORT in state:
            self._guard.assign(state[TRANSPORT], owner)

    async def _record_unauthorized(self, scope: Scope, headers: Headers) -> None:
        """Count a request without a valid token. One with a wrong token is logged, and delayed against guessing."""
        reason = "missing" if token_of(scope, headers) is None else "wrong"
        self._metrics.unauthorized.labels(reason).inc()
        if reason == "wrong":
            _log.warning("wrong token", extra={"address": (scope.get("client") or ("",))[0]})
            await asyncio.sleep(self._wrong_token_delay_s)

    def _allowed(self, origin: str, host: str) -> bool:
        return "*" in self._origins or origin in self._origins or origin.partition("://")[2] == host


def _hosts_without_token(settings: ServerSettings) -> tuple[str, ...]:
    own = (settings.host.strip("[]"),) if settings.is_loopback else ()
    return tuple(dict.fromkeys((*LOOPBACK_HOSTS, *own, *settings.allow_hosts)))


def _host_problem(scope: Scope, headers: Headers) -> ProblemError | None:
    """Return the problem of a request of HTTP/1.1 without exactly one `Host` (RFC 9112, section 3.2)."""
    hosts = headers.getlist("host")
    if len(hosts) == 1 or (scope["http_version"] == "1.0" and not hosts):
        return None
    rule = "a request must have exactly one header Host"
    return ProblemError("bad-request", f"{len(hosts)} headers Host: {rule}", field="Host", value=hosts, rule=rule)


def _is_open(path: str) -> bool:
    return path in OPEN_PATHS or path.startswith((f"{DOCS_ASSETS}/", f"{PAGE_ASSETS}/"))


def token_of(scope: Scope, headers: Headers) -> str | None:
    """Return the bearer token of a request or a WebSocket, valid or not."""
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return token.strip()
    if scope["type"] == "websocket":  # browsers can set no header but the subprotocol
        for offered in scope.get("subprotocols", []):
            if offered.startswith(_BEARER_SUBPROTOCOL):
                return offered.removeprefix(_BEARER_SUBPROTOCOL)
    return None
