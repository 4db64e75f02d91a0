"""Servers on real sockets for the tests, a plain HTTP client, frame messages, an engine that waits on demand."""

import asyncio
import http.client
import json
import socket
import struct
import threading
import time
from dataclasses import dataclass
from functools import cache, partial, wraps
from typing import ClassVar

import numpy as np
from websockets.sync.client import connect

from kept_exports import BUILTINS
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import Session
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import MAGIC, column_major, pack
from roomlight.wire.light_message import MEDIA_TYPE
from roomlight_server.answers import light_forms
from roomlight_server.app import create_app
from roomlight_server.base.settings import ServerSettings
from roomlight_server.serving import GracefulServer
from roomlight_server.work import workers
from rooms import BoxRoom, camera_at

TOKEN, OTHER = "a-token-of-sixteen-or-more", "another-token-of-sixteen"
LATE = "/v1/sessions/room/probes"
TETRAHEDRON = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
"""An object as an OBJ file."""


def once(work):
    """Return the function without effect for arguments that it had before."""
    done: set[tuple[int, ...]] = set()

    @wraps(work)
    def call(*args):
        if (key := tuple(map(id, args))) not in done:
            with BUILTINS:
                work(*args)
            done.add(key)

    return call


# Each server compiles and runs everything once when it starts: 0.3 s of CPU time, of 250 servers.
light_forms.warm_up = once(light_forms.warm_up)
workers.warm_up = once(workers.warm_up)

SMALL = {"model": "classical", "height": 16, "reference_exposure": 1.0}
"""Options of a fast session."""


LONG_S = 600
"""Time limit of what must not wait for ever; the first composite of a slow machine compiles its kernels for minutes."""


def wait_until(condition):
    """Ask again and again until a condition holds."""
    end = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < end, "the condition did not become true"


class RunningServer:
    """A server in its own thread on a free port, of the classical model unless another is given, in a `with`."""

    def __init__(self, *, clock=None, **settings):
        settings.setdefault("wrong_token_delay_s", 0)
        settings.setdefault("refusal_delay_s", 0)
        settings.setdefault("decode_timeout_s", LONG_S)  # the machine is busy with other tests
        settings.setdefault("object_timeout_s", LONG_S)
        settings.setdefault("composite_timeout_s", LONG_S)
        settings.setdefault("port", 0)
        if "weights" not in settings:
            settings.setdefault("model", "classical")
        self.settings = ServerSettings(**settings)
        self.app = create_app(self.settings, **({} if clock is None else {"clock": clock}))
        self._up = threading.Event()
        self.loop: asyncio.AbstractEventLoop | None = None  # from the start on
        self._server = GracefulServer(self.settings, self.app)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        startup = self._server.startup

        async def startup_and_signal(sockets=None):
            await startup(sockets)
            self.loop = asyncio.get_running_loop()
            self._up.set()

        self._server.startup = startup_and_signal
        self._server.run()
        self._up.set()

    def __enter__(self):
        self._thread.start()
        self._up.wait()
        return self

    def __exit__(self, *_):
        self.stop()

    def begin_stop(self):
        """Let the server stop, as a signal does, without waiting for its end."""
        self._server.should_exit = True

    def stop(self):
        self.begin_stop()
        self._thread.join(LONG_S)
        assert not self._thread.is_alive()

    @property
    def registry(self):
        return self.app.state.context.registry

    @property
    def port(self):
        return self._server.servers[0].sockets[0].getsockname()[1]

    def call(self, method, path, body=None, *, token=None, headers=None, timeout=LONG_S):
        """Send one request on a new connection; a dict is sent as JSON."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout)
        given = {} if token is None else {"Authorization": f"Bearer {token}"}
        if isinstance(body, dict):
            body, given["Content-Type"] = json.dumps(body).encode(), "application/json"
        try:
            connection.request(method, path, body, given | (headers or {}))
            return answer_from(connection.getresponse())
        finally:
            connection.close()

    def dial(self, source="127.0.0.1"):
        """Connect from an address of this machine, without a request."""
        return socket.create_connection(("127.0.0.1", self.port), LONG_S, (source, 0))

    def open(self, name="room", options=None, **more):
        answer = self.call("PUT", f"/v1/sessions/{name}", SMALL if options is None else options, **more)
        assert answer.status in (200, 201), answer
        return answer

    def push(self, index, body=None, name="room", **more):
        return self.call("PUT", f"/v1/sessions/{name}/frames/{index}", frame(index) if body is None else body, **more)

    def state(self, name="room", **more):
        return self.call("GET", f"/v1/sessions/{name}", **more).json

    def stream(self, name="room", *, token=None, headers=None, **more):
        """Connect to the WebSocket of a session."""
        sent = {**(headers or {}), **({} if token is None else {"Authorization": f"Bearer {token}"})}
        url = f"ws://127.0.0.1:{self.port}/v1/sessions/{name}/stream"
        return connect(url, additional_headers=sent, open_timeout=LONG_S, ping_timeout=None, **more)

    def wait_until(self, condition):
        """Wait on the event loop, one request after the other; each must succeed."""

        def holds():
            if condition():
                return True
            assert self.call("GET", "/healthz").status == 200
            return False

        wait_until(holds)

    def wait_until_ready(self):
        self.wait_until(lambda: self.call("GET", "/readyz").status == 200)

    def wait_until_accepted(self, index, name="room"):
        """Wait until a frame is in the queue."""
        self.wait_until(lambda: self.state(name)["frames"]["last_index"] == index)

    def wait_until_saved(self, index, name="room", **more):
        """Wait until a frame is on disk."""
        self.wait_until(lambda: self.state(name, **more)["frames"]["durable_index"] == index)


def server_on(folder, **settings):
    """Return a server that saves its sessions in a folder, soon after each change."""
    return RunningServer(**{"state_dir": folder, "state_interval_s": 0.1, "idle_expiry_s": 1e6} | settings)


def metric(server, name):
    """Return a value of /metrics, 0 before the first one; `name` includes the labels."""
    lines = server.call("GET", "/metrics").body.decode().splitlines()
    return next((float(line.removeprefix(f"{name} ")) for line in lines if line.startswith(f"{name} ")), 0.0)


def with_small_buffer():
    """A socket that receives 4096 bytes ahead of its reader."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    return connection


