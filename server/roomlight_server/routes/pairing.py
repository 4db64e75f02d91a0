"""Route of pairing: the address and QR code by which a phone reaches this server."""

from functools import lru_cache

from fastapi import APIRouter, Request, Response

from roomlight.wire.room import Pairing
from roomlight_server.base.problems import documented
from roomlight_server.base.tls import fingerprint
from roomlight_server.routes.context import ContextDep
from roomlight_server.transport.auth import token_of
from roomlight_server.transport.lan import phone_url, qr_svg

router = APIRouter(prefix="/v1/pairing", tags=["page"])
ADVICE = "this server is reached from this machine only; start it with: roomlight serve --lan"
_fingerprint = lru_cache(maxsize=4)(fingerprint)


@router.get("", summary="Address for a phone", responses=documented("unauthorized"))
async def pairing(request: Request, context: ContextDep, response: Response) -> Pairing:
    """Return the address of the phone's page with the token of this request, and the address as a QR code."""
    response.headers["Cache-Control"] = "no-store"
    settings = context.settings
    address = settings.public_url or context.public_url
    if address is None:
        return Pairing(url=None, qr_svg=None, fingerprint=None, advice=ADVICE)
    url = phone_url(address, token_of(request.scope, request.headers) or "")
    shown = None if settings.tls_cert is None else _fingerprint(settings.tls_cert)
    return Pairing(url=url, qr_svg=qr_svg(url), fingerprint=shown, advice=None)
