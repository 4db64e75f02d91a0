"""A client that does what no client should, in a process of its own: `python -m roomlight_bench.server.hostile_client`.

It reads a JSON object from standard input: `port`, `token`, `attack` and `seconds`. It writes a line when it begins,
repeats the attack until the time is over, and writes a JSON object of what it did: requests, and answers by status. All
connections come from 127.0.0.2, so that the limit of connections per address is its own; idle ones come from ten
addresses.
"""

import asyncio
import hashlib
import json
import re
import struct
import sys
import time
import zlib
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from contextlib import suppress
from functools import partial
from typing import Any, Final

import cv2
import numpy as np
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from roomlight.captures import CaptureOptions, open_capture
from roomlight.placement import point_in_view
from roomlight.sample import sample_capture
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import FrameLimits, pack, parse
from roomlight.wire.light_message import MEDIA_TYPE
from roomlight_bench.server.hostile_floods import FLOODS, SLOW_BYTES_PER_S, flood, interleaved_glb

ADDRESS: Final = "127.0.0.2"
IDLE_ADDRESSES: Final = tuple(f"127.0.0.{last}" for last in range(2, 12))
ROWS: Final = 512
CLIENT_HELLO: Final = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"
"""The first bytes of a TLS handshake."""
_END_S: Final = 10.0
_JSON: Final = {"Content-Type": "application/json"}
_FRAME: Final = {"Content-Type": "application/vnd.roomlight.frame"}


