"""Hosts and web origins as browsers send them: in lower case, an origin without the default port and without a path."""

import re
from typing import Final
from urllib.parse import urlsplit

_DEFAULT_PORTS: Final = {"http": 80, "https": 443}
_AUTHORITY: Final = re.compile(r"[a-z0-9._-]+(:\d+)?|\[[0-9a-f:.]+\](:\d+)?")


def host_name(host: str) -> str | None:
    """Return the name or address in a header `Host`; None if the header is malformed."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:  # unbalanced brackets
        return None


def checked_host(host: str) -> str:
    """Return a host of the settings as `host_name` returns it.

    Raises:
        ValueError: It is no name or address alone.
    """
    name = host.strip("[]").lower()
    if not re.fullmatch(r"[a-z0-9._-]+|[0-9a-f:.]*:[0-9a-f:.]*:[0-9a-f:.]*", name):
        raise ValueError(f"{host!r} is no host: give a name or an address, without scheme, port and path")
    return name


def checked_origin(origin: str) -> str:
    """Return a web origin of the settings as browsers send it; `*` and `null` stay.

    Raises:
        ValueError: It is no origin.
    """
    if origin in ("*", "null"):
        return origin
    scheme, separator, authority = origin.lower().removesuffix("/").partition("://")
    if not separator or not scheme or not _AUTHORITY.fullmatch(authority):
        raise ValueError(f"{origin!r} is no web origin: give scheme, host and port alone, as http://localhost:3000")
    return f"{scheme}://{authority.removesuffix(f':{_DEFAULT_PORTS.get(scheme)}')}"
