"""Server processes for the tests: what only a process of its own shows, such as signals, exit codes and limits."""

import http.client
import json
import os
import signal
import subprocess
import sys
import threading
from typing import Any

BOUND_S = 600
"""Limit on a request, and on the end of a process: a hang, on a busy machine. The server's own is `serving.STOP_S`."""


class Process:
    """A server process, and requests to it. `code` runs before it starts."""

    def __init__(self, *arguments, code="", **variables):
        run = f"{code}\nfrom roomlight_cli.main import main; main()"
        command = [sys.executable, "-c", run, "serve", "--port", "0", "--model", "classical", *arguments]
        environment = os.environ | {"COLUMNS": "200", "ROOMLIGHT_DECODE_TIMEOUT_S": "600"} | variables
        self._process = subprocess.Popen(
            command, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True
        )
        self.lines: list[str] = []
        self._line_read = threading.Condition()
        self.port, self._ready = 0, threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._ready.wait()

    def _read(self):
        assert self._process.stderr is not None
        for line in self._process.stderr:
            with self._line_read:
                self.lines.append(line)
                self._line_read.notify_all()
            if '"event": "serving"' in line:
                self.port = int(json.loads(line)["url"].rsplit(":", 1)[1])
            if '"event": "ready"' in line:
                self._ready.set()
        self._ready.set()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait()
        self._reader.join(BOUND_S)
        assert self._process.stderr is not None
        self._process.stderr.close()

    def wait_for_line(self, text):
        """Wait until the log has a line with this text."""
        with self._line_read:
            assert self._line_read.wait_for(lambda: any(text in line for line in self.lines), BOUND_S), self.lines

    def call(self, method, path, body=None, headers=None, *, token=None) -> tuple[int, Any]:
        """Return (status, JSON); (0, None) without a whole answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=BOUND_S)
        data = json.dumps(body).encode() if isinstance(body, dict) else body
        headers = ({"Content-Type": "application/json"} if isinstance(body, dict) else {}) | (headers or {})
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        try:
            connection.request(method, path, data, headers)
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read())
        except (OSError, http.client.HTTPException):
            return 0, None
        finally:
            connection.close()

    @property
    def pid(self):
        return self._process.pid

    def stop(self, number=signal.SIGTERM):
        """Send a signal; return the exit code."""
        self._process.send_signal(number)
        code = self._process.wait(BOUND_S)
        self._reader.join(BOUND_S)
        return code
