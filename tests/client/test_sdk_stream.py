"""Streams against a scripted WebSocket: what is sent again after a lost connection, and what is not."""

import asyncio
import json
import queue
from typing import Any
from unittest import mock

import httpx
import pytest
from sdk_scripts import STATE, problem
from websockets.asyncio.server import serve

import roomlight_client as sdk
from present import present
from roomlight.errors import OptionError, RoomLightError
from roomlight.wire.frame_message import parse
from roomlight.wire.light_message import pack_light
from roomlight.wire.messages import FrameResult, LightingUpdate
from roomlight_client import AsyncClient, BufferLimits, Client, Retry, _waiting
from roomlight_client.memory import FrameBuffer
from roomlight_client.recovery import is_server_lost
from rooms import BoxRoom, pan

FRAMES = tuple(pan(BoxRoom(), 4, width=16, height=12))


class Room:
    """A server with one session that a test can lose, cut off and make silent."""

    def __init__(self) -> None:
        self.exists, self.last_index, self.probes = True, None, {}
        self.log: list[str] = []
        self.waits_s: list[float] = []
        self.statuses: list[sdk.StreamStatus] = []
        self.problems: list[sdk.RemoteError] = []
        self.lights: list[list[sdk.Light]] = []
        self.refuse: httpx.Response | None = None
        self.silent: set[int] = set()
        self.ignored: set[str] = set()
        self.answers: dict[int, list[Any]] = {}
        self.sockets: list[Any] = []
        self._changed = asyncio.Condition()

    def lose(self) -> None:
        self.exists, self.last_index, self.probes = False, None, {}

    @property
    def states(self) -> list[str]:
        return [status.state for status in self.statuses]

    def _respond(self, request: httpx.Request) -> httpx.Response:
        path = request.url.path.replace("/v1/sessions/room", "")
        self.log.append(f"{request.method} {path}".strip())
        if self.refuse is not None and request.method != "DELETE":
            return httpx.Response(self.refuse.status_code, headers=self.refuse.headers, content=self.refuse.content)
        if request.method == "DELETE" and path == "":
            self.refuse = None
            self.lose()
            return httpx.Response(204)
        if request.method == "PUT" and path == "":
            self.exists = True
        elif not self.exists:
            return problem(404, "session-not-found")
        frames = STATE["frames"] | {"last_index": self.last_index}
        return httpx.Response(200, json=STATE | {"frames": frames, "probes": self.probes})

    async def _serve(self, socket) -> None:
        self.sockets.append(socket)
        if not self.exists:
            await socket.close(4404, "session-not-found")
        async for data in socket:
            if isinstance(data, bytes):
                index = present(parse(data).header.index)
                await self._note(f"frame {index}")
                await self._frame(socket, index)
                continue
            message = json.loads(data)
            await self._note(" ".join([message["type"], message.get("name", "")]).strip())
            if message["type"] in ("track", "untrack") and message["name"] not in self.ignored:
                self.probes.pop(message["name"], None)
                if message["type"] == "track":
                    self.probes[message["name"]] = message["position"]
                await socket.send(json.dumps({"type": "probes", "probes": self.probes}))

    async def _frame(self, socket, index: int) -> None:
        scripted = self.answers.get(index, [])
        answer = scripted.pop(0) if scripted else {"type": "frame", "index": index, "status": "processed"}
        if answer == "cut":
            return await self.cut(index)
        if answer == "cut unseen":
            return await self.cut(None)
        if not (isinstance(answer, dict) and "problem" in answer):
            self.last_index = max(index, -1 if self.last_index is None else self.last_index)
        if index not in self.silent:
            await socket.send(answer if isinstance(answer, bytes) else json.dumps(answer))
        return None

    async def cut(self, accepted: int | None = None) -> None:
        """End the connection without a word."""
        if accepted is not None:
            self.last_index = accepted
        self.sockets[-1].transport.abort()

    async def _note(self, entry: str) -> None:
        async with self._changed:
            self.log.append(entry)
            self._changed.notify_all()

    async def logged(self, entry: str, count: int = 1) -> None:
        async with self._changed:
            await self._changed.wait_for(lambda: self.log.count(entry) >= count)

    async def until(self, state: str, count: int = 1) -> None:
        async with self._changed:
            await self._changed.wait_for(lambda: self.states.count(state) >= count)

    def status(self, status: sdk.StreamStatus) -> None:
        self.statuses.append(status)
        self._later = asyncio.ensure_future(self._notify())

    async def _notify(self) -> None:
        async with self._changed:
            self._changed.notify_all()

    async def wait(self, seconds: float) -> None:
        self.waits_s.append(seconds)
        await asyncio.sleep(0)


