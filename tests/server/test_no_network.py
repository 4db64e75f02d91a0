"""The server and the demo look up no host and connect to no other machine, as the kernel sees it (strace)."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading

import pytest

COMMANDS = {
    "serve": (("serve", "--port", "0", "--model", "video"), '"event": "ready"'),
    "demo": (("demo", "--port", "0"), "frames of the sample are in the light"),
}
"""Arguments of a command, and the line of its output after which it is stopped."""
CALL = re.compile(r"\b(bind|connect|sendto|sendmsg|sendmmsg)\(.*?sa_family=(AF_INET6?)")
LOOPBACK = re.compile(r'inet_addr\("127\.\d+\.\d+\.\d+"\)|inet_pton\(AF_INET6, "::1"')


def traced_lines(folder, arguments, until):
    """Run a command under strace until a line of its output; return the lines of its trace."""
    trace = folder / "trace"
    strace = ["strace", "-f", "--seccomp-bpf", "-qq", "-e", "trace=bind,connect,sendto,sendmsg,sendmmsg"]
    command = [sys.executable, "-c", "from roomlight_cli.main import main; main()", *arguments]
    names = {"ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME"}
    environment = {name: value for name, value in os.environ.items() if name not in names}
    environment |= {"HOME": str(folder), "BROWSER": "true", "COLUMNS": "200"}
    found = threading.Event()
    output: list[str] = []
    with subprocess.Popen(
        [*strace, "-o", str(trace), *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
        start_new_session=True,
    ) as process:

        def read():
            assert process.stdout is not None
            for line in process.stdout:
                output.append(line)
                if until in line:
                    found.set()
            found.set()

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        try:
            found.wait()
            assert any(until in line for line in output), output
        finally:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
            reader.join()
    return trace.read_text().splitlines()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_connects_to_no_other_machine(name, tmp_path):
    """ONNX Runtime's telemetry looked up a host of its maker and wrote files below the home folder."""
    calls = [line for line in traced_lines(tmp_path, *COMMANDS[name]) if CALL.search(line)]
    assert any("bind(" in line for line in calls)  # the trace sees the server's own socket
    assert [line for line in calls if not LOOPBACK.search(line) or "htons(53)" in line] == []
    assert [path for path in tmp_path.rglob("*") if "Microsoft" in path.parts] == []
