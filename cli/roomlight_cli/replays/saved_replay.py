"""What a replay saves in its output folder while it runs, so that the same command goes on after it was stopped.

`.replay/state` holds the session and all that a replay knows after a frame, `.replay/000000.mp4` ... the finished parts
of its video. Both go when the replay is finished.
"""

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from roomlight.captures.capture import PassState, SkippedFrame
from roomlight.conventions import Position
from roomlight.engine.options import SessionOptions
from roomlight.engine.session import FrameReport, Session
from roomlight.engine.state.encoding import records_of_snapshot, session_of_records
from roomlight.engine.state.records import Record, pack_records, read_first_records, unpack_records
from roomlight.engine.state.values import records_of_values, values_of_records
from roomlight.errors import OutputError, StateError
from roomlight.files import write_durable
from roomlight_cli.replays.pictures import PicturesState

FOLDER: Final = ".replay"
_STATE: Final = "state"
SAVE_EVERY: Final = 25
"""Frames after which the state is saved (10 to 20 MB, 0.1 s), from the first on that a pass can go on after; in a long
replay, a hundredth of the frames so far."""


@dataclass
class ReplayState:
    """What a replay knows after a frame.

    Attributes:
        inputs: Digest of the capture's and the weights' files.
        positions: The probes, world metres; none before the first frame.
        inside: Whether the first volume contains them.
        reports: Of the frames so far.
        unusable: Frames that the session refused.
        written: Indices of the frames whose panoramas are written.
        interpolated: How many of these were interpolated.
        wall_s: Time so far.
        passed: Where the pass over the capture is; None at its beginning.
        pictures: Of video and summary; None before the first frame.
    """

    inputs: str
    positions: tuple[Position, ...] = ()
    inside: tuple[bool, ...] = ()
    reports: list[FrameReport] = field(default_factory=list[FrameReport])
    unusable: list[SkippedFrame] = field(default_factory=list[SkippedFrame])
    written: list[int] = field(default_factory=list[int])
    interpolated: int = 0
    wall_s: float = 0.0
    passed: PassState | None = None
    pictures: PicturesState | None = None


def is_due(frames: int) -> bool:
    """Return whether the state is saved after so many frames."""
    return frames % (SAVE_EVERY * max(1, frames // (100 * SAVE_EVERY))) == 0


def save_replay(out: Path, state: ReplayState, session: Session) -> None:
    """Write the state after a frame, complete or not at all. Raises OutputError."""
    records = [
        Record("RPLY", {"frames": len(state.reports)}),
        *records_of_values(state, "LOOP"),
        *records_of_snapshot(session.snapshot()),
    ]
    (out / FOLDER).mkdir(exist_ok=True)
    write_durable(out / FOLDER / _STATE, pack_records(records))


def load_replay(out: Path, inputs: str, options: SessionOptions) -> tuple[ReplayState, Session] | None:
    """Return the state of a stopped replay with the same options, and its session; None if there is none.

    Args:
        out: The replay's folder.
        inputs: Digest of the capture's and the weights' files as they are now.
        options: Of the session.

    Raises:
        OutputError: The inputs have changed since, or the state is damaged.
    """
    path = out / FOLDER / _STATE
    try:
        records = unpack_records(path.read_bytes(), str(path))
        state = values_of_records(ReplayState, records, "LOOP", str(path))
        if state.inputs != inputs:
            raise StateError("files of the recording or the weights have changed since")
        return state, Session.from_snapshot(session_of_records(records, str(path)).snapshot(), options)
    except FileNotFoundError:
        return None
    except (OSError, StateError) as error:
        raise OutputError(f"{out}: the stopped replay cannot go on: {error}; begin again with --overwrite") from error


def saved_frames(out: Path) -> int:
    """Return after how many frames a stopped replay goes on; 0 if it begins again."""
    try:
        return int(read_first_records(out / FOLDER / _STATE, 1)[0].values["frames"])
    except (OSError, StateError):
        return 0


def forget_replay(out: Path) -> None:
    """Remove what a replay has saved to go on from. Raises OutputError."""
    try:
        shutil.rmtree(out / FOLDER)
    except FileNotFoundError:
        return
    except OSError as error:
        raise OutputError(f"{out / FOLDER}: cannot be removed ({error.strerror or error})") from error
