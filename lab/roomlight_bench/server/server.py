"""`roomlight bench server`: a server process under streaming phones, beside the engine called directly.

The server listens on loopback, and the phones stream the sample capture. Each row of the load has a server process of
its own, so that its memory starts from a fresh process; this also measures several starts. Phones and server share
this machine's cores: on two cores the phones' work is part of every figure.
"""

import asyncio
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Interval

from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session as Engine
from roomlight.engine.session import SessionOptions
from roomlight.frame import Frame
from roomlight.placement import point_in_view
from roomlight.rules import check_options
from roomlight.sample import sample_capture
from roomlight.threads import thread_count
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.frame_message import FrameLimits
from roomlight.wire.messages import ModelName
from roomlight_bench.reporting import Counts, describe_machine
from roomlight_bench.server.server_load import PROBE, TIMEOUTS, Load, Outcome, Phones, frame_call
from roomlight_bench.server.server_process import ServerProcess, polling_health
from roomlight_bench.server.server_report import Latencies, LoadRow, OverheadRow, ServerReport
from roomlight_bench.timing import ProgressCallback
from roomlight_client import Client, FrameEncoding
from roomlight_server.work.decode_worker import decode_to_box
from roomlight_server.work.intake import parse_frame

_WARM_UP_FRAMES: Final = 2
"""First frames that are not measured: the first one makes the volume, the second one meets cold caches."""


@dataclass(frozen=True)
class ServerBenchOptions:
    """What is measured.

    Attributes:
        sessions: Numbers of sessions at the same time, separated by commas: a row each.
        seconds: Seconds of streaming for each row.
        fps: Frames per second that each phone sends.
        passes: How often the frames go through the server and the engine; the least time of each frame counts. More
            passes remove more of the machine's other work from the difference.
        frames: Use at most this many frames of the sample capture; phones start again after the last.
        model: Model of the sessions.
        weights: A model folder of `roomlight export`, instead of the weights inside the package.
        height: Rows of the panoramas.
    """

    sessions: Counts = (1, 4, 16, 64)
    seconds: Annotated[float, Interval(ge=0.5, le=3600)] = 12.0
    fps: Annotated[float, Interval(ge=0.1, le=60)] = 3.0
    passes: Annotated[int, Ge(1)] = 8
    frames: Annotated[int, Ge(1)] | None = None
    model: ModelName = "auto"
    weights: Path | None = None
    height: Annotated[int, Interval(ge=16, le=512)] = 120

    def __post_init__(self) -> None:
        check_options(self)

    def server(self) -> ServerProcess:
        """Prepare a server that allows what these options measure; all phones have this machine's address."""
        weights = [] if self.weights is None else ["--weights", str(self.weights)]
        arguments = ["--max-sessions", str(max(self.sessions) + 4), "--model", self.model, *weights]
        connections = str(100 + 8 * max(self.sessions))
        return ServerProcess(arguments, variables={"ROOMLIGHT_MAX_CONNECTIONS_PER_ADDRESS": connections})


def run_server_bench(options: ServerBenchOptions, *, progress: ProgressCallback | None = None) -> ServerReport:
    """Measure overhead and load, two minutes by default.

    Raises:
        ModelError: The model is not available.
        ServerError: The server does not start or stops responding.
    """
    report: ProgressCallback = progress or (lambda _: None)
    busy = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    report("reading the sample capture")
    frames = list(open_capture(sample_capture(), CaptureOptions(max_frames=options.frames)))
    probe = point_in_view(frames[0])
    engine = _engine(options)
    bodies = [pack_frame(frame, colour="jpeg") for frame in frames]
    alive_ms: list[float] = []
    ready_ms: list[float] = []

    def started(server: ServerProcess) -> ServerProcess:
        alive_ms.append(server.alive_ms)
        ready_ms.append(server.ready_ms)
        return server

    report("starting a server")
    with options.server() as server, Client(started(server).url, timeouts=TIMEOUTS) as client:
        colours: tuple[FrameEncoding, ...] = ("jpeg", "exact")
        overhead = [_overhead(client, frames[::2], colour, probe, options, report) for colour in colours]
    load: list[LoadRow] = []
    for sessions in options.sessions:
        report(f"{sessions} sessions: starting a server")
        with options.server() as server:
            load.append(_loaded(started(server), bodies, probe, sessions, options, report))
    return ServerReport(
        model=engine.model,
        seconds=options.seconds,
        start_alive_ms=tuple(alive_ms),
        start_ready_ms=tuple(ready_ms),
        overhead=tuple(overhead),
        load=tuple(load),
        machine=describe_machine(),
        threads=thread_count(),
        cores=os.cpu_count() or 1,
        busy=busy,
    )


