"""`roomlight bench replicas`: replicas under Ray Serve beside one plain server, on this machine.

Phones send frames one after the other, each as soon as the one before is answered. So the frames per second of all
phones together are the throughput, and the time of a frame with one phone shows what Ray's proxy adds. Phones, proxy
and replicas share this machine's cores: replicas add throughput only where cores are left.
"""

import asyncio
import os
import tempfile
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Any, Final

from annotated_types import Interval
from rich.table import Table

from roomlight import sample_capture
from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.placement import point_in_view
from roomlight.rules import check_options
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.messages import ModelName
from roomlight_bench.reporting import Counts, describe_machine, short_number
from roomlight_bench.server.server_load import PROBE, TIMEOUTS, frame_call
from roomlight_bench.server.server_process import ServerProcess
from roomlight_bench.timing import ProgressCallback
from roomlight_client import AsyncClient

_WARM_UP_FRAMES: Final = 2
"""First frames of each phone that are not measured: the first one makes the volume, the second meets cold caches."""
_FRAMES: Final = 24


@dataclass(frozen=True)
class ReplicaBenchOptions:
    """What is measured.

    Attributes:
        replicas: Numbers of replicas, separated by commas: a row each.
        phones: Phones at the same time.
        seconds: Seconds of sending for each row, and as many of one phone alone before.
        model: Model of the sessions.
        height: Rows of the panoramas.
    """

    replicas: Counts = (1, 2, 3)
    phones: Annotated[int, Interval(ge=1, le=1000)] = 6
    seconds: Annotated[float, Interval(ge=0.5, le=3600)] = 12.0
    model: ModelName = "classical"
    height: Annotated[int, Interval(ge=16, le=512)] = 120

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class ReplicaRow:
    """One arrangement of servers.

    Attributes:
        replicas: Replicas under Ray Serve; 0 is a plain server.
        ready_s: Time from the start of the command until all replicas are ready.
        frame_ms: Median time of a frame of one phone alone.
        frames_per_s: Frames of all phones per second.
        loaded_ms: Median time of a frame while all phones send.
    """

    replicas: int
    ready_s: float
    frame_ms: float
    frames_per_s: float
    loaded_ms: float


@dataclass(frozen=True)
class ReplicaReport:
    """The rows of a run; the first one is the plain server."""

    rows: tuple[ReplicaRow, ...]
    options: ReplicaBenchOptions
    machine: dict[str, str]
    cores: int
    busy: float | None

    @property
    def overhead(self) -> float | None:
        """Time of a frame with one replica under Ray over that of a plain server; None if it was not measured."""
        single = [row.frame_ms for row in self.rows if row.replicas == 1]
        return single[0] / self.rows[0].frame_ms if single else None

    def table(self) -> Table:
        """Return the rows, with ratios to the plain server."""
        title = f"{self.options.phones} phones, model {self.options.model}, {self.cores} cores"
        if self.busy is not None:
            title += f", load of other work before the run {self.busy:.1f}"
        headings = ("servers", "ready, s", "frame of one phone, ms", "ratio", "frames/s of all", "ratio", "frame, ms")
        table = Table(*headings, title=title, title_justify="left")
        for column in table.columns:
            column.no_wrap = True
        plain = self.rows[0]
        for row in self.rows:
            name = "plain" if row.replicas == 0 else f"Ray, {row.replicas} replica{'s' if row.replicas > 1 else ''}"
            table.add_row(
                name,
                f"{row.ready_s:.1f}",
                short_number(row.frame_ms),
                f"{row.frame_ms / plain.frame_ms:.2f}",
                f"{row.frames_per_s:.1f}",
                f"{row.frames_per_s / plain.frames_per_s:.2f}",
                short_number(row.loaded_ms),
            )
        return table

    def to_json(self) -> dict[str, Any]:
        """Return all figures."""
        return asdict(self) | {"overhead": self.overhead}


def run_replica_bench(options: ReplicaBenchOptions, *, progress: ProgressCallback | None = None) -> ReplicaReport:
    """Measure a plain server and replicas under Ray Serve.

    Raises:
        ServerError: A server does not start (Ray may be missing), or stops responding.
    """
    report: ProgressCallback = progress or (lambda _: None)
    busy = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    frames = list(open_capture(sample_capture(), CaptureOptions(max_frames=_FRAMES)))
    probe, bodies = point_in_view(frames[0]), [pack_frame(frame, colour="jpeg") for frame in frames]
    rows = [_row(count, bodies, probe, options, report) for count in (0, *options.replicas)]
    return ReplicaReport(tuple(rows), options, describe_machine(), os.cpu_count() or 1, busy)


def _row(
    replicas: int, bodies: Sequence[bytes], probe: Position, options: ReplicaBenchOptions, report: ProgressCallback
) -> ReplicaRow:
    name = "a plain server" if replicas == 0 else f"{replicas} under Ray"
    report(f"{name}: starting")
    with tempfile.TemporaryDirectory(prefix="roomlight-replicas-") as folder:
        arguments = ["--model", options.model, "--max-sessions", str(options.phones + 8)]
        arguments += ["--state-dir", str(Path(folder) / "state")]  # both save sessions
        arguments += ["--ray", "--replicas", str(replicas)] if replicas else []
        with ServerProcess(arguments) as server:
            report(f"{name}: one phone")
            alone = asyncio.run(send_frames(server.url, 1, bodies, probe, options))
            report(f"{name}: {options.phones} phones")
            loaded = asyncio.run(send_frames(server.url, options.phones, bodies, probe, options))
            return ReplicaRow(
                replicas=replicas,
                ready_s=server.ready_ms / 1e3,
                frame_ms=median(alone.times_ms),
                frames_per_s=len(loaded.times_ms) / loaded.seconds,
                loaded_ms=median(loaded.times_ms),
            )


@dataclass(frozen=True)
class Sent:
    """Times of all frames, the seconds in which they were answered, and the mean memory of a session at the end."""

    times_ms: list[float]
    seconds: float
    session_bytes: float


async def send_frames(
    url: str, phones: int, bodies: Sequence[bytes], probe: Position, options: ReplicaBenchOptions
) -> Sent:
    """Let phones send frames for `options.seconds`, each as soon as the one before is answered.

    The sessions stay open, so that what is saved of them can be measured.
    """
    times_ms: list[float] = []
    async with AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(AsyncClient(url, timeouts=TIMEOUTS)) for _ in range(phones)]
        sessions = [
            await client.open(model=options.model, height=options.height, reference_exposure=1.0) for client in clients
        ]

        async def send(client: AsyncClient, name: str, index: int) -> float:
            began_s = time.perf_counter()
            await client.run(frame_call(name, index, bodies[index % len(bodies)]))
            return 1e3 * (time.perf_counter() - began_s)

        for client, session in zip(clients, sessions, strict=True):
            await session.track(PROBE, probe)
            for index in range(_WARM_UP_FRAMES):
                await send(client, session.id, index)

        async def stream(client: AsyncClient, name: str, end_s: float) -> None:
            index = _WARM_UP_FRAMES
            while time.perf_counter() < end_s:
                times_ms.append(await send(client, name, index))
                index += 1

        began_s = time.perf_counter()
        end_s = began_s + options.seconds
        names = [session.id for session in sessions]
        await asyncio.gather(*(stream(client, name, end_s) for client, name in zip(clients, names, strict=True)))
        seconds = time.perf_counter() - began_s
        states = [await session.state() for session in sessions]
    return Sent(times_ms, seconds, fmean(state.memory.bytes for state in states))
