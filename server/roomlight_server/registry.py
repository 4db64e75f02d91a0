"""The sessions of a server, by owner and id: how many there may be, and when idle ones go."""

import logging
import math
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace

from roomlight.engine.memory import Footprint
from roomlight.engine.session import Session
from roomlight.errors import ModelError
from roomlight.wire.messages import SessionRequest
from roomlight_server.live_session import Limits, LiveSession
from roomlight_server.metrics import Metrics
from roomlight_server.problems import ProblemError
from roomlight_server.settings import ServerSettings
from roomlight_server.workers import Workers

_log = logging.getLogger("roomlight.server")
Clock = Callable[[], float]
"""Seconds that only go forward."""


class Registry:
    """Sessions that are held. Ids of different owners do not meet: another's session is not found."""

    def __init__(self, settings: ServerSettings, workers: Workers, metrics: Metrics, clock: Clock) -> None:
        """Empty."""
        self._settings, self._workers, self._metrics, self._clock = settings, workers, metrics, clock
        self._sessions: dict[tuple[str, str], LiveSession] = {}
        self._limits = Limits(
            frame=settings.frame_limits,
            frames_in_flight=settings.frames_in_flight,
            max_probes=settings.max_probes,
            idle_expiry_s=settings.idle_expiry_s,
        )
        self.stopping = False
        metrics.sessions.set_function(lambda: len(self._sessions))
        metrics.session_bytes.set_function(
            lambda: sum(live.state().memory.bytes for live in tuple(self._sessions.values()))
        )

    async def open(self, owner: str, name: str, request: SessionRequest) -> tuple[LiveSession, bool]:
        """The session, and whether it is new. Raises ProblemError: other options, no room, no such weights."""
        held = self._current(owner, name)
        if held is not None:
            return self._same(held, request), False
        try:
            graphs = await self._workers.graphs_of(request.mode)
        except ModelError as error:
            rule = (
                "`auto` takes what the server was started with, else trained networks if it has any, else `classical`"
            )
            detail = f"the server cannot serve it: {error}"
            raise ProblemError("model-not-here", detail, field="mode", value=request.mode, rule=rule) from error
        held = self._current(owner, name)  # another request may have made it meanwhile
        if held is not None:
            return self._same(held, request), False
        self._check_room()
        base = self._workers.base_options
        options = replace(
            base,
            model="classical" if graphs is None else base.model if request.mode == "auto" else request.mode,
            height=request.height,
            unknown_depth=request.unknown_depth,
        )
        live = LiveSession(
            name,
            request,
            engine=Session(options, graphs=graphs),
            workers=self._workers,
            footprint=Footprint.of(graphs, request.height),
            limits=self._limits,
            metrics=self._metrics,
        )
        most = self._settings.max_session_bytes
        if live.bound_bytes > most:
            rule = f"a session may come to {most} bytes at most; a lower height takes less"
            raise ProblemError(
                "invalid",
                f"with these options it could hold {live.bound_bytes} bytes",
                field="height",
                value=request.height,
                rule=rule,
            )
        live.last_used_s = self._clock()
        self._sessions[owner, name] = live
        _log.info("session opened", extra={"session": name, "model": live.state().model})
        return live, True

    @contextmanager
    def use(self, owner: str, name: str) -> Generator[LiveSession]:
        """The session, which does not expire meanwhile. Raises ProblemError (404)."""
        live = self._current(owner, name)
        if live is None:
            raise ProblemError(
                "session-not-found", "there is no session of this id; PUT it first", field="id", value=name
            )
        live.users += 1
        try:
            yield live
        finally:
            live.users -= 1
            live.last_used_s = self._clock()

    def delete(self, owner: str, name: str) -> None:
        """End a session. Raises ProblemError (404)."""
        with self.use(owner, name) as live:
            del self._sessions[owner, name]
            live.close()
            self._ended(name, "deleted")

    def expire(self) -> None:
        """End the sessions that nobody used for too long."""
        limit = self._clock() - self._settings.idle_expiry_s
        for key, live in tuple(self._sessions.items()):
            if live.users == 0 and live.last_used_s < limit:
                del self._sessions[key]
                live.close()
                self._ended(live.name, "expired")

    def close(self) -> None:
        """End all."""
        for live in self._sessions.values():
            live.close()
        self._sessions.clear()

    def _current(self, owner: str, name: str) -> LiveSession | None:
        self.expire()
        return self._sessions.get((owner, name))

    def _ended(self, name: str, reason: str) -> None:
        self._metrics.sessions_ended.labels(reason).inc()
        _log.info("session ended", extra={"session": name, "reason": reason})

    def _same(self, live: LiveSession, request: SessionRequest) -> LiveSession:
        if live.request != request:
            raise ProblemError(
                "session-conflict",
                "it was opened with other options; DELETE it first, or use another id",
                field="options",
                value=live.request.model_dump_json(),
                rule="the same options as before",
            )
        live.last_used_s = self._clock()
        return live

    def _check_room(self) -> None:
        if self.stopping:
            raise ProblemError("stopping", "the server is stopping", retry_after_s=5)
        most = self._settings.max_sessions
        if len(self._sessions) < most:
            return
        # the first that could expire; busy ones may well outlive it
        oldest = min(live.last_used_s for live in self._sessions.values())
        wait_s = oldest + self._settings.idle_expiry_s - self._clock()
        raise ProblemError(
            "server-full",
            f"{most} sessions are open; DELETE one that is no longer needed, or try later",
            rule=f"at most {most} sessions",
            retry_after_s=max(1, min(60, math.ceil(wait_s))),
        )
