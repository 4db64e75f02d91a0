"""Malformed and hostile requests over a real socket: they are rejected with a reason and change nothing."""

import asyncio
import http.client
import json
import random
import struct
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import zstandard
from numpy.typing import DTypeLike
from starlette.exceptions import HTTPException

from http_servers import RunningServer, answer_of, box_shot, build, frame, header_of, parts_of, with_parts
from roomlight.wire.frame_message import column_major
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.settings import ServerSettings
from roomlight_server.routes import bodies

LIMIT = 2**18


@pytest.fixture(scope="module")
def server():
    with RunningServer(max_body_bytes=LIMIT, max_colour_pixels=10**6) as running:
        running.open()
        running.push(0)
        probe_tag(running)
        yield running


def jpeg():
    return cv2.imencode(".jpg", np.full((36, 48, 3), 90, np.uint8))[1].tobytes()


def depth_png(value=1500, dtype: DTypeLike = np.uint16, shape=(36, 48)):
    return cv2.imencode(".png", np.full(shape, value, dtype))[1].tobytes()


def pose(**rows):
    matrix = box_shot(0).camera_to_world.copy()
    for name, values in rows.items():
        matrix[int(name[3:])] = values
    return column_major(matrix)


PNG_MM = {"format": "uint16_mm", "encoding": "png"}
SIZE = {"width": 48, "height": 36}
LENS = {"fx": 30.0, "fy": 30.0, "cx": 24.0, "cy": 18.0, **SIZE}
HUGE = LENS | {"fx": 9e3, "fy": 9e3, "width": 16384, "height": 12288}

