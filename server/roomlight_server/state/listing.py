"""The sessions of an owner on disk, from the first records of their files."""

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Final

from pydantic import ValidationError

from roomlight.engine.state.records import read_first_records
from roomlight.errors import StateError
from roomlight_server.state.live_state import SavedValues
from roomlight_server.state.session_folder import STATE, session_folders

_RECORDS: Final = 2  # values of the server, values of the engine


@dataclass(frozen=True)
class SavedHead:
    """What a list shows of a saved session.

    Attributes:
        values: of the server.
        model: of the engine.
        idle_s: seconds since its last use, by the date of its file.
        bytes: of its files.
    """

    values: SavedValues
    model: str
    idle_s: float
    bytes: int


class SavedList:
    """Reads which sessions are on disk. Each file is read again only after it has changed."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = Lock()
        self._known: dict[str, tuple[tuple[int, int, int], SavedValues | None, str]] = {}

    def of(self, owner: str) -> list[SavedHead]:
        """Return the saved sessions of an owner (the digest that is stored), last used first.

        A file whose first records are damaged or of another version is left out: it does not say whose it is.
        """
        heads: list[SavedHead] = []
        with self._lock:
            folders = session_folders(self._root)
            for folder in folders:
                with contextlib.suppress(OSError):  # it was erased in the meantime, or is not complete yet
                    changed_s = self._read(folder)
                    _, values, model = self._known[folder.name]
                    if values is not None and values.owner == owner:
                        size = sum(file.stat().st_size for file in folder.iterdir())
                        heads.append(SavedHead(values, model, max(0.0, time.time() - changed_s), size))
            for name in self._known.keys() - {folder.name for folder in folders}:
                del self._known[name]
        return sorted(heads, key=lambda head: head.idle_s)

    def _read(self, folder: Path) -> float:
        """Read a file if it has changed; return the time of its last change in seconds."""
        path = folder / STATE
        stat = path.stat()
        version = (stat.st_ino, stat.st_size, stat.st_mtime_ns)
        known = self._known.get(folder.name)
        if known is None or known[0] != version:
            values, model = None, ""
            with contextlib.suppress(StateError, ValidationError, LookupError, TypeError):
                server, engine = read_first_records(path, _RECORDS)
                values, model = SavedValues.model_validate(server.values), str(engine.values["networks"]["model"])
            self._known[folder.name] = (version, values, model)
        return stat.st_mtime
