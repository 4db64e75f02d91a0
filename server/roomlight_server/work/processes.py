"""Processes that work for the server, killed at a time limit: a decoder in C cannot be interrupted."""

import json
import logging
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import IO, Any, Final, Literal, TypeVar

from roomlight.errors import WireError
from roomlight_server.work.decode_worker import READY, REQUEST, RESULT
from roomlight_server.work.shared_block import BLOCK_BYTES, SharedBlock

_log = logging.getLogger("roomlight.server")
_R = TypeVar("_R")
_START_S: Final = 60.0
_READ_BYTES: Final = 2**16
"""Read at once: a result's head and its JSON, without the arrays."""


class _DeadlineError(Exception):
    """The process did not answer in time."""


class _StartError(RuntimeError):
    """The process cannot start: no request is to blame."""


class KilledError(Exception):
    """A process was killed, has ended, or used up its memory; the message is the rule that was broken.

    Attributes:
        reason: late, crashed or memory.
    """

    def __init__(self, rule: str, reason: Literal["late", "crashed", "memory"]) -> None:
        super().__init__(rule)
        self.reason = reason


class Cancellation:
    """Kills the process that works for somebody who no longer waits. Methods may be called on any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: WorkerProcess | None = None
        self._asked = False

    def __call__(self) -> None:
        """Kill the process now, or as soon as it begins."""
        with self._lock:
            self._asked = True
            if self._process is not None:
                self._process.kill()

    @property
    def asked(self) -> bool:
        """Whether the work is to be ended, because nobody waits for its result."""
        return self._asked

    def watch(self, process: "WorkerProcess | None") -> None:
        """Take the process that works now; None: it has ended."""
        with self._lock:
            self._process = process
            if self._asked and process is not None:
                process.kill()


def with_few_threads(threads: int) -> dict[str, str]:
    """Return the environment of a process whose address space is bounded.

    On many cores the threads that OpenBLAS and OpenCV begin would use it up: 140 MB each.
    """
    return {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": str(threads)}


class WorkerProcess:
    """One process; used by one thread at a time."""

    def __init__(self, module: str) -> None:
        self._block = SharedBlock()
        shared = self._block.descriptor
        command = [sys.executable, "-P", "-m", module, str(shared)]
        pipe, environment = subprocess.PIPE, with_few_threads(1)
        try:
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, bufsize=0, pass_fds=(shared,), env=environment
            )
        except OSError:
            self._block.close()
            raise
        os.set_blocking(self._pipe(self._process.stdin).fileno(), False)
        self._ready = False

    @property
    def pid(self) -> int:
        """Of the system."""
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    @property
    def is_ready(self) -> bool:
        """Whether it has started: a frame that waits for a new process would wait for its imports too."""
        if self._ready:
            return True
        poll = select.poll()
        poll.register(self._pipe(self._process.stdout).fileno(), select.POLLIN)
        return bool(poll.poll(0))

    def request(self, head: bytes, body: bytes, timeout_s: float) -> tuple[dict[str, Any], int]:
        """Return the result's JSON and the bytes of its arrays, which `arrays` reads.

        Raises: _DeadlineError, _StartError, or OSError if the process has ended or answers otherwise than it may.
        """
        if not self._ready:
            self._start()
        deadline = time.monotonic() + timeout_s
        if len(body) <= BLOCK_BYTES:
            self._block.write(body)
            self._write(head, deadline)
        else:
            for part in (head, body):
                self._write(part, deadline)
        answer = self._read(RESULT.size, deadline)
        text_bytes, data_bytes = RESULT.unpack_from(answer)
        if text_bytes + data_bytes > BLOCK_BYTES:
            raise OSError("the result is too large")
        rest = RESULT.size + text_bytes - len(answer)
        answer += self._read(rest, deadline) if rest > 0 else b""
        if len(answer) != RESULT.size + text_bytes:
            raise OSError("the result is longer than stated")
        return json.loads(memoryview(answer)[RESULT.size :].tobytes()), data_bytes

    def _start(self) -> None:
        try:
            self._read(len(READY), time.monotonic() + _START_S, len(READY))
        except OSError as error:
            if (code := self._process.wait()) > 0:  # it was not killed
                text = f"a process ended with exit code {code} at its start: --log-level debug shows why"
                raise _StartError(text) from error
            raise
        self._ready = True

    @contextmanager
    def arrays(self, size: int, sent: int) -> Generator[memoryview]:
        """Yield the arrays of the last result in the shared memory: the process can change them until they are copied.

        Args:
            size: Bytes of the arrays.
            sent: Bytes of the request's body.
        """
        view = self._block.view(size)
        try:
            yield view
        finally:
            view.release()
            self._block.release(max(sent, size))

    def kill(self) -> None:
        """End the process at once. The thread that uses it, if any, calls `close`."""
        self._process.kill()

    def close(self) -> None:
        """End the process at once and close its pipes."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            self._pipe(pipe).close()
        self._block.close()

    @staticmethod
    def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
        assert pipe is not None
        return pipe

    def _write(self, data: bytes, deadline: float) -> None:
        descriptor, view = self._pipe(self._process.stdin).fileno(), memoryview(data)
        while view:
            _wait(descriptor, select.POLLOUT, deadline)
            view = view[os.write(descriptor, view) :]

    def _read(self, least: int, deadline: float, most: int = _READ_BYTES) -> bytearray:
        """Read what has arrived, at least and, in one piece, at most so many bytes."""
        descriptor = self._pipe(self._process.stdout).fileno()
        data = bytearray()
        while len(data) < least:
            _wait(descriptor, select.POLLIN, deadline)
            part = os.read(descriptor, most)
            if not part:
                raise OSError("the process has ended")
            data += part
        return data


