"""Routes of pairing: a link and QR code for one phone, the token that the phone gets for it, and the list of phones."""

import asyncio
import logging
import time
from functools import lru_cache
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from roomlight.wire.room import PairedPhone, Pairing, PairingCode, PhoneList, PhoneToken
from roomlight_server.base.problems import BODY_PROBLEMS, ProblemError, documented
from roomlight_server.base.tls import fingerprint
from roomlight_server.routes.context import Context, ContextDep, OwnerDep
from roomlight_server.transport.auth import PHONES
from roomlight_server.transport.lan import phone_url, qr_svg
from roomlight_server.transport.phones import LINK_S, Phone, check_operator

_log = logging.getLogger("roomlight.server")
router = APIRouter(tags=["page"])
ADVICE = (
    "This server is reached from this machine only; start it with: roomlight serve --lan, or, behind a proxy, set "
    "ROOMLIGHT_PUBLIC_URL to the proxy's address"
)
ADVICE_ON_NETWORK = (
    "The address by which phones reach this server is not known: set ROOMLIGHT_PUBLIC_URL to it; the camera of a phone "
    "needs HTTPS: a proxy with TLS, --tls-cert and --tls-key, or roomlight serve --lan"
)
_fingerprint = lru_cache(maxsize=4)(fingerprint)


@router.post(
    "/v1/pairing", summary="Link for a phone", responses=documented("unauthorized", "operator-only", "owner-quota")
)
async def pairing(context: ContextDep, owner: OwnerDep, response: Response) -> Pairing:
    """Return the address of the phone's page, on a server with tokens with a code, and the address as a QR code.

    The code pairs one phone within ten minutes. A phone that opens the address sends the code to `POST /v1/phones` and
    gets a token of its own.
    """
    response.headers["Cache-Control"] = "no-store"
    settings = context.settings
    address = settings.public_url or context.public_url
    if address is None:
        advice = ADVICE if settings.is_loopback else ADVICE_ON_NETWORK
        return Pairing(url=None, qr_svg=None, fingerprint=None, expires_in_s=None, advice=advice)
    url = phone_url(address, context.phones.link(owner)) if settings.tokens else f"{address.rstrip('/')}/phone"
    fingerprint = None if settings.tls_cert is None else _fingerprint(settings.tls_cert)
    expires_in_s = LINK_S if settings.tokens else None
    return Pairing(url=url, qr_svg=qr_svg(url), fingerprint=fingerprint, expires_in_s=expires_in_s, advice=None)


@router.post(
    PHONES, summary="Pair a phone", status_code=201, responses=documented(*BODY_PROBLEMS, "unauthorized", "invalid")
)
async def pair_phone(context: ContextDep, body: PairingCode, request: Request, response: Response) -> PhoneToken:
    """Use the code of a link; return the token of this phone. Needs no token.

    The phone's sessions are its own: other phones cannot see them, who paired it can.
    """
    response.headers["Cache-Control"] = "no-store"
    try:
        phone, token = context.phones.pair(body.code)
    except ProblemError:
        context.metrics.unauthorized.labels("wrong").inc()
        _log.warning("wrong code of a phone", extra={"address": request.client.host if request.client else ""})
        await asyncio.sleep(context.settings.wrong_token_delay_s)
        raise
    return PhoneToken(id=phone.id, token=token, expires_in_s=context.settings.phone_expiry_s)


@router.get(PHONES, summary="List the paired phones", responses=documented("unauthorized", "operator-only"))
async def list_phones(context: ContextDep, owner: OwnerDep) -> PhoneList:
    """Return the phones that this token has paired."""
    check_operator(owner)
    return PhoneList(phones=[_described(phone, context) for phone in context.phones.listed(owner)])


@router.delete(
    PHONES + "/{phone_id}",
    summary="Remove a phone",
    status_code=204,
    responses=documented("unauthorized", "operator-only", "phone-not-found", "invalid"),
)
async def remove_phone(
    context: ContextDep, owner: OwnerDep, phone_id: Annotated[str, Path(pattern="^[0-9a-f]{8}$")]
) -> None:
    """End the token of a phone and its connections; its sessions stay, and this token sees them."""
    check_operator(owner)
    context.guard.close_owner(context.phones.revoke(owner, phone_id).owner)


def _described(phone: Phone, context: Context) -> PairedPhone:
    sessions = [live.name for (owner, _), live in context.registry.items() if owner == phone.owner]
    now_s = time.time()
    return PairedPhone(
        id=phone.id,
        age_s=round(max(0.0, now_s - phone.paired_s), 1),
        expires_in_s=round(max(0.0, phone.expires_s - now_s), 1),
        sessions=sessions,
    )
