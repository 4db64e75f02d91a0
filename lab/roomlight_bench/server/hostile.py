"""`roomlight bench hostile`: one client that does what no client should, beside a neighbour that streams.

A server process on loopback has two tokens. The neighbour streams the sample capture with the one, first alone, then
during each attack of `hostile_client` with the other. The hostile client is a process of low priority (nice 19),
because it would be another machine in reality; its work still takes part of this machine's time.
"""

import asyncio
import json
import os
import secrets
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

from annotated_types import Interval

from roomlight.captures import CaptureOptions, open_capture
from roomlight.errors import OptionError, ServerError
from roomlight.placement import point_in_view
from roomlight.rules import check_options
from roomlight.sample import sample_capture
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.messages import ModelName
from roomlight_bench.reporting import describe_machine
from roomlight_bench.server.hostile_client import ATTACKS
from roomlight_bench.server.hostile_report import AttackRow, HostileReport
from roomlight_bench.server.server_load import Load, Outcome, Phones
from roomlight_bench.server.server_process import ServerProcess
from roomlight_bench.server.server_report import Latencies
from roomlight_bench.timing import ProgressCallback

SESSION_BYTES: Final = 2**31
"""Memory that the sessions of a token may reach."""
PENDING_BYTES: Final = 2**29
"""Memory of all requests and answers in progress."""
PROCESS_BYTES: Final = 512 * 2**20
"""Allowance for what is not counted: the heap of the process, frames being decoded, threads and decoding processes."""
_RSS_EVERY_S: Final = 0.25
_SETTLE_S: Final = 1.0
"""Time after an attack until memory is read: ended sessions return theirs by then."""


@dataclass(frozen=True)
class HostileOptions:
    """What is measured.

    Attributes:
        minutes: Minutes of the whole run: a fifth is the neighbour alone, the rest is shared by the attacks.
        attacks: Run this attack alone. Repeatable. Default: all.
        fps: Frames per second of the neighbour.
        model: Model of the neighbour's session.
        height: Rows of the neighbour's panoramas.
    """

    minutes: Annotated[float, Interval(ge=0.05, le=600)] = 10.0
    attacks: tuple[str, ...] = ()
    fps: Annotated[float, Interval(ge=0.1, le=60)] = 2.0
    model: ModelName = "auto"
    height: Annotated[int, Interval(ge=16, le=512)] = 120

    def __post_init__(self) -> None:
        check_options(self)
        for attack in self.attacks:
            if attack not in ATTACKS:
                raise OptionError(f"attacks holds {attack!r}; it must be one of {', '.join(ATTACKS)}")
        object.__setattr__(self, "attacks", self.attacks or tuple(ATTACKS))

    @property
    def alone_s(self) -> float:
        """Seconds of the neighbour alone."""
        return 12.0 * self.minutes

    @property
    def attack_s(self) -> float:
        """Seconds of each attack."""
        return 48.0 * self.minutes / len(self.attacks)


def run_hostile(options: HostileOptions, *, progress: ProgressCallback | None = None) -> HostileReport:
    """Measure the neighbour alone and during each attack.

    Raises:
        ServerError: The server does not start or stops responding, or the hostile client fails.
    """
    report: ProgressCallback = progress or (lambda _: None)
    report("reading the sample capture")
    frames = list(open_capture(sample_capture(), CaptureOptions(max_frames=24)))
    bodies, probe = [pack_frame(frame, colour="jpeg") for frame in frames], point_in_view(frames[0])
    hostile, neighbour = secrets.token_hex(16), secrets.token_hex(16)
    limits = {
        "ROOMLIGHT_MAX_OWNER_SESSION_BYTES": str(SESSION_BYTES),
        "ROOMLIGHT_MAX_PENDING_BYTES": str(PENDING_BYTES),
    }
    with tempfile.TemporaryDirectory() as folder:
        tokens = Path(folder) / "tokens"
        tokens.write_text(f"{hostile}\n{neighbour}\n", encoding="utf-8")
        arguments = ["--token-file", str(tokens), "--model", options.model]
        report("starting a server")
        with ServerProcess(arguments, variables=limits) as server:
            before = server.resident_bytes() or 0

            def measured(attack: str, seconds: float) -> AttackRow:
                report(f"{attack}: {seconds:g} s")
                load = Load(1, seconds, options.fps, bodies, probe, options.model, options.height, neighbour)
                return _measure(server, load, attack, hostile)

            alone = measured("alone", options.alone_s)
            attacks = [measured(attack, options.attack_s) for attack in options.attacks]
    return HostileReport(
        alone=alone,
        attacks=tuple(attacks),
        rss_start_bytes=before,
        rss_bound_bytes=before + 2 * SESSION_BYTES + PENDING_BYTES + PROCESS_BYTES,
        fps=options.fps,
        machine=describe_machine(),
        cores=os.cpu_count() or 1,
        busy=os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    )


def _measure(server: ServerProcess, load: Load, attack: str, token: str) -> AttackRow:
    """Stream as the neighbour during an attack, or without one (`alone`)."""
    seconds = load.seconds

    async def run() -> tuple[Outcome, dict[str, Any]]:
        async with Phones(server.url, load) as phones:
            done: dict[str, Any] = {}
            if attack == "alone":
                outcome = await phones.stream()
            else:
                with _hostile_process(server.port, token, attack, seconds + 2) as process:
                    outcome = await phones.stream()
                    done = await asyncio.to_thread(_result, process)
            for session in phones.sessions:
                await session.close()
            return outcome, done

    before = server.resident_bytes() or 0
    with _watching_memory(server) as sizes:
        outcome, done = asyncio.run(run())
    time.sleep(_SETTLE_S)
    return AttackRow(
        attack=attack,
        seconds=seconds,
        due=outcome.sent + outcome.dropped,
        processed=outcome.in_time,
        frame=Latencies.of(outcome.frame_ms),
        light=Latencies.of(outcome.light_ms),
        rss_bytes=max(sizes, default=0),
        rss_before_bytes=before,
        rss_after_bytes=server.resident_bytes() or 0,
        requests=done.get("requests", 0),
        answers=done.get("answers", {}),
    )


@contextmanager
def _hostile_process(port: int, token: str, attack: str, seconds: float) -> Generator[subprocess.Popen[bytes]]:
    """Start the hostile client and wait until it begins; kill it at the end."""
    command = ["nice", "-n", "19", sys.executable, "-m", "roomlight_bench.server.hostile_client"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            order = {"port": port, "token": token, "attack": attack, "seconds": seconds}
            process.stdin.write(json.dumps(order).encode())
            process.stdin.close()
            process.stdout.readline()
            yield process
        finally:
            process.kill()


def _result(process: subprocess.Popen[bytes]) -> dict[str, Any]:
    assert process.stdout is not None
    output = process.stdout.read()
    if process.wait() != 0 or not output:
        raise ServerError(f"the hostile client ended with status {process.returncode}; its error is above")
    return json.loads(output)


@contextmanager
def _watching_memory(server: ServerProcess) -> Generator[list[int]]:
    """Collect the resident memory of the server's process several times a second."""
    sizes: list[int] = []
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_RSS_EVERY_S):
            sizes.append(server.resident_bytes() or 0)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield sizes
    finally:
        ended.set()
        thread.join()
