"""Processes that decode images, killed when a frame exceeds its time limit: a decoder in C cannot be interrupted."""

import json
import logging
import os
import select
import subprocess
import sys
import threading
import time
from typing import IO, Any, Final

from roomlight.errors import WireError
from roomlight.frame import Frame
from roomlight.wire.frame_message import FrameMessage
from roomlight_server.decode_worker import READY, REQUEST, RESULT, unpack_frame

_log = logging.getLogger("roomlight.server")
_START_S: Final = 60.0
_MAX_RESULT_BYTES: Final = 2**28


class _DeadlineError(Exception):
    """The process did not answer in time."""


class _Process:
    """One decoding process; used by one thread at a time."""

    def __init__(self) -> None:
        command = [sys.executable, "-P", "-m", "roomlight_server.decode_worker"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        self._ready = False

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def request(self, head: bytes, body: bytes, timeout_s: float) -> tuple[dict[str, Any], bytearray]:
        """Return JSON and arrays of the result. Raises _DeadlineError, or OSError if the process has ended."""
        if not self._ready:
            self._read(len(READY), time.monotonic() + _START_S)
            self._ready = True
        requests = self._pipe(self._process.stdin)
        for part in (head, body):
            view = memoryview(part)
            while view:
                view = view[requests.write(view) or 0 :]
        deadline = time.monotonic() + timeout_s
        text_bytes, data_bytes = RESULT.unpack(self._read(RESULT.size, deadline))
        if text_bytes + data_bytes > _MAX_RESULT_BYTES:
            raise OSError("the result is too large")
        text = json.loads(self._read(text_bytes, deadline))
        return text, self._read(data_bytes, deadline)

    def kill(self) -> None:
        """End the process at once. The thread that uses it, if any, calls `close`."""
        self._process.kill()

    def close(self) -> None:
        """End the process at once and close its pipes."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            self._pipe(pipe).close()

    @staticmethod
    def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
        assert pipe is not None
        return pipe

    def _read(self, size: int, deadline: float) -> bytearray:
        descriptor = self._pipe(self._process.stdout).fileno()
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        parts: list[bytes] = []
        while size:
            if not poll.poll(max(0.0, deadline - time.monotonic()) * 1000):
                raise _DeadlineError
            part = os.read(descriptor, size)
            if not part:
                raise OSError("the process has ended")
            parts.append(part)
            size -= len(part)
        return bytearray().join(parts)


class DecodeProcesses:
    """Decoding processes, started when they are needed and reused. Methods may be called on any thread."""

    def __init__(self, timeout_s: float) -> None:
        """Create an empty pool; a frame may take `timeout_s` seconds."""
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._idle: list[_Process] = []
        self._all: set[_Process] = set()
        self._stopped = False

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
        seconds = int(self._timeout_s) + 10
        head = REQUEST.pack(len(body), index, reference, min_confidence, *box, seconds)
        process = self._acquire()
        try:
            text, data = process.request(head, body, self._timeout_s)
        except (_DeadlineError, OSError) as error:
            late = isinstance(error, _DeadlineError)
            rule = f"must decode within {self._timeout_s:g} s" if late else "the decoder crashed"
            self._replace(process)
            _log.warning("decoding process killed", extra={"frame": index, "bytes": len(body), "reason": rule})
            encoding = message.header.colour.encoding
            raise WireError("bad-frame", field="colour", value=f"{len(body)} bytes, {encoding}", rule=rule) from error
        self._release(process)
        return unpack_frame(text, data, message, index)

    def _acquire(self) -> _Process:
        with self._lock:
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