def post(server, body, path=LATE, token=None, connection=None):
    """Send a POST on a new connection and return it without reading the answer."""
    data = json.dumps(body)
    access = "" if token is None else f"Authorization: Bearer {token}\r\n"
    connection = connection or socket.socket()
    connection.connect(("127.0.0.1", server.port))
    connection.sendall(
        f"POST {path} HTTP/1.1\r\nHost: localhost\r\n{access}Accept: {MEDIA_TYPE}\r\n"
        f"Content-Type: application/json\r\nContent-Length: {len(data)}\r\n\r\n{data}".encode()
    )
    return connection


def flood(connection, data, most=2**25):
    """Send the data again and again until the server closes; return whether it did before `most` bytes."""
    sent = 0
    try:
        while sent < most:
            sent += connection.send(data)
    except ConnectionError:
        return True
    return False


def is_closed(connection):
    """Whether the server has closed a connection on which it sends nothing."""
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


@dataclass(frozen=True)
class Answer:
    status: int
    headers: dict
    body: bytes

    @property
    def json(self):
        return json.loads(self.body)

    @property
    def kind(self):
        """The kind of a problem; asserts that the answer is a problem."""
        assert self.headers["content-type"] == "application/problem+json", self
        assert {"type", "title", "status", "detail"} <= self.json.keys()
        assert self.json["status"] == self.status
        return self.json["type"].removeprefix("urn:roomlight:problem:")


def answer_from(response):
    return Answer(response.status, {key.lower(): value for key, value in response.getheaders()}, response.read())


def answer_of(connection):
    """Read the answer to a request that was sent by hand."""
    response = http.client.HTTPResponse(connection)
    response.begin()
    return answer_from(response)


