"""The uploaded recordings of a server: quotas, expiry, replays. Used on the event loop."""

import asyncio
import logging
import secrets
import shutil
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Literal

from roomlight.errors import ServerError
from roomlight.sample import sample_capture
from roomlight.wire.messages import SessionRequest
from roomlight.wire.recordings import Recording, RecordingList, RecordingRequest, ReplayRequest
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.request_context import Flow, current_flow, may_see
from roomlight_server.base.settings import ServerSettings
from roomlight_server.recordings.files import RecordingFiles, append
from roomlight_server.recordings.film import FilmMaker
from roomlight_server.recordings.jobs import MAX_FILM_BYTES, FilmJob
from roomlight_server.recordings.locked_folder import LockedFolder, remove_left_folders
from roomlight_server.recordings.player import Player, Progress
from roomlight_server.sessions.registry import Registry

_log = logging.getLogger("roomlight.server")
MAX_FILES: Final = 200_000
"""Most files of a recording."""
MAX_RECORDINGS: Final = 64
"""Most recordings of a token."""
SPARE_DISK_BYTES: Final = 256 * 2**20
"""Bytes that an upload leaves free on the disk."""


class StoredRecording:
    """An uploaded recording, its replay, and when it was last used."""

    def __init__(self, owner: str, files: RecordingFiles, now_s: float) -> None:
        self.id = files.folder.name
        self.owner, self.files, self.last_used_s = owner, files, now_s
        self.player: Player | None = None
        self.task: asyncio.Task[None] | None = None
        self.film: FilmMaker | None = None
        self.film_task: asyncio.Task[None] | None = None

    @property
    def playing(self) -> bool:
        """Whether a replay runs."""
        return self.task is not None and not self.task.done()

    @property
    def filming(self) -> bool:
        """Whether a film is being made."""
        return self.film_task is not None and not self.film_task.done()

    @property
    def reserved_bytes(self) -> int:
        """What the recording and its film take on the disk, or may."""
        return self.files.announced.bytes + (0 if self.film is None else self.film.reserved_bytes)

    @property
    def status(self) -> Literal["uploading", "ready", "playing", "finished", "failed"]:
        """See `Recording.status`."""
        if self.playing:
            return "playing"
        if self.player is not None and self.player.progress.problem is not None:
            return "failed"
        if self.player is not None:
            return "finished"
        return "ready" if self.files.complete else "uploading"


