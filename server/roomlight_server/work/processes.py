"""Processes that work for the server, killed at a time limit: a decoder in C cannot be interrupted."""

import json
import logging
import os
import select
import subprocess
import sys
import threading
import time
from typing import IO, Any, Final, Literal

from roomlight_server.work.decode_worker import READY, REQUEST, RESULT
from roomlight_server.work.shared_block import BLOCK_BYTES, SharedBlock

_log = logging.getLogger("roomlight.server")
_START_S: Final = 60.0


class _DeadlineError(Exception):
    """The process did not answer in time."""


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

    def watch(self, process: "WorkerProcess | None") -> None:
        """Take the process that works now; None: it has ended."""
        with self._lock:
            self._process = process
            if self._asked and process is not None:
                process.kill()


class WorkerProcess:
    """One process; used by one thread at a time."""

    def __init__(self, module: str) -> None:
        self._block = SharedBlock()
        shared = self._block.descriptor
        command = [sys.executable, "-P", "-m", module, str(shared)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, pass_fds=(shared,)
        )
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

    def request(self, head: bytes, body: bytes, timeout_s: float) -> tuple[dict[str, Any], bytes]:
        """Return JSON and arrays of the result. Raises _DeadlineError, or OSError if the process has ended."""
        if not self._ready:
            self._read(len(READY), time.monotonic() + _START_S)
            self._ready = True
        deadline = time.monotonic() + timeout_s
        if len(body) <= BLOCK_BYTES:
            self._block.write(body)
            self._write(head, deadline)
        else:
            for part in (head, body):
                self._write(part, deadline)
        text_bytes, data_bytes = RESULT.unpack(self._read(RESULT.size, deadline))
        if text_bytes + data_bytes > BLOCK_BYTES:
            raise OSError("the result is too large")
        text, data = json.loads(self._read(text_bytes, deadline)), self._block.read(data_bytes)
        self._block.release(max(len(body), data_bytes))
        return text, data

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

    def _read(self, size: int, deadline: float) -> bytearray:
        descriptor = self._pipe(self._process.stdout).fileno()
        parts: list[bytes] = []
        while size:
            _wait(descriptor, select.POLLIN, deadline)
            part = os.read(descriptor, size)
            if not part:
                raise OSError("the process has ended")
            parts.append(part)
            size -= len(part)
        return bytearray().join(parts)


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
        *,
        retry: bool = True,
        cancel: Cancellation | None = None,
    ) -> tuple[dict[str, Any], bytes]:
        """Return the result of one request.

        Raises:
            KilledError: The process took too long, has ended, or used up its memory.
        """
        text = json.dumps(arguments).encode()
        head = REQUEST.pack(len(text), len(body), int(timeout_s) + 10) + text
        for last in (False, True) if retry else (True,):  # it may have been killed for another reason: try again
            process = self._acquire()
            try:
                if cancel is not None:
                    cancel.watch(process)
                result = process.request(head, body, timeout_s)
            except (_DeadlineError, OSError) as error:
                late = isinstance(error, _DeadlineError)
                rule = f"must decode within {timeout_s:g} s" if late else "the decoder crashed"
                if cancel is not None:
                    cancel.watch(None)
                self._replace(process)
                fields = {"work": arguments["work"], "bytes": len(body), "reason": rule}
                _log.warning(f"{self._name} process killed", extra=fields)
                if late or last or self._stopped:
                    raise KilledError(rule, "late" if late else "crashed") from error
            else:
                if cancel is not None:
                    cancel.watch(None)
                self._release(process)
                if "memory" in result[0]:
                    raise KilledError("must decode within the memory of a decoding process", "memory")
                return result
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