class Hostile:
    """Attacks on one server. Each repeats until it is cancelled."""

    def __init__(self, port: int, token: str, attack: str) -> None:
        """Prepare frames of the sample capture, and the images of the attack."""
        self._port, self._token = port, token
        self._opened: set[str] = set()
        self._uploaded: list[str] = []
        self.requests = 0
        self.answers: Counter[str] = Counter()
        frames = list(open_capture(sample_capture(), CaptureOptions(max_frames=8)))
        self._bodies = [pack_frame(frame, colour="jpeg") for frame in frames]
        self._point = point_in_view(frames[0])
        self._bombs = []
        if attack == "decode-bombs":
            images = [
                ("jpeg", _slow_jpeg(60)),
                ("jpeg", _slow_jpeg(64)),
                ("jpeg", _slow_jpeg(3000)),
                ("png", _slow_png()),
            ]
            self._bombs = [self._with_colour(encoding, data) for encoding, data in images]

    async def decode_bombs(self) -> None:
        """Send images of 12 megapixels and 60 to 100 scans, and of 500 compressed texts, in four sessions."""

        async def repeat(session: int) -> None:
            await self._open(f"bomb{session}")
            index = 0
            while True:
                index += 1
                path = f"/v1/sessions/bomb{session}/frames/{index}"
                await self._call("PUT", path, self._bombs[index % len(self._bombs)], _FRAME)

        await self._all(repeat(session) for session in range(4))

    async def large_headers(self) -> None:
        """Send headers without an end on eight connections."""

        async def repeat() -> None:
            while True:
                try:
                    reader, writer = await self._connect()
                    writer.write(b"GET /healthz HTTP/1.1\r\n")
                    for number in range(1000):
                        writer.write(b"X-%d: " % number + b"a" * 65_536 + b"\r\n")
                        await writer.drain()
                    self._count(await reader.read(12))
                    writer.close()
                except OSError:
                    self._count(b"")

        await self._all(repeat() for _ in range(8))

    async def refused_bodies(self) -> None:
        """Send bodies of 9 GB with a wrong token on eight connections."""
        head = b"PUT /v1/sessions/a/frames/0 HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer wrong\r\n"

        async def repeat() -> None:
            while True:
                with suppress(OSError):
                    reader, writer = await self._connect()
                    writer.write(head + b"Content-Length: 9000000000\r\n\r\n")
                    self._count(await reader.read(12))
                    while not writer.is_closing():
                        writer.write(bytes(2**18))
                        await writer.drain()
                    writer.close()

        await self._all(repeat() for _ in range(8))

    async def idle_connections(self, hold: int, every_s: float, data: bytes = b"") -> None:
        """Hold as many connections as the server accepts, which send `data` and nothing more, from ten addresses."""
        writers: list[asyncio.StreamWriter] = []
        while True:
            with suppress(OSError):
                writers.append((await self._connect(IDLE_ADDRESSES[self.requests % len(IDLE_ADDRESSES)]))[1])
                if data:
                    writers[-1].write(data)
            self.requests += 1
            if len(writers) >= hold:
                writers.pop(0).close()
            await asyncio.sleep(every_s)

    async def hung_up_posts(self) -> None:
        """Request 64 late points twenty times and hang up; then again."""
        await self._fill("room", 120)
        body = self._light_request(64, {"format": "sh"})
        while True:
            for _ in range(20):
                with suppress(OSError):
                    _, writer = await self._connect()
                    writer.write(self._request("POST", "/v1/sessions/room/probes", body, _JSON))
                    await writer.drain()
                    self.requests += 1
                    writer.close()
            await asyncio.sleep(0.5)

    async def large_answers(self) -> None:
        """Request ten forms `specular` of 256 pixels on forty connections."""
        await self._fill("room", 120)
        body = self._light_request(1, *({"format": "specular", "size": 256} for _ in range(10)))

        async def repeat() -> None:
            while True:
                await self._call("POST", "/v1/sessions/room/probes", body, _JSON | {"Accept": MEDIA_TYPE})

        await self._all(repeat() for _ in range(40))

    async def tall_probes(self) -> None:
        """Stream frames to a session with sixteen probes of 512 rows, and request late ones."""
        await self._open("tall", ROWS)
        x, y, z = self._point
        for number in range(16):
            place = {"position": [x + 0.02 * number, y, z]}
            await self._call("PUT", f"/v1/sessions/tall/probes/p{number}", json.dumps(place).encode(), _JSON)

        async def push(offset: int) -> None:
            index = 100 + offset
            while True:
                body = self._bodies[index % len(self._bodies)]
                await self._call("PUT", f"/v1/sessions/tall/frames/{index}", body, _FRAME)
                index += 2

        async def late() -> None:
            while True:
                body = self._light_request(8, {"format": "sh"})
                await self._call("POST", "/v1/sessions/tall/probes", body, _JSON)

        await self._all((push(0), push(1), late()))

    async def unread_messages(self) -> None:
        """Send 15,000 requests for light on a WebSocket and read no answer; then again."""
        await self._fill("room", 120)
        message = json.dumps(
            {"type": "light", "request": "r", "probes": [{"position": self._point}] * 8, "forms": [{"format": "npy"}]}
        )
        url = f"ws://127.0.0.1:{self._port}/v1/sessions/room/stream"
        access = {"Authorization": f"Bearer {self._token}"}
        while True:
            with suppress(OSError, WebSocketException):
                async with connect(
                    url, additional_headers=access, local_addr=(ADDRESS, 0), max_queue=1, close_timeout=0
                ) as stream:
                    for _ in range(15_000):
                        await stream.send(message)
                        self.requests += 1
            await asyncio.sleep(0.1)

    async def flood(self, name: str, bytes_per_s: float | None) -> None:
        """Send a flood of `hostile_floods` on one connection after the other."""
        await self._open("flood")
        await flood(self._connect, name, token=self._token, bytes_per_s=bytes_per_s, count=self._count)

    async def glb_bombs(self) -> None:
        """Upload objects of 31 MiB whose 25 accessors share one view."""
        body = interleaved_glb()
        self._uploaded.append(hashlib.sha256(body).hexdigest())
        while True:
            await self._call("POST", "/v1/objects", body, {"Content-Type": "model/gltf-binary"})

    async def final_composites(self) -> None:
        """Request composites of the quality `final`, with a glass sphere, in four sessions."""
        place = {"shape": "sphere", "size_m": 0.3, "position": self._point, "material": {"kind": "glass"}}
        body = json.dumps({"objects": [place], "quality": "final"}).encode()

        async def repeat(session: str) -> None:
            await self._fill(session, 120)
            while True:
                await self._call("POST", f"/v1/sessions/{session}/composite", body, _JSON)

        await self._all(repeat(f"final{number}") for number in range(4))

    async def many_sessions(self) -> None:
        """Open 10,000 sessions."""

        async def repeat(worker: int) -> None:
            for number in range(10_000):
                await self._open(f"many{worker}-{number}")

        await self._all(repeat(worker) for worker in range(8))

    async def _fill(self, session: str, height: int) -> None:
        await self._open(session, height)
        for index, body in enumerate(self._bodies):
            await self._call("PUT", f"/v1/sessions/{session}/frames/{index}", body, _FRAME)

    async def end(self) -> None:
        """Delete the sessions and objects that were made."""
        for digest in self._uploaded:
            await self._call("DELETE", f"/v1/objects/{digest}", b"", {})
        for session in sorted(self._opened):
            await self._call("DELETE", f"/v1/sessions/{session}", b"", {})

    async def _open(self, session: str, height: int = 120) -> None:
        body = json.dumps({"model": "classical", "height": height, "reference_exposure": 1.0}).encode()
        if await self._call("PUT", f"/v1/sessions/{session}", body, _JSON) == "201":
            self._opened.add(session)

    def _light_request(self, points: int, *forms: dict[str, Any]) -> bytes:
        x, y, z = self._point
        probes = [{"position": [x, y + 0.005 * number, z]} for number in range(points)]
        return json.dumps({"probes": probes, "forms": list(forms)}).encode()

    def _with_colour(self, encoding: str, data: bytes) -> bytes:
        """Return the first frame with another image file, of 4032 x 3024 pixels."""
        message = parse(self._bodies[0], FrameLimits())
        header = message.header.model_dump(exclude_none=True)
        scale = 4032 / header["intrinsics"]["width"]
        header["intrinsics"] |= {"width": 4032, "height": 3024}
        for name in ("fx", "fy", "cx", "cy"):
            header["intrinsics"][name] *= scale
        header["colour"] = {"encoding": encoding, "bytes": len(data)}
        checked = FrameHeader.model_validate_json(json.dumps(header))
        planes = (None if part is None else bytes(part) for part in (message.depth, message.confidence))
        return pack(checked, data, *planes)

    async def _connect(self, address: str = ADDRESS) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection("127.0.0.1", self._port, local_addr=(address, 0))

    def _request(self, method: str, path: str, body: bytes, headers: dict[str, str]) -> bytes:
        given = {"Host": "localhost", "Authorization": f"Bearer {self._token}", "Content-Length": str(len(body))}
        lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in (given | headers).items())]
        return "\r\n".join([*lines, "Connection: close", "", ""]).encode() + body

    async def _call(self, method: str, path: str, body: bytes, headers: dict[str, str]) -> str:
        """Send a request on a new connection, read and drop the answer, and return its status."""
        status = ""
        try:
            reader, writer = await self._connect()
            try:
                writer.write(self._request(method, path, body, headers))
                await writer.drain()
                status = self._count(await reader.read(12))
                while await reader.read(2**20):
                    pass
            finally:
                writer.close()
        except OSError:
            status = self._count(b"")
            await asyncio.sleep(0.05)
        return status

    def _count(self, head: bytes) -> str:
        self.requests += 1
        match = re.match(rb"HTTP/1\.1 (\d+)", head)
        status = match[1].decode() if match else "closed"
        self.answers[status] += 1
        return status

    @staticmethod
    async def _all(work: Iterable[Coroutine[Any, Any, None]]) -> None:
        async with asyncio.TaskGroup() as tasks:
            for coroutine in work:
                tasks.create_task(coroutine)


