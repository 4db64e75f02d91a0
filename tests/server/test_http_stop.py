"""SIGTERM on a real process under load: frames are drained, sessions are saved, and the process ends."""

import http.client
import json
import os
import signal
import subprocess
import sys
import threading

import pytest

from http_servers import SMALL, InThread, RunningServer, frame
from roomlight_server.light_routes import encode_lights

SESSIONS = 4
LATE = {"probes": [{"position": [0.2, 1.2, -0.01 * number]} for number in range(8)], "forms": [{"format": "sh"}]}
LIGHT = "/probe?x=0.2&y=1.2&z=-0.5&format=npy"
BOUND_S = 60
"""Limit on the end of a process: a hang, on a busy machine. The server's own limit is `serving.STOP_S`."""


class Process:
    """A server process, and requests to it. `code` runs before it starts."""

    def __init__(self, *arguments, code="", **variables):
        run = f"{code}\nfrom roomlight_cli.main import main; main()"
        command = [sys.executable, "-c", run, "serve", "--port", "0", "--model", "classical", *arguments]
        environment = os.environ | {"COLUMNS": "200", "ROOMLIGHT_DECODE_TIMEOUT_S": "60"} | variables
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        self.lines: list[str] = []
        self.port, self._ready = 0, threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        assert self._ready.wait(300)

    def _read(self):
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self.lines.append(line)
            if line.startswith("Serving on"):
                self.port = int(line.split()[2].rsplit(":", 1)[1])
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

    def call(self, method, path, body=None):
        """Return (status, JSON); (0, None) without a whole answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=BOUND_S)
        data = json.dumps(body).encode() if isinstance(body, dict) else body
        kind = {"Content-Type": "application/json"} if isinstance(body, dict) else {}
        try:
            connection.request(method, path, data, kind)
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read())
        except (OSError, http.client.HTTPException):
            return 0, None
        finally:
            connection.close()

    def stop(self):
        """Send SIGTERM; return the exit code."""
        self._process.send_signal(signal.SIGTERM)
        code = self._process.wait(BOUND_S)
        self._reader.join(BOUND_S)
        return code


def stream(server, name, outcomes, processed):
    """Push frames until the server is gone; `outcomes` are (index, status, kind of problem or frame status)."""
    for index in range(10_000):
        status, answer = server.call("PUT", f"/v1/sessions/{name}/frames/{index}", frame(index % 90))
        if answer is None:
            outcomes.append((index, 0, ""))
            return
        outcomes.append((index, status, answer.get("status") if status == 200 else answer["type"].split(":")[-1]))
        processed.release()
        if status == 503:
            return


@pytest.mark.slow
def test_a_stop_under_load_drains_saves_and_ends(tmp_path):
    names = [f"room-{number}" for number in range(SESSIONS)]
    outcomes = {name: [] for name in names}
    processed = threading.Semaphore(0)
    with Process("--state-dir", str(tmp_path), "--state-interval-s", "3600") as server:
        for name in names:
            assert server.call("PUT", f"/v1/sessions/{name}", SMALL)[0] == 201
        streams = [InThread(stream, server, name, outcomes[name], processed) for name in names]
        late = [InThread(server.call, "POST", f"/v1/sessions/{name}/probes", LATE) for name in names * 2]
        for _ in range(5 * SESSIONS):
            assert processed.acquire(timeout=BOUND_S)
        assert server.stop() in (0, -signal.SIGTERM)
        for each in (*streams, *late):
            each.result()
        log = [json.loads(line) for line in server.lines if not line.startswith("Serving on")]
    assert [line["event"] for line in log].count("stopping") == 1
    assert [line for line in log if line["level"] == "error"] == []
    for found in outcomes.values():
        assert {status for _, status, _ in found[:-1]} == {200}
        assert found[-1][1:] in ((503, "stopping"), (0, ""))  # refused, or sent after the socket was closed
    with RunningServer(state_dir=tmp_path, tokens=()) as restored, RunningServer() as whole:
        for name, found in outcomes.items():
            last = max(index for index, _, outcome in found if outcome == "processed")
            assert restored.state(name)["frames"]["last_index"] == last
            whole.open(name)
            for index in range(last + 1):
                assert whole.push(index, frame(index % 90), name=name).json["status"] == "processed"
            light = [each.call("GET", f"/v1/sessions/{name}{LIGHT}") for each in (restored, whole)]
            assert light[0].headers["etag"] == light[1].headers["etag"]


def test_a_request_that_the_stop_ends_is_told_so(monkeypatch, caplog):
    """It was a 500, and an error with a traceback in the log."""
    begun, free = threading.Event(), threading.Event()

    async def held(workers, lights, forms):
        begun.set()
        await workers.run_in_encode_pool(free.wait, 60)
        return await encode_lights(workers, lights, forms)

    monkeypatch.setattr("roomlight_server.light_routes.encode_lights", held)
    with RunningServer() as server:
        server.open()
        server.push(0)
        post = InThread(server.call, "POST", "/v1/sessions/room/probes", LATE)
        assert begun.wait(60)
        server._server.should_exit = True
        answer = post.result()
        free.set()
    assert (answer.status, answer.kind, answer.headers["retry-after"]) == (503, "stopping", "5")
    assert not [record for record in caplog.records if record.exc_info]


@pytest.mark.slow
def test_a_stop_that_hangs_is_ended_at_its_limit():
    hang = "import time; from roomlight_server import registry, serving; serving.STOP_S = 0.5\n"
    hang += "registry.Registry.close = lambda self: time.sleep(10**6)"
    with Process(code=hang) as server:
        assert server.stop() == 1
        assert any("the stop took longer than 0.5 s" in line for line in server.lines)
