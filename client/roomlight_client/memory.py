"""What a client keeps of its session, to bring a server up to date that was started again.

The options, the tracked points and the last frames; no I/O.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from roomlight.conventions import Position
from roomlight.errors import OptionError
from roomlight.wire.messages import FrameResult, LightForm, SessionRequest, SessionState


@dataclass(frozen=True)
class BufferLimits:
    """Bounds of the frames that a client keeps. The newest frame is kept whatever its size.

    Attributes:
        frames: Number of frames. A server with a state directory writes frames down within 5 s.
        bytes: Bytes of their messages; an `exact` frame has 1.2 MB, one as JPEG 60 kB.

    Raises:
        OptionError: If a limit is below 1.
    """

    frames: int = 128
    bytes: int = 256_000_000

    def __post_init__(self) -> None:
        if min(self.frames, self.bytes) < 1:
            raise OptionError(f"the limits of the frame buffer must be at least 1, got {self}")


@dataclass
class KeptFrame:
    """A frame that may have to be sent again.

    Attributes:
        index: Its index.
        message: Its bytes on the wire.
        state: `waiting` to be sent; `sent`, without an answer; `done`, in the light unless the server loses it.
        sends: How often it was sent.
    """

    index: int
    message: bytes
    state: Literal["waiting", "sent", "done"]
    sends: int = 0


class FrameBuffer:
    """The last frames of a session, in the order of their indices."""

    def __init__(self, limits: BufferLimits) -> None:
        self._limits = limits
        self._kept: dict[int, KeptFrame] = {}
        self._forgotten_top = -1

    def __iter__(self) -> Iterator[KeptFrame]:
        return iter([self._kept[index] for index in sorted(self._kept)])

    @property
    def size(self) -> int:
        """Bytes of all messages."""
        return sum(len(frame.message) for frame in self._kept.values())

    def add(self, index: int, message: bytes, *, state: Literal["waiting", "sent"]) -> list[KeptFrame]:
        """Add a frame; return those dropped for it: first the oldest in the light, then the oldest."""
        added = self._kept[index] = KeptFrame(index, message, state, sends=1 if state == "sent" else 0)
        dropped: list[KeptFrame] = []
        while len(self._kept) > 1 and (len(self._kept) > self._limits.frames or self.size > self._limits.bytes):
            candidates = [frame for frame in self if frame is not added]
            frame = next((candidate for candidate in candidates if candidate.state == "done"), candidates[0])
            dropped.append(frame)
            self._forget(frame)
        return dropped

    def find(self, index: int) -> KeptFrame | None:
        """Return the frame of an index."""
        return self._kept.get(index)

    def remove(self, index: int) -> None:
        """Remove a frame that the server will not need again."""
        self._kept.pop(index, None)

    def settle(self, result: FrameResult) -> None:
        """Record a result. Only frames in the light are kept, until the server has written them down."""
        frame = self._kept.get(result.index)
        if frame is not None and result.status in ("processed", "queued"):
            frame.state = "done"
        else:
            self.remove(result.index)
        durable = -1 if result.durable_index is None else result.durable_index
        for frame in self:
            if frame.state == "done" and frame.index <= durable:
                self._forget(frame)

    def lacks(self, last_index: int | None) -> bool:
        """Return whether a session that has the frames up to this index lacks some that are no longer kept."""
        return self._forgotten_top > (-1 if last_index is None else last_index)

    def _forget(self, frame: KeptFrame) -> None:
        self.remove(frame.index)
        if frame.state != "waiting":
            self._forgotten_top = max(self._forgotten_top, frame.index)


class SessionMemory:
    """The memory of one session.

    Attributes:
        request: The options of a session that this client opened; None for one that it joined.
        frames: The last frames.
        probes: The points that this client tracks.
        changed: Names of points that were tracked or removed over a stream, until the server says so.
        forms: The forms of the stream's subscription.
        deleted: Whether the app has deleted the session, which then must not be opened again.
    """

    def __init__(self, request: SessionRequest | None, limits: BufferLimits) -> None:
        self.request = request
        self.frames = FrameBuffer(limits)
        self.probes: dict[str, Position] = {}
        self.changed: set[str] = set()
        self.forms: tuple[LightForm, ...] = ()
        self.deleted = False

    @property
    def can_reopen(self) -> bool:
        """Whether a missing session may be opened again."""
        return self.request is not None and not self.deleted

    def track(self, name: str, position: Position) -> None:
        """Record a tracked point."""
        self.probes[name] = position
        self.changed.discard(name)

    def untrack(self, name: str) -> None:
        """Record that a point is no longer tracked."""
        self.probes.pop(name, None)
        self.changed.discard(name)

    def confirm(self, probes: Mapping[str, Sequence[float]]) -> None:
        """Record that the session has these points, and no others."""
        self.changed = {name for name in self.changed if self._differs(name, probes)}

    def probe_changes(self, state: SessionState) -> tuple[dict[str, Position], tuple[str, ...]]:
        """Return the points that the session lacks, and the names that it has too much.

        In a joined session what others changed stays, unless it has no points at all, as after a restart of the server.
        """
        self.confirm(state.probes)
        restored = self.changed if self.request is None and state.probes else self.probes
        missing = {
            name: at for name, at in self.probes.items() if name in restored and self._differs(name, state.probes)
        }
        unwanted = tuple(name for name in self.changed if name not in self.probes)
        return missing, unwanted

    def _differs(self, name: str, probes: Mapping[str, Sequence[float]]) -> bool:
        return [float(value) for value in self.probes.get(name, ())] != list(probes.get(name, ()))
