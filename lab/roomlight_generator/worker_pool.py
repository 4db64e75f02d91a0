"""The worker processes of a run: each is assigned one shard after the other; one that dies is replaced.

They are plain child processes that exchange lines with this one (`worker`), not a `concurrent.futures` pool: such
a pool breaks when one of its processes is killed for lack of memory, and imports the parent's script into each.
"""

import json
import os
import queue
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from roomlight import errors
from roomlight.errors import DatasetError
from roomlight_generator.worker import ShardTask

DEATHS: Final = 3
"""Worker deaths at one shard, with no sequence finished in between, after which the run fails."""

_ONE_THREAD: Final = dict.fromkeys(
    ("ROOMLIGHT_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""A process a core, so a thread a process."""

_GRACE_S: Final = 20.0
"""Time that a worker that closed its output has to exit before it is killed."""

Message = dict[str, Any]


class WorkerPool:
    """Up to `size` workers; on_message gets the messages about finished sequences, and notes."""

    def __init__(self, size: int, *, on_message: Callable[[Message], None]) -> None:
        self._size = size
        self._on_message = on_message
        self._inbox: queue.Queue[tuple[_Worker, Message | None]] = queue.Queue()
        self._workers: set[_Worker] = set()
        self._deaths: dict[Path, int] = {}

    def run(self, tasks: deque[ShardTask]) -> None:
        """Run all tasks; no worker is left when this returns or raises, KeyboardInterrupt included.

        Raises:
            RoomLightError: the error with which a worker failed, of its own class.
            DatasetError: if workers keep dying at one shard.
            RuntimeError: if a worker failed with an unexpected error; the message holds its traceback.
        """
        try:
            for _ in range(min(self._size, len(tasks))):
                self._start(tasks)
            while self._workers:
                worker, message = self._inbox.get()
                task = worker.task
                if message is None:
                    self._workers.discard(worker)
                    ending = worker.reap()
                    if task is not None:
                        self._count_death(task, ending)
                        tasks.appendleft(task)
                        self._start(tasks)
                elif message["what"] == "shard":
                    if tasks:
                        worker.assign(tasks.popleft())
                    else:
                        worker.dismiss()
                elif message["what"] == "failed":
                    raise _error(message)
                else:
                    if message["what"] == "sequence" and task is not None:
                        self._deaths.pop(task.tar, None)
                    self._on_message(message)
        finally:
            for worker in self._workers:
                worker.kill()
            for worker in self._workers:
                worker.reap()

    def _start(self, tasks: deque[ShardTask]) -> None:
        worker = _Worker(self._inbox)
        self._workers.add(worker)
        worker.assign(tasks.popleft())

    def _count_death(self, task: ShardTask, ending: str) -> None:
        self._deaths[task.tar] = self._deaths.get(task.tar, 0) + 1
        text = f"a worker died ({ending}) making {task.tar}; another goes on with it"
        self._on_message({"what": "note", "text": text})
        if self._deaths[task.tar] >= DEATHS:
            raise DatasetError(
                f"{task.tar}: {DEATHS} workers in a row died making it, the last by {ending}. Signal 9 is "
                "mostly the system short of memory: use fewer `workers`; finished sequences are kept"
            )


def _error(message: Message) -> Exception:
    kind: object = getattr(errors, message["error"], None)
    if isinstance(kind, type) and issubclass(kind, errors.RoomLightError):
        return kind(message["text"])
    return RuntimeError(f"a worker failed:\n{message['text']}")


class _Worker:
    """A worker's process; its messages are put on `inbox` as (worker, message), and (worker, None) at its end."""

    def __init__(self, inbox: "queue.Queue[tuple[_Worker, Message | None]]") -> None:
        self.task: ShardTask | None = None
        self._last_lines: deque[str] = deque(maxlen=20)
        # The worker must find the same modules as this process.
        path = os.pathsep.join(entry or os.curdir for entry in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "roomlight_generator.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **_ONE_THREAD, "PYTHONPATH": path},
            process_group=0,  # Ctrl-C goes to this process alone, which then ends the workers
        )
        self._threads = [
            threading.Thread(target=self._read_messages, args=(inbox,), daemon=True),
            threading.Thread(target=self._read_errors, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def assign(self, task: ShardTask) -> None:
        """Send the worker a shard to make."""
        self.task = task
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it just died, which `inbox` will report
            self._process.stdin.write(task.to_line())
            self._process.stdin.flush()

    def dismiss(self) -> None:
        """Close the worker's input, upon which it exits."""
        self.task = None
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()

    def reap(self) -> str:
        """Wait for the process, which is exiting, and return how it ended, for a message."""
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:  # it closed its output and still runs
            self._process.kill()
            code = self._process.wait()
        for thread in self._threads:
            thread.join()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
        last = f": {self._last_lines[-1]}" if self._last_lines else ""
        return f"signal {-code}" if code < 0 else f"exit code {code}{last}"

    def _read_messages(self, inbox: "queue.Queue[tuple[_Worker, Message | None]]") -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with suppress(ValueError):  # the torn last line of a killed worker
                inbox.put((self, json.loads(line)))
        inbox.put((self, None))

    def _read_errors(self) -> None:
        """Keep the last lines that libraries and a dying interpreter print."""
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.strip():
                self._last_lines.append(line.strip())
