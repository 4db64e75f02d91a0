"""Named probes of one session, and its light at these probes and at other points. Used on the event loop."""

import asyncio
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Final

from roomlight.conventions import NO_FRAME, Position
from roomlight.engine.session import FrameReport, Session
from roomlight.light.light import Light
from roomlight.wire.messages import ProbeQuery
from roomlight_server.answers.light_forms import default_panorama
from roomlight_server.base.problems import ProblemError, convert_probe_errors
from roomlight_server.sessions.engine_access import EngineAccess
from roomlight_server.sessions.quotas import Quotas
from roomlight_server.sessions.session_parts import LIGHT_PIXEL_BYTES, LightCache, cached_lights
from roomlight_server.state.live_state import NamedProbe
from roomlight_server.work.workers import Workers

_LATE: Final = 1
"""Order of late points among the work of engine threads: frames and new probes come first."""


class SessionLighting:
    """The named probes and the light of a session.

    Attributes:
        frame: Index of the last processed frame, after which light is answered; NO_FRAME before the first.
    """

    def __init__(self, access: EngineAccess, workers: Workers, quotas: Quotas, *, max_probes: int, height: int) -> None:
        """Begin without probes; panoramas have `height` rows."""
        self._access, self._workers, self._quotas = access, workers, quotas
        self._max_probes, self._height = max_probes, height
        self._named: dict[str, NamedProbe] = {}
        self._cache = LightCache(cached_lights(self.light_bytes))
        self.frame = NO_FRAME

    async def track(self, name: str, at: Sequence[float]) -> bool:
        """Track a named probe; an existing name moves to the new position. Return whether the name is new.

        Raises:
            ProblemError: There are too many probes, the position is unusable, or the session has ended.
        """
        # a client that disconnects meanwhile must not leave a probe in the engine that has no name
        return await asyncio.shield(asyncio.ensure_future(self._track(name, _position(at))))

    async def _track(self, name: str, position: Position) -> bool:
        async with self._access.engine_lock:
            engine, old = self._access.live(), self._named.get(name)
            if old is not None and old.position == position:
                return False
            if old is None and len(self._named) >= self._max_probes:
                limit = self._max_probes
                detail = f"the session already tracks {limit} named probes; delete one first"
                raise ProblemError("too-many-probes", detail, rule=f"at most {limit} probes")
            with self._quotas.adding_probe(self._height) if old is None else nullcontext():
                await self._replace_probe(engine, name, position)
            return old is None

    async def _replace_probe(self, engine: Session, name: str, position: Position) -> None:
        async with self._workers.engine_slot():
            handle = await convert_probe_errors(self._workers.run_in_engine_pool(engine.track, position))
        new = NamedProbe(position=position, handle=handle)
        if self.has_light:
            new.coverage = (await self._workers.run_in_decode_pool(engine.light, handle)).coverage
        async with self._access.state_lock:
            if name in self._named:
                self._remove(engine, name)
            self._named[name] = new
            self._access.changed(urgent=True)

    async def untrack(self, name: str) -> None:
        """Stop tracking a named probe.

        Raises:
            ProblemError: There is no probe of this name (404), or the session has ended.
        """
        async with self._access.engine_lock, self._access.state_lock:
            engine = self._access.live()
            self._named_probe(name)
            self._remove(engine, name)
            self._access.changed(urgent=True)

    def _remove(self, engine: Session, name: str) -> None:
        named = self._named.pop(name)
        engine.untrack(named.handle)
        self._cache.drop(name, named.position)

    async def at(self, queries: Sequence[ProbeQuery]) -> list[Light]:
        """Return the light at each point after the same frame, with its etag; before the first frame the default light.

        Raises:
            ProblemError: A probe name is unknown, a position is unusable, or the session has ended.
        """
        with self._quotas.late_probes(sum(query.name is None for query in queries)):
            async with self._access.state_lock:
                lights = await self._at_hand(queries)
            if None in lights:
                return await self._with_late_points(queries)
            return [light for light in lights if light is not None]

    async def _with_late_points(self, queries: Sequence[ProbeQuery]) -> list[Light]:
        """Compute late points from a view of the session: frames of every session go first, and change nothing."""
        async with self._workers.engine_slot(_LATE):
            async with self._access.state_lock:
                lights, frame = await self._at_hand(queries), self.frame
                view = await self._workers.read_in_engine_pool(self._access.live().view)
            late = [number for number, light in enumerate(lights) if light is None]
            positions = [self._position(queries[number]) for number in late]
            made = await convert_probe_errors(self._workers.read_in_engine_pool(view.lights_at, positions))
            etags = await self._workers.run_in_decode_pool(lambda: [light.digest() for light in made])
            identified = zip(late, made, etags, strict=True)
            kept = {number: self._kept(light, None, frame, etag) for number, light, etag in identified}
            return [light or kept[number] for number, light in enumerate(lights)]

    async def _at_hand(self, queries: Sequence[ProbeQuery]) -> list[Light | None]:
        """Return cached lights and those of named probes; None for late points."""
        engine = self._access.live()
        if not self.has_light:
            return [self._default(query) for query in queries]
        return [await self._light(engine, query) for query in queries]

    async def _light(self, engine: Session, query: ProbeQuery) -> Light | None:
        name = query.name
        cached = self._cache.get(name, self._position(query), self.frame)
        if cached is not None or name is None:
            return cached
        light, etag = await self._workers.run_in_decode_pool(_identified, engine, self._named[name].handle)
        return self._kept(light, name, self.frame, etag)

    def _kept(self, light: Light, name: str | None, frame: int, etag: str) -> Light:
        labelled = light.labelled(name=name, frame=frame, etag=etag)
        self._cache.put(labelled)
        return labelled

    def _default(self, query: ProbeQuery) -> Light:
        panorama, observed, etag = default_panorama(self._height)
        return Light(self._position(query), panorama, observed, 0.0, frame=NO_FRAME, name=query.name, etag=etag)

    def _position(self, query: ProbeQuery) -> Position:
        if query.name is not None:
            return self._named_probe(query.name).position
        assert query.position is not None
        return _position(query.position)

    def _named_probe(self, name: str) -> NamedProbe:
        named = self._named.get(name)
        if named is None:
            raise ProblemError("probe-not-found", f"the session has no probe {name!r}", field="name", value=name)
        return named

    @property
    def has_light(self) -> bool:
        """Whether a frame has been processed."""
        return self.frame != NO_FRAME

    @property
    def positions(self) -> dict[str, Position]:
        """Positions of the named probes."""
        return {name: named.position for name, named in self._named.items()}

    @property
    def handles(self) -> dict[str, int]:
        """Handles of the named probes in the engine."""
        return {name: named.handle for name, named in self._named.items()}

    @property
    def coverage(self) -> dict[str, float]:
        """Covered part of the sphere of each named probe."""
        return {name: round(named.coverage, 4) for name, named in self._named.items()}

    def take_coverage(self, engine: Session, report: FrameReport) -> None:
        """Take the coverage of the named probes from the report of a frame."""
        coverage = dict(zip(engine.handles, report.coverage, strict=True))
        for named in self._named.values():
            named.coverage = coverage.get(named.handle, named.coverage)

    @property
    def light_bytes(self) -> int:
        """Memory of one light."""
        return LIGHT_PIXEL_BYTES * 2 * self._height**2

    @property
    def cached_bytes(self) -> int:
        """Memory of the cached lights."""
        return len(self._cache) * self.light_bytes

    def clear(self) -> None:
        """Release the cached lights."""
        self._cache.clear()

    def saved(self) -> dict[str, NamedProbe]:
        """Return a copy of the named probes, for the state on disk."""
        return {name: named.model_copy() for name, named in self._named.items()}

    def restore(self, probes: dict[str, NamedProbe], frame: int) -> None:
        """Continue with saved probes, after a frame."""
        self._named, self.frame = probes, frame


def _position(coordinates: Sequence[float]) -> Position:
    x, y, z = coordinates
    return x, y, z


def _identified(engine: Session, handle: int) -> tuple[Light, str]:
    light = engine.light(handle)
    return light, light.digest()
