"""Both clients against the real server over a real socket."""

import asyncio
import textwrap
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from either_client import client_of

import roomlight_client as sdk
from http_servers import TETRAHEDRON, HeldSession, RunningServer
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ObjectError, WireError
from roomlight.images import decode_colour
from roomlight_client import CameraFrame, Client, Retry, _waiting
from rooms import BoxRoom, camera_at, pan
from written_captures import write_capture

ROOM = BoxRoom(lamp=((0.5, 3.0, 0.3), 0.3))
FRAMES = tuple(pan(ROOM, 3, width=64, height=48))
POINTS = ((0.4, 1.2, -0.3), (-0.8, 1.0, 0.6))
SMALL: dict[str, Any] = {"model": "classical", "height": 16}
BOTH = pytest.mark.parametrize("kind", ["sync", "async"])


@pytest.fixture(scope="module")
def server():
    with RunningServer(model="classical") as running:
        yield running


def url_of(running):
    return f"http://127.0.0.1:{running.port}"


def run(server, kind, work, **options):
    async def main():
        async with client_of(kind, url_of(server), **options) as client:
            return await work(client)

    return asyncio.run(main())


@pytest.fixture(scope="module")
def direct():
    """The engine in this process: the light of a tracked probe, and of another point at the end."""
    session = Session(SessionOptions(model="classical", height=16))
    handle = session.track(POINTS[0])
    for frame in FRAMES:
        session.push(frame)
    return session.light(handle), session.light_at(POINTS[1])


@BOTH
def test_the_clients_light_equals_the_engines_bit_for_bit(server, kind, direct):
    forms = ("npy", "main_light", "confidence")

    async def work(client):
        session = await client.open(**SMALL)
        await session.track("table", POINTS[0])
        results = [await session.push(frame) for frame in FRAMES]
        lights = await session.lights_at(["table", POINTS[1]], forms)
        again = await session.light_at("table")
        state = await session.state()
        await session.untrack("table")
        with pytest.raises(sdk.GoneError) as gone:
            await session.light_at("table")
        await session.close()
        return results, lights, again, state, gone.value

    results, lights, again, state, gone = run(server, kind, work)
    assert [(result.index, result.status) for result in results] == [(n, "processed") for n in range(3)]
    assert state.frames.processed == 3
    assert gone.kind == "probe-not-found"
    for light, expected in zip(lights, direct, strict=True):
        assert (light.panorama == expected.panorama).all()
        assert light.coverage == expected.coverage
        assert light.position == expected.position
        assert light.observed == pytest.approx(expected.observed, abs=0.5 / 255 + 1e-6)
        assert light.main_light.to_json() == expected.main_light.to_json()
        assert light.frame == expected.frame == 2
    assert lights[0].name == "table"
    assert (again.panorama == lights[0].panorama).all()
    assert again.etag == lights[0].etag


@BOTH
def test_camera_frames_are_numbered(server, kind):
    shot = FRAMES[0]
    camera = CameraFrame(linear_to_srgb8(shot.image), shot.depth_m, shot.intrinsics, shot.camera_to_world)

    async def work(client):
        session = await client.open("phone-" + kind, **SMALL)
        first = await session.push(camera)
        limited = await session.push(replace(camera, tracking_state="limited"))
        joined = await client.join("phone-" + kind)
        third = await joined.push(replace(camera, exposure=2.0))
        repeated = await joined.push(replace(camera, exposure=2.0), third.index)
        with pytest.raises(sdk.ConflictError) as conflict:
            await joined.push(camera, third.index)
        queued = await joined.push(camera, wait=False)
        state = await joined.state()
        await joined.close()
        await session.close()  # once more does no harm
        with pytest.raises(sdk.GoneError):
            await client.join("phone-" + kind)
        return [first, limited, third, repeated, queued], conflict.value, state

    results, conflict, state = run(server, kind, work)
    assert [result.index for result in results] == [0, 1, 2, 2, 3]
    assert [result.status for result in results][:4] == ["processed", "skipped", "processed", "processed"]
    assert results[3].replay
    assert results[4].status in ("queued", "processed")
    assert (conflict.kind, conflict.field, conflict.value) == ("frame-conflict", "index", "2")
    assert state.frames.replayed == 1


