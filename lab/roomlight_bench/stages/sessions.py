"""Whole frames and late points of sessions, as a program of its own: also of another checkout of RoomLight.

    python -m roomlight_bench.stages.sessions MODEL...

reads lines and answers each with a line of JSON: milliseconds by measurement, of one round. So two checkouts are
measured in turns, and other work on the machine slows both. It uses only names that other checkouts have, too.
"""

import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO, Any, Final

from roomlight.engine.session import FrameReport, Session, SessionOptions
from roomlight.errors import OptionError
from roomlight_bench.stages.room import PROBE, RoomSize, handheld, views

FURTHER: Final = 4
"""Further tracked probes of the second session."""
LATE: Final = 16
"""Late points in one call."""
PROGRAM: Final[tuple[str, ...]] = (__file__,)
"""Arguments of the Python that measures a checkout."""


class MeasuredSession:
    """A session that has seen a turn around the room, and goes on with a camera held by hand.

    Attributes:
        stage_ms: what the session's own clock said of each frame with one probe, by stage.
    """

    def __init__(self, model: str, size: RoomSize, **options: Any) -> None:
        """Push the turn into a session with one probe, and into one with `FURTHER` more."""
        self.name = model
        self.stage_ms: dict[str, list[float]] = {}
        chosen: Any = SessionOptions(model=model, height=size.panorama_height, keyframes=size.keyframes, **options)  # type: ignore[arg-type]
        self._sessions = [Session(chosen) for _ in range(2)]
        x, y, z = PROBE
        self._sessions[0].track(PROBE)
        for number in range(1 + FURTHER):
            self._sessions[1].track((x + 0.1 * number, y, z))
        for frame, session in itertools.product(views(size.keyframes, size), self._sessions):
            session.push(frame)
        self._frames = [itertools.cycle(handheld(30, size)) for _ in self._sessions]
        self.keyframes = self._sessions[0].keyframes

    def runs(self) -> dict[str, Callable[[], object]]:
        """Return what is measured, by name."""
        return {
            f"frame, {self.name}": self._frame,
            f"frame with {FURTHER} further probes, {self.name}": lambda: self._push(1),
            f"late point, {self.name}": lambda: self._sessions[0].light_at(PROBE),
            f"{LATE} late points, {self.name}": self._late_points,
        }

    def _push(self, which: int) -> FrameReport:
        return self._sessions[which].push(next(self._frames[which]))

    def _frame(self) -> None:
        for stage, ms in self._push(0).stage_ms.items():
            self.stage_ms.setdefault(stage, []).append(ms)

    def _late_points(self) -> None:
        x, y, z = PROBE
        points = [(x + 0.05 * number, y, z) for number in range(LATE)]
        session: Any = self._sessions[0]
        if hasattr(session, "lights_at"):
            session.lights_at(points)
        else:
            for point in points:
                session.light_at(point)


def measure_against(other: Path, models: tuple[str, ...], *, rounds: int) -> Iterator[tuple[str, float, float]]:
    """Measure this checkout and another one in turns.

    Args:
        other: Folder of the other checkout; this Python runs it, with its kernels compiled before the measurement.
        rounds: Measurements of each; the least counts.

    Yields:
        Name, milliseconds here, milliseconds there.

    Raises:
        OptionError: A checkout cannot be measured.
    """
    folders = (Path(__file__).parents[3], other)
    least: list[dict[str, float]] = [{}, {}]
    with ExitStack() as stack:
        processes = [stack.enter_context(_Measuring(folder, models)) for folder in folders]
        for _ in range(rounds + 1):  # the first one warms up
            for process, ms in zip(processes, least, strict=True):
                for name, value in process.round().items():
                    ms[name] = min(value, ms.get(name, value))
    for name, ms in least[0].items():
        yield name, ms, least[1][name]


class _Measuring:
    """A process that measures a checkout, a round at a time."""

    def __init__(self, folder: Path, models: tuple[str, ...]) -> None:
        self._folder = folder
        paths = [str(folder / part) for part in ("core", "model", "export", "server", "client", "lab", "cli")]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
        command = [sys.executable, *PROGRAM, *models]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)

    def __enter__(self) -> "_Measuring":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def round(self) -> dict[str, float]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(BrokenPipeError):  # it has ended
            self._process.stdin.write("\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise OptionError(f"{self._folder}: its frames cannot be measured; see the error above")
        return json.loads(line)


def _answer(models: list[str], lines: IO[str], out: IO[str]) -> None:
    runs: dict[str, Callable[[], object]] = {}
    for model in models:
        runs |= MeasuredSession(model, RoomSize()).runs()
    for _ in lines:
        took: dict[str, float] = {}
        for name, run in runs.items():
            began = time.perf_counter()
            run()
            took[name] = (time.perf_counter() - began) * 1e3
        out.write(json.dumps(took) + "\n")
        out.flush()


if __name__ == "__main__":
    _answer(sys.argv[1:], sys.stdin, sys.stdout)