ATTACKS: Final[dict[str, Callable[[Hostile], Awaitable[None]]]] = {
    "decode-bombs": Hostile.decode_bombs,
    "large-headers": Hostile.large_headers,
    "refused-bodies": Hostile.refused_bodies,
    "idle-connections": partial(Hostile.idle_connections, hold=1100, every_s=0.002),
    "hung-up-posts": Hostile.hung_up_posts,
    "large-answers": Hostile.large_answers,
    "tall-probes": Hostile.tall_probes,
    "unread-messages": Hostile.unread_messages,
    "many-sessions": Hostile.many_sessions,
    "glb-bombs": Hostile.glb_bombs,
    "tls-handshakes": partial(Hostile.idle_connections, hold=1400, every_s=0.0),
    "tls-handshakes-slow": partial(Hostile.idle_connections, hold=1400, every_s=0.02, data=CLIENT_HELLO),
    "final-composites": Hostile.final_composites,
    **{
        f"{name}{suffix}": partial(Hostile.flood, name=name, bytes_per_s=rate)
        for name in FLOODS
        for suffix, rate in (("", None), ("-slow", SLOW_BYTES_PER_S))
    },
}
"""The attacks by name."""
TLS_ATTACKS: Final = ("tls-handshakes", "tls-handshakes-slow")
"""Attacks on a server with HTTPS."""


def _slow_jpeg(scans: int) -> bytes:
    """Return a progressive JPEG of 4032 x 3024 pixels whose last scan is repeated; it takes seconds to decode."""
    image = np.random.default_rng(scans).integers(0, 64, (189, 252, 3), np.uint8)
    image = cv2.resize(image, (4032, 3024), interpolation=cv2.INTER_LINEAR)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_QUALITY, 60])[1].tobytes()
    starts = [match.start() for match in re.finditer(b"\xff\xda", data)]
    return data[:-2] + data[starts[-1] : -2] * (scans - len(starts)) + b"\xff\xd9"


def _slow_png() -> bytes:
    """Return a PNG of 4032 x 3024 pixels with 500 compressed texts of 8 MB each."""
    data = cv2.imencode(".png", np.zeros((3024, 4032, 3), np.uint8))[1].tobytes()
    text = b"zTXt" + b"a\0\0" + zlib.compress(bytes(8_000_000), 9)
    chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
    after_header = 33  # signature and IHDR
    return data[:after_header] + 500 * chunk + data[after_header:]


async def _attack(hostile: Hostile, name: str, seconds: float) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await ATTACKS[name](hostile)
    with suppress(TimeoutError):
        async with asyncio.timeout(_END_S):
            await hostile.end()


def main() -> None:
    """Run one attack; see the module."""
    order = json.load(sys.stdin)
    hostile = Hostile(order["port"], order["token"], order["attack"])
    sys.stdout.write("begins\n")
    sys.stdout.flush()
    start_s = time.perf_counter()
    asyncio.run(_attack(hostile, order["attack"], order["seconds"]))
    seconds = time.perf_counter() - start_s
    json.dump({"requests": hostile.requests, "answers": hostile.answers, "seconds": seconds}, sys.stdout)


if __name__ == "__main__":
    main()
