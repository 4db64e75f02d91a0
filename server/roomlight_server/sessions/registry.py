"""The sessions of a server by owner and id: their limit, and the expiry of idle ones."""

import asyncio
import json
import logging
import math
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from roomlight.engine.memory import Footprint
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ModelError, OptionError
from roomlight.wire.messages import SessionRequest
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.settings import ServerSettings
from roomlight_server.sessions.live_session import LiveSession
from roomlight_server.sessions.quotas import Quotas
from roomlight_server.state.journal import Journal
from roomlight_server.state.listing import SavedHead
from roomlight_server.state.restoring import restore
from roomlight_server.state.store import Saveable, StateStore
from roomlight_server.work.workers import Workers

_log = logging.getLogger("roomlight.server")
Clock = Callable[[], float]
"""A monotonic clock, in seconds."""
_IDLE_ENDS: Final = {
    "expired": "it is deleted",
    "saved": "it is saved, and goes on with the next request",
    "lost": "its last changes could not be saved and are lost",
}
"""What becomes of an idle session, by the reason of its end."""


class Registry:
    """The open sessions. Each owner has a separate set of ids and cannot find the sessions of others."""

    def __init__(
        self,
        settings: ServerSettings,
        workers: Workers,
        metrics: Metrics,
        clock: Clock,
        states: StateStore | None = None,
        *,
        phones_of: Callable[[str], Sequence[str]] = lambda _: (),
    ) -> None:
        """Create an empty registry; `states` saves and restores its sessions, `phones_of` has an owner's phones."""
        self._phones_of = phones_of
        self._states = states
        self._settings, self._workers, self._metrics, self._clock = settings, workers, metrics, clock
        self._sessions: dict[tuple[str, str], LiveSession] = {}
        self._opening = asyncio.Lock()
        self._quotas = Quotas(settings, self._sessions_of)
        metrics.late_points.set_function(lambda: self._quotas.late_points)
        self.stopping = False
        metrics.sessions.set_function(lambda: len(self._sessions))
        metrics.session_bytes.set_function(
            lambda: sum(live.state().memory.bytes for live in tuple(self._sessions.values()))
        )

    def owner_of(self, owner: str, name: str) -> str:
        """Return whose session an owner means by an id: its own, else that of a phone that it has paired.

        Raises:
            ProblemError: Several phones have a session of this id (409).
        """
        phones = self._phones_of(owner)
        if not phones or self._exists(owner, name):
            return owner
        owners = [phone for phone in phones if self._exists(phone, name)]
        if len(owners) > 1:
            ids = ", ".join(phone.rpartition(".")[2] for phone in owners)
            detail = f"the phones {ids} have a session of this id; each reaches its own"
            raise ProblemError("session-conflict", detail, field="id", value=name)
        return owners[0] if owners else owner

    def _exists(self, owner: str, name: str) -> bool:
        return (owner, name) in self._sessions or (self._states is not None and self._states.has(owner, name))

    async def open(self, owner: str, name: str, request: SessionRequest) -> tuple[LiveSession, bool]:
        """Open a session, or return the open session of this id if its options are equal.

        Returns:
            The session, and whether it is new.

        Raises:
            ProblemError: The session exists with other options (409), the model is not available (409), the session
                limit is reached (503), or the session could need too much memory (422).
        """
        existing = await self.recall(owner, name)
        if existing is not None:
            return self._reopen(existing, request), False
        if self._states is None:
            return await self._open_new(owner, name, request)
        async with self._states.lock(owner, name):
            return await self._open_new(owner, name, request)

    async def _open_new(self, owner: str, name: str, request: SessionRequest) -> tuple[LiveSession, bool]:
        graphs = await self._graphs_of(request)
        existing = self._current(owner, name)  # another request may have opened it in the meantime
        if existing is not None:
            return self._reopen(existing, request), False
        async with self._opening:  # until it is added: sessions that are opened at once count each other
            self._check_capacity(owner)
            await self._check_disk(owner)
            base = self._workers.base_options
            model = base.model if request.model == "auto" else request.model
            options = replace(base, model=model, height=request.height, unknown_depth=request.unknown_depth)
            live = self._live(name, request, _engine(options, graphs), graphs)
            self._check_size(owner, live)
            if self._states is not None:
                live.journal, live.lease = self._states.journal(), await self._states.claim(owner, name, new=True)
            self._add(owner, live)
            _log.info("session opened", extra={"session": name, "model": live.state().model})
            return live, True

    async def recall(self, owner: str, name: str) -> LiveSession | None:
        """Return the session from memory, or restore it from disk; None if there is none.

        Raises:
            ProblemError: The saved state cannot be used (409) or not be read now (503), there is no room (429, 503), or
                another server has owned the session in the meantime (503): the next request restores it.
        """
        known = self._current(owner, name)
        if known is not None and known.lease is not None:
            try:
                await known.lease.check()
            except ProblemError:
                self.end_moved((owner, name), known)
                raise
        if known is not None or self._states is None or not self._states.has(owner, name):
            return known
        async with self._states.lock(owner, name):
            known = self._current(owner, name)  # another request may have restored it in the meantime
            if known is not None or not self._states.has(owner, name):
                return known
            self._check_capacity(owner)
            lease = await self._states.claim(owner, name)  # before it is read: nobody else writes it any more
            reading = await self._states.read(owner, name)
            graphs = await self._graphs_of(reading.values.request)
            engine, state = await restore(self._workers, reading, graphs)
            live = self._live(name, reading.values.request, engine, graphs)
            self._check_capacity(owner)  # others may have been opened while it was read
            self._check_size(owner, live)
            live.resume(state)
            live.journal, live.lease = self._states.restored(reading), lease
            self._add(owner, live)
            _log.info("session restored", extra={"session": name, "frame": state.values.light_frame})
            return live

    async def _graphs_of(self, request: SessionRequest) -> LightingGraphs | None:
        try:
            return await self._workers.graphs_of(request.model)
        except (ModelError, OptionError) as error:
            raise _no_model(request.model, error) from error

    def _live(self, name: str, request: SessionRequest, engine: Session, graphs: LightingGraphs | None) -> LiveSession:
        return LiveSession(
            name,
            request,
            engine=engine,
            workers=self._workers,
            footprint=Footprint.of(graphs, request.height),
            settings=self._settings,
            quotas=self._quotas,
            metrics=self._metrics,
        )

    def _add(self, owner: str, live: LiveSession) -> None:
        live.last_used_s = self._clock()
        self._sessions[owner, live.name] = live

    def _check_size(self, owner: str, live: LiveSession) -> None:
        limit = self._settings.max_session_bytes
        if live.bound_bytes > limit:
            detail = f"a session with these options could need {live.bound_bytes} bytes"
            rule = f"at most {limit} bytes per session; a lower height needs less"
            raise ProblemError("invalid", detail, field="height", value=live.request.height, rule=rule)
        self._quotas.check_session(owner, live.bound_bytes, retry_after_s=self._expected_wait_s(owner))

    async def _check_disk(self, owner: str) -> None:
        """Check that a new session of an owner may be saved. Raises ProblemError otherwise (429)."""
        heads = [] if self._states is None else await self._states.listed(owner)
        used, limit = sum(head.bytes for head in heads), self._settings.max_owner_state_bytes
        if used >= limit:
            rule = f"at most {limit} bytes of saved sessions for one token"
            detail = f"the {len(heads)} saved sessions of the token have {used} bytes; delete some first"
            raise ProblemError("owner-quota", detail, field="session", value=used, rule=rule, retry_after_s=60)

    @contextmanager
    def use(self, owner: str, name: str) -> Generator[LiveSession]:
        """Return the session; it does not expire inside the context.

        Raises:
            ProblemError: There is no session of this id (404).
        """
        live = self._current(owner, name)
        if live is None:
            detail = "there is no session of this id; it may have expired; open it with PUT"
            raise ProblemError("session-not-found", detail, field="id", value=name)
        live.users += 1
        try:
            yield live
        finally:
            live.users -= 1
            live.last_used_s = self._clock()
            if live.ended is not None and not live.users:
                self._workers.release_memory()  # of work that was running when the session ended

    def listed(self, owner: str) -> list[tuple[LiveSession, float]]:
        """Return the sessions of an owner and its phones, and the seconds since the last use, last used first."""
        self.expire()
        now_s, owners = self._clock(), {owner, *self._phones_of(owner)}
        own = [live for (session_owner, _), live in self._sessions.items() if session_owner in owners]
        idle = [(live, 0.0 if live.users else now_s - live.last_used_s) for live in own]
        return sorted(idle, key=lambda entry: entry[1])

    async def saved(self, owner: str) -> list[SavedHead]:
        """Return the sessions of an owner and its phones that are on disk and not in memory, last used first."""
        heads: list[SavedHead] = []
        if self._states is None:
            return heads
        for session_owner in (owner, *self._phones_of(owner)):
            listed = await self._states.listed(session_owner)
            heads += [head for head in listed if (session_owner, head.values.name) not in self._sessions]
        return sorted(heads, key=lambda head: head.idle_s)

    def delete(self, owner: str, name: str) -> None:
        """End a session. Raises ProblemError if there is no session of this id (404)."""
        with self.use(owner, name) as live:
            del self._sessions[owner, name]
            live.close()
            if live.journal is not None:
                live.journal.closed = True  # what is being copied is not written any more
            self._record_end(name, "deleted")

    async def erase(self, owner: str, name: str) -> None:
        """End a session, and remove it from the disk.

        Raises:
            ProblemError: There is no session of this id (404), or its files cannot be removed (503).
        """
        if self._states is None:
            self.delete(owner, name)
            return
        async with self._states.lock(owner, name):
            if self._current(owner, name) is not None:
                self.delete(owner, name)
                await self._states.erase(owner, name)
            elif not await self._states.erase(owner, name):
                self.delete(owner, name)  # raises: it is nowhere

    def end_moved(self, key: tuple[str, str], live: Saveable) -> None:
        """End a session that another server owns; what is not saved of it is lost."""
        known = self._sessions.get(key)
        if known is None or known is not live or known.lease is None:
            return
        del self._sessions[key]
        known.close(known.lease.problem)
        if known.journal is not None:
            known.journal.closed = True
        self._record_end(known.name, "moved")

    def items(self) -> list[tuple[tuple[str, str], LiveSession]]:
        """Return the sessions in memory by (owner, id)."""
        return list(self._sessions.items())

    @property
    def frames_in_flight(self) -> int:
        """Frames that are being received, decoded or processed, or whose outcome is being sent."""
        return sum(live.frames_in_flight for live in self._sessions.values())

    def expire(self) -> None:
        """End all sessions that are idle for too long."""
        now_s = self._clock()
        for key, live in tuple(self._sessions.items()):
            if live.users or now_s - live.last_used_s <= self._idle_limit_s(live.journal):
                continue
            del self._sessions[key]
            unsaved = live.journal is not None and live.journal.is_unsaved
            reason = "expired" if self._states is None else "lost" if unsaved else "saved"
            live.close(ProblemError("session-closed", f"the session was idle for too long: {_IDLE_ENDS[reason]}"))
            if self._states is not None:
                self._states.left_memory(key[0], live)
            if unsaved:
                _log.error("an idle session leaves memory before it is saved", extra={"session": live.name})
            self._record_end(live.name, reason)

    def _idle_limit_s(self, journal: Journal | None) -> float:
        """Return how long an idle session is kept.

        Twice as long if it is unsaved, and if saving fails until the server is full.
        """
        if journal is None or not journal.is_unsaved:
            return self._settings.idle_expiry_s
        is_full = len(self._sessions) >= self._settings.max_sessions
        return 2 * self._settings.idle_expiry_s if is_full or not journal.failing else math.inf

    def close(self) -> None:
        """End all sessions."""
        for live in self._sessions.values():
            live.close()
        self._sessions.clear()

    def _current(self, owner: str, name: str) -> LiveSession | None:
        self.expire()
        return self._sessions.get((owner, name))

    def _record_end(self, name: str, reason: str) -> None:
        self._metrics.sessions_ended.labels(reason).inc()
        _log.info("session ended", extra={"session": name, "reason": reason})

    def _reopen(self, live: LiveSession, request: SessionRequest) -> LiveSession:
        if live.request != request:
            raise _conflict(live.request, request)
        live.last_used_s = self._clock()
        return live

    def _check_capacity(self, owner: str) -> None:
        self.check_not_stopping()
        limit = self._settings.max_sessions
        if len(self._sessions) >= limit:
            raise ProblemError(
                "server-full",
                f"{limit} sessions are open; delete one that is no longer needed (`GET /v1/sessions` lists them), or "
                "retry later; the server's settings are --max-sessions and --idle-expiry-s",
                rule=f"at most {limit} sessions",
                retry_after_s=self._expected_wait_s(),
            )
        self._quotas.check_session(owner, 0, retry_after_s=self._expected_wait_s(owner))

    def check_not_stopping(self) -> None:
        """Check that new sessions and frames are accepted. Raises ProblemError if the server is stopping (503)."""
        if self.stopping:
            raise ProblemError("stopping", "the server is stopping; connect again in a few seconds", retry_after_s=5)

    def _sessions_of(self, owner: str) -> list[LiveSession]:
        return [live for (session_owner, _), live in self._sessions.items() if session_owner == owner]

    def _expected_wait_s(self, owner: str | None = None) -> int:
        """Return the earliest time in which a session of an owner, or of all, could expire; at most a minute."""
        sessions = self._sessions.values() if owner is None else self._sessions_of(owner)
        used_s = [live.last_used_s for live in sessions]
        wait_s = min(used_s, default=self._clock()) + self._settings.idle_expiry_s - self._clock()
        return max(1, min(60, math.ceil(wait_s)))


def _engine(options: SessionOptions, graphs: LightingGraphs | None) -> Session:
    """Return a new engine session. Raises ProblemError if the weights of its model are missing."""
    try:
        return Session(options, graphs=graphs)
    except ModelError as error:  # of the parts, whose weights are not among the graphs
        raise _no_model(options.model, error) from error


def _no_model(model: str, error: Exception) -> ProblemError:
    rule = "must be a model of the server; `auto` is its default model"
    detail = f"the server has no weights of the model: {error}"
    return ProblemError("model-not-here", detail, field="model", value=model, rule=rule)


def _conflict(existing: SessionRequest, request: SessionRequest) -> ProblemError:
    """Return the error that names each differing option with both values; `field` is the first one."""
    old = {name: json.dumps(value) for name, value in existing.model_dump().items()}
    new = {name: json.dumps(value) for name, value in request.model_dump().items()}
    differing = [name for name in old if old[name] != new[name]]
    first = differing[0]
    listed = ", ".join(f"{name} {old[name]} (requested: {new[name]})" for name in differing)
    return ProblemError(
        "session-conflict",
        f"the session exists with {listed}; join it with GET, delete it first, or use another id",
        field=first,
        value=new[first],
        rule=f"must be {old[first]}, as when the session was opened",
    )