HOSTILE = {
    "cut off": (frame()[:-1], 422, None),
    "an image of 201 megapixels": (with_parts(intrinsics=HUGE), 413, "intrinsics"),
    "a cut JPEG": (with_parts(({"encoding": "jpeg"}, jpeg()[:-40])), 422, "colour"),
    "NaN in linear light": (
        with_parts(({"encoding": "linear_f32"}, np.full(48 * 36 * 3, np.nan, "<f4").tobytes() + bytes(48 * 36))),
        422, "colour",
    ),
    "negative light": (
        with_parts(({"encoding": "linear_f32"}, np.full(48 * 36 * 3, -1, "<f4").tobytes() + bytes(48 * 36))),
        422, "colour",
    ),
    "a zstd frame with a huge window": (
        with_parts(depth=({"encoding": "zstd"}, b"\x28\xb5\x2f\xfd\x00\xff" + bytes(40))), 422, "depth",
    ),
    "zstd that breaks off": (
        with_parts(depth=({"encoding": "zstd"}, zstandard.ZstdCompressor().compress(parts_of(box_shot(0))[1])[:-9])),
        422, "depth",
    ),
    "confidence of 16 bits": (with_parts(confidence=({"encoding": "png"}, depth_png(2))), 422, "confidence"),
    "another index in the header": (frame(index=77), 422, "index"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_frame_is_rejected_and_changes_nothing(server, name):
    body, status, field = HOSTILE[name]
    before, tag = server.state(), probe_tag(server)
    answer = server.push(5, body)
    assert (answer.status, answer.json.get("field")) == (status, field), answer.json
    assert answer.kind in ("bad-frame", "too-large")
    assert answer.json["detail"]
    assert len(answer.body) < 2000
    after = server.state()
    assert after["frames"].pop("refused") == before["frames"].pop("refused") + 1
    assert after == before
    assert probe_tag(server) == tag


def probe_tag(server):
    return server.call("GET", "/v1/sessions/room/probe?x=0.2&y=1.2&z=-0.2&format=sh").headers["etag"]


@pytest.mark.parametrize("index", ["-1", "x", "1.5", "9007199254740992", "1e3", "%00", "0x1"])
def test_an_index_must_be_an_integer(server, index):
    answer = server.call("PUT", f"/v1/sessions/room/frames/{index}", frame())
    assert (answer.status, answer.json["field"]) == (422, "index")


def test_a_body_over_the_limit_is_rejected_also_if_chunked(server):
    declared = server.push(6, bytes(LIMIT + 1))
    assert (declared.status, declared.kind) == (413, "too-large")
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    chunks = (bytes(2**16) for _ in range(LIMIT // 2**16 + 1))
    connection.request(
        "PUT", "/v1/sessions/room/frames/6", chunks, encode_chunked=True, headers={"Transfer-Encoding": "chunked"}
    )
    streamed = connection.getresponse()
    assert streamed.status == 413
    assert json.loads(streamed.read())["type"].endswith("too-large")
    connection.close()


def half_a_frame(server):
    body = frame()
    raw = server.dial()
    raw.sendall(
        b"PUT /v1/sessions/room/frames/8 HTTP/1.1\r\nHost: 127.0.0.1\r\n"
        + f"Content-Length: {len(body)}\r\n\r\n".encode()
        + body[: len(body) // 2]
    )
    return raw


def test_a_body_that_stops_arriving_is_answered_with_408():
    with RunningServer(body_timeout_s=0.5) as server:
        server.open()
        with half_a_frame(server) as raw:
            answer = answer_of(raw)
        assert (answer.status, answer.kind) == (408, "body-timeout")


@pytest.mark.parametrize(
    ("first_bytes", "piece_bytes", "status"), [(2**20, 2**20, 200), (2**16, 2**16, 408), (2**24, 1, 408)]
)
def test_a_body_may_take_long_while_it_brings_enough(first_bytes, piece_bytes, status, monkeypatch):
    """An object of 15 MB was refused where the network sent less than 0.5 MB a second."""
    now_s, sent = 0.0, []

    async def receive():
        nonlocal now_s
        now_s += 20.0
        await asyncio.sleep(0)
        n_bytes = first_bytes if now_s == 20.0 else piece_bytes
        return {"type": "http.request", "body": bytes(n_bytes), "more_body": now_s < 600}

    async def read_all(_scope, receive, _send):
        status = 200
        try:
            while (await receive())["more_body"]:
                pass
        except HTTPException as error:
            status = error.status_code
        sent.append(status)

    monkeypatch.setattr(bodies, "time", SimpleNamespace(monotonic=lambda: now_s, perf_counter=lambda: now_s))
    middleware = bodies.BodyMiddleware(read_all, settings=ServerSettings(), metrics=Metrics())
    scope = {"type": "http", "method": "POST", "path": bodies.OBJECTS_PATH, "headers": []}
    asyncio.run(middleware(scope, receive, Mock()))
    assert sent == [status]


def test_a_disconnected_client_frees_its_frame_slot(server):
    for _ in range(10):  # more than there are slots
        half_a_frame(server).close()
    assert server.push(0).json["replay"]
    assert server.state()["frames"]["last_index"] == 0


STRANGE = {
    "two by two pixels": build(
        header_of(box_shot(0))
        | {
            "colour": {"encoding": "rgb8", "bytes": 12},
            "depth": {"format": "float32_m", "width": 2, "height": 2, "bytes": 16},
            "intrinsics": {"fx": 2.0, "fy": 2.0, "cx": 1.0, "cy": 1.0, "width": 2, "height": 2},
        },
        bytes(12),
        np.full(4, 1.5, "<f4").tobytes(),
    ),
    "a ribbon": build(
        header_of(box_shot(0))
        | {
            "colour": {"encoding": "rgb8", "bytes": 3 * 640 * 5},
            "depth": {"format": "float32_m", "width": 256, "height": 2, "bytes": 4 * 512},
            "intrinsics": {"fx": 500.0, "fy": 5.0, "cx": 320.0, "cy": 2.5, "width": 640, "height": 5},
        },
        bytes(3 * 640 * 5),
        np.full(512, 1.5, "<f4").tobytes(),
    ),
    "the longest lens": with_parts(intrinsics=LENS | {"fx": 4800.0, "fy": 3600.0}),
    "the shortest lens": with_parts(intrinsics=LENS | {"fx": 0.48, "fy": 0.36}),
    "far from the origin": with_parts(
        camera_to_world=pose(row0=[1, 0, 0, 9999.0], row1=[0, 1, 0, 0], row2=[0, 0, 1, 0])
    ),
    "one pixel at the edge of numbers": with_parts(
        depth=({}, np.r_[np.full(48 * 36 - 2, 1.5), 3e38, 1e-38].astype("<f4").tobytes())
    ),
    "light as bright as numbers go": with_parts(
        ({"encoding": "linear_f32"}, np.full(48 * 36 * 3, 3e38, "<f4").tobytes() + bytes(48 * 36))
    ),
    "darkness": with_parts(({}, bytes(48 * 36 * 3))),
    "the longest exposure": with_parts(exposure=1e6),
    "the shortest exposure": with_parts(exposure=1e-6),
    "one pixel of depth": with_parts(depth=({}, np.r_[1.5, np.zeros(48 * 36 - 1)].astype("<f4").tobytes())),
}


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("name", STRANGE)
def test_an_extreme_frame_never_breaks_a_session(server, name, first):
    session = f"{name.replace(' ', '-')}-{first}"
    server.open(session)
    if not first:
        assert server.push(0, name=session).status == 200
    answer = server.push(1, STRANGE[name], name=session)
    assert answer.status in (200, 422), answer.json
    assert server.push(2, frame(10), name=session).status == 200
    light = server.call("GET", f"/v1/sessions/{session}/probe?x=0.2&y=1.2&z=-0.2&format=main_light")
    assert light.status == 200
    assert np.isfinite(light.json["intensity"]).all()
    assert server.call("DELETE", f"/v1/sessions/{session}").status == 204


def seeds():
    compress = zstandard.ZstdCompressor().compress
    yield frame()
    yield with_parts(({"encoding": "jpeg"}, jpeg()), (PNG_MM, depth_png()))
    yield with_parts(
        ({"encoding": "png"}, cv2.imencode(".png", np.full((36, 48, 3), 90, np.uint8))[1].tobytes()),
        ({"encoding": "zstd"}, compress(parts_of(box_shot(0))[1])),
        ({"encoding": "zstd"}, compress(bytes([2]) * (48 * 36))),
    )


def mutated(body, rng):
    """Return the message with a few bytes changed, dropped or repeated, or with one value of its header replaced."""
    body = bytearray(body)
    length = struct.unpack_from("<I", body, 4)[0]
    kind = rng.randrange(4)
    if kind == 0:
        for _ in range(rng.randint(1, 8)):
            body[rng.randrange(len(body))] = rng.randrange(256)
    elif kind == 1:
        at = rng.randrange(len(body))
        del body[at : at + rng.randint(1, 64)]
    elif kind == 2:
        at = rng.randrange(len(body))
        body[at:at] = body[at : at + rng.randint(1, 64)]
    else:
        header = json.loads(body[8 : 8 + length])
        place, name = header, rng.choice(list(header))
        if isinstance(header[name], dict):
            place, name = header[name], rng.choice(list(header[name]))
        elif isinstance(header[name], list):
            place, name = header[name], rng.randrange(16)
        odd = [0, -1, 1, 2, 1e-9, 1e9, 1e300, -0.0, float("nan"), float("inf"), None, "", "raw", [], {}, True, 2**64]
        place[name] = rng.choice(odd)
        return build(header, bytes(body[8 + length :]))
    return bytes(body)


def test_mutated_frames_never_break_a_session(server):
    name, count = "fuzzed", 150
    server.open(name)
    rng, bodies = random.Random(7), list(seeds())
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    index, counts = 0, {}
    for number in range(count):
        connection.request("PUT", f"/v1/sessions/{name}/frames/{index}", mutated(bodies[number % 3], rng))
        answer = connection.getresponse()
        content = json.loads(answer.read())
        counts[answer.status] = counts.get(answer.status, 0) + 1
        assert answer.status in (200, 413, 422), content
        index += answer.status == 200
    connection.close()
    frames = server.state(name)["frames"]
    assert (frames["accepted"], frames["refused"]) == (counts[200], counts[422] + counts.get(413, 0))
    assert counts[422] > count / 2
    assert server.state(name)["status"] == "open"
    assert server.push(index, name=name).json["status"] == "processed"
