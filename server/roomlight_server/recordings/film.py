"""Films of an uploaded recording with objects in it, each made in a process of its own (`film_worker`)."""

import contextlib
import logging
import pickle
import shutil
from asyncio.subprocess import PIPE
from pathlib import Path

from roomlight.wire.recordings import Film
from roomlight_server.base.problems import INTERNAL_DETAIL, ProblemError
from roomlight_server.recordings.jobs import MAX_FILM_BYTES, FilmJob
from roomlight_server.recordings.player import read_record, reading_process

_log = logging.getLogger("roomlight.server")


class FilmMaker:
    """Makes one film of a recording. `run` is a task; cancel it to stop."""

    def __init__(self, folder: Path, file: Path, job: FilmJob, *, timeout_s: float) -> None:
        """Prepare a film of the recording in a folder; no frame may take longer than `timeout_s`."""
        self._folder, self.file, self._job, self._timeout_s = folder, file, job, timeout_s
        self.film = Film(status="reading", frame=0, frames=0, bytes=0, problem=None)

    @property
    def reserved_bytes(self) -> int:
        """What the film takes on the disk, or could."""
        return {"ready": self.film.bytes, "failed": 0}.get(self.film.status, MAX_FILM_BYTES)

    async def run(self) -> None:
        """Make the film; a failure is in its `problem`."""
        problem: ProblemError | None = None
        try:
            async with reading_process("film_worker", str(self._folder), str(self.file), stdin=PIPE) as process:
                assert process.stdin is not None
                with contextlib.suppress(ConnectionError):  # it has ended: its output says why
                    process.stdin.write(pickle.dumps(tuple(self._job), protocol=pickle.HIGHEST_PROTOCOL))
                    await process.stdin.drain()
                    process.stdin.close()
                while "end" not in (text := (await read_record(process, self._timeout_s))[0]):
                    self.film = Film(**text, bytes=0, problem=None)
            size = self.file.stat().st_size
            self.film = self.film.model_copy(update={"status": "ready", "bytes": size})
        except ProblemError as error:
            problem = error
        except Exception:
            _log.exception("film failed", extra={"folder": self._folder.name})
            problem = ProblemError("internal", INTERNAL_DETAIL)
        if problem is not None:
            self.film = self.film.model_copy(update={"status": "failed", "problem": problem.problem})
            self.remove()

    def remove(self) -> None:
        """Remove the film, and what a killed process left of it."""
        shutil.rmtree(self.file.parent, ignore_errors=True)
