"""A real `roomlight serve` for the benchmark: a process of its own, on a free port of this machine."""

import http.client
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from roomlight.errors import ServerError

_SERVE: Final = "from roomlight_cli.main import main; main()"
_PATIENCE_S: Final = 300
"""Until it must be ready: kernels that were never compiled take most of a minute, on a busy machine several."""
_POLL_S: Final = 0.02


class ServerProcess:
    """Use it in a `with` statement; within, it is ready. Raises ServerError if it ends or takes too long.

    alive_ms, ready_ms: from the start of the process to the first answer of /healthz, and to 200 of /readyz.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        """`arguments` of `roomlight serve`, besides the port. The environment's ROOMLIGHT_* do not reach it, but the
        number of threads.
        """
        self._command = [sys.executable, "-c", _SERVE, "serve", "--port", "0", "--log-level", "warning", *arguments]
        self._said: deque[str] = deque(maxlen=30)
        self._told = threading.Event()
        self.port = 0
        self.alive_ms = self.ready_ms = 0.0

    def __enter__(self) -> "ServerProcess":
        """Start it, and wait until it is ready."""
        environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith("ROOMLIGHT_") or name == "ROOMLIGHT_THREADS"
        }
        self._began_s = time.perf_counter()
        self._process = subprocess.Popen(
            self._command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        try:
            self._told.wait(_PATIENCE_S)
            self.alive_ms = self._wait_for("/healthz")
            self.ready_ms = self._wait_for("/readyz")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Tell it to stop, as Ctrl-C does; kill it if it does not."""
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
        """Its address."""
        return f"http://127.0.0.1:{self.port}"

    def resident_bytes(self) -> int | None:
        """Memory it holds; None where the system does not say (Linux does)."""
        try:
            status = Path(f"/proc/{self._process.pid}/status").read_text(encoding="utf-8")
        except OSError:
            return None
        found = re.search(r"^VmRSS:\s+(\d+) kB$", status, re.MULTILINE)
        return None if found is None else int(found[1]) * 1024

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._said.append(line.decode(errors="replace").rstrip())
            found = re.search(r"Serving on http://127\.0\.0\.1:(\d+)", self._said[-1])
            if found is not None:
                self.port = int(found[1])
                self._told.set()
        self._told.set()  # it has ended

    def _wait_for(self, path: str) -> float:
        """Milliseconds from the start until the address answers 200."""
        while time.perf_counter() - self._began_s < _PATIENCE_S:
            if self._process.poll() is not None or not self.port:
                break
            if _status(self.port, path) == 200:
                return 1e3 * (time.perf_counter() - self._began_s)
            time.sleep(_POLL_S)
        told = "\n".join(self._said) or "it said nothing"
        raise ServerError(
            f"the server of the benchmark did not get ready; it was started with\n{self._command}\n{told}"
        )


def _status(port: int, path: str) -> int:
    """Of a GET; 0 without an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.request("GET", path)
        return connection.getresponse().status
    except OSError:
        return 0
    finally:
        connection.close()


@contextmanager
def watching_health(port: int) -> Generator[Callable[[], list[float]]]:
    """Poll /healthz meanwhile, from another process (`bench.health`); the function that is given ends it and returns
    the latencies in milliseconds.
    """
    command = [sys.executable, "-m", "roomlight_bench.server_health", str(port)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    def ended() -> list[float]:
        output, _ = process.communicate()
        if process.returncode != 0:
            raise ServerError("the server stopped answering /healthz during the benchmark")
        return json.loads(output)

    with process:
        try:
            yield ended
        finally:
            process.kill()
