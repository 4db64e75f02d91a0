"""The uploaded recordings of a server: quotas, expiry, replays. Used on the event loop."""

import asyncio
import logging
import secrets
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, Literal

from roomlight.sample import sample_capture
from roomlight.wire.messages import SessionRequest
from roomlight.wire.recordings import Recording, RecordingList, RecordingRequest, ReplayRequest
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.request_context import Flow, current_flow, sees
from roomlight_server.base.settings import ServerSettings
from roomlight_server.recordings.files import RecordingFiles, append
from roomlight_server.recordings.locked_folder import LockedFolder, remove_left_folders
from roomlight_server.recordings.player import Player
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
        """Create an upload without files."""
        self.id = files.folder.name
        self.owner, self.files, self.last_used_s = owner, files, now_s
        self.player: Player | None = None
        self.task: asyncio.Task[None] | None = None

    @property
    def playing(self) -> bool:
        """Whether a replay runs."""
        return self.task is not None and not self.task.done()

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
        """Create an empty store; its folder is made with the first recording."""
        self._settings, self._registry, self._clock = settings, registry, clock
        self._recordings: dict[str, StoredRecording] = {}
        self._root: LockedFolder | None = None
        remove_left_folders(settings.recordings_folder)

    def add(self, owner: str, announced: RecordingRequest) -> Recording:
        """Begin an upload.

        Raises:
            ProblemError: It is too large (422), or the quota of the token (409) or of the server (503) is used up.
        """
        settings = self._settings
        own = [recording for recording in self._recordings.values() if recording.owner == owner]
        for field, value, most in (
            ("bytes", announced.bytes, settings.max_recording_bytes),
            ("files", announced.files, MAX_FILES),
        ):
            if value > most:
                rule = f"at most {most} {field}"
                raise ProblemError("invalid", f"{field}: {rule} in a recording", field=field, value=value, rule=rule)
        limit = settings.max_owner_recording_bytes
        if len(own) >= MAX_RECORDINGS or _announced(own) + announced.bytes > limit:
            rule = f"at most {limit} bytes in {MAX_RECORDINGS} recordings of one token"
            detail = f"{len(own)} recordings take {_announced(own)} bytes: {rule}; delete one first"
            raise ProblemError("too-many-recordings", detail, field="bytes", value=announced.bytes, rule=rule)
        root = self._folder()
        total = _announced(self._recordings.values())
        uploads = [recording.files for recording in self._recordings.values()]
        missing = sum(files.announced.bytes - files.received for files in uploads)
        free = shutil.disk_usage(root).free - SPARE_DISK_BYTES - missing
        if announced.bytes > min(settings.max_all_recording_bytes - total, free):
            rule = f"at most {settings.max_all_recording_bytes} bytes of all recordings, and what the disk has free"
            detail = f"the server has no room for {announced.bytes} bytes: {rule}; retry later"
            raise ProblemError(
                "recording-memory", detail, field="bytes", value=announced.bytes, rule=rule, retry_after_s=60
            )
        files = RecordingFiles(root / f"r-{secrets.token_hex(8)}", announced)
        recording = StoredRecording(owner, files, self._clock())
        self._recordings[recording.id] = recording
        return self.describe(recording)

    async def add_sample(self, owner: str) -> Recording:
        """Add the sample recording of the package, complete.

        Raises:
            ProblemError: The quota of the token (409) or of the server (503) is used up.
        """
        folder = sample_capture()
        contents = {
            path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
        }
        announced = RecordingRequest(name="Sample room", bytes=sum(map(len, contents.values())), files=len(contents))
        recording = self.find(owner, self.add(owner, announced).id)
        for path, data in contents.items():
            with recording.files.piece(path, 0, len(data)) as file:
                await asyncio.to_thread(append, file, 0, data)
        return self.describe(recording)

    def find(self, owner: str, recording_id: str) -> StoredRecording:
        """Return a recording, which counts as a use.

        Raises:
            ProblemError: The owner has no such recording (404).
        """
        self.expire()
        recording = self._recordings.get(recording_id)
        if recording is None or not sees(owner, recording.owner):
            detail = "there is no recording of this id; it may have expired; upload it again"
            raise ProblemError("recording-not-found", detail, field="id", value=recording_id)
        recording.last_used_s = self._clock()
        return recording

    def listed(self, owner: str) -> RecordingList:
        """Return the recordings of an owner and its phones, the newest first; the bytes are the owner's own."""
        self.expire()
        seen = [recording for recording in self._recordings.values() if sees(owner, recording.owner)]
        return RecordingList(
            recordings=[self.describe(recording) for recording in reversed(seen)],
            bytes=_announced(recording for recording in seen if recording.owner == owner),
            limit_bytes=self._settings.max_owner_recording_bytes,
        )

    def describe(self, recording: StoredRecording) -> Recording:
        """Return a recording as clients see it."""
        files, progress = recording.files, None if recording.player is None else recording.player.progress
        expiry_s = self._settings.recording_expiry_s
        idle_s = 0.0 if recording.playing else self._clock() - recording.last_used_s
        return Recording(
            id=recording.id,
            name=files.announced.name,
            bytes=files.announced.bytes,
            received=files.received,
            files=files.announced.files,
            files_received=files.files,
            status=recording.status,
            session=None if progress is None else progress.session,
            frame=0 if progress is None else progress.frame,
            frames=None if progress is None else progress.frames,
            unreadable=0 if progress is None else progress.unreadable,
            notes=[] if progress is None else list(progress.notes),
            problem=None if progress is None else progress.problem,
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
        if not recording.files.complete:
            files = recording.files
            state = f"{files.received} of {files.announced.bytes} bytes, {files.files} of {files.announced.files} files"
            raise ProblemError("recording-not-ready", f"the upload is not complete: {state}")
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
        if recording.task is not None and not recording.task.done():
            recording.task.cancel()
            await asyncio.wait([recording.task])

    async def delete(self, recording: StoredRecording) -> None:
        """Stop the replay and delete the files; an upload in progress is cancelled."""
        self._recordings.pop(recording.id, None)
        await self.stop(recording)
        await asyncio.to_thread(recording.files.delete)

    def expire(self) -> None:
        """Delete the recordings that are unused for too long."""
        limit_s = self._clock() - self._settings.recording_expiry_s
        for recording in tuple(self._recordings.values()):
            if not recording.playing and recording.last_used_s < limit_s:
                del self._recordings[recording.id]
                recording.files.delete()
                _log.info("recording deleted", extra={"recording": recording.id, "reason": "expired"})

    async def close(self) -> None:
        """Stop all replays and delete all files."""
        for recording in tuple(self._recordings.values()):
            await self.stop(recording)
        self._recordings.clear()
        if self._root is not None:
            self._root.remove()
            self._root = None

    def _folder(self) -> Path:
        if self._root is None:
            self._root = LockedFolder(self._settings.recordings_folder)
        return self._root.path


def _announced(recordings: Iterable[StoredRecording]) -> int:
    return sum(recording.files.announced.bytes for recording in recordings)
