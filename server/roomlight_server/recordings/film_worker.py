"""The process that makes a film of an uploaded recording: `python -m roomlight_server.recordings.film_worker IN OUT`.

A pickled `FilmJob` comes on standard input, from the server alone; records go to standard output, as those of `worker`.
Uploaded files are not trusted: the process has limits on its memory and on what it writes. It gives way to the server.
"""

import os
import pickle
import sys
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, Final

from roomlight.captures import CaptureOptions, open_capture
from roomlight.compositing.compositor import Compositor
from roomlight.engine.session import Session
from roomlight.imaging.video_writer import VideoWriter
from roomlight_server.answers.composites import BOXES, MAX_PATHS
from roomlight_server.recordings.jobs import MAX_FILM_BYTES, FilmJob
from roomlight_server.recordings.worker import capture_path, film_rate, limited_output, run, write

_NICE: Final = 10
_LIGHT_FRAMES: Final = 200
"""Most frames that are read for the light; of a longer recording, every n-th."""


def make(folder: Path, film: Path, job: FilmJob, output: BinaryIO) -> None:
    """Read the room, then composite the frames of the film, and write a record for each.

    Raises:
        RoomLightError: The recording cannot be read, or an object cannot be placed.
    """
    path = capture_path(folder)
    whole = open_capture(path)
    every, fps = film_rate(whole.frames_per_second)
    seen = open_capture(path, CaptureOptions(every=every * -(-whole.frame_count // (every * _LIGHT_FRAMES))))
    session = Session(job.options)
    for number, frame in enumerate(seen, start=1):
        session.push(frame)
        write(output, {"status": "reading", "frame": number, "frames": seen.frame_count})
    shown = open_capture(path, CaptureOptions(every=every, max_frames=job.first + job.frames))
    wanted = shown.frame_count - job.first
    made = 0
    with (
        closing(Compositor(session, job.scene, quality=job.quality, max_paths=MAX_PATHS)) as compositor,
        VideoWriter(film, frames_per_second=fps) as video,
    ):
        for frame in shown:
            if frame.index >= job.first * every:
                video.write(compositor.composite(frame.resized(*BOXES[job.quality])).image)
                made += 1
                write(output, {"status": "making", "frame": made, "frames": wanted})
    write(output, {"end": True} if made else {"problem": f"it has no usable frame from number {job.first} on"})


def main(arguments: list[str]) -> None:
    """Make a film, the second argument, of the recording in the folder of the first."""
    output = limited_output(MAX_FILM_BYTES)
    os.nice(_NICE)
    folder, film = (Path(argument) for argument in arguments)
    run(lambda: make(folder, film, FilmJob(*pickle.load(sys.stdin.buffer)), output), folder, output)


if __name__ == "__main__":
    main(sys.argv[1:])
