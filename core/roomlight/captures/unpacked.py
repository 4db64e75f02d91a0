"""The reader of an unpacked archive: what it says names the archive, not the temporary folder."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from roomlight.captures.capture import Preparing, RawFrame, Reader, ReadRecord
from roomlight.errors import RoomLightError
from roomlight.notes import Note


class UnpackedReader:
    """Reads by the format's reader of the unpacked files; its notes, names and errors name the archive."""

    def __init__(self, reader: Reader, unpacked: Path, archive: Path) -> None:
        self._reader, self._paths = reader, (str(unpacked), str(archive))
        self.format, self.conventions = reader.format, reader.conventions
        self.count, self.probes = reader.count, reader.probes

    @property
    def notes(self) -> list[Note]:
        """The notes so far."""
        return list(map(self._renamed, self._reader.notes))

    def name_of(self, index: int) -> str:
        """Return the file in the archive."""
        return self._shown(self._reader.name_of(index))

    def timestamps(self) -> list[float | None]:
        """Return the stored times."""
        return self._reader.timestamps()

    @contextmanager
    def records(self) -> Generator[ReadRecord]:
        """Open the files of one pass."""
        with renaming(*self._paths), self._reader.records() as read:
            yield lambda index: self._record(read, index)

    def _record(self, read: ReadRecord, index: int) -> RawFrame:
        with renaming(*self._paths):
            raw = read(index)
        picture = replace(raw.picture, notes=tuple(map(self._renamed, raw.picture.notes)))
        depth_name = None if raw.depth_name is None else self._shown(raw.depth_name)
        return replace(raw, name=self._shown(raw.name), depth_name=depth_name, picture=picture)

    def _shown(self, text: str) -> str:
        return text.replace(*self._paths)

    def _renamed(self, note: Note) -> Note:
        return Note(*map(self._shown, (note.left_out, note.effect, note.advice)))


class UnpackedVideo(UnpackedReader):
    """As `UnpackedReader`, of a reader that looks at the whole recording first."""

    def prepare(self, watch: Callable[[int, int], object]) -> None:
        """Look at the recording."""
        assert isinstance(self._reader, Preparing)
        with renaming(*self._paths):
            self._reader.prepare(watch)


@contextmanager
def renaming(unpacked: str, archive: str) -> Generator[None]:
    """Raise errors of the block with the archive's path in place of the unpacked one's."""
    try:
        yield
    except RoomLightError as error:
        shown = str(error).replace(unpacked, archive)
        if shown == str(error):
            raise
        raise type(error)(shown) from error
