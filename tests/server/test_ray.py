"""Replicas under Ray Serve: streams go on when a replica is killed and one is added, with the same light.

A real cluster of this machine, started by `roomlight serve --ray`: about 20 processes, two minutes on two idle cores.
"""

import asyncio
import itertools
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import pytest

from present import present
from roomlight_client import AsyncClient, Client, Retry
from rooms import BoxRoom, pan

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1500),
    pytest.mark.skipif(find_spec("ray") is None, reason="the extra `ray` is not installed"),
]

FRAMES = tuple(pan(BoxRoom(lamp=((0.5, 3.0, 0.3), 0.3)), 14, width=64, height=48))
POINT = (0.4, 1.2, -0.3)
PATIENT = Retry(attempts=2000, first_delay_s=0.05, max_delay_s=0.5)
STREAMS = 12
KILL_AFTER, ADD_AFTER, MORE = 3 * STREAMS, 5 * STREAMS, 6
START_S = 600
"""The machine is busy with other tests."""
_MAIN = "from roomlight_cli.main import main; main()"


class RayServer:
    """`roomlight serve --ray` with a cluster of its own; a `with` statement stops it at its end."""

    def __init__(self, folder: Path, replicas: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        self._log = folder / "log"
        self._ray = Path(tempfile.mkdtemp(prefix="ray-", dir="/tmp"))  # paths of its sockets must be short
        self._options = ["--ray", "--state-dir", str(folder / "state"), "--state-interval-s", "1"]
        self._options += ["--port", str(self.port), "--model", "classical", "--max-sessions", "32"]
        self._variables = os.environ | {"RAY_TMPDIR": str(self._ray), "ROOMLIGHT_DECODE_TIMEOUT_S": "120"}
        self._replicas = replicas

    def _command(self, replicas):
        return [sys.executable, "-c", _MAIN, "serve", *self._options, "--replicas", str(replicas)]

    def __enter__(self):
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                self._command(self._replicas), env=self._variables, stdout=log, stderr=log, start_new_session=True
            )
        try:
            self._wait_for("Serving on http://127.0.0.1:")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        self._process.terminate()
        try:
            self._process.wait(600)
        except subprocess.TimeoutExpired:
            pass
        finally:
            for pid in self.processes():
                os.kill(pid, signal.SIGKILL)
            if self._process.poll() is None:
                self._process.kill()
            self._process.wait()
            shutil.rmtree(self._ray, ignore_errors=True)

    def _wait_for(self, text):
        end_s = time.monotonic() + START_S
        while text not in self.log():
            assert time.monotonic() < end_s, self.log()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(0.2)
                raise AssertionError(self.log())

    def log(self):
        return self._log.read_text(errors="replace")

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}"

    def processes(self, name=""):
        """Return the processes below the server's whose title has this text."""
        parents, titles = {}, {}
        for folder in Path("/proc").iterdir():
            if folder.name.isdigit():
                try:
                    stat = (folder / "stat").read_text()
                    titles[int(folder.name)] = (folder / "cmdline").read_bytes().decode(errors="replace")
                except OSError:
                    continue  # it has ended in the meantime
                parents[int(folder.name)] = int(stat.rpartition(")")[2].split()[1])
        found = {self._process.pid}
        while new := {pid for pid, parent in parents.items() if parent in found} - found:
            found |= new
        return sorted(pid for pid in found - {self._process.pid} if name in titles[pid])

    def replicas(self):
        return self.processes("ray::ServeReplica")

    def scale(self, replicas):
        """Run the command again with another number of replicas, as a user does."""
        address = re.findall(r'"ray": "([^"]+)"', self.log())[-1]
        done = subprocess.run(
            self._command(replicas),
            env=self._variables | {"RAY_ADDRESS": address},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=START_S,
        )
        assert done.returncode == 0, done.stdout.decode()

    def claims(self):
        """Return (session, epoch, process) of each claim in the log of the replicas."""
        found = []
        for pid, line in re.findall(r"pid=(\d+)\)?\S* (\{.*?\"event\": \"session claimed\".*?\})", self.log()):
            values = json.loads(line)
            found.append((values["session"], values["epoch"], int(pid)))
        return found


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with RayServer(tmp_path_factory.mktemp("ray"), 3) as running:
        yield running


class Watch:
    """Counts the frames of all streams, runs work on threads once enough are answered; `done` is set after the last."""

    def __init__(self, *due):
        self.answers = []
        self.done = asyncio.Event()
        self._due = list(due)
        self._running = []

    def answered(self, session, result):
        self.answers.append((session, result.index, result.epoch))
        if self._due and len(self.answers) >= self._due[0][0]:
            _, work, *args = self._due.pop(0)
            self._running.append(asyncio.create_task(self._run(work, *args)))

    async def _run(self, work, *args):
        try:
            await asyncio.to_thread(work, *args)
        finally:
            if not self._due:
                self.done.set()

    async def ended(self):
        await asyncio.gather(*self._running)


