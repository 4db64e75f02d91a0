"""Playing a recording to a server as a phone would stream it: at its real pace, newest frame first.

A frame that is due while `in_flight` others are unanswered is dropped here, as the server drops a frame that a newer
one overtakes: late frames are of no use. The frames in flight wait for a server that is away, so that the stream goes
on when it is back. Times are seconds of a monotonic clock. Latencies are milliseconds from
sending a frame to the answer that it is in the light.
"""

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Final

from annotated_types import Ge, Interval

from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.errors import OptionError, WireError
from roomlight.frame import Frame
from roomlight.notes import Note
from roomlight.placement import ABOVE_M, point_at_pixel, point_in_view
from roomlight.rules import check_options
from roomlight.wire.messages import FrameResult, ModelName
from roomlight_cli.options import Flag, Without
from roomlight_cli.shared_options import POINTS
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
"""Pace of a recording without timestamps: about what two cores keep up with."""
PROBE: Final = "stream"
"""Name of the probe whose light is shown."""
_WINDOW_S: Final = 5.0
_LOST_IN_A_ROW: Final = 5
"""Frames in a row without an answer after which the stream ends."""
_REASONS: Final = 5
"""Most reasons of refusal that are kept."""


@dataclass(frozen=True)
class StreamOptions:
    """What to play and how.

    Attributes:
        capture: How to read the capture.
        fps: Frames sent per second; a recording with timestamps keeps its pace and leaves frames out. For one without,
            this is the pace (default: 3).
        colour: How frames travel: jpeg as from a phone, png without loss, exact as floats.
        in_flight: Unanswered frames at the same time; other frames that are due are dropped. 2 upload one while the
            other is processed.
        probe: Show the light at this point: world metres, y up. Default: one point in front of the first camera.
        pixel: Show the light above the surface that this pixel of the first colour image shows: column U, row V from
            the top left.
        above_m: Distance in metres of the point of `--pixel` from its surface.
        session: Play into this session; default: a new one.
        keep: Leave the session on the server at the end, e.g. for a page that shows it.
        model: The session's model.
        height: Panorama height in pixels; the width is twice that.

    Raises:
        OptionError: A value is out of range, or there are two points.
    """

    capture: Annotated[CaptureOptions, Without("every")] = field(default_factory=CaptureOptions)
    fps: Annotated[float, Interval(ge=0.01, le=1000)] | None = None
    colour: FrameEncoding = "jpeg"
    in_flight: Annotated[int, Ge(1)] = 2
    probe: Annotated[Position | None, Flag(panel=POINTS)] = None
    pixel: Annotated[tuple[float, float] | None, Flag(panel=POINTS)] = None
    above_m: Annotated[float, Interval(ge=0, le=10), Flag(panel=POINTS)] = ABOVE_M
    session: Annotated[str | None, Flag(metavar="ID")] = None
    keep: bool = False
    model: ModelName = "auto"
    height: Annotated[int, Interval(ge=16, le=512)] = 120

    def __post_init__(self) -> None:
        check_options(self)
        if self.probe is not None and self.pixel is not None:
            raise OptionError("a stream shows the light at one point: give `probe` or `pixel`, not both")

    def probe_position(self, first: Frame) -> Position:
        """Return the point whose light is shown. Raises OptionError and ProbeError as `point_at_pixel` does."""
        if self.probe is not None:
            return self.probe
        if self.pixel is not None:
            return point_at_pixel(first, *self.pixel, above_m=self.above_m)
        return point_in_view(first)


