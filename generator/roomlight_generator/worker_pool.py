"""The worker processes of a run: each is given one shard after the other; one that dies is replaced.

They are plain child processes that speak JSON lines (`worker`), not a process pool of the library: a pool is lost
whole when one of its processes is killed for memory, and imports the parent's script into each.
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
from typing import Any, Final

from roomlight import errors
from roomlight.errors import DatasetError
from roomlight_generator.worker import ShardTask

DEATHS: Final = 3
"""Of workers at one shard, with no sequence finished in between, after which the run is given up."""

_ONE_THREAD: Final = dict.fromkeys(
    ("ROOMLIGHT_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""A process a core, so a thread a process."""

_GRACE_S: Final = 20.0

Message = dict[str, Any]


def work_through(todo: deque[ShardTask], *, workers: int, hear: Callable[[Message], None]) -> None:
    """Have every task done; `hear` gets the messages about sequences, and notes as they come.

    Raises what a worker failed with, and DatasetError where workers keep dying; no worker is left when this returns
    or raises, KeyboardInterrupt included.
    """
    heard: queue.Queue[tuple[_Worker, Message | None]] = queue.Queue()
    crew: set[_Worker] = set()
    deaths: dict[str, int] = {}

    def start() -> None:
        worker = _Worker(heard)
        crew.add(worker)
        worker.give(todo.popleft())

    try:
        for _ in range(min(workers, len(todo))):
            start()
        while crew:
            worker, message = heard.get()
            task = worker.task
            if message is None:
                crew.discard(worker)
                ending = worker.bury()
                if task is None:
                    continue
                deaths[task.tar] = deaths.get(task.tar, 0) + 1
                hear({"what": "note", "text": f"a worker died ({ending}) making {task.tar}; another goes on with it"})
                if deaths[task.tar] >= DEATHS:
                    raise DatasetError(
                        f"{task.tar}: {DEATHS} workers in a row died making it, the last by {ending}. Signal 9 is "
                        "mostly the system short of memory: give fewer --workers; what is finished stays"
                    )
                todo.appendleft(task)
                start()
            elif message["what"] == "shard":
                if todo:
                    worker.give(todo.popleft())
                else:
                    worker.dismiss()
            elif message["what"] == "failed":
                raise _error(message)
            else:
                if message["what"] == "sequence" and task is not None:
                    deaths.pop(task.tar, None)
                hear(message)
    finally:
        for worker in crew:
            worker.kill()
        for worker in crew:
            worker.bury()


def _error(message: Message) -> Exception:
    kind: object = getattr(errors, message["error"], None)
    if isinstance(kind, type) and issubclass(kind, errors.RoomLightError):
        return kind(message["text"])
    return RuntimeError(f"a worker failed:\n{message['text']}")


class _Worker:
    """A worker's process; what it says is put on `heard` as (worker, message), and (worker, None) at its end."""

    def __init__(self, heard: "queue.Queue[tuple[_Worker, Message | None]]") -> None:
        self.task: ShardTask | None = None
        self._said: deque[str] = deque(maxlen=20)
        # it must find the modules that this process finds, however it was told of them
        path = os.pathsep.join(entry or os.curdir for entry in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "roomlight_generator.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **_ONE_THREAD, "PYTHONPATH": path},
            process_group=0,  # Ctrl-C is for this process, which then ends the workers
        )
        self._threads = [
            threading.Thread(target=self._listen, args=(heard,), daemon=True),
            threading.Thread(target=self._overhear, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def give(self, task: ShardTask) -> None:
        """A shard to make."""
        self.task = task
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it died just now: its end is on its way through `heard`
            self._process.stdin.write(json.dumps(vars(task)) + "\n")
            self._process.stdin.flush()

    def dismiss(self) -> None:
        """Nothing more to do: it ends by itself."""
        self.task = None
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()

    def kill(self) -> None:
        """End it where it is."""
        self._process.kill()

    def bury(self) -> str:
        """Wait until it is gone, which it is about to; how it ended, for a message."""
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:  # it closed its output and lives on
            self._process.kill()
            code = self._process.wait()
        for thread in self._threads:
            thread.join()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
        return f"signal {-code}" if code < 0 else f"exit code {code}" + (f": {self._said[-1]}" if self._said else "")

    def _listen(self, heard: "queue.Queue[tuple[_Worker, Message | None]]") -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with suppress(ValueError):  # a torn last line of one that was killed
                heard.put((self, json.loads(line)))
        heard.put((self, None))

    def _overhear(self) -> None:
        """Keep the last lines of what libraries and a dying interpreter print."""
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.strip():
                self._said.append(line.strip())
