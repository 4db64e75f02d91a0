"""A server that is killed again and again while a client streams: what is lost, and whether the light stays the same.

Each round starts `roomlight serve --state-dir` on the same folder, asks for the last frame of the session, sends the
frames after it again, compares the light of two probes with an engine that was never interrupted (equal digests: equal
bits), and then sends new frames until the server is killed (SIGKILL) at a random time.
"""

import http.client
import json
import random
import re
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

from annotated_types import Ge, Interval
from rich.table import Table

from roomlight import sample_capture
from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ServerError
from roomlight.placement import point_in_view
from roomlight.rules import check_options
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.frame_message import FrameLimits
from roomlight.wire.messages import ModelName
from roomlight_bench.server.server_process import ServerProcess
from roomlight_server.work.decode_worker import decode_to_box
from roomlight_server.work.intake import parse_frame

_SESSION: Final = "/v1/sessions/room"
_TIMEOUT_S: Final = 120


@dataclass(frozen=True)
class DurabilityOptions:
    """What to do.

    Attributes:
        model: Model of the session.
        kills: Number of times that the server is killed.
        interval_s: `--state-interval-s` of the server.
        longest_s: The server is killed after 0 to this many seconds of new frames.
        height: Rows of the panoramas.
        frames: Frames of the sample capture that are sent in turn.
        seed: Seed of the random times.
    """

    model: ModelName = "classical"
    kills: Annotated[int, Interval(ge=1, le=100_000)] = 200
    interval_s: Annotated[float, Interval(ge=0.1, le=60)] = 2.0
    longest_s: Annotated[float, Interval(ge=0.1, le=600)] = 4.0
    height: Annotated[int, Interval(ge=16, le=512)] = 48
    frames: Annotated[int, Ge(1)] = 24
    seed: int = 1

    def __post_init__(self) -> None:
        check_options(self)


@dataclass
class DurabilityReport:
    """What was found.

    Attributes:
        model: Model of the session.
        kills: Number of kills.
        frames: Frames of the uninterrupted session.
        acknowledged: Frames that were answered `processed`, sent again or not.
        lost_late: Acknowledged frames that were older than the interval at the kill and were not restored.
        oldest_lost_s: Age at the kill of the oldest acknowledged frame that was not restored.
        broken_promises: Restored states that ended before an answered `durable_index`.
        compared: Comparisons of light after frames were sent again.
        different: Those that were not equal to the bit.
        sent_again: Frames that were sent again.
        restore_ms: Times of the first request after a start, which restores the session.
        disk_bytes: Size of the session on disk at the end.
        write_ms: Mean time of a write.
        seconds: Duration of the whole run.
    """

    model: str = ""
    kills: int = 0
    frames: int = 0
    acknowledged: int = 0
    lost_late: int = 0
    oldest_lost_s: float = 0.0
    broken_promises: int = 0
    compared: int = 0
    different: int = 0
    sent_again: int = 0
    restore_ms: list[float] = field(default_factory=list[float])
    disk_bytes: int = 0
    write_ms: float = 0.0
    seconds: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether nothing older than the interval was lost and all light was equal."""
        return self.lost_late == 0 and self.broken_promises == 0 and self.different == 0

    def to_json(self) -> dict[str, Any]:
        """Return all figures."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__} | {"holds": self.holds}

    def table(self) -> Table:
        """Return the figures as a table."""
        restore = f"{statistics.median(self.restore_ms):.0f} (at most {max(self.restore_ms):.0f})"
        table = Table("measure", "value", title="A server that is killed while a client streams", title_justify="left")
        for row in (
            ("model", self.model),
            ("kills", str(self.kills)),
            (
                "frames; acknowledged; sent again",
                f"{self.frames}; {self.acknowledged}; {self.sent_again}",
            ),
            ("acknowledged frames older than the interval that were lost", str(self.lost_late)),
            ("age of the oldest acknowledged frame that was lost, s", f"{self.oldest_lost_s:.2f}"),
            ("restored states that ended before `durable_index`", str(self.broken_promises)),
            ("comparisons of light; different", f"{self.compared}; {self.different}"),
            ("size on disk, kB", f"{self.disk_bytes / 1e3:.0f}"),
            ("write, mean ms", f"{self.write_ms:.0f}"),
            ("restore, median ms", restore),
            ("duration, s; of a kill", f"{self.seconds:.0f}; {self.seconds / max(1, self.kills):.1f}"),
        ):
            table.add_row(*row)
        return table