def play(work, **options: Any) -> Room:
    """Run `work(room, session, stream)` with a stream to a scripted server."""

    async def main() -> Room:
        room = Room()
        options.setdefault("reconnect", Retry(attempts=5, first_delay_s=1.0, max_delay_s=3.0))
        async with serve(room._serve, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            client = AsyncClient(f"http://127.0.0.1:{port}", transport=httpx.MockTransport(room._respond), **options)
            with mock.patch.multiple(_waiting, wait_async=room.wait, jitter=lambda: 1.0):
                async with client:
                    session = await client.open("room")
                    handlers = {"on_status": room.status, "on_problem": room.problems.append}
                    async with await session.stream(**handlers, on_lighting=room.lights.append) as stream:
                        await work(room, session, stream)
        return room

    return asyncio.run(main())


def frames_of(room: Room) -> list[str]:
    return [entry for entry in room.log if entry.startswith("frame")]


def test_a_lost_connection_is_resumed_and_nothing_sent_twice():
    async def work(room, _, stream):
        await stream.track("table", (1.0, 2.0, 3.0))
        await stream.subscribe("sh")  # by itself, it is one form
        await stream.push(FRAMES[0])
        room.answers[1] = ["cut"]
        lost = await stream.push(FRAMES[1])
        assert (lost.index, lost.status, lost.replay) == (1, "queued", True)
        assert (await stream.push(FRAMES[2])).status == "processed"

    room = play(work)
    assert frames_of(room) == ["frame 0", "frame 1", "frame 2"]
    assert room.log.count("subscribe") == 2
    assert room.log.count("track table") == 1  # the session still has it
    assert room.states == ["connecting", "open", "reconnecting", "open", "closed"]
    assert not room.statuses[3].reopened


OTHERS = ("moved", "mine", "lamp", "shade")
ALL = ["track moved", "track removed"]


@pytest.mark.parametrize(
    ("kind", "left", "restored"),
    [("opened", OTHERS, ["untrack mine", *ALL]), ("joined", OTHERS, ["untrack mine"]), ("joined", (), ALL)],
)
def test_a_session_gets_changes_that_it_has_not_confirmed_and_those_of_others_stay(kind, left, restored):
    async def work(room, session, stream):
        if kind == "joined":
            session._recovery.memory.request = None
        for name in ("moved", "removed", "mine", "lamp"):
            await stream.track(name, (1.0, 2.0, 3.0))
        await room.logged("track lamp")
        await stream.untrack("lamp")
        await session.untrack("shade")
        await stream.push(FRAMES[0])
        room.ignored.add("mine")
        await stream.untrack("mine")
        await room.logged("untrack mine")
        room.ignored.clear()
        room.probes = {name: [4.0, 5.0, 6.0] for name in left}
        room.log.clear()
        room.refuse = httpx.Response(503)
        await room.cut()
        await room.until("reconnecting")
        await stream.track("new", (1.0, 2.0, 3.0))
        room.ignored.update(("mine", "moved", "removed", "new"))
        room.refuse = None
        await room.logged("track new")
        room.ignored.clear()
        await room.cut()  # before the server took them
        await room.logged("track new", 2)
        await stream.push(FRAMES[1])
        assert [entry for entry in room.log if entry != "GET"] == [*restored, "track new"] * 2 + ["frame 1"]

    play(work, reconnect=Retry(attempts=100_000, first_delay_s=0.0, max_delay_s=0.0))


def test_a_joined_session_gets_changes_over_http_once():
    async def work(room, session, stream):
        session._recovery.memory.request = None
        await stream.push(FRAMES[0])
        room.ignored.update(("lamp", "shade"))
        room.probes = {"shade": [4.0, 5.0, 6.0]}
        await stream.track("lamp", (1.0, 2.0, 3.0))
        await stream.untrack("shade")
        await room.logged("untrack shade")
        room.log.clear()
        for _ in range(2):  # the second time, others have changed both again
            await session._client.follow(session._recovery.restore())
        assert room.log == ["GET", "DELETE /probes/shade", "PUT /probes/lamp", "GET"]

    play(work)


def test_a_lost_session_gets_its_probes_and_frames_again():
    async def work(room, _, stream):
        await stream.track("table", (1.0, 2.0, 3.0))
        await stream.push(FRAMES[0])
        room.silent.add(1)
        unanswered = asyncio.create_task(stream.push(FRAMES[1]))
        await room.logged("frame 1")
        room.silent.clear()
        room.lose()
        room.log.clear()
        await room.cut()
        assert (await unanswered).status == "processed"
        assert room.log == ["GET", "PUT", "track table", "frame 0", "frame 1"]

    assert play(work).statuses[3].reopened


def test_lost_frames_are_sent_one_by_one():
    async def work(room, _, stream):
        for frame in FRAMES[:3]:
            await stream.push(frame)
        room.last_index = 0
        room.silent.add(1)
        await room.cut()
        newest = asyncio.create_task(stream.push(FRAMES[3]))
        await room.logged("frame 1", 2)
        assert frames_of(room)[3:] == ["frame 1"]  # the others wait for its answer
        await room.sockets[-1].send(json.dumps({"type": "frame", "index": 1, "status": "processed"}))
        assert (await newest).index == 3
        assert frames_of(room)[3:] == ["frame 1", "frame 2", "frame 3"]

    play(work)


def test_frames_without_a_connection_wait_in_a_bounded_buffer():
    async def work(room, _, stream):
        room.refuse = httpx.Response(503)
        await room.cut()
        await room.until("reconnecting")
        pushes = [asyncio.create_task(stream.push(frame)) for frame in FRAMES[:3]]
        with pytest.raises(sdk.UnreachableError, match="frame 0 was dropped: the buffer"):
            await pushes[0]
        room.refuse = None
        assert [result.index for result in await asyncio.gather(*pushes[1:])] == [1, 2]

    play(work, buffer=BufferLimits(frames=2), reconnect=Retry(attempts=100_000, first_delay_s=0.0, max_delay_s=0.0))


def test_delays_double_up_to_their_bound_and_attempts_end():
    async def work(room, _, stream):
        room.refuse = httpx.Response(502)
        await room.cut()
        await room.until("closed")
        with pytest.raises(sdk.BusyError):
            await stream.push(FRAMES[0])

    room = play(work, reconnect=Retry(attempts=4, first_delay_s=1.0, max_delay_s=3.0))
    assert room.waits_s == [1.0, 2.0, 3.0, 3.0]
    assert [status.attempt for status in room.statuses if status.state == "reconnecting"] == [1, 2, 3, 4]


def test_a_refusal_that_lasts_ends_the_stream_at_once():
    async def work(room, _, stream):
        room.refuse = problem(401, "unauthorized")
        await room.cut()
        await room.until("closed")
        assert isinstance(stream.status.error, sdk.UnauthorizedError)

    assert len(play(work).waits_s) == 1


def test_a_stream_of_a_missing_session_does_not_open():
    async def work(room, session, _):
        room.lose()
        with pytest.raises(sdk.GoneError):
            await session.stream()
        assert len(room.sockets) == 1

    play(work)


@pytest.mark.parametrize("end", ["delete", "other client", "failed"])
def test_a_deleted_foreign_or_failed_session_stays_closed(end):
    async def work(room, session, _):
        if end == "delete":
            await session.close()
        elif end == "other client":
            session._recovery.memory.request = None  # as after `join`
            room.lose()
        reason = "session-failed" if end == "failed" else "session-closed"
        await room.sockets[-1].close(4410, reason)
        await room.until("closed")
        assert room.log.count("PUT") == 1

    play(work)


def test_a_joined_session_that_was_only_saved_goes_on():
    async def work(room, session, stream):
        session._recovery.memory.request = None  # as after `join`
        await room.sockets[-1].close(4410, "session-closed")
        closed = {"type": "urn:roomlight:problem:session-closed", "title": "No", "status": 410, "detail": "idle"}
        room.answers[0] = [{"type": "problem", "problem": closed, "index": 0}]
        assert (await stream.push(FRAMES[0])).status == "processed"

    assert play(work).states.count("open") == 3


def test_a_frame_that_ends_each_connection_is_given_up():
    async def work(room, _, stream):
        room.answers[0] = ["cut unseen"] * 5
        with pytest.raises(sdk.UnreachableError, match="the connection ended 3 times"):
            await stream.push(FRAMES[0])

    assert frames_of(play(work)) == ["frame 0"] * 3


@pytest.mark.parametrize("kind", ["stopping", "session-moved"])
def test_a_frame_that_a_stopping_server_refuses_waits_for_the_next(kind):
    async def work(room, _, stream):
        refused = {"type": f"urn:roomlight:problem:{kind}", "title": "No", "status": 503, "detail": "no"}
        room.answers[0] = [{"type": "problem", "problem": refused, "index": 0}] * 4
        assert (await stream.push(FRAMES[0])).status == "processed"

    room = play(work)
    assert frames_of(room) == ["frame 0"] * 5
    assert room.problems == []
    assert room.waits_s == [1.0, 2.0, 3.0, 3.0]


def test_a_conflict_of_a_frame_sent_again_means_it_is_there():
    async def work(room, _, stream):
        conflict = {"type": "urn:roomlight:problem:frame-conflict", "title": "No", "status": 409, "detail": "older"}
        room.answers[0] = ["cut unseen", {"type": "problem", "problem": conflict, "index": 0}]
        assert (await stream.push(FRAMES[0])).status == "queued"
        room.answers[1] = [{"type": "problem", "problem": conflict, "index": 1}]
        with pytest.raises(sdk.ConflictError):
            await stream.push(FRAMES[1])
        assert len(room.problems) == 1

    play(work)


def test_a_call_without_an_answer_fails_and_connects_again():
    """A frame waits until the server says whether it has arrived."""

    async def work(room, _, stream):
        with pytest.raises(sdk.UnreachableError, match=r"light r1: no answer in 0\.2 s"):
            await stream.light_at("table")
        await room.until("open", 2)
        room.silent.add(0)
        assert (await stream.push(FRAMES[0])).status == "queued"
        assert frames_of(room) == ["frame 0"]

    play(work, timeouts=sdk.Timeouts(read_s=0.2))


@pytest.mark.parametrize(("messages_s", "sent_s", "lost_s"), [(0, 9, 19), (25, 0, 35), (60, 0, 40)])
def test_a_call_waits_while_bytes_leave_and_a_while_for_messages(messages_s, sent_s, lost_s):
    async def work(room, _, stream):
        loop, later_s = asyncio.get_running_loop(), 0
        start_s = loop.time()

        def time_s() -> float:
            return start_s + later_s

        unsent = property(lambda _: max(sent_s - later_s, 0))
        with mock.patch.object(type(stream), "_unsent", unsent), mock.patch.object(loop, "time", time_s):
            asked = asyncio.create_task(stream.light_at("table"))
            await room.logged("light")
            while not asked.done():
                later_s += 1
                if later_s <= messages_s and later_s % 5 == 0:
                    await stream.push(FRAMES[1], later_s)
                for _ in range(2):  # the timer of this second; the task that waits
                    await asyncio.sleep(0)
        assert later_s in range(lost_s, lost_s + 3)
        with pytest.raises(sdk.UnreachableError, match=r"light r1: no answer in 10 s"):
            await asked

    play(work, timeouts=sdk.Timeouts(read_s=10.0))


def test_a_saved_state_that_cannot_be_used_is_deleted():
    async def work(room, _, stream):
        room.refuse = problem(409, "state-refused")
        await room.cut()
        await room.until("open", 2)
        assert room.log[-3:] == ["GET", "DELETE", "PUT"]
        assert stream.status.reopened

    play(work)


def light_update(form: dict[str, Any]) -> bytes:
    one = {"position": [0, 0, 0], "name": "table", "coverage": 1.0, "etag": "e", "forms": [form]}
    return pack_light(LightingUpdate.model_validate({"frame": 2, "results": [one]}), [bytes(form["bytes"])])


def test_updates_and_malformed_messages_reach_their_handlers():
    async def work(room, _, stream):
        cube = {"format": "cube", "media_type": "m", "bytes": 2}
        room.answers[0] = [light_update(cube)]
        room.silent = set()
        pushed = asyncio.create_task(stream.push(FRAMES[0]))
        await room.logged("frame 0")
        await room.sockets[-1].send(b"no light")
        await room.sockets[-1].send(json.dumps({"type": "frame", "index": 0, "status": "processed"}))
        await pushed

    room = play(work)
    assert room.lights[0][0].name == "table"
    assert room.lights[0][0].frame == 2
    assert [type(error) for error in room.problems] == [sdk.BadReplyError]


def test_a_coroutine_function_as_a_handler_is_refused():
    """It never ran, without a word."""

    async def work(_, session, __):
        with pytest.raises(OptionError, match="on_lighting must be a plain function, got the coroutine function work"):
            await session.stream(on_lighting=work)

    play(work)


def test_closing_a_stream_ends_its_calls():
    async def work(room, _, stream):
        room.silent.add(0)
        waiting = asyncio.create_task(stream.push(FRAMES[0]))
        await room.logged("frame 0")
        await stream.close()
        with pytest.raises(sdk.UnreachableError, match="the stream was closed"):
            await waiting
        with pytest.raises(sdk.UnreachableError, match="the stream was closed"):
            await stream.track("table", (0.0, 0.0, 0.0))

    play(work)


# --- the blocking stream ----------------------------------------------------------------------------------------


def play_blocking(work) -> None:
    """Run `work(room, session)` in a thread, with a session of a blocking client to a scripted server."""

    async def main() -> None:
        room = Room()
        async with serve(room._serve, "127.0.0.1", 0) as server:
            url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
            with Client(url, transport=httpx.MockTransport(room._respond)) as client:
                await asyncio.to_thread(work, room, client.open("room"))

    asyncio.run(main())


WAITING_CALLS = (
    lambda stream: stream.push(FRAMES[1]),
    lambda stream: stream.light_at((0.0, 0.0, 0.0)),
    lambda stream: stream.subscribe(["sh"]),
    lambda stream: stream.track("table", (0.0, 0.0, 0.0)),
)


def test_calls_in_a_handler_that_would_wait_for_themselves_are_refused():
    def work(room, session):
        seen = queue.Queue()

        def on_lighting(_):
            for call in (*WAITING_CALLS, lambda stream: stream.close()):
                with pytest.raises(RoomLightError, match="in another thread") as refused:
                    call(stream)
                seen.put(refused.value)
            seen.put(stream.submit(FRAMES[1]))

        room.answers[0] = [light_update({"format": "cube", "media_type": "m", "bytes": 2})]
        with session.stream(on_lighting=on_lighting) as stream:
            stream.submit(FRAMES[0])
            for _ in range(5):
                seen.get()
            assert seen.get().result().status == "processed"
            assert stream.push(FRAMES[2]).status == "processed"

    play_blocking(work)


def test_a_blocking_stream_closes_where_an_event_loop_runs():
    def work(room, session):
        async def cell():
            with session.stream() as stream:
                assert stream.push(FRAMES[0]).status == "processed"
            room.lose()
            with pytest.raises(sdk.GoneError):
                session.stream()

        asyncio.run(cell())

    play_blocking(work)


@pytest.mark.parametrize("call", [*WAITING_CALLS, lambda stream: stream.submit(FRAMES[1])])
@pytest.mark.filterwarnings("error")
def test_a_closed_blocking_stream_says_so(call):
    def work(room, session):
        room.silent.add(0)
        stream = session.stream()
        waiting = stream.submit(FRAMES[0])
        stream.close()
        stream.close()
        with pytest.raises(sdk.UnreachableError, match="the stream was closed"):
            waiting.result()
        with pytest.raises(sdk.UnreachableError, match="the stream was closed"):
            call(stream)

    play_blocking(work)


# --- the buffer -------------------------------------------------------------------------------------------------


def settled(index: int, durable: int | None = None, status: Any = "processed") -> FrameResult:
    return FrameResult(index=index, status=status, durable_index=durable)


def test_frames_in_the_light_make_room_first():
    buffer = FrameBuffer(BufferLimits(frames=2))
    buffer.add(0, b"a", state="sent")
    buffer.add(1, b"b", state="sent")
    buffer.settle(settled(1))
    assert [frame.index for frame in buffer.add(2, b"c", state="waiting")] == [1]
    assert [frame.index for frame in buffer.add(3, b"d", state="waiting")] == [0]
    assert [buffer.lacks(index) for index in (0, 1)] == [True, False]


def test_the_buffer_is_bounded_in_bytes_but_keeps_the_newest():
    buffer = FrameBuffer(BufferLimits(bytes=10))
    buffer.add(0, bytes(6), state="sent")
    assert [frame.index for frame in buffer.add(1, bytes(60), state="waiting")] == [0]
    assert buffer.size == 60
    with pytest.raises(OptionError, match="at least 1"):
        BufferLimits(frames=0)


def test_frames_that_the_server_has_written_down_or_left_out_are_forgotten():
    buffer = FrameBuffer(BufferLimits())
    for result in (settled(0), settled(1), settled(2, durable=0), settled(3, status="superseded")):
        buffer.add(result.index, b"x", state="sent")
        buffer.settle(result)
    buffer.settle(settled(7))  # of another program
    assert [frame.index for frame in buffer] == [1, 2]


@pytest.mark.parametrize(("error", "lost"), [(httpx.ConnectError("x"), True), (httpx.UnsupportedProtocol("x"), False)])
def test_only_failures_of_the_connection_are_waited_for(error, lost):
    unreachable = sdk.UnreachableError("x")
    unreachable.__cause__ = error
    assert is_server_lost(unreachable) is lost
