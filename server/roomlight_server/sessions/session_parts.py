"""Parts of a live session: its slots for frames in flight, the lights it has computed."""

import asyncio
from collections import OrderedDict
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Final

from roomlight.conventions import Position
from roomlight.light.light import Light
from roomlight_server.base.problems import ProblemError

LIGHT_PIXEL_BYTES: Final = 52
"""Memory of a light for each pixel, float32: what its probe has accumulated (7), and two panoramas (6)."""
MAX_CACHED_LIGHTS: Final = 8
"""Most lights cached for requests of more forms and for `If-None-Match`; 1.5 MB each at a height of 120."""
SCENE_BYTES: Final = 2**17
"""Memory of a scene: 16 objects with a pose of 16 numbers each take 20 kB."""
_MIN_CACHED_LIGHTS: Final = 2
_CACHE_BYTES: Final = 12 * 2**20


def cached_lights(light_bytes: int) -> int:
    """Return how many lights of this size are cached: fewer of tall panoramas."""
    return min(MAX_CACHED_LIGHTS, max(_MIN_CACHED_LIGHTS, _CACHE_BYTES // light_bytes))


class FrameSlots:
    """Slots for frames in flight (being received, decoded or processed)."""

    def __init__(self, limit: int, check_open: Callable[[], None]) -> None:
        """Make all slots free; `check_open` raises ProblemError if the session has ended."""
        self._limit, self._free, self._check_open = limit, asyncio.Semaphore(limit), check_open
        self.taken = 0

    @asynccontextmanager
    async def slot(self) -> AsyncGenerator[None]:
        """Hold a slot. Raises ProblemError if all are taken (429), or the session has ended."""
        self._check_open()
        if self._free.locked():
            limit = self._limit
            detail = f"{limit} frames of this session are in flight; retry with a newer frame"
            raise ProblemError("session-full", detail, rule=f"at most {limit} frames in flight", retry_after_s=1)
        await self.acquire()
        try:
            yield
        finally:
            self.release()

    async def acquire(self) -> None:
        """Wait for a slot; `release` frees it. Raises ProblemError if the session has ended."""
        self._check_open()
        await self._free.acquire()
        self.taken += 1

    def release(self) -> None:
        """Free a slot."""
        self.taken -= 1
        self._free.release()


class LightCache:
    """The lights computed last, by name and position."""

    def __init__(self, capacity: int) -> None:
        """Make an empty cache of at most `capacity` lights."""
        self._capacity = capacity
        self._lights: OrderedDict[tuple[str | None, Position], Light] = OrderedDict()

    def __len__(self) -> int:
        return len(self._lights)

    def get(self, name: str | None, position: Position, frame: int) -> Light | None:
        """Return the light after this frame, if it is cached."""
        light = self._lights.get((name, position))
        if light is None or light.frame != frame:
            return None
        self._lights.move_to_end((name, position))
        return light

    def put(self, light: Light) -> None:
        """Add a light; the one that was used longest ago is dropped."""
        self._lights[light.name, light.position] = light
        while len(self._lights) > self._capacity:
            self._lights.popitem(last=False)

    def drop(self, name: str, position: Position) -> None:
        """Remove the light of a named probe."""
        self._lights.pop((name, position), None)

    def clear(self) -> None:
        """Remove all lights."""
        self._lights.clear()