def run_durability(
    options: DurabilityOptions, *, progress: Callable[[str], object] = lambda _: None
) -> DurabilityReport:
    """Kill a server on this machine `options.kills` times while a client streams.

    Raises:
        ServerError: The server does not start, or answers with an error.
    """
    with tempfile.TemporaryDirectory(prefix="roomlight-durability-") as folder:
        return _Run(options, Path(folder)).run(progress)


class _Uninterrupted:
    """An engine that gets every frame once."""

    def __init__(self, bodies: list[bytes], probes: dict[str, Position], options: DurabilityOptions) -> None:
        self._bodies = bodies
        self._session = Session(SessionOptions(model=options.model, height=options.height, provider="cpu"))
        self._handles = {name: self._session.track(position) for name, position in probes.items()}
        self._next = 0

    @property
    def model(self) -> str:
        """The model in use."""
        return self._session.model

    def digests(self, index: int) -> dict[str, str]:
        """Return the digest of the light of each probe after the frame `index`."""
        for number in range(self._next, index + 1):
            message, _ = parse_frame(self._bodies[number % len(self._bodies)], FrameLimits())
            self._session.push(decode_to_box(message, number, 1.0, 1, WORKING_SIZE))
        self._next = index + 1
        digests: dict[str, str] = {}
        for name, handle in self._handles.items():
            digests[name] = self._session.light(handle).digest()
        return digests


class _Run:
    def __init__(self, options: DurabilityOptions, folder: Path) -> None:
        captured = list(open_capture(sample_capture(), CaptureOptions(max_frames=options.frames)))
        x, y, z = point_in_view(captured[0])
        self._probes: dict[str, Position] = {"table": (x, y, z), "other": (x, y + 0.3, z)}
        self._bodies = [pack_frame(frame, colour="jpeg") for frame in captured]
        self._options, self._folder = options, folder
        self._random = random.Random(options.seed)
        self._whole = _Uninterrupted(self._bodies, self._probes, options)
        self._report = DurabilityReport(self._whole.model)
        self._acknowledged_s: dict[int, float] = {}
        self._promised = -1
        self._opened = False
        self._next = 0
        self._killed_s = 0.0

    def run(self, progress: Callable[[str], object]) -> DurabilityReport:
        began_s = time.monotonic()
        for number in range(self._options.kills):
            progress(f"kill {number + 1} of {self._options.kills}, frame {self._next}")
            with self._server() as server:
                self._begin(server.port)
                delay_s = self._random.uniform(0, self._options.longest_s)
                timer = threading.Timer(delay_s, self._kill, (server,))
                timer.start()
                self._stream_until_dead(server.port)
                timer.join()
            self._report.kills += 1
        with self._server() as server:
            self._begin(server.port)
            end_s = time.monotonic() + 2 * self._options.interval_s
            while time.monotonic() < end_s:
                self._send(server.port, self._next)
                self._next += 1
            self._compare(server.port)
            self._report.write_ms = _mean_write_ms(server.port)
        self._report.seconds = time.monotonic() - began_s
        self._report.frames = self._next
        self._report.disk_bytes = sum(path.stat().st_size for path in self._folder.rglob("*") if path.is_file())
        return self._report

    def _kill(self, server: ServerProcess) -> None:
        self._killed_s = time.monotonic()
        server.kill()

    def _server(self) -> AbstractContextManager[ServerProcess]:
        arguments = ["--model", self._options.model, "--provider", "cpu", "--state-dir", str(self._folder)]
        arguments += ["--state-interval-s", str(self._options.interval_s)]
        # one decoding process is enough for one client, and each adds half a second of computing to a start
        variables = {"ROOMLIGHT_DECODE_TIMEOUT_S": "60", "ROOMLIGHT_DECODE_THREADS": "1"}
        return ServerProcess(arguments, variables=variables, wait_ready=False)

    def _begin(self, port: int) -> None:
        """Open the session, or check what was restored of it; send the frames after that again, and compare."""
        if not self._opened:
            options = {"model": self._options.model, "height": self._options.height, "reference_exposure": 1.0}
            state = _json(port, "PUT", _SESSION, options)
            for name, position in self._probes.items():
                _json(port, "PUT", f"{_SESSION}/probes/{name}", {"position": position})
            self._opened = _wait_until_saved(port, self._folder)
            return
        began_s = time.perf_counter()
        state = _json(port, "GET", _SESSION)
        self._report.restore_ms.append(1e3 * (time.perf_counter() - began_s))
        restored = -1 if state["frames"]["last_index"] is None else state["frames"]["last_index"]
        self._check(restored)
        for index in range(restored + 1, self._next):
            self._report.sent_again += 1
            self._send(port, index)
        self._compare(port)

    def _check(self, restored: int) -> None:
        ages_s = [self._killed_s - at_s for index, at_s in self._acknowledged_s.items() if index > restored]
        self._report.oldest_lost_s = max([self._report.oldest_lost_s, *ages_s])
        self._report.lost_late += sum(age_s > self._options.interval_s for age_s in ages_s)
        self._report.broken_promises += restored < self._promised
        self._promised = max(self._promised, restored)
        self._acknowledged_s.clear()

    def _stream_until_dead(self, port: int) -> None:
        while True:
            try:
                self._send(port, self._next)
            except (OSError, http.client.HTTPException):
                self._next += 1  # sent, and not answered: it is sent again
                return
            self._next += 1

    def _send(self, port: int, index: int) -> None:
        body = self._bodies[index % len(self._bodies)]
        result = _json(port, "PUT", f"{_SESSION}/frames/{index}", body)
        if result["status"] != "processed":
            raise ServerError(f"frame {index} was answered {result['status']}")
        self._acknowledged_s[index] = time.monotonic()
        self._report.acknowledged += 1
        if result["durable_index"] is not None:
            self._promised = max(self._promised, result["durable_index"])

    def _compare(self, port: int) -> None:
        if self._next == 0:
            return
        for name, digest in self._whole.digests(self._next - 1).items():
            etag = _call(port, "GET", f"{_SESSION}/probes/{name}?format=sh", None)[1]["etag"]
            self._report.compared += 1
            self._report.different += not etag.startswith(f'"{digest}-')


