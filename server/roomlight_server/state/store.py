"""The state directory of a server: saves sessions in the background, reads, erases and expires saved ones.

A session is copied between two frames (3 ms) and written on a thread: frames do not wait for the disk. If the disk is
full or fails, serving goes on, `failing` has the reason, and each session is tried again.
"""

import asyncio
import contextlib
import fcntl
import hashlib
import logging
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, Protocol, TypeVar, runtime_checkable
from weakref import WeakValueDictionary

from roomlight.errors import OutputError, ServerError, StateError
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.problems import ProblemError
from roomlight_server.base.settings import ServerSettings
from roomlight_server.state.ages import SavedAges
from roomlight_server.state.fence import Fence, LeaseLostError
from roomlight_server.state.journal import Journal
from roomlight_server.state.lease import SessionLease
from roomlight_server.state.listing import SavedHead, SavedList
from roomlight_server.state.live_state import LiveState
from roomlight_server.state.session_folder import (
    STATE,
    Reading,
    erase,
    read_session,
    session_folders,
    write_session,
)

_log = logging.getLogger("roomlight.server")
_R = TypeVar("_R")
SAVES_PER_INTERVAL: Final = 2.5
"""A session that changes is saved so often per interval, so that waiting and writing fit into the rest."""
CLOSE_S: Final = 3.0
"""Time for saves that are running when the server stops, and as much for the last ones."""
_EXPIRY_PERIOD_S: Final = 60.0
LEASE_PERIOD_S: Final = 2.0
"""A session that another server owns leaves memory after this time, if no request has noticed it before."""


@runtime_checkable
class Saveable(Protocol):
    """A session that can be saved: a `LiveSession`."""

    name: str
    lease: SessionLease | None
    last_used_s: float

    @property
    def journal(self) -> Journal | None:
        """What is unsaved of the session; None if sessions are not saved."""
        ...

    async def copy_state(self, pool: ThreadPoolExecutor, owner: str) -> LiveState | None:
        """Return the state between two frames; see `LiveSession`."""
        ...


Sessions = Callable[[], Iterable[tuple[tuple[str, str], Saveable]]]
"""The open sessions by (owner, id)."""


