"""A session in one file: `Session.save` and `Session.load`."""

from pathlib import Path

from roomlight.engine.state.encoding import records_of_snapshot, saved_session
from roomlight.engine.state.records import pack_records
from roomlight.engine.state.snapshot import SessionSnapshot
from roomlight.errors import StateError
from roomlight.files import write_durable


def write_session(path: Path, snapshot: SessionSnapshot) -> None:
    """Write a snapshot with the pixels of its kept frames.

    Raises:
        OutputError: The file cannot be written.
    """
    write_durable(path, pack_records(records_of_snapshot(snapshot)))


def read_session(path: Path) -> SessionSnapshot:
    """Read a snapshot.

    Raises:
        StateError: The file cannot be read, or is no saved session of this version, or is damaged.
    """
    try:
        file = path.read_bytes()
    except OSError as error:
        raise StateError(f"{path}: cannot be read ({error.strerror or error})") from error
    return saved_session(file, str(path)).snapshot()