@dataclass
class Tally:
    """Counts of frames by their outcome so far, and the light. It changes while the stream runs.

    due = sent + dropped; sent = processed + superseded + busy + overtaken + refused + lost + unanswered ones.

    Attributes:
        frames: Frames of the recording.
        due: Frames whose time has come.
        sent: Frames sent.
        processed: Frames in the light.
        dropped: Not sent, because `in_flight` others were unanswered.
        superseded: The server processed a newer frame instead.
        busy: The server's queue was full (429, 503).
        overtaken: Arrived after a newer frame.
        refused: Refused by the server; `reasons` holds the first few reasons.
        lost: Sent without an answer.
        unreadable: Bad frames of the recording itself.
        notes: What the recording states and was left out, guessed or changed.
        pace: 1 = as recorded; less where reading the recording does not keep up.
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
    notes: tuple[Note, ...] = ()
    pace: float = 1.0
    session_id: str = ""
    model: str = ""
    reasons: list[str] = field(default_factory=list[str])
    frame_ms: list[float] = field(default_factory=list[float])
    light_ms: list[float] = field(default_factory=list[float])
    light: Light | None = None
    _moments_s: deque[float] = field(default_factory=lambda: deque[float](maxlen=1000))

    def count(self, result: FrameResult, *, took_ms: float, now_s: float) -> None:
        """Count the answer to a frame."""
        if result.status == "superseded":
            self.superseded += 1
        elif result.status == "processed":
            self.processed += 1
            self.frame_ms.append(took_ms)
            self._moments_s.append(now_s)
        else:
            self.refuse(f"frame {result.index} is {result.status}")

    def refuse(self, reason: str) -> None:
        """Count a refused frame."""
        self.refused += 1
        if len(self.reasons) < _REASONS:
            self.reasons.append(reason)

    def rate(self, now_s: float) -> float:
        """Return frames processed per second, over the last 5 s."""
        recent = [moment for moment in self._moments_s if now_s - moment <= _WINDOW_S]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0


@dataclass(frozen=True)
class Clock:
    """The time in seconds, and sleeping; tests replace it by virtual time."""

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
    """Play a recording to a server, and delete the session at the end, after errors and cancellation too.

    Args:
        path: The recording.
        client: The server.
        options: What to play and how.
        tally: Counts to continue; None starts new ones.
        show: Called whenever the tally has changed.
        clock: The time.

    Returns:
        The tally.

    Raises:
        CaptureError: The recording cannot be read.
        OptionError: `pixel` lies outside the image.
        ProbeError: There is no depth to place the probe by.
        RemoteError: The server fails, or its session is gone.
    """
    tally = tally or Tally()
    async with AsyncExitStack() as stack:
        session = await client.open(options.session, model=options.model, height=options.height, reference_exposure=1.0)
        if not options.keep:
            await stack.enter_async_context(session)
        tally.session_id, tally.model = session.id, session.model
        player = _Player(session, options, tally, show or (lambda _: None), clock or Clock())
        try:
            await player.play(path)
        except ExceptionGroup as group:  # a task group's: the first error cancelled the other tasks
            raise group.exceptions[0] from None
    return tally


class _Player:
    def __init__(
        self,
        session: AsyncSession,
        options: StreamOptions,
        tally: Tally,
        show: Callable[[Tally], object],
        clock: Clock,
    ) -> None:
        self._session, self._options, self._tally, self._show, self._clock = session, options, tally, show, clock
        self._index_offset = session.next_index  # above 0 if the session existed
        self._unanswered = self._lost_in_a_row = 0
        self._light_task: asyncio.Task[None] | None = None

    async def play(self, path: Path) -> None:
        """Send all frames, and wait for the last answer."""
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
                    await self._session.track(PROBE, options.probe_position(frame))
                    first, started_s, due_from_s = frame, (now_s := clock.now()), now_s
                position_s = _seconds_since(first, frame, step_s * tally.due)
                wait_s = due_from_s + position_s - clock.now()
                if wait_s < 0:  # reading is slower than the recording: play slower, not in leaps
                    due_from_s -= wait_s
                await clock.sleep(max(0.0, wait_s))
                tally.due += 1
                tally.pace = position_s / max(position_s, clock.now() - started_s) if position_s else 1.0
                if self._unanswered >= options.in_flight:
                    tally.dropped += 1
                else:
                    tally.sent += 1
                    self._unanswered += 1
                    tasks.create_task(self._send(frame, tasks))
                self._show(tally)
            tally.unreadable, tally.notes = len(capture.skipped), capture.notes
        if tally.processed:
            await self._fetch_light()

    async def _send(self, frame: Frame, tasks: asyncio.TaskGroup) -> None:
        tally, clock = self._tally, self._clock
        began_s = clock.now()
        try:
            index = self._index_offset + frame.index
            result = await self._session.push(frame, index, colour=self._options.colour, retry="without answer")
        except BusyError:
            tally.busy += 1
        except (WireError, InvalidError) as error:
            tally.refuse(f"{frame.source}: {error}")
        except ConflictError as error:
            if error.kind != "frame-conflict":
                raise
            tally.overtaken += 1
        except UnreachableError:
            tally.lost += 1
            self._lost_in_a_row += 1
            if self._lost_in_a_row >= _LOST_IN_A_ROW:
                raise
        else:
            self._lost_in_a_row = 0
            now_s = clock.now()
            tally.count(result, took_ms=1e3 * (now_s - began_s), now_s=now_s)
            if result.status == "processed" and (self._light_task is None or self._light_task.done()):
                self._light_task = tasks.create_task(self._fetch_light())
        self._unanswered -= 1
        self._show(tally)

    async def _fetch_light(self) -> None:
        """Fetch the current light. A busy or silent server is no error here."""
        began_s = self._clock.now()
        try:
            self._tally.light = await self._session.light_at(PROBE, ("sh", "main_light"))
        except (BusyError, UnreachableError):
            return  # the next answer to a frame fetches it again
        self._tally.light_ms.append(1e3 * (self._clock.now() - began_s))
        self._show(self._tally)


def _seconds_since(first: Frame, frame: Frame, otherwise_s: float) -> float:
    """Return the seconds from the first frame to this one: the recording's, or `otherwise_s` without timestamps."""
    if first.timestamp_s is None or frame.timestamp_s is None:
        return otherwise_s
    return max(0.0, frame.timestamp_s - first.timestamp_s)