def _wait(descriptor: int, event: int, deadline: float) -> None:
    """Wait until a pipe can be used, or has ended. Raises _DeadlineError."""
    poll = select.poll()
    poll.register(descriptor, event)
    if not poll.poll(max(0.0, deadline - time.monotonic()) * 1000):
        raise _DeadlineError


class Processes:
    """Processes of one kind, started when they are needed and reused. Methods may be called on any thread."""

    def __init__(self, module: str, name: str, *, spare: bool) -> None:
        """Create an empty pool.

        Args:
            module: What the processes run.
            name: What they do, for the log.
            spare: Whether a process that was killed is replaced before somebody needs another one.
        """
        self._module, self._name, self._spare = module, name, spare
        self._lock = threading.Lock()
        self._idle: list[WorkerProcess] = []
        self._all: set[WorkerProcess] = set()
        self._stopped = False
        self._used_s = 0.0

    @property
    def pids(self) -> list[int]:
        """Ids of the processes that are not in use, and then of those that are."""
        with self._lock:
            return [process.pid for process in (*self._idle, *self._all.difference(self._idle))]

    def start(self, count: int) -> None:
        """Start processes, without waiting, so that the first frames need not wait for it."""
        for _ in range(count):
            self._release(self._started())

    def stop(self) -> None:
        """Kill all processes; what they work on is rejected."""
        with self._lock:
            self._stopped = True
            idle, busy = self._idle, self._all.difference(self._idle)
            self._all, self._idle = set(), []
        for process in idle:
            process.close()
        for process in busy:
            process.kill()

    def close_unused(self, unused_s: float) -> None:
        """End the processes if none has worked for a time."""
        with self._lock:
            if time.monotonic() - self._used_s < unused_s:
                return
            idle, self._idle = self._idle, []
            self._all.difference_update(idle)
        for process in idle:
            process.close()

    def _request(
        self,
        arguments: dict[str, Any],
        body: bytes,
        timeout_s: float,
        unpack: Callable[[dict[str, Any], memoryview], _R],
        *,
        retry: bool = True,
        cancel: Cancellation | None = None,
    ) -> _R:
        """Return what `unpack` makes of the JSON and the arrays of one request's result, and raise what it raises.

        `unpack` copies the arrays before it looks at them; they are not there any more when it has returned.

        Raises:
            KilledError: The process took too long, has ended, or used up its memory.
            WireError: The process rejected the body.
            RuntimeError: The work failed; the text is the traceback. Or no process can start.
        """
        wanted = json.dumps(arguments).encode()
        head = REQUEST.pack(len(wanted), len(body), int(timeout_s) + 10) + wanted
        for last in (False, True) if retry else (True,):  # it may have been killed for another reason: try again
            process = self._acquire()
            try:
                if cancel is not None:
                    cancel.watch(process)
                text, size = process.request(head, body, timeout_s)
            except (_DeadlineError, OSError) as error:
                late = isinstance(error, _DeadlineError)
                rule = f"must decode within {timeout_s:g} s" if late else "the decoder crashed"
                level = logging.WARNING
                if cancel is not None:
                    cancel.watch(None)
                    if cancel.asked:
                        rule, level, last = "its client has left", logging.INFO, True
                self._replace(process)
                fields = {"work": arguments["work"], "bytes": len(body), "reason": rule}
                _log.log(level, f"{self._name} process killed", extra=fields)
                if late or last or self._stopped:
                    raise KilledError(rule, "late" if late else "crashed") from error
            except _StartError:
                if cancel is not None:
                    cancel.watch(None)
                self._replace(process)
                if last:
                    raise
            else:
                if cancel is not None:
                    cancel.watch(None)
                try:
                    with process.arrays(size, len(body)) as arrays:  # its end frees the body too
                        if "memory" in text:
                            raise KilledError("must decode within the memory of a decoding process", "memory")
                        if "rejected" in text:
                            raise WireError(**text["rejected"])
                        if "failed" in text:
                            raise RuntimeError(text["failed"])
                        return unpack(text, arrays)
                finally:
                    self._release(process)
        raise AssertionError("unreachable")

    def _acquire(self) -> WorkerProcess:
        with self._lock:
            self._idle.sort(key=lambda process: process.is_ready)
            while self._idle:
                process = self._idle.pop()
                if process.is_alive:
                    return process
                self._all.discard(process)
                process.close()
        return self._started()

    def _started(self) -> WorkerProcess:
        process = WorkerProcess(self._module)
        with self._lock:
            self._all.add(process)
        return process

    def _release(self, process: WorkerProcess) -> None:
        with self._lock:
            self._used_s = time.monotonic()
            if not self._stopped:
                self._idle.append(process)
                return
        process.close()

    def _replace(self, process: WorkerProcess) -> None:
        with self._lock:
            self._all.discard(process)
            stopped = self._stopped
        process.close()
        if self._spare and not stopped:
            self._release(self._started())
