"""A recording played to a server as a phone would stream it: at its real pace, newest frame first, light on the way.

A frame that is due while enough others are on their way is dropped here, as the server drops one that a newer frame
overtakes: what is late is worth nothing. Times are seconds of a clock that only goes forward; latencies are
milliseconds from the moment a frame is handed over to the moment the light has it.
"""

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.errors import CaptureError, WireError
from roomlight.frame import Frame
from roomlight.placement import point_in_view
from roomlight.wire.messages import FrameResult, ModelName
from roomlight_client import (
    AsyncClient,
    AsyncSession,
    BusyError,
    ConflictError,
    FrameEncoding,
    InvalidError,
    Light,
    UnreachableError,
)

DEFAULT_FPS: Final = 3.0
"""Of a recording that has no times: about what two cores keep up with."""
PROBE: Final = "stream"
_WINDOW_S: Final = 5.0
_LOST_AT_MOST: Final = 5
"""Frames in a row without an answer: after them the server is gone."""
_TOLD: Final = 5


@dataclass(frozen=True)
class StreamOptions:
    """What to play and how.

    fps:         how many frames a second are sent; the recording keeps its own pace, and the frames in between are left
                 out (the nearest rate that every n-th frame gives). Of a recording without times it is the pace itself.
                 None: every frame.
    colour:      how frames travel; jpeg is what a phone sends.
    in_flight:   frames on their way at once: 2 upload one while the other is worked on.
    probe:       the point whose light is shown; None: one in front of the first camera.
    session_id:  play into this session; None: a new one.
    keep:        leave the session to others at the end, e.g. to a page that shows it.
    """

    capture: CaptureOptions = field(default_factory=CaptureOptions)
    fps: float | None = None
    colour: FrameEncoding = "jpeg"
    in_flight: int = 2
    probe: Position | None = None
    session_id: str | None = None
    keep: bool = False
    mode: ModelName = "auto"
    height: int = 120

    def __post_init__(self) -> None:
        """Refuse rates and numbers of frames at which nothing is sent."""
        if self.fps is not None and not 0.01 <= self.fps <= 1000:
            raise CaptureError(f"--fps must be 0.01 to 1000 frames a second, got {self.fps:g}")
        if self.in_flight < 1:
            raise CaptureError(f"--in-flight must be 1 or more, got {self.in_flight}")


@dataclass
class Tally:
    """What became of the frames so far, and the light. Changed while the stream runs.

    due = sent + dropped; sent = processed + superseded + busy + overtaken + refused + lost + those on their way.

    dropped:     not sent, because `in_flight` others were on their way.
    superseded:  the server let a newer one go before.
    busy:        the server had its hands full (429, 503).
    overtaken:   arrived after a newer one.
    refused:     not taken, with the first reasons in `reasons`; the recording's own bad frames are `unreadable`.
    lost:        no answer.
    pace:        1 = as recorded; less where reading the recording does not keep up.
    """

    frames: int = 0
    due: int = 0
    sent: int = 0
    processed: int = 0
    dropped: int = 0
    superseded: int = 0
    busy: int = 0
    overtaken: int = 0
    refused: int = 0
    lost: int = 0
    unreadable: int = 0
    pace: float = 1.0
    session_id: str = ""
    model: str = ""
    reasons: list[str] = field(default_factory=list[str])
    frame_ms: list[float] = field(default_factory=list[float])
    light_ms: list[float] = field(default_factory=list[float])
    light: Light | None = None
    _moments_s: deque[float] = field(default_factory=lambda: deque[float](maxlen=1000))

    def count(self, result: FrameResult, *, took_ms: float, now_s: float) -> None:
        """An answer to a frame."""
        if result.status == "superseded":
            self.superseded += 1
        elif result.status == "processed":
            self.processed += 1
            self.frame_ms.append(took_ms)
            self._moments_s.append(now_s)
        else:
            self.refuse(f"frame {result.index} is {result.status}")

    def refuse(self, reason: str) -> None:
        """A frame that was not taken."""
        self.refused += 1
        if len(self.reasons) < _TOLD:
            self.reasons.append(reason)

    def rate(self, now_s: float) -> float:
        """Frames processed a second, over the last 5 s."""
        recent = [moment for moment in self._moments_s if now_s - moment <= _WINDOW_S]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0


def percentile_ms(values: list[float], share: float) -> float | None:
    """The latency that this share of the answers stays under; None without an answer."""
    return float(np.percentile(values, 100 * share)) if values else None


@dataclass(frozen=True)
class Clock:
    """Time, so that tests need none: `now` in seconds, `sleep` for so many."""

    now: Callable[[], float] = time.perf_counter
    sleep: Callable[[float], Awaitable[object]] = asyncio.sleep


