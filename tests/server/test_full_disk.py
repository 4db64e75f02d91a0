"""A disk that takes no more bytes, as the kernel refuses them: serving goes on, and `/readyz` says so."""

import resource

import pytest

from http_servers import SMALL, RunningServer, frame, wait_until
from server_processes import Process

SESSION = "/v1/sessions/room"
LIMIT_BYTES = 10_000
"""Largest file that the process may write; the state of a session is larger."""


def wait_for_state(server, expected):
    def is_expected():
        status, answer = server.call("GET", "/readyz")
        assert status == 200
        return answer["state"] == expected

    wait_until(is_expected)


def wait_until_durable(server, index):
    wait_until(lambda: server.call("GET", SESSION)[1]["frames"]["durable_index"] == index)


@pytest.mark.slow
def test_a_process_serves_while_it_cannot_write(tmp_path):
    with Process("--state-dir", str(tmp_path), "--state-interval-s", "0.2") as server:
        assert server.call("PUT", SESSION, SMALL)[0] == 201
        assert server.call("PUT", f"{SESSION}/frames/0", frame(0))[0] == 200
        wait_until_durable(server, 0)
        _, hard = resource.prlimit(server.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(server.pid, resource.RLIMIT_FSIZE, (LIMIT_BYTES, hard))
        for index in (1, 2):
            assert server.call("PUT", f"{SESSION}/frames/{index}", frame(12 * index))[1]["status"] == "processed"
        wait_for_state(server, "not saved: File too large")
        assert server.call("PUT", f"{SESSION}/frames/3", frame(36))[1]["status"] == "processed"
        assert server.call("GET", SESSION)[1]["frames"]["durable_index"] < 3
        resource.prlimit(server.pid, resource.RLIMIT_FSIZE, (hard, hard))
        wait_for_state(server, "saved")
        wait_until_durable(server, 3)
        assert any("sessions cannot be saved" in line for line in server.lines)
    with RunningServer(state_dir=tmp_path) as restored:
        assert restored.state()["frames"]["last_index"] == 3
