"""Streams and pushes whose server is killed under them, and started again on the same port; both clients."""

import asyncio
import threading
from typing import Any

import pytest
from either_client import client_of
from server_process import ServerProcess

import roomlight_client as sdk
from http_servers import InThread, wait_until
from roomlight.engine.session import Session, SessionOptions
from roomlight_client import Client, Retry
from rooms import BoxRoom, pan

pytestmark = pytest.mark.slow

FRAMES = tuple(pan(BoxRoom(lamp=((0.5, 3.0, 0.3), 0.3)), 4, width=64, height=48))
POINT = (0.4, 1.2, -0.3)
SMALL: dict[str, Any] = {"model": "classical", "height": 16}
PATIENT = Retry(attempts=400, first_delay_s=0.05, max_delay_s=0.25)


@pytest.fixture(scope="module")
def server():
    with ServerProcess() as running:
        yield running


class Waiting:
    """Values that arrive in another thread or task; `until` waits for one of them."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self._changed = threading.Condition()

    def __call__(self, value: Any) -> None:
        with self._changed:
            self.values.append(value)
            self._changed.notify_all()

    def until(self, condition) -> Any:
        with self._changed:
            assert self._changed.wait_for(lambda: any(map(condition, self.values)))
            return next(value for value in self.values if condition(value))


def test_a_blocking_stream_survives_a_killed_server(server):
    statuses = Waiting()
    with Client(server.url, reconnect=PATIENT) as client:
        session = client.open(**SMALL)
        with session.stream(on_status=statuses) as stream:
            stream.track("table", POINT)
            assert stream.push(FRAMES[0]).status == "processed"
            server.kill()
            statuses.until(lambda status: status.state == "reconnecting")
            waiting = [stream.submit(frame) for frame in FRAMES[1:3]]
            server.start()
            assert [future.result().status for future in waiting] == ["processed", "processed"]
            assert stream.light_at("table").coverage > 0
            assert session.state().frames.processed == 3
        session.close()
        with pytest.raises(sdk.GoneError):
            session.stream()


def test_pushes_survive_a_killed_server(server):
    async def main():
        async with (
            client_of("sync", server.url, reconnect=PATIENT) as blocking,
            client_of("async", server.url, reconnect=PATIENT) as client,
        ):
            sessions = [await one.open(**SMALL) for one in (blocking, client)]
            for session in sessions:
                await session.track("table", POINT)
                await session.push(FRAMES[0])
            await asyncio.to_thread(server.kill)
            starting = asyncio.create_task(asyncio.to_thread(server.start))
            results = await asyncio.gather(*(session.push(FRAMES[1]) for session in sessions))
            await starting
            assert [(result.index, result.status) for result in results] == [(1, "processed")] * 2
            for session in sessions:
                assert (await session.light_at("table")).coverage > 0
                assert (await session.state()).frames.processed == 2
                await session.close()

    asyncio.run(main())


def test_a_missing_session_is_opened_again_by_any_call(server):
    with Client(server.url, reconnect=PATIENT) as client:
        session = client.open(**SMALL)
        session.track("table", POINT)
        session.push(FRAMES[0])
        joined = client.join(session.id)
        server.restart()
        with pytest.raises(sdk.GoneError):  # it did not open the session
            joined.light_at("table")
        assert session.light_at("table").frame == 0
        assert joined.light_at("table").frame == 0
        session.close()


# --- a server with a state directory ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def uninterrupted():
    """The light of the engine in this process after all frames."""
    session = Session(SessionOptions(model="classical", height=16))
    handle = session.track(POINT)
    for frame in FRAMES:
        session.push(frame)
    return session.light(handle).panorama


@pytest.mark.parametrize("way", ["stream", "pushes"])
def test_light_after_a_kill_is_that_without_one(tmp_path, uninterrupted, way):
    statuses = Waiting()
    with ServerProcess(state_dir=tmp_path / "state") as server, Client(server.url, reconnect=PATIENT) as client:
        session = client.open(**SMALL, reference_exposure=1.0)
        session.track("table", POINT)
        if way == "stream":
            with session.stream(on_status=statuses) as stream:
                for number, frame in enumerate(FRAMES):
                    assert stream.push(frame).index == frame.index
                    if number in (0, 2):
                        until_saved(session, frame.index)
                        opened = count_open(statuses)
                        server.restart()
                        statuses.until(lambda _, before=opened: count_open(statuses) > before)
        else:
            for number, frame in enumerate(FRAMES):
                starting = None
                if number in (1, 3):
                    until_saved(session, FRAMES[number - 1].index)
                    server.kill()
                    starting = InThread(server.start)
                session.push(frame)
                if starting is not None:
                    starting.result()
        assert (session.light_at("table").panorama == uninterrupted).all()
        assert not any(status.reopened or status.incomplete for status in statuses.values)
        assert session.state().frames.processed == len(FRAMES)
        session.close()


def until_saved(session, index):
    """Ask until the frame is on disk."""
    wait_until(lambda: session.state().frames.durable_index == index)


def count_open(statuses: Waiting) -> int:
    return sum(status.state == "open" for status in statuses.values)
