"""The files of an uploaded recording: pieces in order, checked paths, an exact announced size.

Only this module writes them. It creates folders and regular files alone, so no link can lead out of the folder.
"""

import re
import shutil
import unicodedata
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from roomlight.wire.recordings import RecordingRequest
from roomlight_server.base.problems import ProblemError

PIECE_PATH: Final = re.compile(r"/v1/recordings/[^/]+/files/.+")
"""Requests whose body is a piece of a file."""
MAX_PIECE_BYTES: Final = 8 * 2**20
"""Largest piece of a file."""
MAX_DEPTH: Final = 8
"""Most parts of a path; known formats have at most four."""
MAX_PART_BYTES: Final = 200
"""Longest part of a path; file systems allow 255."""


def check_path(path: str) -> tuple[str, ...]:
    """Return the parts of a relative path.

    Raises:
        ProblemError: The path is absolute, leads out of the folder, is hidden, too long or has unusual letters (422).
    """
    parts = tuple(path.split("/"))
    rule = None
    if len(parts) > MAX_DEPTH:
        rule = f"at most {MAX_DEPTH} parts"
    elif any(not part or part.startswith(".") for part in parts):
        rule = "must be relative; no part may be empty or begin with a dot"
    elif any(len(part.encode("utf-8", "surrogatepass")) > MAX_PART_BYTES for part in parts):
        rule = f"at most {MAX_PART_BYTES} bytes per part"
    elif "\\" in path or any(unicodedata.category(letter)[0] == "C" for letter in path):
        rule = "no backslashes and no control characters"
    if rule is not None:
        detail = f"the path {path[:200]!r} cannot be used: {rule}"
        raise ProblemError("invalid", detail, field="path", value=path, rule=rule)
    return parts


class RecordingFiles:
    """The folder of one upload. Sizes are kept in memory; other threads write, one piece of a file at once."""

    def __init__(self, folder: Path, announced: RecordingRequest) -> None:
        self.folder, self.announced = folder, announced
        self.received = 0
        """Bytes written."""
        self._sizes: dict[tuple[str, ...], int] = {}
        self._folders: set[tuple[str, ...]] = set()
        self._busy: set[tuple[str, ...]] = set()
        self._reserved, self._deleted = 0, False
        folder.mkdir(mode=0o700)

    @property
    def files(self) -> int:
        """Files that have begun."""
        return len(self._sizes)

    @property
    def complete(self) -> bool:
        """Whether all announced bytes and files are there."""
        return self.received == self.announced.bytes and self.files == self.announced.files and not self._busy

    @contextmanager
    def piece(self, path: str, offset: int, size: int) -> Generator[Path]:
        """Reserve a piece of a file; inside the context, write it with `append` to the file that is yielded.

        Raises:
            ProblemError: The path is unusable (422), the piece does not continue the file (409), or there are more
                bytes or files than announced (422).
        """
        parts = check_path(path)
        expected = self._sizes.get(parts, 0)
        if offset != expected or parts in self._busy:
            state = "another piece of it is being written" if parts in self._busy else f"it has {expected} bytes"
            detail = f"{path}: the piece begins at {offset}, but {state}"
            rule = f"must be {expected}"
            raise ProblemError("upload-offset", detail, field="Upload-Offset", value=offset, rule=rule)
        new = parts not in self._sizes
        rule = None
        if self.received + self._reserved + size > self.announced.bytes:
            rule = f"at most {self.announced.bytes} bytes, as announced"
        elif new and len(self._sizes) + len(self._busy - self._sizes.keys()) >= self.announced.files:
            rule = f"at most {self.announced.files} files, as announced"
        elif parts in self._folders or any(parts[:depth] in self._sizes for depth in range(1, len(parts))):
            rule = "a file and a folder must have different names"
        if rule is not None:
            raise ProblemError("invalid", f"{path}: {rule}", field="path", value=path, rule=rule)
        self._busy.add(parts)
        self._folders |= {parts[:depth] for depth in range(1, len(parts))}
        self._reserved += size
        try:
            yield self.folder.joinpath(*parts)
            self._sizes[parts] = expected + size
            self.received += size
        finally:
            self._busy.discard(parts)
            self._reserved -= size
            if self._deleted:
                self.delete()

    def size_of(self, path: str) -> int:
        """Return the bytes of a file so far; 0 if it has not begun."""
        return self._sizes.get(tuple(path.split("/")), 0)

    def delete(self) -> None:
        """Delete all files."""
        self._deleted = True
        shutil.rmtree(self.folder, ignore_errors=True)


def append(file: Path, offset: int, data: bytes) -> None:
    """Write a piece at its place; what a failed attempt left after it is cut off.

    Raises:
        OSError: The disk is full, or the recording was deleted.
    """
    if not file.parent.is_dir():
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with file.open("r+b" if offset else "wb") as stream:
        stream.seek(offset)
        stream.write(data)
        stream.truncate()
