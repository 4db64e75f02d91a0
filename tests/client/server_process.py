"""A real `roomlight serve` that a test kills and starts again on the same port."""

import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from roomlight_client import Client, Retry, UnreachableError

READY: Final = Retry(attempts=400, first_delay_s=0.05, max_delay_s=0.25)
"""A server takes seconds to start on a busy machine."""
_MAIN: Final = "from roomlight_cli.main import main; main()"


class ServerProcess:
    """A server in a process of its own; a `with` statement kills it at its end."""

    def __init__(self, *options: str, state_dir: Path | None = None) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        self._options = [*options, *([] if state_dir is None else ["--state-dir", str(state_dir)])]
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def __enter__(self) -> "ServerProcess":
        self.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.kill()

    def start(self) -> None:
        command = [sys.executable, "-c", _MAIN, "serve", "--model", "classical", "--port", str(self.port)]
        self._process = subprocess.Popen(
            [*command, *self._options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        with Client(self.url, retry=READY) as client:
            try:
                client.ready()
            except UnreachableError as error:
                raise AssertionError(f"the server did not start, its exit code: {self._process.poll()}") from error

    def kill(self) -> None:
        """End the process at once, without any chance to write or to say goodbye."""
        if self._process is not None:
            self._process.send_signal(signal.SIGKILL)
            self._process.wait()
            self._process = None

    def restart(self) -> None:
        self.kill()
        self.start()