async def stream(
    path: Path,
    client: AsyncClient,
    options: StreamOptions,
    *,
    tally: Tally | None = None,
    show: Callable[[Tally], object] | None = None,
    clock: Clock | None = None,
) -> Tally:
    """Play a recording to a server. `show` is called whenever the tally has changed.

    Cancelled, or after an error, it still deletes its session. Raises RoomLightError.
    """
    tally = tally or Tally()
    async with AsyncExitStack() as stack:
        session = await client.open(
            options.session_id, model=options.mode, height=options.height, reference_exposure=1.0
        )
        if not options.keep:
            await stack.enter_async_context(session)
        tally.session_id, tally.model = session.id, session.model
        player = _Player(session, options, tally, show or _ignore, clock or Clock())
        try:
            await player.play(path)
        except ExceptionGroup as group:  # of a task group: the first that went wrong took the others with it
            raise group.exceptions[0] from None
    return tally


class _Player:
    """One recording on its way."""

    def __init__(
        self,
        session: AsyncSession,
        options: StreamOptions,
        tally: Tally,
        show: Callable[[Tally], object],
        clock: Clock,
    ) -> None:
        self._session, self._options, self._tally, self._show, self._clock = session, options, tally, show, clock
        self._before = session.next_index  # of a session that was there already
        self._flying = self._lost_in_a_row = 0
        self._light_task: asyncio.Task[None] | None = None

    async def play(self, path: Path) -> None:
        """To the end, and until the last answer is there."""
        options, tally, clock = self._options, self._tally, self._clock
        rate = open_capture(path, options.capture).frames_per_second
        stride = max(1, round(rate / options.fps)) if rate is not None and options.fps is not None else 1
        capture = open_capture(path, replace(options.capture, every=options.capture.every * stride))
        tally.frames = capture.frame_count
        step_s = 1 / (options.fps or DEFAULT_FPS)
        frames = iter(capture)
        started_s = due_from_s = clock.now()
        first: Frame | None = None
        async with asyncio.TaskGroup() as tasks:
            while (frame := await asyncio.to_thread(next, frames, None)) is not None:
                tally.unreadable = len(capture.skipped)
                if first is None:
                    await self._session.track(PROBE, options.probe or point_in_view(frame))
                    first, started_s, due_from_s = frame, (now_s := clock.now()), now_s
                position_s = _since(first, frame, step_s * tally.due)
                wait_s = due_from_s + position_s - clock.now()
                if wait_s < 0:  # reading is slower than the recording: it plays slower, rather than in leaps
                    due_from_s -= wait_s
                await clock.sleep(max(0.0, wait_s))
                tally.due += 1
                tally.pace = position_s / max(position_s, clock.now() - started_s) if position_s else 1.0
                if self._flying >= options.in_flight:
                    tally.dropped += 1
                else:
                    tally.sent += 1
                    self._flying += 1
                    tasks.create_task(self._send(frame, tasks))
                self._show(tally)
            tally.unreadable = len(capture.skipped)
        if tally.processed:
            await self._ask()

    async def _send(self, frame: Frame, tasks: asyncio.TaskGroup) -> None:
        tally, clock = self._tally, self._clock
        began_s = clock.now()
        try:
            index = self._before + frame.index
            result = await self._session.push(frame, index, colour=self._options.colour, retry=False)
        except BusyError:
            tally.busy += 1
        except WireError as error:
            tally.refuse(f"{frame.source}: {error}")
        except InvalidError as error:
            tally.refuse(f"{frame.source}: {error}")
        except ConflictError as error:
            if error.kind != "frame-conflict":
                raise
            tally.overtaken += 1
        except UnreachableError:
            tally.lost += 1
            self._lost_in_a_row += 1
            if self._lost_in_a_row >= _LOST_AT_MOST:
                raise
        else:
            self._lost_in_a_row = 0
            now_s = clock.now()
            tally.count(result, took_ms=1e3 * (now_s - began_s), now_s=now_s)
            if result.status == "processed" and (self._light_task is None or self._light_task.done()):
                self._light_task = tasks.create_task(self._ask())
        self._flying -= 1
        self._show(tally)

    async def _ask(self) -> None:
        """The light as of now; it may fail as a frame may."""
        began_s = self._clock.now()
        try:
            self._tally.light = await self._session.light_at(PROBE, ("sh", "main_light"))
        except (BusyError, UnreachableError):
            return
        self._tally.light_ms.append(1e3 * (self._clock.now() - began_s))
        self._show(self._tally)


def _since(first: Frame, frame: Frame, otherwise_s: float) -> float:
    """When a frame is due after the first, by the recording's clock if it has one that goes forward."""
    if first.timestamp_s is None or frame.timestamp_s is None:
        return otherwise_s
    return max(0.0, frame.timestamp_s - first.timestamp_s)


def _ignore(_: Tally) -> None:
    return None
