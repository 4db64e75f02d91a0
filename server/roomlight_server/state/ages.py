"""How long saved sessions have not been used, counted while a server runs.

Dates of files and the clock on the wall do not decide: a clock that is set two days ahead would erase every session.
"""

import contextlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from roomlight.errors import OutputError
from roomlight.files import write_durable


class SavedAges:
    """Seconds since the last use of each saved session, kept in a file so that they continue after a restart."""

    def __init__(self, file: Path, clock: Callable[[], float]) -> None:
        """Continue from the file, if it is there; `clock` is monotonic, in seconds."""
        self._file, self._clock = file, clock
        self._at_s = clock()
        self._ages: dict[str, tuple[str, float]] = {}  # by folder: version of its state, seconds
        with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):
            ages = json.loads(file.read_bytes())
            self._ages = {str(name): (str(version), float(age_s)) for name, (version, age_s) in ages.items()}

    def advance(self, versions: Mapping[str, str], in_use: Iterable[str]) -> dict[str, float]:
        """Add the time since the last call, and return the age of each session in seconds.

        Args:
            versions: What changes when a session is written or touched, by folder. A new one begins at 0.
            in_use: Folders of sessions that are open; they stay at 0.
        """
        now_s = self._clock()
        passed_s, self._at_s = max(0.0, now_s - self._at_s), now_s
        ages: dict[str, tuple[str, float]] = {}
        for name, version in versions.items():
            before = self._ages.get(name)
            unchanged = before is not None and before[0] == version and name not in in_use
            ages[name] = (version, before[1] + passed_s if before is not None and unchanged else 0.0)
        self._ages = ages
        with contextlib.suppress(OutputError):  # a full disk: the ages begin again at the last ones that were written
            write_durable(self._file, json.dumps(ages).encode())
        return {name: age_s for name, (_, age_s) in ages.items()}
