"""`roomlight bench capacity`: machines for a number of phones, from what one server does on this machine.

Measured: frames per second of a loaded server, bytes of a frame, bytes of a saved session, memory of a session. The
rest is arithmetic with stated assumptions; `machines_for` has the formulas.
"""

import asyncio
import math
import os
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, Final

from annotated_types import Interval
from rich.table import Table

from roomlight import sample_capture
from roomlight.captures import CaptureOptions, open_capture
from roomlight.placement import point_in_view
from roomlight.rules import check_options
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.messages import ModelName
from roomlight_bench.server.replicas import ReplicaBenchOptions, send_frames
from roomlight_bench.server.server_process import ServerProcess
from roomlight_bench.timing import ProgressCallback
from roomlight_server.state.store import SAVES_PER_INTERVAL

_FRAMES: Final = 24
_PHONES: Final = 6


@dataclass(frozen=True)
class ServiceCost:
    """What was measured of one server.

    Attributes:
        frames_per_core_s: Frames per second of a loaded server, divided by the cores of its machine.
        frame_bytes: Mean size of a frame message.
        state_bytes: Size of the file that is written each time a session is saved.
        session_bytes: Memory of a session.
    """

    frames_per_core_s: float
    frame_bytes: float
    state_bytes: float
    session_bytes: float


@dataclass(frozen=True)
class Assumptions:
    """What is assumed.

    Attributes:
        fps: Frames per second that a phone sends.
        cores: Cores of a machine.
        memory_gb: Memory of a machine for sessions, in GB.
        load: Share of a machine's time that is planned for; the rest is for peaks and for the loss of a machine.
        ratio: Time of a frame through the front (Ray, nginx) over that without (`roomlight bench replicas`).
        state_interval_s: The servers' --state-interval-s; 0: sessions are not saved.
    """

    fps: Annotated[float, Interval(ge=0.01, le=60)] = 3.0
    cores: Annotated[int, Interval(ge=1, le=1024)] = 16
    memory_gb: Annotated[float, Interval(ge=0.5, le=10_000)] = 48.0
    load: Annotated[float, Interval(ge=0.05, le=1)] = 0.6
    ratio: Annotated[float, Interval(ge=1, le=10)] = 1.0
    state_interval_s: Annotated[float, Interval(ge=0, le=3600)] = 5.0

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class Capacity:
    """What a number of phones needs at the same time; traffic in bytes per second of all of them.

    Attributes:
        phones: Phones that stream at the same time.
        machines: The larger number of those for frames and those for memory.
        by_frames: Machines that process the frames.
        by_memory: Machines that hold the sessions.
        frame_traffic: Of frames to the servers.
        state_traffic: Of saved sessions to the shared directory.
    """

    phones: int
    machines: int
    by_frames: int
    by_memory: int
    frame_traffic: float
    state_traffic: float


def machines_for(phones: int, cost: ServiceCost, assumed: Assumptions) -> Capacity:
    """Return what phones need.

    machines by frames: phones * fps * ratio / (frames per core and second * cores * load), rounded up.
    machines by memory: phones * bytes of a session / memory of a machine, rounded up.
    state traffic: phones * bytes of a state * 2.5 / interval, as a changing session is saved 2.5 times per interval.
    """
    frames_per_s = assumed.cores * cost.frames_per_core_s * assumed.load / assumed.ratio
    by_frames = math.ceil(phones * assumed.fps / frames_per_s)
    by_memory = math.ceil(phones * cost.session_bytes / (1e9 * assumed.memory_gb))
    saves_per_s = SAVES_PER_INTERVAL / assumed.state_interval_s if assumed.state_interval_s else 0.0
    return Capacity(
        phones=phones,
        machines=max(by_frames, by_memory),
        by_frames=by_frames,
        by_memory=by_memory,
        frame_traffic=phones * assumed.fps * cost.frame_bytes,
        state_traffic=phones * cost.state_bytes * min(saves_per_s, assumed.fps),
    )


@dataclass(frozen=True)
class CapacityReport:
    """The figures of one machine, and what phones need."""

    cost: ServiceCost
    assumed: Assumptions
    rows: tuple[Capacity, ...]
    model: str
    cores: int
    busy: float | None

    def table(self) -> Table:
        """Return a row for each number of phones; the title states what was measured and assumed."""
        cost, assumed = self.cost, self.assumed
        title = (
            f"measured, model {self.model}: {cost.frames_per_core_s:.1f} frames/s a core ({self.cores} cores), "
            f"{cost.frame_bytes / 1e3:.0f} kB a frame, {cost.state_bytes / 1e6:.1f} MB a state, "
            f"{cost.session_bytes / 1e6:.0f} MB a session; assumed: {assumed.fps:g} frames/s a phone, "
            f"{assumed.cores} cores and {assumed.memory_gb:.0f} GB a machine, load {assumed.load:.0%}, "
            f"front x {assumed.ratio:.2f}, saved within {assumed.state_interval_s:g} s"
        )
        headings = ("phones", "machines", "by frames", "by memory", "frames, MB/s", "states, MB/s", "states, MB/s each")
        table = Table(*headings, title=title, title_justify="left")
        for column in table.columns:
            column.no_wrap = True  # numbers would be cut to dots
        for row in self.rows:
            traffic = f"{row.frame_traffic / 1e6:,.0f}", f"{row.state_traffic / 1e6:,.0f}"
            per_machine = f"{row.state_traffic / row.machines / 1e6:,.0f}"
            counts = f"{row.phones:,}", f"{row.machines:,}", f"{row.by_frames:,}", f"{row.by_memory:,}"
            table.add_row(*counts, *traffic, per_machine)
        return table

    def to_json(self) -> dict[str, Any]:
        """Return all figures."""
        return asdict(self)


def run_capacity(
    phones: Sequence[int],
    assumed: Assumptions,
    *,
    model: ModelName = "classical",
    seconds: float = 12.0,
    progress: ProgressCallback | None = None,
) -> CapacityReport:
    """Measure a server on this machine, half a minute by default, and compute what phones need.

    Raises:
        ServerError: The server does not start or stops responding.
    """
    report: ProgressCallback = progress or (lambda _: None)
    busy = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    cores = os.cpu_count() or 1
    frames = list(open_capture(sample_capture(), CaptureOptions(max_frames=_FRAMES)))
    probe, bodies = point_in_view(frames[0]), [pack_frame(frame, colour="jpeg") for frame in frames]
    options = ReplicaBenchOptions(phones=_PHONES, seconds=seconds, model=model)
    with tempfile.TemporaryDirectory(prefix="roomlight-capacity-") as folder:
        report("starting a server")
        with ServerProcess(["--model", model, "--state-dir", folder]) as server:
            report(f"{_PHONES} phones")
            sent = asyncio.run(send_frames(server.url, _PHONES, bodies, probe, options))
        states = [path.stat().st_size for path in Path(folder).glob("sessions/*/state")]
    cost = ServiceCost(
        frames_per_core_s=len(sent.times_ms) / sent.seconds / cores,
        frame_bytes=fmean(map(len, bodies)),
        state_bytes=fmean(states),
        session_bytes=sent.session_bytes,
    )
    rows = tuple(machines_for(count, cost, assumed) for count in phones)
    return CapacityReport(cost, assumed, rows, model, cores, busy)