class StateStore:
    """The saved sessions of a server, in one folder each. Used on the event loop; files are handled on threads."""

    def __init__(self, root: Path, settings: ServerSettings, metrics: Metrics, clock: Callable[[], float]) -> None:
        """Make the directory and lock it for this process; only this user can read its folder `sessions`.

        `root` is the state directory; servers may share it only if each has `state_shared`.

        Raises:
            ServerError: The directory cannot be used, or another server uses it and not both share it.
        """
        self._root, self._metrics, self._clock = root / "sessions", metrics, clock
        shared, expiry_s = settings.state_shared, settings.state_expiry_s
        # other servers touch what they have open once in a period
        self._expiry_s = max(expiry_s, 3 * _EXPIRY_PERIOD_S) if shared else expiry_s
        self._list = SavedList(self._root)
        self._ages = SavedAges(root / "ages.json", clock)
        self._period_s = settings.state_interval_s / SAVES_PER_INTERVAL
        self._tick_s = min(0.25, self._period_s / 4)
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="state")
        self._copy_pool = ThreadPoolExecutor(1, thread_name_prefix="copy")  # not behind the disk: frames wait for it
        self._writers = asyncio.Semaphore(2)  # only these have copies of states in memory
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._saving: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._next_expiry_s = clock()
        self.failing: str | None = None
        """Why sessions cannot be written now; None: they can."""
        self._lock_file = _locked(root, self._root, shared)
        self._fence = Fence(root) if shared else None
        self._fence_pool = ThreadPoolExecutor(4, thread_name_prefix="fence")  # not behind writes, which take 0.1 s
        self._read_pool = ThreadPoolExecutor(2, thread_name_prefix="read")
        self._next_lease_check_s = clock() + LEASE_PERIOD_S

    # --- saving -----------------------------------------------------------------------------------------------

    def journal(self) -> Journal:
        """Return the journal of a new session."""
        return Journal(self._clock)

    async def run(self, sessions: Sessions, end_moved: Callable[[tuple[str, str], Saveable], object]) -> None:
        """Save changed sessions, until cancelled.

        `end_moved` is called with a session that another server owns.
        """
        while True:
            await asyncio.sleep(self._tick_s)
            await self._check_leases(sessions, end_moved)
            for key, live in sessions():
                if key not in self._saving and live.journal is not None and live.journal.is_due(self._period_s):
                    self._start_saving(key, live)
            unsaved_s = max((journal.unsaved_s for _, _, journal in _unsaved(sessions)), default=0.0)
            self._metrics.state_unsaved_seconds.set(unsaved_s)

    async def _check_leases(self, sessions: Sessions, end_moved: Callable[[tuple[str, str], Saveable], object]) -> None:
        if self._fence is None or self._clock() < self._next_lease_check_s:
            return
        self._next_lease_check_s = self._clock() + LEASE_PERIOD_S
        for key, live in list(sessions()):
            if live.lease is not None:
                try:
                    await live.lease.check()
                except ProblemError:
                    end_moved(key, live)

    def _start_saving(self, key: tuple[str, str], live: Saveable) -> None:
        task = self._saving[key] = asyncio.create_task(self.save(key, live))
        task.add_done_callback(lambda _: self._saving.pop(key, None))

    async def save(self, key: tuple[str, str], live: Saveable) -> None:
        """Save a session now. A failure is logged, and `failing` has the reason."""
        journal = live.journal
        assert journal is not None
        journal.begin()
        try:
            async with self._writers:
                await self._save(key, live, journal)
        except Exception as error:  # also if out of memory, or of a bug, other sessions are saved nevertheless
            if self.failing is None and not isinstance(error, OSError | OutputError):
                _log.exception("unexpected error while a session was saved", extra={"session": live.name})
            journal.failed()
            self._record_failure(error, live.name)

    async def _save(self, key: tuple[str, str], live: Saveable, journal: Journal) -> None:
        state = await live.copy_state(self._copy_pool, digest_of_owner(key[0]))
        if state is None:  # it has ended: nothing can be saved any more
            journal.closed = True
            return
        async with self.lock(*key):
            if journal.closed:  # deleted in the meantime
                return
            with self._metrics.state_write_seconds.time():
                write = write_session if live.lease is None else live.lease.guarded(write_session)
                try:
                    bases, size = await self._in_thread(
                        write, self._folder(*key), state, dict(journal.messages), journal.bases
                    )
                except LeaseLostError:
                    self._metrics.state_writes.labels("refused").inc()
                    _log.warning("a session is not saved: another server owns it", extra={"session": live.name})
                    journal.closed = True
                    return
            journal.saved(bases, state.values.light_frame, state.values.queue.last_index)
            self._record_success(size)

    def _record_failure(self, error: Exception, name: str) -> None:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        reason = (cause.strerror if isinstance(cause, OSError) else None) or type(cause).__name__
        if self.failing is None:
            _log.error("sessions cannot be saved: %s; serving goes on", error, extra={"session": name})
        self.failing = reason
        self._metrics.state_writes.labels("failed").inc()

    def _record_success(self, n_bytes: int) -> None:
        if self.failing is not None:
            _log.warning("sessions can be saved again")
        self.failing = None
        self._metrics.state_writes.labels("written").inc()
        self._metrics.state_session_bytes.observe(n_bytes)

    async def close(self, sessions: Sessions) -> None:
        """Save all changed sessions for the last time, at most twice `CLOSE_S`; release the directory."""
        if self._saving:
            await asyncio.wait(tuple(self._saving.values()), timeout=CLOSE_S)
        tasks = [asyncio.create_task(self.save(key, live)) for key, live, _ in _unsaved(sessions)]
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=CLOSE_S)
            for task in late:
                task.cancel()
            if unsaved := len(_unsaved(sessions)):
                _log.error("%d sessions were not saved: %s", unsaved, self.failing or "no time was left")
        for (owner, _), live in sessions():
            self.left_memory(owner, live)
        for pool in (self._copy_pool, self._read_pool, self._pool):
            await asyncio.to_thread(pool.shutdown, wait=True, cancel_futures=True)
        await asyncio.to_thread(self._fence_pool.shutdown, wait=True)
        os.close(self._lock_file)

    # --- owners -----------------------------------------------------------------------------------------------

    async def claim(self, owner: str, name: str, *, new: bool = False) -> SessionLease | None:
        """Become the owner of a session among servers that share the directory. Hold its `lock`.

        `new`: the session begins, so that no frame of an owner before can be missing.

        Returns:
            The lease; None if no other server shares the directory.

        Raises:
            ProblemError: The directory cannot be used now (503).
        """
        if self._fence is None:
            return None
        fence, key, loop = self._fence, self._folder(owner, name).name, asyncio.get_running_loop()
        try:
            lease = await loop.run_in_executor(self._fence_pool, fence.claim, key)
        except (OSError, OutputError) as error:
            _log.error("a session cannot be claimed: %s", error, extra={"session": name})
            detail = "the owner of the session cannot be written now; retry later"
            raise ProblemError("state-unavailable", detail, retry_after_s=5) from error
        _log.info("session claimed", extra={"session": name, "epoch": lease.record.epoch})
        return SessionLease(name, fence, lease, self._fence_pool, refuses_gap=lease.taken_over and not new)

    # --- saved sessions ---------------------------------------------------------------------------------------

    def has(self, owner: str, name: str) -> bool:
        """Return whether a session is on disk, or may be: `read` says why the disk does not tell."""
        try:
            (self._folder(owner, name) / STATE).stat()
        except OSError as error:
            return not isinstance(error, FileNotFoundError | NotADirectoryError)
        return True

    async def listed(self, owner: str) -> list[SavedHead]:
        """Return the sessions of an owner that are on disk, those in memory too; last used first."""
        return await self._in_thread(self._list.of, digest_of_owner(owner), pool=self._read_pool)

    def lock(self, owner: str, name: str) -> asyncio.Lock:
        """Return the lock of a session's folder: one of saving, restoring and erasing at a time."""
        return self._lock_of(self._folder(owner, name))

    def _lock_of(self, folder: Path) -> asyncio.Lock:
        return self._locks.setdefault(folder.name, asyncio.Lock())  # lives while one of its users refers to it

    async def read(self, owner: str, name: str) -> Reading:
        """Read a saved session. Raises ProblemError if the state cannot be used (409), or not be read now (503)."""
        try:
            arguments = (self._folder(owner, name), digest_of_owner(owner), name)
            return await self._in_thread(read_session, *arguments, pool=self._read_pool)
        except StateError as error:
            raise refused(error, name) from error
        except OSError as error:
            _log.error("a saved session cannot be read: %s", error, extra={"session": name})
            detail = f"the saved state cannot be read now ({error.strerror}); retry later"
            raise ProblemError("state-unavailable", detail, retry_after_s=5) from error

    def restored(self, reading: Reading) -> Journal:
        """Return the journal of a restored session."""
        journal = self.journal()
        journal.begin()
        journal.saved(dict(reading.values.bases), reading.values.light_frame, reading.values.queue.last_index)
        return journal

    async def erase(self, owner: str, name: str) -> bool:
        """Remove a session from the disk; return whether it was there. Hold its `lock`.

        Raises:
            ProblemError: A file cannot be removed (503).
        """
        folder = self._folder(owner, name)
        try:
            existed = folder.exists()
            lease = await self.claim(owner, name) if existed else None  # its owner writes nothing afterwards
            await self._in_thread(erase if lease is None else lease.guarded(erase), folder)
        except (OSError, LeaseLostError) as error:
            _log.error("a saved session cannot be removed: %s", error, extra={"session": name})
            reason = error.strerror if isinstance(error, OSError) else "another server has just restored it"
            detail = f"the saved state cannot be removed ({reason}); retry later"
            raise ProblemError("state-unavailable", detail, retry_after_s=5) from error
        return existed

    def left_memory(self, owner: str, live: Saveable) -> None:
        """Begin the time to expiry of a saved session again, and let another server own it if all of it is on disk.

        The date of its file is that of its last use.
        """
        with contextlib.suppress(OSError):
            used_s = time.time() - max(0.0, self._clock() - live.last_used_s)
            os.utime(self._folder(owner, live.name) / STATE, (used_s, used_s))
        if live.lease is not None and live.journal is not None and live.journal.unsaved_s == 0:
            live.lease.release()

    async def run_expiry(self, sessions: Sessions) -> None:
        """Erase expired sessions, one after the other, until cancelled."""
        while True:
            await asyncio.sleep(self._tick_s)
            if self._clock() < self._next_expiry_s:
                continue
            self._next_expiry_s = self._clock() + min(_EXPIRY_PERIOD_S, self._expiry_s)
            for folder, version in await self._in_thread(self._expired, self._open_folders(sessions)):
                async with self._lock_of(folder):
                    if folder.name not in self._open_folders(sessions):
                        await self._in_thread(self._erase_expired, folder, version)

    def _expired(self, open_folders: set[str]) -> list[tuple[Path, str]]:
        """Return the folders of expired sessions, and their versions."""
        folders = session_folders(self._root)
        for folder in folders if self._fence is not None else ():
            if folder.name in open_folders:
                with contextlib.suppress(OSError):
                    os.utime(folder / STATE)  # other servers do not know that it is open
        versions = {folder.name: _version(folder) for folder in folders}
        ages_s = self._ages.advance(versions, open_folders)
        if self._fence is not None:  # records of sessions that are gone
            self._fence.forget(time.time() - self._expiry_s, open_folders | versions.keys())
        return [(folder, versions[folder.name]) for folder in folders if ages_s[folder.name] > self._expiry_s]

    def _erase_expired(self, folder: Path, version: str) -> None:
        # it was erased or saved in the meantime, or cannot be removed: next time
        with contextlib.suppress(OSError, OutputError, LeaseLostError):
            if _version(folder) == version:
                fence = self._fence
                with contextlib.nullcontext() if fence is None else fence.guarded(fence.claim(folder.name)):
                    erase(folder)
                _log.info("a saved session has expired")

    def _open_folders(self, sessions: Sessions) -> set[str]:
        return {self._folder(*key).name for key, _ in sessions()}

    def _folder(self, owner: str, name: str) -> Path:
        return self._root / hashlib.sha256(f"{digest_of_owner(owner)}/{name}".encode()).hexdigest()[:32]

    async def _in_thread(self, work: Callable[..., _R], *args: object, pool: ThreadPoolExecutor | None = None) -> _R:
        return await asyncio.get_running_loop().run_in_executor(pool or self._pool, work, *args)


