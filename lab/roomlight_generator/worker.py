"""A process that makes shards: `python -m roomlight_generator.worker`, started by `generate`.

It reads tasks from standard input, a line each (`ShardTask.to_line`), and writes messages to standard output, a JSON
object a line. When the input ends, also because the parent died, the process exits at once: the next writer of its
shard truncates an unfinished sequence.
"""

import json
import os
import pickle
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from roomlight.dataset.archive import pack
from roomlight.dataset.folder import sequence_name
from roomlight.dataset.recording import Recording
from roomlight.dataset.sequence_files import encode
from roomlight.dataset.shards import ShardWriter
from roomlight.errors import DatasetError, RoomLightError
from roomlight_generator.room_request import RenderRoom, RoomRequest

if TYPE_CHECKING:
    from roomlight_generator.generate import GenerateOptions

ATTEMPTS: Final = 3
"""Rooms drawn for one room index before the run fails."""


@dataclass(frozen=True)
class ShardTask:
    """A shard to make or to continue.

    Attributes:
        first, last: The shard's sequences are `first` to `last` - 1 of the split.
        renderer: `module:function` that renders a room's recordings.
    """

    tar: Path
    first: int
    last: int
    options: "GenerateOptions"
    renderer: str

    def to_line(self) -> str:
        """Return the task as a line of text: a pickle in hexadecimal digits, since options hold paths."""
        return pickle.dumps(self).hex() + "\n"

    @staticmethod
    def from_line(line: str) -> "ShardTask":
        """Read what `to_line` returned."""
        return pickle.loads(bytes.fromhex(line))


Emit = Callable[[dict[str, Any]], None]


def make_shard(task: ShardTask, render: RenderRoom, emit: Emit) -> None:
    """Make the sequences that the shard does not hold yet; emits a message when each is on the disk.

    Raises:
        DatasetError: if a room cannot be made or the shard is damaged.
        OutputError: if the shard cannot be written.
    """
    per_room, split = task.options.sequences_per_room, task.options.split
    with ShardWriter(task.tar) as shard:
        names = shard.names
        for room in range(task.first // per_room, -(-task.last // per_room)):
            numbers = range(max(task.first, room * per_room), min(task.last, (room + 1) * per_room))
            missing = {n - room * per_room for n in numbers if sequence_name(split, n) not in names}
            clock = time.process_time()
            for within, packed in _room(task, room, missing, render, emit):
                name = sequence_name(split, room * per_room + within)
                shard.append(name, packed)
                clock, before = time.process_time(), clock
                emit({"what": "sequence", "name": name, "bytes": len(packed), "core_s": clock - before})
        shard.finish()


def _room(task: ShardTask, room: int, missing: set[int], render: RenderRoom, emit: Emit) -> Iterator[tuple[int, bytes]]:
    """Yield the missing walks of a room, packed, in order.

    If a room fails at some walk, the next attempt's room provides that walk and the following. Which attempt a sequence
    comes from depends on the room alone, not on the sequences that the shard contains. Attempts after the first have a
    seed drawn from the seed and the attempt's number.
    """
    options, done = task.options, 0
    for attempt in range(ATTEMPTS):
        drawn = np.random.SeedSequence([options.seed, attempt]).generate_state(1, np.uint64)
        seed = int(drawn[0]) if attempt else options.seed
        request = RoomRequest(
            room,
            seed,
            options.split,
            options.sequences_per_room,
            options.frames,
            furniture=options.furniture,
            panoramas=options.panoramas,
            furniture_share=options.furniture_share,
            scenes=options.scenes,
            samples=options.samples,
        )
        try:
            for within, recording in enumerate(render(request)):
                if within < done:
                    continue
                done = within + 1
                if within in missing:
                    yield within, _packed(options, room, within, attempt, seed, recording)
                if done > max(missing, default=-1):
                    return
            raise ValueError(f"it gave {done} of {options.sequences_per_room} sequences")
        except (RoomLightError, MemoryError):
            raise
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            last = f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno})"
            what = f"room {room} of {options.split}, seed {options.seed}, attempt {attempt + 1} of {ATTEMPTS}: {last}"
            emit({"what": "note", "text": what})
            if attempt == ATTEMPTS - 1:
                advice = "another `seed` gives other rooms"
                if options.scenes:
                    advice = f"leave {options.scenes[room].name} out, or free more of its floor if places lack"
                raise DatasetError(
                    f"room {room} of {options.split} with seed {options.seed} cannot be made; all {ATTEMPTS} attempts "
                    f"failed, the last with {last}; {advice}"
                ) from error


def _packed(options: "GenerateOptions", room: int, within: int, attempt: int, seed: int, recording: Recording) -> bytes:
    name = sequence_name(options.split, room * options.sequences_per_room + within)
    made = {"seed": options.seed, "split": options.split, "room": room, "walk": within}
    made |= {"attempt": attempt, "room_seed": seed}
    return pack(name, encode(replace(recording, name=name, facts={**recording.facts, "made": made})))


def main() -> None:
    """Make the shards requested on standard input until it ends."""
    # Messages get a descriptor of their own: libraries print to standard output too.
    messages = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    cv2.setNumThreads(1)  # the environment that the parent sets limits the other libraries
    tasks: queue.Queue[str] = queue.Queue()

    def read_tasks() -> None:
        for line in sys.stdin:
            tasks.put(line)
        os._exit(0)

    def emit(message: dict[str, Any]) -> None:
        messages.write(json.dumps(message) + "\n")
        messages.flush()

    threading.Thread(target=read_tasks, daemon=True).start()
    while True:
        task = ShardTask.from_line(tasks.get())
        try:
            make_shard(task, resolve_name(task.renderer), emit)
            emit({"what": "shard"})
        except RoomLightError as error:
            emit({"what": "failed", "error": type(error).__name__, "text": str(error)})
        except MemoryError:
            sys.exit("MemoryError: out of memory")
        except Exception:
            emit({"what": "failed", "error": "bug", "text": traceback.format_exc()})


if __name__ == "__main__":
    main()
