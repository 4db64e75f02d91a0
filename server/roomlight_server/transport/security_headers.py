"""Headers that keep browsers from misusing an answer: no frames, no guessing of types, and a policy for `/docs`."""

from typing import Final

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_POLICY: Final = "Content-Security-Policy"
NOTHING: Final = "default-src 'none'; frame-ancestors 'none'"
"""Policy of answers that are no page; the pages of `routes.page` set their own."""
DOCS: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'unsafe-inline'",  # FastAPI starts Swagger UI by an inline script
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""Policy of Swagger UI, whose files come from this server."""

HEADERS: Final = {_POLICY: NOTHING, "X-Content-Type-Options": "nosniff", "X-Frame-Options": "DENY"}
"""Of each answer that has none of its own."""


class SecurityHeadersMiddleware:
    """Adds the headers to each answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message.setdefault("headers", [])
                headers = MutableHeaders(scope=message)
                own = {_POLICY: DOCS} if scope["path"] == "/docs" else {}
                for name, value in (HEADERS | own).items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)
