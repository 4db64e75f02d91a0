"""A server on the local network: its addresses and names, its token, and the QR code that opens the phone's page."""

import io
import os
import secrets
import socket
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final

import segno

from roomlight.errors import ServerError
from roomlight_server.base.tls import check_certificate, ensure_certificate, write_private
from roomlight_server.transport.auth import LOOPBACK_HOSTS

TOKEN: Final = "lan-token"
PHONES_FILE: Final = "phones.json"
_WHITE_ON_BLACK, _RESET = "\x1b[97;40m", "\x1b[0m"
_ELSEWHERE: Final = ("192.0.2.1", 9)
"""An address of documentation networks (RFC 5737). Choosing a route to it sends no packet."""


def state_folder() -> Path:
    """Return the folder of the certificate and the token: `$XDG_STATE_HOME/roomlight` or `~/.local/state/roomlight`."""
    stated = os.environ.get("XDG_STATE_HOME", "")
    return (Path(stated) if stated else Path.home() / ".local" / "state") / "roomlight"


def local_address() -> str:
    """Return this machine's address on the local network: the one by which it would reach other networks.

    Raises:
        ServerError: There is no network.
    """
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(_ELSEWHERE)
            address = probe.getsockname()[0]
    except OSError as error:
        raise ServerError(f"no local network ({error.strerror}); give the address with --host") from error
    return address


def names_on_lan(host: str | None) -> tuple[str, ...]:
    """Return address and names of this machine on the local network, the address first: `host` if it is given.

    Raises:
        ServerError: There is no network, or the host is not one address.
    """
    address = (host or local_address()).strip("[]")
    try:
        parsed = ip_address(address)
    except ValueError:
        raise ServerError(f"host: {address!r} must be an address of this machine, for example 192.168.1.7") from None
    if parsed.is_unspecified:
        raise ServerError(f"host: {address} is every address; with --lan give the one that phones reach")
    name = socket.gethostname().lower()
    names = (name, f"{name.partition('.')[0]}.local")
    usable = tuple(host for host in names if host and host.isascii() and "_" not in host and " " not in host)
    return tuple(dict.fromkeys((address, *usable, *LOOPBACK_HOSTS)))


def ensure_token(folder: Path) -> str:
    """Return the token of the local network; make it if there is none.

    Raises:
        ServerError: The file cannot be read or written, or holds no token.
    """
    file = folder / TOKEN
    try:
        token = file.read_text("ascii").strip()
    except FileNotFoundError:
        token = secrets.token_urlsafe(24)
        write_private(file, f"{token}\n".encode())
        return token
    except (OSError, ValueError) as error:
        raise ServerError(f"{file}: cannot be read ({error}); delete it to make a new token") from error
    if len(token) < 16:
        raise ServerError(f"{file}: holds no token of 16 characters or more; delete it to make a new one")
    return token


def lan_options(
    *,
    host: str | None,
    tokens: tuple[str, ...],
    tls: tuple[Path | None, Path | None] = (None, None),
    folder: Path | None = None,
    allow_hosts: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Return the settings of a server on the local network.

    Args:
        host: Its address; by default found.
        tokens: Tokens that are configured already; by default one is made and kept.
        tls: Files of a certificate and its key; by default made and kept.
        folder: Where they are kept (`state_dir`); by default `state_folder`.
        allow_hosts: More names of this machine.

    Raises:
        ServerError: There is no network, or a file cannot be used.
    """
    folder = folder or state_folder()
    names = tuple(dict.fromkeys((*names_on_lan(host), *allow_hosts)))
    certificate, key = tls
    if certificate is None:
        certificate, key = ensure_certificate(folder, names)
    check_certificate(certificate, key)
    return {
        "host": names[0],
        "tokens": tokens or (ensure_token(folder),),
        "tls_cert": certificate,
        "tls_key": key,
        "allow_hosts": names,
        "on_lan": True,
        "phones_file": folder / PHONES_FILE,
    }


def phone_url(address: str, code: str) -> str:
    """Return the address of the phone's page; the code is in the fragment, which browsers send to no server."""
    return f"{address.rstrip('/')}/phone#pair={code}"


def qr_svg(text: str) -> str:
    """Return a QR code as an SVG document, black on white."""
    out = io.BytesIO()
    code = segno.make(text, error="m", micro=False)
    code.save(out, kind="svg", xmldecl=False, svgns=True, border=4, dark="#000", light="#fff", omitsize=True)
    return out.getvalue().decode()


def qr_text(text: str) -> str:
    """Return a QR code for a terminal: two rows of modules a line, readable on dark and light backgrounds."""
    out = io.StringIO()
    segno.make(text, error="l", micro=False).terminal(out=out, border=2, compact=True)
    return "".join(f"{_WHITE_ON_BLACK}{line}{_RESET}\n" for line in out.getvalue().splitlines())
