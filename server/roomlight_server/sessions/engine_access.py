"""Access to the engine of one session: its locks, the end of the session, and what changes are recorded in."""

import asyncio

from roomlight.engine.session import Session
from roomlight_server.base.problems import ProblemError
from roomlight_server.state.journal import Journal


class EngineAccess:
    """The engine of a session, until the session ends.

    Attributes:
        engine_lock: One engine call at a time (push, track, untrack), in the order of arrival;
            held while this session waits behind others for a slot of the engine's threads.
        state_lock: The engine's state and the named probes; held only while they change. Reading the light of named
            probes takes this lock alone: it waits for a frame in the engine, and not for a slot; late points take it
            for a view of the engine.
        engine: The engine; None after the end.
        ended: The reason why the session has ended, or None.
        journal: What is unsaved; None if sessions are not saved.

    Locks are taken in this order: engine_lock, an engine slot of the workers, state_lock.
    """

    def __init__(self, engine: Session) -> None:
        self.engine_lock, self.state_lock = asyncio.Lock(), asyncio.Lock()
        self.engine: Session | None = engine
        self.ended: ProblemError | None = None
        self.journal: Journal | None = None

    def check_open(self) -> None:
        """Check that the session is usable. Raises ProblemError if the session has failed or was closed."""
        if self.ended is not None:
            raise self.ended

    def live(self) -> Session:
        """Return the engine. Raises ProblemError if the session has ended."""
        self.check_open()
        assert self.engine is not None
        return self.engine

    def end(self, reason: ProblemError) -> None:
        """Release the engine; later uses are answered with this reason."""
        self.ended, self.engine = reason, None

    def changed(self, *, urgent: bool = False) -> None:
        """Record a change that is not on disk yet. An urgent one is saved as soon as possible."""
        if self.journal is not None:
            self.journal.changed(urgent=urgent)