def _unsaved(sessions: Sessions) -> list[tuple[tuple[str, str], Saveable, Journal]]:
    """Return the sessions that can be saved and are not on disk as they are now."""
    journals = [(key, live, live.journal) for key, live in sessions()]
    return [(key, live, of) for key, live, of in journals if of is not None and of.is_unsaved]


def refused(error: StateError, name: str) -> ProblemError:
    """Return the problem of a saved state that cannot be used, and log it."""
    _log.error("a saved session is refused: %s", error, extra={"session": name})
    return ProblemError("state-refused", f"{error}; delete the session and open it again", field="id", value=name)


def digest_of_owner(owner: str) -> str:
    """Return what is stored of an owner; `owner` is already a digest of the token."""
    return hashlib.sha256(f"roomlight owner {owner}".encode()).hexdigest()


def _version(folder: Path) -> str:
    """Return what changes when a saved session is written or touched."""
    state = folder / STATE
    try:
        stat = (state if state.exists() else folder).stat()
    except OSError:  # it was erased in the meantime
        return ""
    return f"{stat.st_ino}-{stat.st_mtime_ns}"


def _locked(root: Path, sessions: Path, shared: bool) -> int:
    """Make the directory and its folder of sessions, and lock it; return the descriptor that holds the lock."""
    try:
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        sessions.mkdir(mode=0o700, exist_ok=True)
        sessions.chmod(0o700)
        descriptor = os.open(root / "lock", os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise ServerError(f"state_dir: {root}: cannot be used ({error.strerror}); choose another folder") from error
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if not isinstance(error, BlockingIOError):
            advice = "choose a folder of a file system that has locks"
            raise ServerError(f"state_dir: {root}: cannot be locked ({error.strerror}); {advice}") from error
        advice = "stop it, choose another folder, or set state_shared for all of them"
        raise ServerError(f"state_dir: {root}: is used by another server; {advice}") from error
    return descriptor
