"""What is unsaved of one session, and which of its keyframes are on disk. Used on the event loop."""

from collections.abc import Callable

from roomlight.wire.frame_message import FrameMessage
from roomlight_server.state.live_state import SavedBase

MAX_MESSAGE_BYTES = 2 * 2**20
"""Larger messages of keyframes (raw images of a camera) are stored as pixels of the working size, 0.6 MB."""


class Journal:
    """Changes of a session since it was last saved.

    Attributes:
        messages: Messages of keyframes that are not on disk yet, as they came, by index.
        bases: Files of the keyframes on disk, by index.
        durable_index: Every frame up to this index is on disk; None before the first.
        failing: Whether the last write that ended has failed.
        closed: Whether the session has ended: nothing of it is written any more.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        """Begin with a session of which nothing is saved. `clock` returns seconds."""
        self._clock = clock
        self._unsaved_since_s: float | None = clock()
        self._saving_since_s: float | None = None
        self._urgent = True
        self._started_s = float("-inf")
        self.messages: dict[int, bytes] = {}
        self.bases: dict[int, SavedBase] = {}
        self.durable_index: int | None = None
        self.failing = self.closed = False

    def changed(self, *, urgent: bool = False) -> None:
        """Record a change. An urgent one (probes) is saved as soon as possible."""
        if self._unsaved_since_s is None:
            self._unsaved_since_s = self._clock()
        self._urgent |= urgent

    def processed(self, index: int, message: FrameMessage, *, keyframe: bool, most: int) -> None:
        """Record a processed frame; keep the message of a keyframe until it is written, at most the newest `most`.

        One without depth makes no frame again, whose depth was estimated: the frame is stored as pixels.
        """
        self.changed()
        if keyframe and message.depth is not None:
            body = body_of(message)
            if len(body) <= MAX_MESSAGE_BYTES:
                self.messages[index] = body
            if len(self.messages) > most:  # a write hangs: the oldest keyframe is gone, or is stored as pixels
                del self.messages[min(self.messages)]

    def is_due(self, period_s: float) -> bool:
        """Return whether to save now: something is unsaved, and the last start was `period_s` ago or it is urgent."""
        if self.closed or self._unsaved_since_s is None:
            return False
        return self._urgent or self._clock() - self._started_s >= period_s

    def begin(self) -> None:
        """Begin to save: what changes from now on counts as unsaved again."""
        self._started_s, self._urgent = self._clock(), False
        self._saving_since_s, self._unsaved_since_s = self._unsaved_since_s, None

    def saved(self, bases: dict[int, SavedBase], processed_index: int, durable_index: int | None) -> None:
        """Record that the state after the frame `processed_index` is on disk, with these files."""
        self.bases, self.durable_index, self._saving_since_s, self.failing = bases, durable_index, None, False
        self.messages = {index: body for index, body in self.messages.items() if index > processed_index}

    def failed(self) -> None:
        """Record that the state could not be written. Messages are released: their frames are stored as pixels."""
        self.messages.clear()
        self.failing = True
        if self._saving_since_s is not None:
            self._unsaved_since_s = self._saving_since_s

    @property
    def is_unsaved(self) -> bool:
        """Whether something is not on disk yet that is to be written."""
        return not self.closed and self.unsaved_s > 0

    @property
    def unsaved_s(self) -> float:
        """Seconds since the oldest change that is not on disk; 0 if all is saved."""
        since_s = self._saving_since_s if self._saving_since_s is not None else self._unsaved_since_s
        return 0.0 if since_s is None else self._clock() - since_s


def body_of(message: FrameMessage) -> bytes:
    """Return the bytes of a message as it came; its parts are views of them."""
    return bytes(message.colour.obj)
