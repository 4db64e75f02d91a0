"""The Swift package, compiled and run on a real server, where Swift is installed."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from http_servers import RunningServer

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("swift") is None, reason="Swift is not installed")
def test_swifts_own_tests_pass_on_a_server(tmp_path):
    with RunningServer() as server:
        environment = os.environ | {"ROOMLIGHT_SERVER": f"http://127.0.0.1:{server.port}"}
        command = ["swift", "test", "--package-path", str(ROOT / "client/swift"), "--scratch-path", str(tmp_path)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Executed 4 tests, with 0 failures" in done.stdout + done.stderr
    assert "skipped" not in done.stdout + done.stderr
