"""`roomlight bench server`: a real server process on loopback, phones that stream the sample capture to it, and the
engine called directly in the same run.

Each part has a server of its own, so that memory is counted from a fresh process, and starts are measured several
times. Phones and server share this machine's cores: on two of them the phones' share is part of every figure.
"""

import asyncio
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Final

import numpy as np

from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.engine.session import Session as Engine
from roomlight.engine.session import SessionOptions
from roomlight.frame import Frame
from roomlight.placement import point_in_view
from roomlight.sample import sample_capture
from roomlight.threads import thread_count
from roomlight.wire.frame_message import FrameLimits
from roomlight.wire.messages import ModelName
from roomlight_bench.server_load import FORMS, PROBE, TIMEOUTS, Load, Outcome, Phones, frame_call
from roomlight_bench.server_process import ServerProcess, watching_health
from roomlight_bench.server_report import Latencies, LoadRow, OverheadRow, ProbeRow, ServerReport
from roomlight_bench.stages_report import machine_here
from roomlight_client import Client, FrameEncoding, Session
from roomlight_client.frames import pack_frame
from roomlight_server.intake import decode_to_size, parse_frame

Progress = Callable[[str], None]
LATE_AT_MOST: Final = 16
"""Points asked about late, in one call: each takes some 0.1 s of catching up."""
_SETTLED: Final = 2
"""Frames that are left out at the beginning: the first makes the volume, and the second meets cold caches."""
_SPREAD_M: Final = 0.4
"""Points lie this far around the one in view, on any side."""


@dataclass(frozen=True)
class ServerBenchOptions:
    """What is measured.

    sessions:  at once, one row each.
    seconds:   that phones stream, for each row.
    fps:       frames a second that each phone sends.
    points:    counts of probes; late ones up to `LATE_AT_MOST`.
    rounds:    of the questions for light; times are the median of them.
    passes:    of the frames that go through the server and through the engine here, of which the least time counts: the
               more of them, the less of what else the machine does is in their difference.
    frames:    of the sample capture, at most; sent again from the start when they are through.
    """

    sessions: tuple[int, ...] = (1, 4, 16, 64)
    seconds: float = 12.0
    fps: float = 3.0
    points: tuple[int, ...] = (1, 4, 16, 64)
    rounds: int = 3
    passes: int = 8
    frames: int | None = None
    mode: ModelName = "auto"
    weights: Path | None = None
    allow_untrained: bool = False
    height: int = 120

    @property
    def serve_arguments(self) -> list[str]:
        """For `roomlight serve`."""
        held = ["--max-sessions", str(max(self.sessions) + 4), "--max-probes", str(max(self.points))]
        model = [] if self.weights is None else ["--weights", str(self.weights)]
        return [*held, "--model", self.mode, *model, *(["--allow-untrained"] if self.allow_untrained else [])]


def run_server_bench(options: ServerBenchOptions, *, progress: Progress | None = None) -> ServerReport:
    """Measure everything. Raises ModelError and ServerError where no server can be started as asked."""
    say: Progress = progress or _say_nothing
    busy = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    say("reading the sample capture")
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

    say("starting a server")
    with ServerProcess(options.serve_arguments) as server, Client(started(server).url, timeouts=TIMEOUTS) as client:
        colours: tuple[FrameEncoding, ...] = ("jpeg", "exact")
        overhead = [_overhead(client, frames[::2], colour, probe, options, say) for colour in colours]
        probes = [_followed(client, bodies, probe, count, options, say) for count in options.points]
        probes += _late(client, bodies, probe, options, say)
    load: list[LoadRow] = []
    for sessions in options.sessions:
        say(f"{sessions} sessions at once: starting a server")
        with ServerProcess(options.serve_arguments) as server:
            load.append(_loaded(started(server), bodies, probe, sessions, options, say))
    return ServerReport(
        model=engine.model,
        seconds=options.seconds,
        start_alive_ms=tuple(alive_ms),
        start_ready_ms=tuple(ready_ms),
        overhead=tuple(overhead),
        load=tuple(load),
        probes=tuple(probes),
        machine=machine_here(),
        threads=thread_count(),
        cores=os.cpu_count() or 1,
        busy=busy,
    )


def _engine(options: ServerBenchOptions) -> Engine:
    return Engine(
        SessionOptions(
            model=options.mode,
            weights=options.weights,
            allow_untrained=options.allow_untrained,
            height=options.height,
        )
    )


def _open(client: Client, options: ServerBenchOptions) -> Session:
    return client.open(model=options.mode, height=options.height, reference_exposure=1.0)


def _overhead(
    client: Client, frames: Sequence[Frame], colour: FrameEncoding, probe: Position, options: ServerBenchOptions, say: Progress
) -> OverheadRow:
    """Every frame here and there, in turn; which goes first alternates."""
    bodies = [pack_frame(frame, colour=colour) for frame in frames]
    rounds: list[list[tuple[float, float, float]]] = []
    for turn in range(options.passes):
        say(f"one session, frames as {colour}, round {turn + 1} of {options.passes}")
        rounds.append(_here_and_there(client, bodies, probe, options))
    kept = np.array(rounds)[:, min(_SETTLED, len(bodies) - 1) :]
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


