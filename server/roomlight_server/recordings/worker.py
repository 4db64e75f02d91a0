"""The process that reads an uploaded recording: `python -m roomlight_server.recordings.worker PATH FPS`.

It writes records to standard output: the lengths of a JSON text and of a body, the text, the body. The first record
describes the recording, those with `preparing` say that it is being looked at, each following one is a frame message,
and the last one has `end`. Uploaded files are not trusted: this process has limits on its memory and writes no file,
so that a hostile file harms the server in no way. The pipe holds the process until the server takes the next frame.
"""

import json
import math
import os
import resource
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final

from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.captures.recognition import is_record3d_archive
from roomlight.errors import CaptureError, ObjectError, ProbeError, RoomLightError, SceneError
from roomlight.placement import point_in_view
from roomlight.wire.frame_encoding import pack_frame
from roomlight_server.recordings.jobs import RECORD
from roomlight_server.work.decode_worker import open_output

MAX_MEMORY_BYTES: Final = 4 * 2**30
"""Address space of the process; reading a 12-megapixel frame takes 0.6 GB of it, mostly libraries."""
TIMED_FPS: Final = 10.0
"""Most frames per second of a recording with timestamps, where none is given: more than two cores process."""
UNTIMED_FPS: Final = 3.0
"""Pace of a recording without timestamps: about what two cores keep up with."""
FILM_FPS: Final = 30.0
"""Most frames per second of a film."""
_MAX_NOTES, _MAX_NOTE_LENGTH = 16, 400


def write(output: BinaryIO, text: dict[str, Any], body: bytes = b"") -> None:
    """Write a record."""
    encoded = json.dumps(text).encode()
    output.write(RECORD.pack(len(encoded), len(body)) + encoded + body)
    output.flush()


def capture_path(folder: Path) -> Path:
    """Return the recording in an upload's folder: a single file or folder inside it, or the folder itself.

    Raises:
        CaptureError: It is a zip file: what it unpacks to would not count in its owner's disk quota.
    """
    entries = list(folder.iterdir())
    while len(entries) == 1:
        folder = entries[0]
        entries = list(folder.iterdir()) if folder.is_dir() else []
    if folder.suffix.lower() == ".zip" and folder.is_file() and not is_record3d_archive(folder):
        raise CaptureError(f"{folder}: is not unpacked here; unpack it, and send its files")
    return folder


def film_rate(rate: float | None) -> tuple[int, float]:
    """Return which of a recording's frames a film shows, every n-th, and how many a second; without timestamps, 10."""
    every = 1 if rate is None else max(1, math.ceil(rate / FILM_FPS - 0.01))
    return every, min(max(rate / every, 0.1), FILM_FPS) if rate else TIMED_FPS


def play(folder: Path, fps: float | None, output: BinaryIO) -> None:
    """Write the records of a recording. Raises RoomLightError if the recording cannot be read."""
    path = capture_path(folder)
    whole = open_capture(path)
    rate = whole.frames_per_second
    every = 1 if rate is None else max(1, math.ceil(rate / (fps or TIMED_FPS) - 0.01))
    capture = open_capture(path, CaptureOptions(every=every))
    step_s = every / rate if rate else 1 / (fps or UNTIMED_FPS)
    probes = [list(probe.position) for probe in capture.probes]
    film_every, film_fps = film_rate(rate)
    film = {"film_frames": -(-whole.frame_count // film_every), "film_fps": film_fps}
    write(output, {"frames": capture.frame_count, "format": capture.format, "probes": probes} | film)
    capture.prepare(lambda _text, done, total: write(output, {"preparing": [done, total]}))
    start_s: float | None = None
    sent, unusable = 0, 0
    for frame in capture:
        try:
            body = pack_frame(frame, colour="jpeg")
        except RoomLightError:
            unusable += 1
            continue
        due_s = (frame.index // every) * step_s
        if rate is not None and frame.timestamp_s is not None:
            start_s = frame.timestamp_s if start_s is None else start_s
            due_s = frame.timestamp_s - start_s
        notes = _notes(capture, folder)
        text: dict[str, Any] = {"due_s": due_s, "unreadable": len(capture.skipped) + unusable, "notes": notes}
        if sent == 0:
            try:
                text["view"] = list(point_in_view(frame))
            except ProbeError:
                text["view"] = None
        write(output, text, body)
        sent += 1
    reasons = [without(folder, f"{skipped.file}: {skipped.reason}") for skipped in capture.skipped[:3]]
    bad = len(capture.skipped) + unusable
    write(output, {"end": True, "unreadable": bad, "notes": _notes(capture, folder), "reasons": reasons})


def _notes(capture: Capture, folder: Path) -> list[str]:
    return [without(folder, str(note))[:_MAX_NOTE_LENGTH] for note in capture.notes[:_MAX_NOTES]]


def without(folder: Path, text: str) -> str:
    """Return a text without the place of the upload on the server; paths in it are those of the client."""
    for place in {str(folder), str(folder.resolve())}:
        text = text.replace(f"{place}{os.sep}", "").replace(place, "the recording")
    return text


def limited_output(file_bytes: int = 0) -> BinaryIO:
    """Limit this process, which may write files of `file_bytes`, and return where it writes records."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    return open_output(MAX_MEMORY_BYTES)


def run(work: Callable[[], None], folder: Path, output: BinaryIO) -> None:
    """Run the work of this process on the recording in a folder; the record of a failure says why."""
    try:
        work()
    except BrokenPipeError:
        pass  # the server has stopped it
    except (SceneError, ObjectError) as error:
        write(output, {"place": str(error)[:1000]})
    except (RoomLightError, OSError, ValueError) as error:
        write(output, {"problem": without(folder, str(error))[:1000]})
    except MemoryError:
        write(output, {"problem": f"it needs more than {MAX_MEMORY_BYTES} bytes of memory"})


def main(arguments: list[str]) -> None:
    """Play the recording in the folder of the first argument; the second is the rate, or `-`."""
    output = limited_output()
    folder, fps = Path(arguments[0]), None if arguments[1] == "-" else float(arguments[1])
    run(partial(play, folder, fps, output), folder, output)


if __name__ == "__main__":
    main(sys.argv[1:])
