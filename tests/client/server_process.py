"""A real `roomlight serve` that a test kills and starts again on the same port."""

from pathlib import Path
from typing import Any

from server_processes import Process


class ServerProcess:
    """A server in a process of its own; a `with` statement kills it at its end."""

    def __init__(self, *options: str, state_dir: Path | None = None) -> None:
        self._options = [*options, *([] if state_dir is None else ["--state-dir", str(state_dir)])]
        self._process: Process | None = None
        self.port = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def __enter__(self) -> "ServerProcess":
        self.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.kill()

    def start(self) -> None:
        self._process = Process(*self._options, "--port", str(self.port))
        assert self._process.port, self._process.lines
        self.port = self._process.port

    def kill(self) -> None:
        """End the process at once, without any chance to write or to say goodbye."""
        if self._process is not None:
            self._process.__exit__()
            self._process = None

    def restart(self) -> None:
        self.kill()
        self.start()
