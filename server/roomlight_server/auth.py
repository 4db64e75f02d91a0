"""Authentication by bearer token, and the check of web origins."""

import asyncio
import hashlib
import hmac
import logging
from collections.abc import Iterable
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from roomlight_server.metrics import Metrics
from roomlight_server.problems import ProblemError, problem_response

_log = logging.getLogger("roomlight.server")

PROBE_PATHS: Final = ("/healthz", "/readyz")
"""Paths that are answered for every `Host`: a load balancer calls them by address."""
OPEN_PATHS: Final = (*PROBE_PATHS, "/metrics", "/openapi.json", "/docs")
DOCS_ASSETS: Final = "/docs-assets"
"""Paths that need no token: their answers contain nothing about any room."""
SUBPROTOCOL: Final = "roomlight.v1"
_BEARER_SUBPROTOCOL: Final = "bearer."


class Tokens:
    """The bearer tokens of a server. Tokens are kept and compared as digests; a digest also names the owner."""

    def __init__(self, tokens: Iterable[str]) -> None:
        """Store the digests of the tokens. Without tokens, all clients are the same owner."""
        self._digests = [hashlib.sha256(token.encode()).digest() for token in tokens]

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
        return owner


class AuthMiddleware:
    """Sets `scope["state"]["owner"]`, or answers 401 or 403 before the body is read."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        tokens: Tokens,
        origins: tuple[str, ...],
        loopback: bool,
        metrics: Metrics,
        wrong_token_delay_s: float,
    ) -> None:
        """Wrap an application.

        Args:
            app: The application.
            tokens: Tokens that are accepted.
            origins: Web origins that are allowed besides the server's own; `*` allows all.
            loopback: Accept only requests whose `Host` is this machine, because the server has no token.
            metrics: Count requests without a valid token.
            wrong_token_delay_s: Time after which a request with a wrong token is answered.
        """
        self._metrics, self._wrong_token_delay_s = metrics, wrong_token_delay_s
        self._app, self._tokens, self._origins, self._loopback = app, tokens, origins, loopback

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if scope["type"] not in ("http", "websocket") or scope["path"] in PROBE_PATHS:
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        problem = self._check(scope, headers)
        if problem is None:
            await self._app(scope, receive, send)
            return
        if problem.kind == "unauthorized":
            await self._record_unauthorized(scope, headers)
        if scope["type"] == "websocket" and "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008, "reason": problem.kind})
        else:  # a WebSocket is answered over HTTP until it is accepted
            await problem_response(problem)(scope, receive, send)

    def _check(self, scope: Scope, headers: Headers) -> ProblemError | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if self._loopback and _host_name(host) not in ("localhost", "127.0.0.1", "::1"):
            # DNS rebinding: a page of another site whose name resolves to this machine
            return ProblemError(
                "forbidden-origin", f"without a token the server serves localhost only, not {host[:100]}"
            )
        if _is_open(scope["path"]):
            return None
        if origin is not None and not self._allowed(origin, host):
            return ProblemError("forbidden-origin", f"{origin[:100]} is not in allow_origins", field="Origin")
        owner = self._tokens.owner(_token_of(scope, headers))
        if owner is None:
            return ProblemError("unauthorized", "header Authorization: Bearer TOKEN is required", field="Authorization")
        scope.setdefault("state", {})["owner"] = owner
        return None

    async def _record_unauthorized(self, scope: Scope, headers: Headers) -> None:
        """Count a request without a valid token. One with a wrong token is logged, and delayed against guessing."""
        reason = "missing" if _token_of(scope, headers) is None else "wrong"
        self._metrics.unauthorized.labels(reason).inc()
        if reason == "wrong":
            _log.warning("wrong token", extra={"address": (scope.get("client") or ("",))[0]})
            await asyncio.sleep(self._wrong_token_delay_s)

    def _allowed(self, origin: str, host: str) -> bool:
        return "*" in self._origins or origin in self._origins or origin.partition("://")[2] == host


def _host_name(host: str) -> str | None:
    """Return the name or address in a header `Host`; None if the header is malformed."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:  # unbalanced brackets
        return None


def _is_open(path: str) -> bool:
    return path in OPEN_PATHS or path.startswith(f"{DOCS_ASSETS}/")


def _token_of(scope: Scope, headers: Headers) -> str | None:
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return token.strip()
    if scope["type"] == "websocket":  # browsers can set no header but the subprotocol
        for offered in scope.get("subprotocols", []):
            if offered.startswith(_BEARER_SUBPROTOCOL):
                return offered.removeprefix(_BEARER_SUBPROTOCOL)
    return None