class RecordingStore:
    """All recordings. Each owner has a separate set and a quota, and finds those of its phones."""

    def __init__(self, settings: ServerSettings, registry: Registry, clock: Callable[[], float]) -> None:
        """Create an empty store; its folder is made with the first recording.

        Raises:
            ServerError: The folder for recordings of the settings cannot be used.
        """
        self._settings, self._registry, self._clock = settings, registry, clock
        self._recordings: dict[str, StoredRecording] = {}
        self._root: LockedFolder | None = None
        remove_left_folders(settings.recordings_folder)
        if (folder := settings.recordings_folder) is not None:
            try:
                LockedFolder(folder).remove()
            except OSError as error:
                rule = f"cannot be used ({error.strerror}); choose another folder"
                raise ServerError(f"recordings_folder: {folder}: {rule}") from error

    def add(self, owner: str, announced: RecordingRequest) -> Recording:
        """Begin an upload.

        Raises:
            ProblemError: It is too large (422), the quota of the token (409) or of the server (503) is used up, or the
                folder cannot be used (503).
        """
        settings = self._settings
        for field, value, most in (
            ("bytes", announced.bytes, settings.max_recording_bytes),
            ("files", announced.files, MAX_FILES),
        ):
            if value > most:
                rule = f"at most {most} {field}"
                raise ProblemError("invalid", f"{field}: {rule} in a recording", field=field, value=value, rule=rule)
        root = self._room_for(owner, announced.bytes, MAX_RECORDINGS - 1)
        with _on_disk():
            files = RecordingFiles(root / f"r-{secrets.token_hex(8)}", announced)
        recording = StoredRecording(owner, files, self._clock())
        self._recordings[recording.id] = recording
        return self.describe(recording)

    async def add_sample(self, owner: str) -> Recording:
        """Add the sample recording of the package, complete.

        Raises:
            ProblemError: The quota of the token (409) or of the server (503) is used up, or the folder cannot be used
                (503).
        """
        folder = sample_capture()
        contents = {
            path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
        }
        announced = RecordingRequest(name="Sample room", bytes=sum(map(len, contents.values())), files=len(contents))
        recording = self.find(owner, self.add(owner, announced).id)
        for path, data in contents.items():
            with _on_disk(), recording.files.piece(path, 0, len(data)) as file:
                await asyncio.to_thread(append, file, 0, data)
        return self.describe(recording)

    def find(self, owner: str, recording_id: str) -> StoredRecording:
        """Return a recording, which counts as a use. Raises ProblemError if the owner has no such recording (404)."""
        self.expire()
        recording = self._recordings.get(recording_id)
        if recording is None or not may_see(owner, recording.owner):
            detail = "there is no recording of this id; it may have expired; upload it again"
            raise ProblemError("recording-not-found", detail, field="id", value=recording_id)
        recording.last_used_s = self._clock()
        return recording

    def listed(self, owner: str) -> RecordingList:
        """Return the recordings of an owner and its phones, the newest first; the bytes are the owner's own."""
        self.expire()
        seen = [recording for recording in self._recordings.values() if may_see(owner, recording.owner)]
        return RecordingList(
            recordings=[self.describe(recording) for recording in reversed(seen)],
            bytes=_reserved(recording for recording in seen if recording.owner == owner),
            limit_bytes=self._settings.max_owner_recording_bytes,
        )

    def describe(self, recording: StoredRecording) -> Recording:
        """Return a recording as clients see it."""
        files, player = recording.files, recording.player
        progress = Progress(session=None) if player is None else player.progress
        expiry_s = self._settings.recording_expiry_s
        idle_s = 0.0 if recording.playing or recording.filming else self._clock() - recording.last_used_s
        return Recording(
            id=recording.id,
            name=files.announced.name,
            bytes=files.announced.bytes,
            received=files.received,
            files=files.announced.files,
            files_received=files.files,
            status=recording.status,
            film=None if recording.film is None else recording.film.film,
            **vars(progress),
            expires_in_s=round(max(0.0, expiry_s - idle_s), 1),
        )

    async def play(self, recording: StoredRecording, request: ReplayRequest) -> None:
        """Begin a replay into a new session.

        Raises:
            ProblemError: The upload is not complete, a replay runs, or the session has frames (409); or the session
                cannot be opened.
        """
        if recording.playing:
            raise ProblemError("recording-playing", "the recording is being played; stop it first with DELETE")
        self._check_complete(recording)
        options = SessionRequest(model=request.model, height=request.height)
        live, _ = await self._registry.open(recording.owner, request.session, options)
        if live.state().frames.accepted:
            rule = "must have no frame yet; the worlds of two recordings do not fit together"
            detail = f"the session {request.session!r} has frames: {rule}"
            raise ProblemError("session-conflict", detail, field="session", value=request.session, rule=rule)
        if recording.playing:  # another request was faster
            raise ProblemError("recording-playing", "the recording is being played; stop it first with DELETE")
        probes = self._settings.max_probes
        recording.player = Player(recording.files.folder, request, live, max_probes=probes, clock=self._clock)
        recording.task = asyncio.create_task(self._run(recording, recording.player, request.session))

    async def _run(self, recording: StoredRecording, player: Player, session: str) -> None:
        current_flow.set(Flow(recording.owner, session))
        try:
            with self._registry.use(recording.owner, session):  # it does not expire meanwhile
                await player.run()
        except ProblemError as error:
            player.progress.problem = error.problem
        finally:
            recording.last_used_s = self._clock()

    async def stop(self, recording: StoredRecording) -> None:
        """Stop the replay, if one runs; the session stays."""
        await _cancelled(recording.task)

    def make_film(self, recording: StoredRecording, job: FilmJob) -> None:
        """Begin a film, in place of the one that the recording has.

        Raises:
            ProblemError: The upload is not complete (409), a film of it or as many as the server makes at once are
                being made (429), the first frame is beyond its last (422), or there is no room for a film (409, 503).
        """
        self._check_complete(recording)
        if recording.filming:
            detail = "a film of the recording is being made; stop it first with DELETE, or retry later"
            raise ProblemError("film-running", detail, retry_after_s=30)
        running = sum(other.filming for other in self._recordings.values())
        if running >= self._settings.composite_threads:
            rule = f"at most {self._settings.composite_threads} films at once"
            detail = f"the server is making {running} films: {rule}; retry later"
            raise ProblemError("film-running", detail, rule=rule, retry_after_s=30)
        count = None if recording.player is None else recording.player.progress.film_frames
        if count is not None and job.first >= count:
            rule = f"must be below {count}, the frames that a film of it can have"
            raise ProblemError("invalid", f"first: {rule}", field="first", value=job.first, rule=rule)
        old_bytes = 0 if recording.film is None else recording.film.reserved_bytes
        folder = self._room_for(recording.owner, MAX_FILM_BYTES - old_bytes) / f"{recording.id}-film"
        self._remove_film(recording)
        file, timeout_s = folder / "film.mp4", self._settings.composite_timeout_s
        recording.film = FilmMaker(recording.files.folder, file, job, timeout_s=timeout_s)
        recording.film_task = asyncio.create_task(self._run_film(recording, recording.film))

    async def _run_film(self, recording: StoredRecording, film: FilmMaker) -> None:
        try:
            await film.run()
        finally:
            recording.last_used_s = self._clock()

    async def stop_film(self, recording: StoredRecording) -> None:
        """Stop the film if it is being made, and delete it."""
        await _cancelled(recording.film_task)
        self._remove_film(recording)

    @staticmethod
    def _remove_film(recording: StoredRecording) -> None:
        if recording.film is not None:
            recording.film.remove()
            recording.film = None

    @staticmethod
    def _check_complete(recording: StoredRecording) -> None:
        if not recording.files.complete:
            files = recording.files
            state = f"{files.received} of {files.announced.bytes} bytes, {files.files} of {files.announced.files} files"
            raise ProblemError("recording-not-ready", f"the upload is not complete: {state}")

    def _room_for(self, owner: str, wanted: int, most: int = MAX_RECORDINGS) -> Path:
        """Return the folder of all recordings if an owner with at most so many may use this much more of its disk."""
        settings = self._settings
        own = [recording for recording in self._recordings.values() if recording.owner == owner]
        limit = settings.max_owner_recording_bytes
        if len(own) > most or _reserved(own) + wanted > limit:
            rule = f"at most {limit} bytes in {MAX_RECORDINGS} recordings of one token"
            detail = f"{len(own)} recordings take {_reserved(own)} bytes: {rule}; delete one first"
            raise ProblemError("too-many-recordings", detail, field="bytes", value=wanted, rule=rule)
        with _on_disk():
            root = self._folder()
            disk_bytes = shutil.disk_usage(root).free
        total = _reserved(self._recordings.values())
        uploads = [recording.files for recording in self._recordings.values()]
        missing = sum(files.announced.bytes - files.received for files in uploads)
        free = max(disk_bytes - SPARE_DISK_BYTES - missing, 0)
        room = settings.max_all_recording_bytes - total
        if wanted > min(room, free):
            rule = f"at most {settings.max_all_recording_bytes} bytes of all recordings"
            if free < room:
                rule = f"the disk of ROOMLIGHT_RECORDINGS_FOLDER has {free} bytes for recordings"
            detail = f"the server has no room for {wanted} bytes: {rule}; retry later"
            raise ProblemError("recording-memory", detail, field="bytes", value=wanted, rule=rule, retry_after_s=60)
        return root

    async def delete(self, recording: StoredRecording) -> None:
        """Stop the replay and delete the files; an upload in progress is cancelled."""
        self._recordings.pop(recording.id, None)
        await self.stop(recording)
        await self.stop_film(recording)
        await asyncio.to_thread(recording.files.delete)

    def expire(self) -> None:
        """Delete the recordings that are unused for too long, or whose files another program removed."""
        limit_s = self._clock() - self._settings.recording_expiry_s
        for recording in tuple(self._recordings.values()):
            removed = not recording.files.folder.is_dir()
            if not (recording.playing or recording.filming) and (removed or recording.last_used_s < limit_s):
                del self._recordings[recording.id]
                self._remove_film(recording)
                asyncio.get_running_loop().run_in_executor(None, recording.files.delete)  # 0.6 s for 20,000 files
                reason = "its files were removed" if removed else "expired"
                _log.info("recording deleted", extra={"recording": recording.id, "reason": reason})

    async def close(self) -> None:
        """Stop all replays and films and delete all files."""
        for recording in tuple(self._recordings.values()):
            await self.stop(recording)
            await self.stop_film(recording)
        self._recordings.clear()
        if self._root is not None:
            self._root.remove()
            self._root = None

    def _folder(self) -> Path:
        """Return the folder of all recordings; make it, also again if another program removed it."""
        if self._root is not None and not self._root.path.is_dir():
            self._root.remove()
            self._root = None
        if self._root is None:
            self._root = LockedFolder(self._settings.recordings_folder)
        return self._root.path


@contextmanager
def _on_disk() -> Generator[None]:
    """Turn an error of the disk inside the context into a problem (503)."""
    try:
        yield
    except OSError as error:
        _log.error("uploads cannot be stored: %s", error)
        reason = error.strerror or type(error).__name__
        detail = f"the server cannot store recordings now: {reason}; retry later"
        raise ProblemError("recording-memory", detail, retry_after_s=60) from error


async def _cancelled(task: asyncio.Task[None] | None) -> None:
    if task is not None and not task.done():
        task.cancel()
        await asyncio.wait([task])


def _reserved(recordings: Iterable[StoredRecording]) -> int:
    return sum(recording.reserved_bytes for recording in recordings)
