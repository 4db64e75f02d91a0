"""Processes that make composites of the qualities `good` and `final`: limited, killed at a deadline or when in vain."""

import pickle
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from roomlight.engine.options import SessionOptions
from roomlight.engine.state.snapshot import SessionSnapshot
from roomlight.errors import SceneError
from roomlight.frame import Frame
from roomlight.wire.compositing import CompositeFormat, CompositeQuality
from roomlight_server.work.processes import Cancellation, KilledError, Processes

if TYPE_CHECKING:
    from roomlight.compositing.placement.scene import Scene

MAX_MEMORY_BYTES: Final = 4 * 2**30
"""Address space of a process, of which libraries and networks take 2 GB."""


class CompositeJob(NamedTuple):
    """A composite that is to be made: the session after a frame, the frame, and what is asked for."""

    snapshot: SessionSnapshot
    options: SessionOptions
    frame: Frame
    scene: "Scene"
    quality: CompositeQuality
    form: CompositeFormat


class Composited(NamedTuple):
    """A composite: the poses of its objects and the share of each that is seen, by name, and the answer's bytes."""

    poses: dict[str, list[float]]
    visible: dict[str, float]
    data: bytes


class CompositeMemoryError(Exception):
    """A composite needs more memory than its process may have."""


class CompositeProcesses(Processes):
    """Composite processes. Methods may be called on any thread."""

    def __init__(self) -> None:
        super().__init__("roomlight_server.answers.composite_worker", "composite", spare=False)

    def composite(self, job: CompositeJob, timeout_s: float, cancel: Cancellation) -> Composited:
        """Make a composite.

        Raises:
            SceneError: A place is refused, or an object is not in view.
            CompositeMemoryError: It needs too much memory.
            TimeoutError: It takes longer than `timeout_s`.
            RuntimeError: It failed.
        """
        body = pickle.dumps(tuple(job), protocol=pickle.HIGHEST_PROTOCOL)
        try:
            return self._request({"work": "composite"}, body, timeout_s, _composited, retry=False, cancel=cancel)
        except KilledError as error:
            # A library in C++ that gets no memory may end its process: the log says which of the two it was.
            raise (TimeoutError if error.reason == "late" else CompositeMemoryError)(str(error)) from error


def _composited(text: dict[str, Any], data: memoryview) -> Composited:
    if "refused" in text:
        raise SceneError(text["refused"])
    return Composited(text["poses"], text["visible"], bytes(data))
