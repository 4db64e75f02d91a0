"""Phones that are paired with a server: links that work once, and a token for each phone.

The operator is who has a token of the server's settings. A phone's owner is the operator's, a dot and the phone's id,
so that a phone has sessions of its own and the operator finds them. Only digests of tokens are stored.
"""

import fcntl
import hashlib
import json
import logging
import os
import secrets
import time
from collections.abc import Callable, Collection, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from pydantic import BaseModel, TypeAdapter, ValidationError

from roomlight.errors import ServerError
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.tls import write_private

_log = logging.getLogger("roomlight.server")
LINK_S: Final = 600.0
"""Time in which a link can be used."""
MAX_PHONES: Final = 64
_MAX_LINKS: Final = 16
_KEPT_S: Final = 30 * 86_400.0
"""Time after its expiry for which a phone is known: the operator still sees its saved sessions."""


class Phone(BaseModel, frozen=True, extra="forbid"):
    """A phone: its operator, the digest of its token (empty: revoked), and times of the wall clock in seconds."""

    id: str
    operator: str
    digest: str
    paired_s: float
    expires_s: float

    @property
    def owner(self) -> str:
        """The owner of the phone's sessions."""
        return f"{self.operator}.{self.id}"


_FILE: Final = TypeAdapter(dict[str, Phone])


class Phones:
    """The paired phones. Event loop only."""

    def __init__(
        self,
        file: Path | None,
        *,
        expiry_s: float,
        clock: Callable[[], float] = time.monotonic,
        now: Callable[[], float] = time.time,
    ) -> None:
        """Read the phones that are known.

        Args:
            file: Where they are stored; None: until the server stops.
            expiry_s: Time for which a phone's token is valid.
            clock: Monotonic clock, for links.
            now: Wall clock, for tokens.

        Raises:
            ServerError: The file cannot be read or is damaged.
        """
        self._file, self._expiry_s, self._clock, self._now = file, expiry_s, clock, now
        self._links: dict[str, tuple[str, float]] = {}  # operator and expiry, by the code's digest
        self._phones = {} if file is None else _read(file)
        self._version: tuple[int, int, int] | None = None  # of the file as it was read last

    def link(self, operator: str) -> str:
        """Return a code that pairs one phone within `LINK_S`.

        Raises:
            ProblemError: The owner is a phone itself (403), or there are `MAX_PHONES` (429).
        """
        check_operator(operator)
        if len([phone for phone in self._current() if self._is_valid(phone)]) >= MAX_PHONES:
            rule = f"at most {MAX_PHONES} phones"
            raise ProblemError("owner-quota", f"{rule} are paired; remove one first", rule=rule, retry_after_s=60)
        code = secrets.token_urlsafe(16)
        while len(self._links) >= _MAX_LINKS:
            self._links.pop(next(iter(self._links)))
        self._links[_digest(code)] = operator, self._clock() + LINK_S
        return code

    def pair(self, code: str) -> tuple[Phone, str]:
        """Use a code; return the new phone and its token.

        Raises:
            ProblemError: The code is unknown, was used, or has expired (401).
        """
        operator, until_s = self._links.pop(_digest(code), ("", 0.0))
        if not operator or self._clock() > until_s:
            rule = f"works once, for {LINK_S / 60:g} minutes"
            raise ProblemError(
                "unauthorized", f"the code is not known: it {rule}; scan a new one", field="code", rule=rule
            )
        token, now_s = secrets.token_urlsafe(24), self._now()
        phone = Phone(
            id=secrets.token_hex(4),
            operator=operator,
            digest=_digest(token),
            paired_s=now_s,
            expires_s=now_s + self._expiry_s,
        )
        self._phones[phone.id] = phone
        self._save()
        _log.info("phone paired", extra={"phone": phone.id})
        return phone, token

    def find(self, token: str) -> Phone | None:
        """Return the phone whose valid token this is."""
        digest = _digest(token)
        return next((phone for phone in self._current() if phone.digest == digest and self._is_valid(phone)), None)

    def listed(self, operator: str) -> list[Phone]:
        """Return the phones of an operator whose tokens are valid."""
        return [phone for phone in self._current() if phone.operator == operator and self._is_valid(phone)]

    def owners(self, operator: str) -> list[str]:
        """Return the owners of the sessions of an operator's phones, past ones too."""
        return [phone.owner for phone in self._current() if phone.operator == operator]

    def revoke(self, operator: str, phone_id: str) -> Phone:
        """End the token of a phone; its sessions stay, and the operator sees them.

        Raises:
            ProblemError: The operator has no such phone (404).
        """
        phone = next((phone for phone in self.listed(operator) if phone.id == phone_id), None)
        if phone is None:
            raise ProblemError("phone-not-found", "there is no phone of this id", field="phone", value=phone_id)
        self._phones[phone_id] = phone.model_copy(update={"digest": ""})
        self._save()
        _log.info("phone removed", extra={"phone": phone_id})
        return phone

    def _is_valid(self, phone: Phone) -> bool:
        return bool(phone.digest) and self._now() < phone.expires_s

    def _current(self) -> Collection[Phone]:
        """Return all phones, also as another server has stored them since."""
        try:
            if self._file is not None and self._file.exists():
                stat = self._file.stat()
                version = (stat.st_ino, stat.st_mtime_ns, stat.st_size)
                if version != self._version:
                    self._add(_read(self._file))
                    self._version = version
        except (OSError, ServerError) as error:
            _log.error("the phones that other servers have stored are not known: %s", error)
        return self._phones.values()

    def _save(self) -> None:
        """Store the phones besides those that another server has stored; one that either has removed stays removed."""
        if self._file is None:
            self._add({})
            return
        try:
            with _locked(self._file.parent):
                self._add(_read(self._file))
                values = {key: phone.model_dump() for key, phone in self._phones.items()}
                write_private(self._file, json.dumps(values, indent=1).encode())
        except (OSError, ServerError) as error:  # a full disk: as stored before when the server starts again
            _log.error("the phones are not stored: %s", error)

    def _add(self, stored: dict[str, Phone]) -> None:
        removed = {key: phone for key, phone in self._phones.items() if not phone.digest}
        phones, now_s = self._phones | stored | removed, self._now()
        self._phones = {key: phone for key, phone in phones.items() if now_s < phone.expires_s + _KEPT_S}


def _read(file: Path) -> dict[str, Phone]:
    if not file.exists():
        return {}
    try:
        return _FILE.validate_json(file.read_bytes())
    except (OSError, ValidationError) as error:
        advice = "delete it, and pair the phones again"
        raise ServerError(f"{file}: is no list of phones ({str(error)[:200]}); {advice}") from error


@contextmanager
def _locked(folder: Path) -> Generator[None]:
    """Keep other servers from the files of a folder meanwhile, if its file system has locks."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def check_operator(owner: str) -> None:
    """Check that an owner is no phone. Raises ProblemError otherwise (403)."""
    if "." in owner:
        raise ProblemError("operator-only", "a phone may not do this; use a token of the server itself")


def _digest(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
