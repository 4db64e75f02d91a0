"""A process that makes shards: `python -m roomlight_generator.worker`, started by `generate`.

Tasks come in on standard input and messages go out on standard output, one JSON object a line. When the input ends,
which it does when the parent is gone for whatever reason, the process ends in the midst of its work: what it was
writing is cut off by the next writer of that shard.
"""

import json
import os
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

import cv2
import numpy as np

from roomlight.dataset.archive import pack
from roomlight.dataset.folder import sequence_name
from roomlight.dataset.recording import Recording, Split
from roomlight.dataset.sequence_files import encode
from roomlight.dataset.shards import ShardWriter
from roomlight.errors import DatasetError, RoomLightError

ATTEMPTS: Final = 3
"""Rooms drawn for one room number before it is given up."""


@runtime_checkable  # so that a checker of annotations can look at it in the test run
class RenderRoom(Protocol):
    """What makes the recordings of a room: `dataset.room_sequences.render_room`, or a test's stand-in."""

    def __call__(
        self, room_index: int, *, seed: int, split: Split, furniture: Path | None, count: int, frames: int
    ) -> Iterator[Recording]:
        """`count` walks of so many frames through the room of this number, one by one."""
        ...


@dataclass(frozen=True)
class ShardTask:
    """One shard to make or to go on with: sequences `first` to `last` - 1 of a split, into `tar`."""

    tar: str
    split: Split
    first: int
    last: int
    seed: int
    sequences_per_room: int
    frames: int
    furniture: str | None
    renderer: str


Emit = Callable[[dict[str, Any]], None]


def make_shard(task: ShardTask, render: RenderRoom, emit: Emit) -> None:
    """Make what the shard does not have yet. Every sequence is reported when it is on the disk.

    DatasetError where a room cannot be made or the shard is damaged; OutputError where it cannot be written.
    """
    per_room = task.sequences_per_room
    with ShardWriter(Path(task.tar)) as shard:
        names = shard.names
        for room in range(task.first // per_room, -(-task.last // per_room)):
            numbers = range(max(task.first, room * per_room), min(task.last, (room + 1) * per_room))
            missing = {n - room * per_room for n in numbers if sequence_name(task.split, n) not in names}
            clock = time.process_time()
            for within, packed in _room(task, room, missing, render, emit):
                name = sequence_name(task.split, room * per_room + within)
                shard.append(name, packed)
                clock, before = time.process_time(), clock
                emit({"what": "sequence", "name": name, "bytes": len(packed), "core_s": clock - before})
        shard.finish()


def _room(task: ShardTask, room: int, missing: set[int], render: RenderRoom, emit: Emit) -> Iterator[tuple[int, bytes]]:
    """The missing walks of a room, packed, in order.

    Where a room fails, the next attempt's takes over from the walk it failed at: which sequences are of which attempt
    depends on the room alone, not on what was there already. The seed of an attempt after the first is drawn from the
    seed and the attempt's number.
    """
    furniture = None if task.furniture is None else Path(task.furniture)
    done = 0
    for attempt in range(ATTEMPTS):
        seed = task.seed if attempt == 0 else _attempt_seed(task.seed, attempt)
        try:
            walks = render(
                room,
                seed=seed,
                split=task.split,
                furniture=furniture,
                count=task.sequences_per_room,
                frames=task.frames,
            )
            for within, recording in enumerate(walks):
                if within < done:
                    continue
                done = within + 1
                if within in missing:
                    yield within, _packed(task, room, within, attempt, seed, recording)
                if done > max(missing, default=-1):
                    return
            raise ValueError(f"it gave {done} of {task.sequences_per_room} sequences")
        except (RoomLightError, MemoryError):
            raise
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            last = f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno})"
            what = f"room {room} of {task.split}, seed {task.seed}, attempt {attempt + 1} of {ATTEMPTS}: {last}"
            emit({"what": "note", "text": what})
            if attempt == ATTEMPTS - 1:
                raise DatasetError(
                    f"room {room} of {task.split} with seed {task.seed} cannot be made; all {ATTEMPTS} attempts "
                    f"failed, the last with {last}; another --seed gives other rooms"
                ) from error


def _packed(task: ShardTask, room: int, within: int, attempt: int, seed: int, recording: Recording) -> bytes:
    name = sequence_name(task.split, room * task.sequences_per_room + within)
    made = {"seed": task.seed, "split": task.split, "room": room, "walk": within, "attempt": attempt, "room_seed": seed}
    return pack(name, encode(replace(recording, name=name, facts={**recording.facts, "made": made})))


def _attempt_seed(seed: int, attempt: int) -> int:
    return int(np.random.SeedSequence([seed, attempt]).generate_state(1, np.uint64)[0])


def find_renderer(name: str) -> RenderRoom:
    """The function of `module:function`."""
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)


def _one_thread() -> None:
    """The parent starts a process a core; its environment holds the other libraries to one thread."""
    cv2.setNumThreads(1)


def main() -> None:
    """Make the shards asked for on standard input until it ends."""
    # what libraries print must not get between the messages
    messages = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    _one_thread()
    tasks: queue.Queue[str] = queue.Queue()

    def listen() -> None:
        for line in sys.stdin:
            tasks.put(line)
        os._exit(0)

    def emit(message: dict[str, Any]) -> None:
        messages.write(json.dumps(message) + "\n")
        messages.flush()

    threading.Thread(target=listen, daemon=True).start()
    while True:
        task = ShardTask(**json.loads(tasks.get()))
        try:
            make_shard(task, find_renderer(task.renderer), emit)
            emit({"what": "shard", "tar": task.tar})
        except RoomLightError as error:
            emit({"what": "failed", "error": type(error).__name__, "text": str(error)})
        except MemoryError:
            sys.exit("MemoryError: out of memory")
        except Exception:
            emit({"what": "failed", "error": "bug", "text": traceback.format_exc()})


if __name__ == "__main__":
    main()
