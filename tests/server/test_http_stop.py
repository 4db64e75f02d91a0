"""SIGTERM on a real process under load: frames are drained, sessions are saved, and the process ends."""

import json
import signal
import threading

import pytest

from http_servers import SMALL, InThread, RunningServer, frame
from roomlight_server.routes.light import encode_lights
from server_processes import BOUND_S, Process

SESSIONS = 2
LATE = {"probes": [{"position": [0.2, 1.2, -0.01 * number]} for number in range(8)], "forms": [{"format": "sh"}]}
LIGHT = "/probe?x=0.2&y=1.2&z=-0.5&format=npy"


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
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=["SIGTERM", "SIGHUP"])
def test_a_stop_under_load_drains_saves_and_ends(tmp_path, number):
    """SIGHUP, when the terminal was closed, ended the server without saving."""
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
        assert server.stop(number) in (0, -number)
        for each in (*streams, *late):
            each.result()
        log = [json.loads(line) for line in server.lines]
    assert [line["event"] for line in log].count("stopping") == 1
    assert [line for line in log if "traceback" in line] == []
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


@pytest.mark.slow
def test_a_request_that_the_stop_ends_is_told_so(monkeypatch, caplog):
    """It was a 500, and an error with a traceback in the log."""
    begun, free = threading.Event(), threading.Event()

    async def held(workers, lights, forms):
        begun.set()
        await workers.run_in_encode_pool(free.wait, 60)
        return await encode_lights(workers, lights, forms)

    monkeypatch.setattr("roomlight_server.routes.light.encode_lights", held)
    with RunningServer() as server:
        server.open()
        server.push(0)
        post = InThread(server.call, "POST", "/v1/sessions/room/probes", LATE)
        begun.wait()
        server.begin_stop()
        answer = post.result()
        free.set()
    assert (answer.status, answer.kind, answer.headers["retry-after"]) == (503, "stopping", "5")
    assert not [record for record in caplog.records if record.exc_info]


@pytest.mark.slow
def test_a_stop_that_hangs_is_ended_at_its_limit():
    hang = "import time; from roomlight_server import serving; from roomlight_server.sessions import registry\n"
    hang += "serving.STOP_S = 0.5\n"
    hang += "registry.Registry.close = lambda self: time.sleep(10**6)"
    with Process(code=hang) as server:
        assert server.stop() == 1
        assert any("the stop took longer than 0.5 s" in line for line in server.lines)
