"""Files that an object's file names: glTF's buffers and images, OBJ's materials and their textures."""

import urllib.parse
from pathlib import Path

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import ObjectError


class FilesBeside:
    """The files in an object's folder and in folders inside it; none for an object that came as bytes.

    They are found as their writers' systems find them: with backslashes, percent signs and another case of letters.
    """

    def __init__(self, folder: Path | None, limits: ObjectLimits, file_bytes: int) -> None:
        """Begin with the object's own file.

        Args:
            folder: Its folder.
            limits: What is refused.
            file_bytes: Its size, which counts toward `ObjectLimits.file_bytes`.
        """
        self._folder, self._limits, self._bytes = folder, limits, file_bytes

    @property
    def exists(self) -> bool:
        """Whether there is a folder to read from."""
        return self._folder is not None

    def read(self, uri: str, label: str) -> bytes:
        """Return a file's content.

        Args:
            uri: Its address relative to the object's file.
            label: What names it, for messages.

        Raises:
            ObjectError: It is not inside the folder, is missing or cannot be read, or all together pass `file_bytes`.
        """
        if self._folder is None:
            raise ObjectError(f"{label} is at {uri[:60]!r}, outside the file; export as one GLB file")
        root = self._folder.resolve()
        path = self._find(root, uri)
        if path is None:
            raise ObjectError(
                f"{label} is at {uri[:60]!r}, which is not in the folder of the file; copy it there, or export as GLB"
            )
        try:
            self._bytes += path.stat().st_size
            self._limits.check("file_bytes", self._bytes, label)
            return path.read_bytes()
        except OSError as error:
            raise ObjectError(f"{label} at {uri[:60]!r} cannot be read ({error.strerror or error})") from error

    def _find(self, root: Path, uri: str) -> Path | None:
        for stated in (urllib.parse.unquote(uri), uri):
            path = root
            for step in stated.replace("\\", "/").split("/"):
                if step not in ("", "."):
                    path = _child(path, step)
            try:
                path = path.resolve()
                if path.is_relative_to(root) and path.is_file():
                    return path
            except (OSError, ValueError):  # a name that no file can have
                continue
        return None


def _child(folder: Path, name: str) -> Path:
    """Return the file of this name in a folder, in another case of letters if there is none in this."""
    path = folder / name
    try:
        if name != ".." and not path.exists() and folder.is_dir():
            return next((entry for entry in sorted(folder.iterdir()) if entry.name.lower() == name.lower()), path)
    except (OSError, ValueError):
        pass
    return path
