"""Replay of an uploaded recording into a session, at the recording's pace, as a phone would stream it.

The recording is read in a process of its own (`recordings.worker`). Frames that the engine cannot keep up with are
superseded by newer ones, as with any stream.
"""

import asyncio
import json
import logging
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from roomlight.threads import thread_count
from roomlight.wire.messages import Problem
from roomlight.wire.recordings import ReplayRequest
from roomlight_server.base.problems import INTERNAL_DETAIL, ProblemError
from roomlight_server.recordings.jobs import RECORD
from roomlight_server.sessions.live_session import LiveSession
from roomlight_server.work.processes import with_few_threads

_log = logging.getLogger("roomlight.server")
READ_TIMEOUT_S: Final = 60.0
"""Time limit for reading one frame; the first includes the start of the process."""
_MAX_RECORD_BYTES: Final = 64 * 2**20
VIEW: Final = "view"
"""Name of the probe in front of the first camera."""


@dataclass
class Progress:
    """How far a replay is.

    Attributes:
        session: id of the session; None before the first replay.
        frames: frames that are played; None until the recording is open.
        frame: frames sent to the session.
        unreadable: frames that could not be read or used.
        notes: what the recording states and was left out, guessed or changed.
        film_frames, film_fps: frames that a film of it can have, and their rate.
        problem: why the replay failed.
    """

    session: str | None
    frames: int | None = None
    frame: int = 0
    unreadable: int = 0
    notes: list[str] = field(default_factory=list[str])
    film_frames: int | None = None
    film_fps: float | None = None
    problem: Problem | None = None


class Player:
    """Plays one recording into one session. `run` is a task; cancel it to stop."""

    def __init__(
        self, folder: Path, request: ReplayRequest, live: LiveSession, *, max_probes: int, clock: Callable[[], float]
    ) -> None:
        """Prepare a replay of the recording in a folder."""
        self._folder, self._request, self._live, self._clock = folder, request, live, clock
        self._max_probes = max_probes
        self.progress = Progress(request.session)

    async def run(self) -> None:
        """Play the recording to its end; a failure is in `progress.problem`."""
        rate = "-" if self._request.fps is None else repr(self._request.fps)
        try:
            async with reading_process("worker", str(self._folder), rate, stdin=DEVNULL) as process:
                await self._play(process)
        except ProblemError as error:
            self.progress.problem = error.problem
        except Exception:
            _log.exception("replay failed", extra={"session": self._live.name})
            self.progress.problem = ProblemError("internal", INTERNAL_DETAIL).problem

    async def _play(self, process: Process) -> None:
        described, _ = await read_record(process, READ_TIMEOUT_S)
        self.progress.frames = described["frames"]
        self.progress.film_frames, self.progress.film_fps = described["film_frames"], described["film_fps"]
        start_s: float | None = None
        while True:
            text, body = await read_record(process, READ_TIMEOUT_S)
            if "preparing" in text:
                continue
            self.progress.unreadable, self.progress.notes = text["unreadable"], text["notes"]
            if "end" in text:
                break
            if start_s is None:
                await self._track(described["probes"], text["view"])
                start_s = self._clock()
            wait_s = start_s + text["due_s"] - self._clock()
            if wait_s > 0:
                await asyncio.sleep(wait_s)
            await self._send(body)
        if self.progress.frame == 0:
            raise _unreadable("; ".join(text["reasons"]) or "it has no usable frame")

    async def _track(self, stated: list[list[float]], view: list[float] | None) -> None:
        """Track the requested probes; by default those of the recording, and one in front of the first camera."""
        places: dict[str, list[float]] = {}
        if self._request.probes is not None:
            places = dict(self._request.probes)
        else:
            if view is not None:
                places[VIEW] = view
            places |= {f"probe-{number}": place for number, place in enumerate(stated, start=1)}
        for name, place in list(places.items())[: self._max_probes]:
            await self._live.lighting.track(name, place)

    async def _send(self, body: bytes) -> None:
        """Send a frame to the session; up to `frames_in_flight` are processed or wait."""
        await self._live.slots.acquire()
        try:
            entry = await self._live.accept(body, self.progress.frame)
        except ProblemError as error:
            self._live.slots.release()
            if error.kind in ("session-failed", "session-closed"):
                raise
            self.progress.unreadable += 1
            return
        except BaseException:
            self._live.slots.release()
            raise
        self.progress.frame += 1
        entry.outcome.add_done_callback(self._on_outcome)

    def _on_outcome(self, outcome: "asyncio.Future[Any]") -> None:
        self._live.slots.release()
        if not outcome.cancelled():
            outcome.exception()  # marks it as retrieved; the session counts refused frames


@asynccontextmanager
async def reading_process(module: str, *arguments: str, stdin: int) -> AsyncGenerator[Process]:
    """Run a module of this package in a process, which has ended after the context. Raises OSError if none can start.

    Its `stdin` is that of `subprocess`; its output is read with `read_record`.
    """
    command = [sys.executable, "-P", "-m", f"{__package__}.{module}", *arguments]
    environment = with_few_threads(thread_count())
    process = await asyncio.create_subprocess_exec(*command, stdin=stdin, stdout=PIPE, env=environment)
    try:
        yield process
    finally:
        await _end(process)


async def _end(process: Process) -> None:
    """Kill a process and wait for its end, also if the caller is cancelled meanwhile."""
    if process.returncode is None:
        process.kill()
    ended = asyncio.ensure_future(process.communicate())  # reads to the end: a pipe that is not read stays open
    try:
        await asyncio.shield(ended)
    finally:
        await ended


async def read_record(process: Process, timeout_s: float) -> tuple[dict[str, Any], bytes]:
    """Read a record of a process that reads recordings. Raises ProblemError if it cannot, or not in time."""
    assert process.stdout is not None
    try:
        async with asyncio.timeout(timeout_s):
            text_bytes, body_bytes = RECORD.unpack(await process.stdout.readexactly(RECORD.size))
            if text_bytes + body_bytes > _MAX_RECORD_BYTES:
                raise _unreadable("a frame is too large")
            text = json.loads(await process.stdout.readexactly(text_bytes))
            body = await process.stdout.readexactly(body_bytes)
    except TimeoutError:
        raise _unreadable(f"a frame takes more than {timeout_s:g} s") from None
    except asyncio.IncompleteReadError:
        raise _unreadable("a file ends the process that reads it; it may be damaged or too large") from None
    if "place" in text:
        raise ProblemError("bad-place", text["place"], field="objects", rule=text["place"])
    if "problem" in text:
        raise _unreadable(text["problem"])
    return text, body


def _unreadable(reason: str) -> ProblemError:
    return ProblemError("bad-recording", f"the recording cannot be played: {reason}", rule=reason)
