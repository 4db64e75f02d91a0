"""Files that an object's file names: glTF's buffers and images, OBJ's materials and their textures."""

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import FrameError, ObjectError
from roomlight.files import FolderSource

_CODE_PAGES: Final = ("gb18030", "cp932", "big5", "cp949", "cp1251")
"""That names of files may be in, beside UTF-8 and Latin-1."""


class FilesBeside:
    """The files in an object's folder and in folders inside it; none for an object that came as bytes."""

    def __init__(self, folder: Path | None, limits: ObjectLimits, file_bytes: int) -> None:
        """Begin with the object's own file.

        Args:
            file_bytes: Its size, which counts toward `ObjectLimits.file_bytes`.
        """
        self._source = None if folder is None else FolderSource(folder, follow_folders=False)
        self._limits, self._bytes = limits, file_bytes

    @property
    def exists(self) -> bool:
        """Whether there is a folder to read from."""
        return self._source is not None

    def near(self, stated: str) -> str | None:
        """Return the name under which a file that another computer names lies here, None if it does not.

        Args:
            stated: Its name, text that is not UTF-8 as Latin-1; or its address there, of which the last part counts; a
                comment may follow.
        """
        if self._source is None:
            return None
        for name in _spellings(stated):
            with contextlib.suppress(FrameError):
                self._source.path(name, max_bytes=None)
                return name
        return None

    def read(self, uri: str, label: str) -> bytes:
        """Return a file's content.

        Args:
            uri: Its address relative to the object's file.

        Raises:
            ObjectError: It is not inside the folder, is missing or cannot be read, or all together pass `file_bytes`.
        """
        if self._source is None:
            raise ObjectError(f"{label} is at {uri[:60]!r}, outside the file; export as one GLB file")
        if "://" in uri:
            raise ObjectError(f"{label} is at {uri[:60]!r}; addresses are not loaded: put the file beside the object")
        try:
            path = self._source.path(uri, max_bytes=None)
            self._bytes += path.stat().st_size
            self._limits.check("file_bytes", self._bytes, label)
            return path.read_bytes()
        except (FrameError, OSError) as error:
            raise ObjectError(f"{label}: {error}; put it into the object's folder, or export as GLB") from error


def _spellings(stated: str) -> Iterator[str]:
    """Yield what a name may be here: as it stands, its last part alone, both in other code pages and uncommented."""
    for name in dict.fromkeys((stated, stated.partition(" #")[0].strip())):
        names = [name]
        with contextlib.suppress(UnicodeEncodeError):
            raw = b"" if name.isascii() else name.encode("latin-1")
            names.append(os.fsdecode(raw))
            for page in _CODE_PAGES:
                with contextlib.suppress(UnicodeDecodeError):
                    names.append(raw.decode(page))
        yield from names
        yield from (re.split(r"[/\\]", name)[-1] for name in names)
