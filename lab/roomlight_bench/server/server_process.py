"""A `roomlight serve` for the benchmark, in a separate process on a free port of this machine."""

import http.client
import json
import os
import re
import ssl
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from roomlight.errors import ServerError

_SERVE: Final = "from roomlight_cli.main import main; main()"
_START_TIMEOUT_S: Final = 300
"""Limit on the start: compiling the kernels for the first time takes a minute, several on a busy machine."""
_POLL_S: Final = 0.02


class ServerProcess:
    """A server process; the `with` statement starts it, waits until it is ready, and stops it at its end.

    Attributes:
        alive_ms: Time from the start of the process to the first response of /healthz.
        ready_ms: Time from the start of the process to status 200 of /readyz.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        *,
        variables: Mapping[str, str] | None = None,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        """Prepare `roomlight serve` with these arguments, besides the port. `tls` trusts its certificate, if any.

        Of the environment's ROOMLIGHT_* variables, the server gets ROOMLIGHT_THREADS alone, and those of `variables`.
        """
        self.tls = tls
        self._variables = dict(variables or {})
        self._command = [sys.executable, "-c", _SERVE, "serve", "--port", "0", *arguments]
        self._log: deque[str] = deque(maxlen=30)
        self._port_known = threading.Event()
        self.port = 0
        self.alive_ms = self.ready_ms = 0.0

    def __enter__(self) -> "ServerProcess":
        """Start the server and wait until it is ready.

        Raises:
            ServerError: The process ends or is not ready in time; the message has its last output.
        """
        environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith("ROOMLIGHT_") or name == "ROOMLIGHT_THREADS"
        } | self._variables
        self._start_s = time.perf_counter()
        self._process = subprocess.Popen(
            self._command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        try:
            self._port_known.wait(_START_TIMEOUT_S)
            self.alive_ms = self._wait_for("/healthz")
            self.ready_ms = self._wait_for("/readyz")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the server as SIGTERM does; kill it if that takes more than 30 seconds."""
        self._process.terminate()
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        assert self._process.stderr is not None
        self._process.stderr.close()

    @property
    def url(self) -> str:
        """The server's address."""
        return f"{'http' if self.tls is None else 'https'}://127.0.0.1:{self.port}"

    def resident_bytes(self) -> int | None:
        """Return the resident memory of the process and its decoding processes; None on systems without /proc."""
        own = _resident_bytes(self._process.pid)
        if own is None:
            return None
        children = Path(f"/proc/{self._process.pid}/task").glob("*/children")
        pids: list[str] = []
        for file in children:
            with suppress(OSError):  # a thread that has ended
                pids += file.read_text(encoding="ascii").split()
        return own + sum(_resident_bytes(int(pid)) or 0 for pid in pids)

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._log.append(line.decode(errors="replace").rstrip())
            match = re.search(r'"url": "https?://127\.0\.0\.1:(\d+)"', self._log[-1])
            if match is not None:
                self.port = int(match[1])
                self._port_known.set()
        self._port_known.set()  # the process has ended: do not wait for its port

    def _wait_for(self, path: str) -> float:
        """Return the milliseconds from the start of the process until `path` returns status 200. Raises ServerError."""
        while time.perf_counter() - self._start_s < _START_TIMEOUT_S:
            if self._process.poll() is not None or not self.port:
                break
            if _status(self.port, path, self.tls) == 200:
                return 1e3 * (time.perf_counter() - self._start_s)
            time.sleep(_POLL_S)
        output = "\n".join(self._log) or "(no output)"
        raise ServerError(
            f"the benchmark's server did not become ready; it was started with\n{self._command}\n{output}"
        )


def _resident_bytes(pid: int) -> int | None:
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return None
    match = re.search(r"^VmRSS:\s+(\d+) kB$", status, re.MULTILINE)
    return None if match is None else int(match[1]) * 1024


def _status(port: int, path: str, tls: ssl.SSLContext | None) -> int:
    """Return the status of a GET request; 0 without a response."""
    if tls is None:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    else:
        connection = http.client.HTTPSConnection("127.0.0.1", port, timeout=10, context=tls)
    try:
        connection.request("GET", path)
        return connection.getresponse().status
    except OSError:
        return 0
    finally:
        connection.close()


@contextmanager
def polling_health(port: int) -> Generator[Callable[[], list[float]]]:
    """Poll /healthz from another process (`server_health`) during the `with` statement.

    Yields:
        A function that ends the polling and returns the latencies in milliseconds. It raises ServerError if the server
        did not respond.
    """
    command = [sys.executable, "-m", "roomlight_bench.server.server_health", str(port)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    def end() -> list[float]:
        output, _ = process.communicate()
        if process.returncode != 0:
            raise ServerError("the server stopped responding to /healthz during the benchmark")
        return json.loads(output)

    with process:
        try:
            yield end
        finally:
            process.kill()
