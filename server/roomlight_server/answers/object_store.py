"""Uploaded objects by owner and digest: their memory limits, and the expiry of unused ones."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.wire.compositing import ObjectInfo, ObjectList
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.request_context import may_see
from roomlight_server.base.settings import ServerSettings
from roomlight_server.work.object_packing import object_bytes

_log = logging.getLogger("roomlight.server")
_MAX_NOTES = 50


@dataclass
class _Stored:
    virtual_object: VirtualObject
    info: ObjectInfo
    last_used_s: float


class ObjectStore:
    """The uploaded objects. Each owner has a separate set, and finds those of its phones. Event loop only."""

    def __init__(self, settings: ServerSettings, metrics: Metrics, clock: Callable[[], float]) -> None:
        self._settings, self._clock = settings, clock
        self._stored: dict[tuple[str, str], _Stored] = {}
        metrics.objects.set_function(lambda: len(self._stored))
        metrics.object_bytes.set_function(lambda: self._bytes())

    def find(self, owner: str, digest: str) -> VirtualObject:
        """Return an object. Raises ProblemError if the owner has none of this id (404)."""
        return self._find(owner, digest).virtual_object

    def info(self, owner: str, digest: str) -> ObjectInfo:
        """Return what an object is. Raises ProblemError if the owner has none of this id (404)."""
        return self._find(owner, digest).info

    def add(self, owner: str, digest: str, virtual_object: VirtualObject) -> ObjectInfo:
        """Store an object under its digest, unless another upload of it was faster.

        Raises:
            ProblemError: The owner's limit (409) or the server's (503) is reached; nothing is stored.
        """
        self.expire()
        if (known := self._stored.get((owner, digest))) is not None:
            return known.info
        low, high = virtual_object.bounds()
        size = object_bytes(virtual_object)
        notes = tuple(str(note) for note in virtual_object.notes[:_MAX_NOTES])
        info = ObjectInfo(
            id=digest,
            triangles=virtual_object.triangles,
            lower_m=low.tolist(),
            size_m=(high - low).tolist(),
            bytes=size,
            notes=notes,
        )
        limit = self._settings.max_owner_object_bytes
        if self._bytes(owner) + size > limit:
            rule = f"at most {limit} bytes of objects for one token"
            detail = f"the object takes {size} bytes and {self._bytes(owner)} are in use; delete one first"
            raise ProblemError("too-many-objects", detail, field="body", value=size, rule=rule)
        limit = self._settings.max_object_bytes
        if self._bytes() + size > limit:
            oldest = min(stored.last_used_s for stored in self._stored.values()) if self._stored else self._clock()
            wait_s = math.ceil(oldest + self._settings.object_expiry_s - self._clock())
            detail = f"the object takes {size} bytes and {self._bytes()} are in use by all clients; retry later"
            rule = f"at most {limit} bytes of objects for all clients"
            raise ProblemError("object-memory", detail, rule=rule, retry_after_s=max(1, min(60, wait_s)))
        self._stored[owner, digest] = _Stored(virtual_object, info, self._clock())
        _log.info("object stored", extra={"bytes": size, "triangles": virtual_object.triangles})
        return info

    def listed(self, owner: str) -> ObjectList:
        """Return all objects of an owner and its phones, the oldest first; the bytes are the owner's own."""
        self.expire()
        infos = {digest: stored.info for (whose, digest), stored in self._stored.items() if may_see(owner, whose)}
        return ObjectList(
            objects=list(infos.values()), bytes=self._bytes(owner), limit_bytes=self._settings.max_owner_object_bytes
        )

    def delete(self, owner: str, digest: str) -> None:
        """Delete an object; composites that use it are finished. Raises ProblemError if there is none (404)."""
        gone = self._find(owner, digest)
        self._stored = {key: stored for key, stored in self._stored.items() if stored is not gone}

    def expire(self) -> None:
        """Delete objects that were not used for too long."""
        limit = self._clock() - self._settings.object_expiry_s
        for key, stored in tuple(self._stored.items()):
            if stored.last_used_s < limit:
                del self._stored[key]
                _log.info("object expired", extra={"bytes": stored.info.bytes})

    def _find(self, owner: str, digest: str) -> _Stored:
        self.expire()
        own = self._stored.get((owner, digest))
        of_phones = (kept for (whose, name), kept in self._stored.items() if name == digest and may_see(owner, whose))
        stored = own or next(of_phones, None)
        if stored is None:
            detail = "there is no object of this id; it may have expired; upload it with POST /v1/objects"
            raise ProblemError("object-not-found", detail, field="object", value=digest)
        stored.last_used_s = self._clock()
        return stored

    def _bytes(self, owner: str | None = None) -> int:
        return sum(stored.info.bytes for (whose, _), stored in self._stored.items() if owner in (None, whose))
