"""Untrusted zip files: members are read into memory under size limits, never unpacked to disk."""

import zipfile
import zlib
from pathlib import Path
from typing import Final
from urllib.parse import unquote

from roomlight.errors import FurnitureError

MAX_MEMBER_BYTES: Final = 192 << 20
"""The largest model of the Debian libraries is 21 MB of text; a member ten times as large is a zip bomb or an error."""

_MAX_MEMBERS: Final = 50_000


class Archive:
    """A zip file with an index of names; every failure is a FurnitureError that names the file and the member."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            FurnitureError: the file is missing, is not a zip file, or has too many members.
        """
        self.path: Final = path
        try:
            self._zip = zipfile.ZipFile(path)
        except FileNotFoundError as error:
            raise FurnitureError(f"{path}: no such file") from error
        except (OSError, zipfile.BadZipFile, ValueError) as error:
            raise FurnitureError(f"{path}: is not a zip file ({error}); a furniture library is a .sh3f file") from error
        names = self._zip.namelist()
        if len(names) > _MAX_MEMBERS:
            self._zip.close()
            raise FurnitureError(f"{path}: has {len(names)} files in it; the maximum is {_MAX_MEMBERS}")
        self._names = set(names)
        # Libraries made on Windows differ from their catalogue file in case and slashes.
        self._folded = {name.replace("\\", "/").lower(): name for name in names}

    def __enter__(self) -> "Archive":
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def find(self, name: str, *, relative_to: str = "") -> str | None:
        """Return the member of that name (from the root, or beside the member `relative_to`), or None.

        Raises:
            FurnitureError: the name leads out of the archive.
        """
        spelled = name.replace("\\", "/")
        if relative_to and not spelled.startswith("/"):
            spelled = relative_to.rpartition("/")[0] + "/" + spelled
        parts: list[str] = []
        for part in spelled.split("/"):
            if part == "..":
                if not parts:
                    raise FurnitureError(f"{self.path}: the path {name!r} leads out of the archive")
                parts.pop()
            elif part not in ("", "."):
                parts.append(part)
        wanted = "/".join(parts)
        for spelling in (wanted, unquote(wanted)):
            if spelling in self._names:
                return spelling
            if spelling.lower() in self._folded:
                return self._folded[spelling.lower()]
        return None

    def read(self, member: str, *, limit: int = MAX_MEMBER_BYTES) -> bytes:
        """Return the bytes of a member that `find` returned.

        Raises:
            FurnitureError: the member is damaged or longer than the limit.
        """
        try:
            with self._zip.open(member) as stream:
                data = stream.read(limit + 1)
        except (OSError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError) as error:
            raise FurnitureError(f"{self.path}: {member} cannot be unpacked ({error})") from error
        if len(data) > limit:
            raise FurnitureError(f"{self.path}: {member} is longer than {limit >> 20} MB unpacked")
        return data