def _here_and_there(
    client: Client, bodies: Sequence[bytes], probe: Position, options: ServerBenchOptions
) -> list[tuple[float, float, float]]:
    """Of each frame: the engine here, that with decoding, and the server; ms."""
    engine, limits = _engine(options), FrameLimits()
    engine.track(probe)

    def here(index: int, body: bytes) -> tuple[float, float]:
        began_s = time.perf_counter()
        frame = decode_to_size(parse_frame(body, limits)[0], index, 1.0, 1)
        engine_ms = _timed(lambda: engine.push(frame))
        return engine_ms, 1e3 * (time.perf_counter() - began_s)

    found: list[tuple[float, float, float]] = []
    with _open(client, options) as session:
        session.track(PROBE, probe)
        for index, body in enumerate(bodies):
            if index % 2:
                engine_ms, decoded_ms = here(index, body)
                http_ms = _timed(lambda index=index: _push(client, session, index, bodies))
            else:
                http_ms = _timed(lambda index=index: _push(client, session, index, bodies))
                engine_ms, decoded_ms = here(index, body)
            found.append((engine_ms, decoded_ms, http_ms))
    return found


def _followed(
    client: Client, bodies: Sequence[bytes], probe: Position, count: int, options: ServerBenchOptions, say: Progress
) -> ProbeRow:
    """A frame before each question, so that no light is at hand that was computed for the last."""
    frame_ms: list[float] = []
    batched_ms: list[float] = []
    single_ms: list[float] = []
    with _open(client, options) as session:
        names = [f"probe-{number}" for number in range(count)]
        for name, position in zip(names, _around(probe, count, seed=count), strict=True):
            session.track(name, position)
        for turn in range(2 * options.rounds + 1):
            say(f"{count} followed points, {turn + 1} of {2 * options.rounds + 1}")
            frame_ms.append(_timed(lambda index=turn: _push(client, session, index, bodies)))
            if turn == 0:
                continue
            if turn % 2:
                batched_ms.append(_timed(lambda: session.lights_at(names, FORMS)))
            else:
                single_ms.append(_timed(lambda: [session.light_at(name, FORMS) for name in names]))
        keyframes = session.state().keyframes
    return ProbeRow(True, count, keyframes, median(frame_ms[1:]), median(batched_ms), median(single_ms))


def _late(
    client: Client, bodies: Sequence[bytes], probe: Position, options: ServerBenchOptions, say: Progress
) -> list[ProbeRow]:
    """Points that nobody asked about before, in a session that has seen the whole capture."""
    rows: list[ProbeRow] = []
    with _open(client, options) as session:
        for index in range(len(bodies)):
            say(f"late points: frame {index + 1} of {len(bodies)}")
            _push(client, session, index, bodies)
        keyframes = session.state().keyframes
        for count in sorted({min(count, LATE_AT_MOST) for count in options.points}):
            batched_ms: list[float] = []
            single_ms: list[float] = []
            for turn in range(options.rounds):
                say(f"{count} late points, {turn + 1} of {options.rounds}")
                first, second = (_around(probe, count, seed=1000 * count + 2 * turn + half) for half in (0, 1))
                batched_ms.append(_timed(lambda points=first: session.lights_at(points, FORMS)))
                single_ms.append(_timed(lambda points=second: [session.light_at(point, FORMS) for point in points]))
            rows.append(ProbeRow(False, count, keyframes, None, median(batched_ms), median(single_ms)))
    return rows


def _loaded(
    server: ServerProcess,
    bodies: Sequence[bytes],
    probe: Position,
    sessions: int,
    options: ServerBenchOptions,
    say: Progress,
) -> LoadRow:
    load = Load(sessions, options.seconds, options.fps, bodies, probe, options.mode, options.height)
    before = server.resident_bytes()

    async def run() -> tuple[Outcome, list[float], list[tuple[int, int]], int | None]:
        say(f"{sessions} sessions at once: their first frames")
        async with Phones(server.url, load) as phones:
            say(f"{sessions} sessions at once: {options.seconds:g} s of frames")
            with watching_health(server.port) as health_ms:
                outcome = await phones.stream()
                healths = await asyncio.to_thread(health_ms)
            after = server.resident_bytes()
            states = [await session.state() for session in phones.sessions]
        return outcome, healths, [(state.memory.bytes, state.keyframes) for state in states], after

    outcome, health_ms, held, after = asyncio.run(run())
    due = outcome.sent + outcome.dropped
    gained = None if before is None or after is None else (after - before) / sessions / 1e6
    return LoadRow(
        sessions=sessions,
        wanted_fps=options.fps,
        held_fps=outcome.held / options.seconds / sessions,
        lost=(outcome.dropped + outcome.superseded) / due,
        frame=Latencies.of(outcome.frame_ms),
        light=Latencies.of(outcome.light_ms),
        health=Latencies.of(health_ms),
        memory_mb=gained,
        stated_mb=fmean(memory for memory, _ in held) / 1e6,
        keyframes=fmean(keyframes for _, keyframes in held),
    )


def _push(client: Client, session: Session, index: int, bodies: Sequence[bytes]) -> None:
    client.run(frame_call(session.id, index, bodies[index % len(bodies)]))


def _timed(work: Callable[[], object]) -> float:
    began_s = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - began_s)


def _around(centre: Position, count: int, *, seed: int) -> list[Position]:
    offsets = np.random.default_rng(seed).uniform(-_SPREAD_M, _SPREAD_M, (count, 3))
    return [(float(x), float(y), float(z)) for x, y, z in np.asarray(centre) + offsets]


def _say_nothing(_: str) -> None:
    pass