def test_a_frame_with_a_lost_answer_is_processed_once(monkeypatch):
    """The connection breaks while the engine processes the frame; a later attempt gets the same result."""
    HeldSession.serve(monkeypatch)
    pushing, released = [], []

    def wait(_):
        if pushing and HeldSession.entered.acquire(timeout=0.1):
            HeldSession.release()
            released.append(True)

    with RunningServer(model="classical") as running, Client(url_of(running)) as patient:
        patient.open("room", **SMALL)
        # many attempts: on a busy machine a frame and its answer may take longer than the timeout
        impatient = Client(url_of(running), timeouts=sdk.Timeouts(read_s=0.3), retry=Retry(attempts=1000))
        monkeypatch.setattr(_waiting, "wait", wait)
        with impatient as client:
            session = client.join("room")
            pushing.append(True)
            result = session.push(FRAMES[0])
        counts = patient.join("room").state().frames
    assert released == [True]
    assert result.status == "processed"
    assert result.replay
    assert result.keyframe
    assert (counts.processed, counts.accepted) == (1, 1)
    assert counts.replayed >= 1


def test_an_unreachable_server_names_the_command():
    with RunningServer(model="classical") as running:
        url = url_of(running)
    with Client(url, retry=Retry(attempts=1)) as client, pytest.raises(sdk.UnreachableError, match="roomlight serve"):
        client.open()


def test_the_example_of_the_package_runs(server, tmp_path, monkeypatch, capsys):
    text = sdk.__doc__ or ""
    block = textwrap.dedent(text[text.index("    import roomlight") : text.index("`AsyncClient` has")])
    assert sum(bool(line.strip()) for line in block.splitlines()) <= 11
    write_capture(tmp_path / "my-capture", [ROOM.frame(camera_at((0.2, 1.4, 1.2)), width=64, height=48)])
    monkeypatch.chdir(tmp_path)
    exec(compile(block.replace("http://localhost:8090", url_of(server)), "example", "exec"), {})
    assert "(120, 240, 3)" in capsys.readouterr().out


@pytest.mark.slow
@BOTH
def test_objects_are_uploaded_and_composited(server, kind, tmp_path):
    file = tmp_path / "tetra.obj"
    file.write_bytes(TETRAHEDRON)
    ahead = FRAMES[0].camera_to_world @ [0, 0, -1.2, 1]

    async def work(client):
        held = await client.upload(file)
        assert await client.upload(TETRAHEDRON, "obj", session_id="room") == held
        session = await client.open(**SMALL)
        place = {"object": held.id, "size_m": 0.4, "position": tuple(ahead[:3].tolist()), "name": "tetra"}
        with pytest.raises(sdk.ConflictError, match="no processed frame"):
            await session.composite([place])
        await session.push(FRAMES[0])
        with pytest.raises(WireError, match="size_m"):
            await session.composite([place | {"size_m": -1.0}])
        with pytest.raises(sdk.InvalidError, match="behind the camera"):
            await session.composite([place | {"position": (FRAMES[0].camera_to_world @ [0, 0, 3, 1])[:3].tolist()}])
        made = await session.composite([place])
        await client.delete_object(held.id)
        await client.delete_object(held.id)
        with pytest.raises(sdk.GoneError):
            await session.composite([place])
        assert held.id not in [one.id for one in (await client.objects()).objects]
        return made

    made = run(server, kind, work, retry=Retry(attempts=1))
    assert 0 < made.visible["tetra"] <= 1
    assert (made.media_type, made.frame, list(made.poses)) == ("image/png", FRAMES[0].index, ["tetra"])
    made.save(tmp_path / "made.png")
    image, _ = decode_colour((tmp_path / "made.png").read_bytes(), "made")
    assert image.shape == FRAMES[0].image.shape
    assert np.abs(image - np.clip(FRAMES[0].image, 0, 1)).max() > 0.05


def test_a_missing_object_file_is_named(server, tmp_path):
    with Client(url_of(server)) as client, pytest.raises(ObjectError, match=r"nothing\.glb"):
        client.upload(tmp_path / "nothing.glb")
