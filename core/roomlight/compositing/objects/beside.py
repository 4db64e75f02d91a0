"""Files that an object's file names: glTF's buffers and images, OBJ's materials and their textures."""

from pathlib import Path

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import FrameError, ObjectError
from roomlight.files import FolderSource


class FilesBeside:
    """The files in an object's folder and in folders inside it; none for an object that came as bytes."""

    def __init__(self, folder: Path | None, limits: ObjectLimits, file_bytes: int) -> None:
        """Begin with the object's own file.

        Args:
            folder: Its folder.
            limits: What is refused.
            file_bytes: Its size, which counts toward `ObjectLimits.file_bytes`.
        """
        self._source = None if folder is None else FolderSource(folder)
        self._limits, self._bytes = limits, file_bytes

    @property
    def exists(self) -> bool:
        """Whether there is a folder to read from."""
        return self._source is not None

    def read(self, uri: str, label: str) -> bytes:
        """Return a file's content.

        Args:
            uri: Its address relative to the object's file.
            label: What names it, for messages.

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
