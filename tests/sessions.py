"""Sessions of frames, and their saved states, for tests."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from roomlight.engine.session import Session, SessionOptions
from roomlight.engine.state.encoding import records_of_snapshot, saved_session
from roomlight.engine.state.records import pack_records
from roomlight.frame import Frame


def session_of(frames: Iterable[Frame] = (), *, probes: Iterable[Any] = (), **options: Any) -> Session:
    """A session of the classical model, unless told otherwise, that tracks probes and then gets the frames."""
    session = Session(SessionOptions(**{"model": "classical", **options}))
    for probe in probes:
        session.track(probe)
    for frame in frames:
        session.push(frame)
    return session


def state_of(session: Session, elsewhere: Collection[int] = ()) -> bytes:
    """The bytes of a session's saved state, without the images of the frames that are `elsewhere`."""
    return pack_records(records_of_snapshot(session.snapshot(), elsewhere=elsewhere))


def session_from(state: bytes, bases: Mapping[int, Any] | None = None) -> Session:
    """The session of a saved state; `bases` are the frames that are kept elsewhere."""
    return Session.from_snapshot(saved_session(state, "room").snapshot(bases))
