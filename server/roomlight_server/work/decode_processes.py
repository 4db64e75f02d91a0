"""Processes that decode images and objects, killed at a time limit: a decoder in C cannot be interrupted."""

import json
import logging
import os
import select
import subprocess
import sys
import threading
import time
from dataclasses import asdict
from typing import IO, Any, Final

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.errors import ObjectError, WireError
from roomlight.frame import Frame
from roomlight.wire.frame_message import FrameMessage
from roomlight_server.work.decode_worker import READY, REQUEST, RESULT, unpack_frame
from roomlight_server.work.object_packing import unpack_object
from roomlight_server.work.shared_block import BLOCK_BYTES, SharedBlock

_log = logging.getLogger("roomlight.server")
_START_S: Final = 60.0


class _DeadlineError(Exception):
    """The process did not answer in time."""


class _KilledError(Exception):
    """A process was killed, or has ended, while it decoded; the message is the rule that was broken."""


class _Process:
    """One decoding process; used by one thread at a time."""

    def __init__(self) -> None:
        self._block = SharedBlock()
        shared = self._block.descriptor
        command = [sys.executable, "-P", "-m", "roomlight_server.work.decode_worker", str(shared)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, pass_fds=(shared,)
        )
        os.set_blocking(self._pipe(self._process.stdin).fileno(), False)
        self._ready = False

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def is_alive(self) -> bool:
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


class DecodeProcesses:
    """Decoding processes, started when they are needed and reused. Methods may be called on any thread."""

    def __init__(self, timeout_s: float, object_timeout_s: float, object_limits: ObjectLimits) -> None:
        """Create an empty pool; a frame and an object may take these times in seconds."""
        self._timeout_s, self._object_timeout_s, self._object_limits = timeout_s, object_timeout_s, object_limits
        self._lock = threading.Lock()
        self._idle: list[_Process] = []
        self._all: set[_Process] = set()
        self._stopped = False

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
        """Kill all processes; frames that are being decoded are rejected."""
        with self._lock:
            self._stopped = True
            idle, busy = self._idle, self._all.difference(self._idle)
            self._all, self._idle = set(), []
        for process in idle:
            process.close()
        for process in busy:
            process.kill()

    def decode(
        self, message: FrameMessage, index: int, reference: float, min_confidence: int, box: tuple[int, int]
    ) -> Frame:
        """Decode a frame and reduce it to fit into a box of (width, height) pixels.

        Raises:
            WireError: A part does not decode, has unusable values, takes too long or ends the decoder.
            RuntimeError: The decoder failed.
        """
        body = message.colour.obj
        assert isinstance(body, bytes)
        arguments = {"work": "frame", "index": index, "reference": reference, "min_confidence": min_confidence}
        try:
            text, data = self._request(arguments | {"box": box}, body, self._timeout_s)
        except _KilledError as error:
            value = f"{len(body)} bytes, {message.header.colour.encoding}"
            raise WireError("bad-frame", field="colour", value=value, rule=str(error)) from error
        return unpack_frame(text, data, message, index)

    def decode_object(self, body: bytes, kind: str | None) -> VirtualObject:
        """Decode the file of an object.

        Raises:
            WireError: The file is refused, takes too long or ends the decoder; of the kind bad-object.
            RuntimeError: The decoder failed.
        """
        value = f"{len(body)} bytes"
        arguments = {"work": "object", "kind": kind, "limits": asdict(self._object_limits)}
        try:
            text, data = self._request(arguments, body, self._object_timeout_s)
            if "rejected" in text:
                raise WireError(**text["rejected"])
            if "failed" in text:
                raise RuntimeError(text["failed"])
            return unpack_object(text, data)
        except _KilledError as error:
            raise WireError("bad-object", field="body", value=value, rule=str(error)) from error
        except ObjectError as error:
            raise WireError("bad-object", field="body", value=value, rule=str(error)) from error

    def _request(self, arguments: dict[str, Any], body: bytes, timeout_s: float) -> tuple[dict[str, Any], bytes]:
        """Return the result of one request. Raises _KilledError if the process took too long or has ended."""
        text = json.dumps(arguments).encode()
        head = REQUEST.pack(len(text), len(body), int(timeout_s) + 10) + text
        for last in (False, True):  # a process may have been killed for another reason: another one tries again
            process = self._acquire()
            try:
                result = process.request(head, body, timeout_s)
            except (_DeadlineError, OSError) as error:
                late = isinstance(error, _DeadlineError)
                rule = f"must decode within {timeout_s:g} s" if late else "the decoder crashed"
                self._replace(process)
                fields = {"work": arguments["work"], "bytes": len(body), "reason": rule}
                _log.warning("decoding process killed", extra=fields)
                if late or last or self._stopped:
                    raise _KilledError(rule) from error
            else:
                self._release(process)
                return result
        raise AssertionError("unreachable")

    def _acquire(self) -> _Process:
        with self._lock:
            self._idle.sort(key=lambda process: process.is_ready)
            while self._idle:
                process = self._idle.pop()
                if process.is_alive:
                    return process
                self._all.discard(process)
                process.close()
        return self._started()

    def _started(self) -> _Process:
        process = _Process()
        with self._lock:
            self._all.add(process)
        return process

    def _release(self, process: _Process) -> None:
        with self._lock:
            if not self._stopped:
                self._idle.append(process)
                return
        process.close()

    def _replace(self, process: _Process) -> None:
        with self._lock:
            self._all.discard(process)
            stopped = self._stopped
        process.close()
        if not stopped:
            self._release(self._started())