def _engine(options: ServerBenchOptions) -> Engine:
    return Engine(SessionOptions(model=options.model, weights=options.weights, height=options.height))


def _overhead(
    client: Client,
    frames: Sequence[Frame],
    colour: FrameEncoding,
    probe: Position,
    options: ServerBenchOptions,
    report: ProgressCallback,
) -> OverheadRow:
    """Process every frame in this process and over HTTP; which goes first alternates."""
    bodies = [pack_frame(frame, colour=colour) for frame in frames]
    rounds: list[list[tuple[float, float, float]]] = []
    for number in range(options.passes):
        report(f"one session, frames as {colour}, round {number + 1} of {options.passes}")
        rounds.append(_direct_and_http(client, bodies, probe, options))
    kept = np.array(rounds)[:, min(_WARM_UP_FRAMES, len(bodies) - 1) :]
    engine_ms, decoded_ms, http_ms = np.median(kept.min(axis=0), axis=0).tolist()
    return OverheadRow(
        colour=colour,
        body_bytes=round(fmean(map(len, bodies))),
        frames=kept.shape[1],
        rounds=options.passes,
        engine_ms=engine_ms,
        decoded_ms=decoded_ms,
        http_ms=http_ms,
    )


def _direct_and_http(
    client: Client, bodies: Sequence[bytes], probe: Position, options: ServerBenchOptions
) -> list[tuple[float, float, float]]:
    """Return the times of each frame in ms: the engine alone, the engine with decoding, and over HTTP."""
    engine, limits = _engine(options), FrameLimits()
    engine.track(probe)

    def direct(index: int, body: bytes) -> tuple[float, float]:
        start_s = time.perf_counter()
        frame = decode_to_box(parse_frame(body, limits)[0], index, 1.0, 1, WORKING_SIZE)
        engine_ms = _timed(lambda: engine.push(frame))
        return engine_ms, 1e3 * (time.perf_counter() - start_s)

    def over_http(index: int, body: bytes) -> float:
        return _timed(lambda: client.run(frame_call(session.id, index, body)))

    times_ms: list[tuple[float, float, float]] = []
    with client.open(model=options.model, height=options.height, reference_exposure=1.0) as session:
        session.track(PROBE, probe)
        for index, body in enumerate(bodies):
            if index % 2:
                engine_ms, decoded_ms = direct(index, body)
                http_ms = over_http(index, body)
            else:
                http_ms = over_http(index, body)
                engine_ms, decoded_ms = direct(index, body)
            times_ms.append((engine_ms, decoded_ms, http_ms))
    return times_ms


def _loaded(
    server: ServerProcess,
    bodies: Sequence[bytes],
    probe: Position,
    sessions: int,
    options: ServerBenchOptions,
    report: ProgressCallback,
) -> LoadRow:
    load = Load(sessions, options.seconds, options.fps, bodies, probe, options.model, options.height)
    before = server.resident_bytes()

    async def run() -> tuple[Outcome, list[float], list[tuple[int, int]], int | None]:
        report(f"{sessions} sessions: their first frames")
        async with Phones(server.url, load) as phones:
            report(f"{sessions} sessions: {options.seconds:g} s of frames")
            with polling_health(server.port) as end_polling:
                outcome = await phones.stream()
                healths = await asyncio.to_thread(end_polling)
            after = server.resident_bytes()
            states = [await session.state() for session in phones.sessions]
        return outcome, healths, [(state.memory.bytes, state.keyframes) for state in states], after

    outcome, health_ms, states, after = asyncio.run(run())
    due = outcome.sent + outcome.dropped
    gained = None if before is None or after is None else (after - before) / sessions / 1e6
    return LoadRow(
        sessions=sessions,
        wanted_fps=options.fps,
        held_fps=outcome.in_time / options.seconds / sessions,
        lost=(outcome.dropped + outcome.superseded) / due,
        frame=Latencies.of(outcome.frame_ms),
        light=Latencies.of(outcome.light_ms),
        health=Latencies.of(health_ms),
        memory_mb=gained,
        stated_mb=fmean(memory for memory, _ in states) / 1e6,
        keyframes=fmean(keyframes for _, keyframes in states),
    )


def _timed(work: Callable[[], object]) -> float:
    start_s = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start_s)
