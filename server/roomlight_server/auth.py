"""Who asks: bearer tokens compared in constant time, and web pages held to the origins that are allowed."""

import hashlib
import hmac
from collections.abc import Iterable
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from roomlight_server.problems import ProblemError, problem_response

OPEN_PATHS: Final = ("/healthz", "/readyz", "/metrics", "/openapi.json", "/docs")
"""What needs no token: it tells nothing about any room."""
SUBPROTOCOL: Final = "roomlight.v1"
_BEARER_SUBPROTOCOL: Final = "bearer."


class Tokens:
    """The tokens of a server; an owner is named by a digest, so that no token stands in memory beside a session."""

    def __init__(self, tokens: Iterable[str]) -> None:
        """None: everyone is one owner."""
        self._digests = [hashlib.sha256(token.encode()).digest() for token in tokens]

    def owner(self, token: str | None) -> str | None:
        """The owner's name, or None for a token that is none. Every token is compared, each in constant time."""
        if not self._digests:
            return "anyone"
        given = hashlib.sha256((token or "").encode()).digest()
        found = None
        for digest in self._digests:
            if hmac.compare_digest(digest, given):
                found = digest.hex()[:16]
        return found


class AuthMiddleware:
    """Sets `scope["state"]["owner"]`, or answers 401 or 403 before a body is read."""

    def __init__(self, app: ASGIApp, *, tokens: Tokens, origins: tuple[str, ...], loopback: bool) -> None:
        """`loopback`: the server has no token and trusts its machine, so requests must be addressed to it."""
        self._app, self._tokens, self._origins, self._loopback = app, tokens, origins, loopback

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] not in ("http", "websocket") or scope["path"] in OPEN_PATHS:
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket" and "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008, "reason": refusal.kind})
        else:  # a WebSocket that is not accepted is still HTTP
            await problem_response(refusal)(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> ProblemError | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if self._loopback and urlsplit(f"//{host}").hostname not in ("localhost", "127.0.0.1", "::1"):
            # a page of another site whose name was made to point here
            return ProblemError("forbidden-origin", f"without a token the server answers for localhost, not for {host}")
        if origin is not None and not self._allowed(origin, host):
            return ProblemError("forbidden-origin", f"{origin[:100]} is not in allow_origins", field="Origin")
        owner = self._tokens.owner(_token_of(scope, headers))
        if owner is None:
            return ProblemError("unauthorized", "send the header Authorization: Bearer TOKEN", field="Authorization")
        scope.setdefault("state", {})["owner"] = owner
        return None

    def _allowed(self, origin: str, host: str) -> bool:
        return "*" in self._origins or origin in self._origins or urlsplit(origin).netloc == host


def _token_of(scope: Scope, headers: Headers) -> str | None:
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return token.strip()
    if scope["type"] == "websocket":  # browsers can set no other header there
        for offered in scope.get("subprotocols", []):
            if offered.startswith(_BEARER_SUBPROTOCOL):
                return offered.removeprefix(_BEARER_SUBPROTOCOL)
    return None
