"""`roomlight bench hostile`: one client that does what no client should, beside a neighbour that streams.

A server process on loopback has two tokens. The neighbour streams the sample capture with the one, first alone, then
during each attack of `hostile_client` with the other. Attacks on TLS meet a second server with a certificate. The
hostile client is a process of low priority (nice 19), because it would be another machine in reality; its work still
takes part of this machine's time.
"""

import asyncio
import json
import os
import secrets
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import httpx
from annotated_types import Interval

from roomlight.captures import CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.errors import OptionError, ServerError
from roomlight.placement import point_in_view
from roomlight.rules import check_options
from roomlight.sample import sample_capture
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.messages import ModelName
from roomlight_bench.reporting import describe_machine
from roomlight_bench.server.hostile_client import ATTACKS, TLS_ATTACKS
from roomlight_bench.server.hostile_report import GROWN, AttackRow, HostileReport
from roomlight_bench.server.server_load import Load, Outcome, Phones
from roomlight_bench.server.server_process import ServerProcess
from roomlight_bench.server.server_report import Latencies
from roomlight_bench.timing import ProgressCallback
from roomlight_client.calls import FRAME_MEDIA_TYPE
from roomlight_server.base.tls import ensure_certificate

SESSION_BYTES: Final = 2**31
"""Memory that the sessions of a token may reach."""
PENDING_BYTES: Final = 2**29
"""Memory of all requests and answers in progress."""
OBJECT_BYTES: Final = 512 * 2**20
"""Memory of the objects of all tokens, as the server's default."""
CHURN_S: Final = 5.0
PROCESS_BYTES: Final = (512 + 2 * 1300) * 2**20
"""Allowance for what is not counted: the heap of the process and threads, and files in two decoding processes."""
_RSS_EVERY_S: Final = 0.25
_SETTLE_S: Final = 10.0
"""Time after an attack within which memory must return: work of its sessions may still end."""


@dataclass(frozen=True)
class HostileOptions:
    """What is measured.

    Attributes:
        minutes: Minutes of the measurement: a fifth is the neighbour alone, the rest is shared by the attacks.
        churn_minutes: Minutes of further attacks one after the other, beside sessions that are opened and deleted; the
            slope of the server's memory is reported.
        attacks: Run this attack alone. Repeatable. Default: all.
        fps: Frames per second of the neighbour.
        model: Model of the neighbour's session.
        height: Rows of the neighbour's panoramas.
    """

    minutes: Annotated[float, Interval(ge=0.05, le=600)] = 10.0
    churn_minutes: Annotated[float, Interval(ge=0, le=600)] = 0.0
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
    with tempfile.TemporaryDirectory() as folder, ExitStack() as servers:
        tokens = Path(folder) / "tokens"
        tokens.write_text(f"{hostile}\n{neighbour}\n", encoding="utf-8")
        arguments = ["--token-file", str(tokens), "--model", options.model]
        report("starting a server")
        server = servers.enter_context(ServerProcess(arguments, variables=limits))
        secure = server
        if set(options.attacks) & set(TLS_ATTACKS):
            certificate, key = ensure_certificate(Path(folder), ("127.0.0.1",))
            trusting = ssl.create_default_context(cafile=certificate)
            files = ["--tls-cert", str(certificate), "--tls-key", str(key)]
            secure = servers.enter_context(ServerProcess([*arguments, *files], variables=limits, tls=trusting))
        before = server.resident_bytes() or 0

        def measured(attack: str, seconds: float) -> AttackRow:
            report(f"{attack}: {seconds:g} s")
            chosen = secure if attack in TLS_ATTACKS else server
            load = Load(1, seconds, options.fps, bodies, probe, options.model, options.height, neighbour, chosen.tls)
            return _measure(chosen, load, attack, hostile)

        for target in {server, secure}:  # code that is loaded once is no growth
            _warm_up(target, bodies[0], probe, neighbour)
        alone = measured("alone", 12.0 * options.minutes)
        attacks = [measured(attack, 48.0 * options.minutes / len(options.attacks)) for attack in options.attacks]
        churn: list[tuple[float, int]] = []
        plain = [attack for attack in options.attacks if attack not in TLS_ATTACKS]
        start_s = time.monotonic()
        while plain and time.monotonic() - start_s < 60 * options.churn_minutes:
            row = measured(plain[len(churn) % len(plain)], CHURN_S)
            churn.append((time.monotonic() - start_s, row.rss_after_bytes))
    return HostileReport(
        alone=alone,
        attacks=tuple(attacks),
        churn=tuple(churn[len(plain) :]),  # the first round fills caches
        rss_start_bytes=before,
        rss_bound_bytes=before + 2 * SESSION_BYTES + PENDING_BYTES + OBJECT_BYTES + PROCESS_BYTES,
        fps=options.fps,
        machine=describe_machine(),
        cores=os.cpu_count() or 1,
        busy=os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    )


def _warm_up(server: ServerProcess, body: bytes, probe: Position, token: str) -> None:
    """Make a composite of each quality, whose code and kernels then stay in the server's memory."""
    place = {"shape": "sphere", "size_m": 0.2, "position": probe, "material": {"kind": "glass"}}
    verify: Any = True if server.tls is None else server.tls
    access = {"Authorization": f"Bearer {token}"}
    with httpx.Client(base_url=server.url, headers=access, verify=verify, timeout=600) as client:
        path = "/v1/sessions/warm"
        client.put(path, json={"model": "classical"}).raise_for_status()
        client.put(f"{path}/frames/0", content=body, headers={"Content-Type": FRAME_MEDIA_TYPE})
        for quality in ("preview", "good"):
            request = {"objects": [place], "quality": quality}
            for attempt in range(10):  # compiling can take longer than a composite may
                answer = client.post(f"{path}/composite", json=request)
                if answer.status_code != 503 or attempt == 9:
                    answer.raise_for_status()
                    break
        client.delete(path).raise_for_status()


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
    settled_s = time.monotonic() + _SETTLE_S
    time.sleep(1.0)
    while (server.resident_bytes() or 0) > GROWN * before and time.monotonic() < settled_s:
        time.sleep(_RSS_EVERY_S)
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