def frame_at(index):
    return FRAMES[index % len(FRAMES)]


async def streamed(url, name, watch, over):
    """Send frames, one after the other, until all work is done, and some more; returns light and state afterwards."""
    async with AsyncClient(url, retry=PATIENT, reconnect=PATIENT) as client:
        session = await client.open(name, model="classical", height=16, reference_exposure=1.0)
        await session.track("table", POINT)
        stream = await session.stream() if over == "websocket" else None
        push = session.push if stream is None else stream.push
        left, index = MORE, 0
        for index in itertools.count():
            watch.answered(name, await push(frame_at(index), index))
            left -= watch.done.is_set()
            if left == 0:
                break
        if stream is not None:
            await stream.close()
        # the ring has changed: with the next frame the client sends what the new owner of its session lacks
        watch.answered(name, await session.push(frame_at(index + 1), index + 1))
        return await session.light_at("table"), await session.state()


async def uninterrupted(url, wanted):
    """Return the light after each of the wanted frames, of a session that nothing happens to."""
    lights = {}
    async with AsyncClient(url) as client:
        session = await client.open("whole", model="classical", height=16, reference_exposure=1.0)
        await session.track("table", POINT)
        for index in range(max(wanted) + 1):
            assert (await session.push(frame_at(index), index)).epoch == 1
            if index in wanted:
                lights[index] = await session.light_at("table")
    return lights


def test_streams_go_on_when_replicas_come_and_go(server):
    killed = []

    def kill():
        owners = [pid for _, _, pid in server.claims()]
        victim = max(server.replicas(), key=owners.count)
        killed.append(victim)
        os.kill(victim, signal.SIGKILL)

    async def main():
        watch = Watch((KILL_AFTER, kill), (ADD_AFTER, server.scale, 4))
        names = [f"phone-{number}" for number in range(STREAMS)]
        kinds = ("websocket", "requests")
        streams = [streamed(server.url, name, watch, kinds[number % 2]) for number, name in enumerate(names)]
        found = dict(zip(names, await asyncio.gather(*streams), strict=True))
        await watch.ended()
        wanted = {state.frames.last_index for _, state in found.values()}
        return found, await uninterrupted(server.url, wanted), watch.answers

    found, whole, answers = asyncio.run(main())

    for name, (light, state) in found.items():
        expected = whole[state.frames.last_index]
        assert light.panorama.tobytes() == expected.panorama.tobytes(), name
        assert (light.frame, light.coverage) == (expected.frame, expected.coverage), name

    claims = server.claims()
    assert len({(session, epoch) for session, epoch, _ in claims}) == len(claims)  # one owner for each epoch
    owners = {(session, epoch): pid for session, epoch, pid in claims}
    for name in found:
        last = present(found[name][1].frames.last_index)
        own = [(index, epoch) for session, index, epoch in answers if session == name]
        assert [index for index, _ in own] == list(range(last + 1))
        epochs = [epoch for _, epoch in own if epoch is not None]
        assert epochs == sorted(epochs), name
        assert all((name, epoch) in owners for epoch in epochs)
    assert any(epoch > 1 for _, _, epoch in answers if epoch)  # the killed replica had a session
    assert killed[0] not in server.replicas()
    assert len(server.replicas()) == 4


def test_a_session_stays_with_one_replica(server):
    """Without a header too, as a browser's WebSocket: the proxy takes the session id from the path."""
    with Client(server.url) as client:
        for number in range(6):
            session = client.open(f"steady-{number}", model="classical", height=16)
            for _ in range(8):
                session.state()
            assert session.push(FRAMES[0]).epoch == 1
            session.close()


def test_the_cluster_listens_on_loopback_alone(server):
    inodes = set()
    for pid in [*server.processes(), server._process.pid]:
        for link in Path(f"/proc/{pid}/fd").glob("*"):
            try:
                target = str(link.readlink())
            except OSError:
                continue
            inodes |= set(re.findall(r"socket:\[(\d+)\]", target))
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    listening = [row[1] for row in rows if row[3] == "0A" and row[9] in inodes]
    assert len(listening) > 3
    loopback = re.compile(r"0100007F:|00000000000000000000000001000000:|0000000000000000FFFF00000100007F:")
    assert [address for address in listening if not loopback.match(address)] == []