class Held:
    """Replaces a function or method: calls of it, or those of which `waits` says so, wait for `release`."""

    def __init__(self, work, waits=lambda *_: True):
        self._work, self._waits = work, waits
        self._entered, self._gate = threading.Semaphore(0), threading.Semaphore(0)
        self.calls = 0

    def __get__(self, instance, owner=None):
        return partial(self, instance)

    def __call__(self, *args):
        if self._waits(*args):
            self.calls += 1
            self._entered.release()
            assert self._gate.acquire(timeout=LONG_S)
        return self._work(*args)

    def wait_entered(self):
        self._entered.acquire()

    def release(self, count=1):
        self._gate.release(count)


class InThread:
    """A call that runs in a thread; `result` waits for it."""

    def __init__(self, work, *args, **kwargs):
        self._outcome = []
        self._thread = threading.Thread(target=lambda: self._outcome.append(work(*args, **kwargs)), daemon=True)
        self._thread.start()

    def result(self):
        self._thread.join()
        return self._outcome[0]


class HeldSession(Session):
    """An engine that waits for `release()` in every push and raises the errors in `broken`, by frame index."""

    entered = threading.Semaphore(0)
    gate = threading.Semaphore(0)
    broken: ClassVar[dict[int, BaseException]] = {}

    @classmethod
    def serve(cls, monkeypatch):
        """Make it the engine of the sessions of servers."""
        cls.entered, cls.gate, cls.broken = threading.Semaphore(0), threading.Semaphore(0), {}
        monkeypatch.setattr("roomlight_server.sessions.registry.Session", cls)

    @classmethod
    def wait_entered(cls):
        cls.entered.acquire()

    @classmethod
    def release(cls, count=1):
        cls.gate.release(count)

    def push(self, frame):
        self.entered.release()
        assert self.gate.acquire(timeout=LONG_S)
        if frame.index in self.broken:
            raise self.broken[frame.index]
        return super().push(frame)


@cache
def box_shot(yaw_degrees):
    room = BoxRoom(size_m=(4.0, 2.6, 3.6), lamp=((0.5, 2.6, 0.3), 0.3))
    return room.frame(camera_at((0.2, 1.4, 0.8), yaw_degrees=float(yaw_degrees)), width=48, height=36)


def header_of(shot, **changes):
    height, width = shot.image.shape[:2]
    k = shot.intrinsics
    header = {
        "colour": {"encoding": "rgb8", "bytes": 3 * width * height},
        "depth": {
            "format": "float32_m", "encoding": "raw", "width": width, "height": height, "bytes": 4 * width * height,
        },
        "intrinsics": {name: getattr(k, name) for name in ("fx", "fy", "cx", "cy", "width", "height")},
        "camera_to_world": column_major(shot.camera_to_world),
    }  # fmt: skip
    return header | changes


def parts_of(shot):
    return linear_to_srgb8(np.clip(shot.image, 0, 1)).tobytes(), shot.depth_m.astype("<f4").tobytes()


def with_parts(colour=None, depth=None, confidence=None, **changes):
    """Return a frame of the box room whose header is not checked.

    Parts are (description, bytes), by default those of the room; lengths are filled in. Without depth if it is False.
    """
    header, parts = header_of(box_shot(0), **changes), []
    for name, given, default in zip(("colour", "depth"), (colour, depth), parts_of(box_shot(0)), strict=True):
        if given is False:
            del header[name]
            continue
        described, data = given if given is not None else ({}, default)
        header[name] = header[name] | described | {"bytes": len(data)}
        parts.append(data)
    if confidence is not None:
        header["confidence"] = {"width": 48, "height": 36, "bytes": len(confidence[1])} | confidence[0]
        parts.append(confidence[1])
    return build(header, *parts)


def build(header, *parts):
    """Return a frame message of a header and parts that are not checked."""
    text = json.dumps(header).encode()
    return MAGIC + struct.pack("<I", len(text)) + text + b"".join(parts)


@cache
def frame(yaw_degrees=0, **changes):
    """Return a frame message of a box room."""
    shot = box_shot(yaw_degrees)
    return pack(FrameHeader.model_validate_json(json.dumps(header_of(shot, **changes))), *parts_of(shot))
