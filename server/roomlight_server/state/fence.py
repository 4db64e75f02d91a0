"""Which server owns a saved session, when several servers share a state directory.

    owners/0f3a…9c        JSON: epoch, holder, released; replaced as a whole
    owners/locks/0f       locked (flock) while an owner changes or a session is written

A server that opens or restores a session claims it: the epoch grows by one, and the record names the new holder. A
session is written under its lock after a look at the record. So a server that another one has followed (it was
suspended, or cut off from the directory) writes nothing any more. The directory needs `flock` among all servers, as
local disks, NFS 4 and Amazon EFS have it. Everything here blocks: it runs on threads.
"""

import contextlib
import fcntl
import logging
import os
import secrets
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, ValidationError

from roomlight.files import write_durable

_log = logging.getLogger("roomlight.server")
LOCK_WAIT_S: Final = 5.0
"""Longest wait for a lock: writing a session takes 0.1 s, a stopped server holds its lock until it ends."""
_POLL_S: Final = 0.005


class LeaseLostError(Exception):
    """Another server owns the session now."""


class OwnerRecord(BaseModel):
    """The owner of a session.

    Attributes:
        epoch: Number of the owner among all owners of the session, from 1.
        holder: Random name of this claim; two claims are never equal, even if a record was lost.
        released: Whether the owner has saved everything and let the session go.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    epoch: int
    holder: str
    released: bool = False


@dataclass(frozen=True)
class Lease:
    """The right to serve a session.

    Attributes:
        key: Name of the session's folder.
        record: What the directory says while the lease holds.
        taken_over: The owner before has not released the session: frames that it answered may be missing.
    """

    key: str
    record: OwnerRecord
    taken_over: bool


class Fence:
    """The owners of the sessions of a state directory."""

    def __init__(self, root: Path) -> None:
        """Use the folder `owners` of a state directory; make it if it is missing.

        Raises:
            OSError: The folder cannot be made.
        """
        self._folder = root / "owners"
        self._locks = self._folder / "locks"
        self._folder.mkdir(mode=0o700, exist_ok=True)
        self._locks.mkdir(mode=0o700, exist_ok=True)

    def claim(self, key: str) -> Lease:
        """Become the owner of a session. A running write of its owner is finished before.

        Raises:
            OSError: The lock was not free in `LOCK_WAIT_S`, or the directory cannot be used.
            OutputError: The record cannot be written.
        """
        with self._locked(key):
            before = self._read(key)
            record = OwnerRecord(epoch=1 if before is None else before.epoch + 1, holder=secrets.token_hex(16))
            self._write(key, record)
            return Lease(key, record, taken_over=before is not None and not before.released)

    def holds(self, lease: Lease) -> bool:
        """Return whether the lease still holds. Raises OSError if the record cannot be read."""
        return self._read(lease.key) == lease.record

    @contextmanager
    def guarded(self, lease: Lease) -> Generator[None]:
        """Hold the session's lock: nobody else can become its owner inside the context.

        Raises:
            LeaseLostError: Another server owns the session.
            OSError: The lock was not free in `LOCK_WAIT_S`, or the directory cannot be used.
        """
        with self._locked(lease.key):
            if not self.holds(lease):
                raise LeaseLostError(lease.key)
            yield

    def release(self, lease: Lease) -> None:
        """Let a session go whose state is on disk. Nothing happens if the lease is lost.

        Raises:
            OSError: The lock was not free in `LOCK_WAIT_S`, or the directory cannot be used.
            OutputError: The record cannot be written.
        """
        with contextlib.suppress(LeaseLostError), self.guarded(lease):
            self._write(lease.key, lease.record.model_copy(update={"released": True}))

    def forget(self, older_than_s: float, kept: set[str]) -> None:
        """Remove records that were not changed since this time (seconds of the wall clock), without those in `kept`."""
        with contextlib.suppress(OSError):  # the directory cannot be read: next time
            for path in self._folder.iterdir():
                if path.is_file() and path.name not in kept:
                    with self._locked(path.name), contextlib.suppress(FileNotFoundError):
                        if path.stat().st_mtime < older_than_s:
                            path.unlink()

    def _read(self, key: str) -> OwnerRecord | None:
        try:
            return OwnerRecord.model_validate_json((self._folder / key).read_bytes())
        except FileNotFoundError:
            return None
        except ValidationError:  # a damaged disk: no lease equals it, and the next claim replaces it
            _log.error("the record of a session's owner is damaged: %s", self._folder / key)
            return OwnerRecord(epoch=0, holder="")

    def _write(self, key: str, record: OwnerRecord) -> None:
        write_durable(self._folder / key, record.model_dump_json().encode())

    @contextmanager
    def _locked(self, key: str) -> Generator[None]:
        """Hold the lock of a session; 256 files, which are never removed, serve all sessions."""
        descriptor = os.open(self._locks / key[:2], os.O_RDWR | os.O_CREAT, 0o600)
        end_s = time.monotonic() + LOCK_WAIT_S
        try:
            while True:
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() > end_s:
                        raise TimeoutError(f"{self._locks / key[:2]}: is locked by another server") from None
                    time.sleep(_POLL_S)
            yield
        finally:
            os.close(descriptor)  # releases the lock