def _wait_until_saved(port: int, folder: Path) -> bool:
    """Wait until the session with its probes is on disk."""
    end_s = time.monotonic() + _TIMEOUT_S
    while time.monotonic() < end_s:
        unsaved = re.search(r"^roomlight_state_unsaved_seconds (\S+)$", _metrics(port), re.MULTILINE)
        if any(folder.glob("sessions/*/state")) and unsaved is not None and float(unsaved[1]) == 0:
            return True
        time.sleep(0.05)
    raise ServerError("the session was not saved")


def _mean_write_ms(port: int) -> float:
    name = "roomlight_state_write_seconds"
    counters = dict(re.findall(rf"^{name}_(sum|count) (\S+)$", _metrics(port), re.MULTILINE))
    return 1e3 * float(counters["sum"]) / max(1.0, float(counters["count"]))


def _metrics(port: int) -> str:
    return _call(port, "GET", "/metrics", None)[2].decode()


def _json(port: int, method: str, path: str, body: bytes | dict[str, Any] | None = None) -> dict[str, Any]:
    return json.loads(_call(port, method, path, body)[2])


def _call(port: int, method: str, path: str, body: bytes | dict[str, Any] | None) -> tuple[int, dict[str, str], bytes]:
    """Send one request. Raises ServerError for an error status, OSError or HTTPException if the server is gone."""
    kind = "application/json" if isinstance(body, dict) else "application/octet-stream"
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=_TIMEOUT_S)
    try:
        data = json.dumps(body).encode() if isinstance(body, dict) else body
        connection.request(method, path, data, {"Content-Type": kind} if data else {})
        response = connection.getresponse()
        content = response.read()
        if response.status >= 400:
            raise ServerError(f"{method} {path} was answered {response.status}: {content[:300].decode()}")
        return response.status, {name.lower(): value for name, value in response.getheaders()}, content
    finally:
        connection.close()
