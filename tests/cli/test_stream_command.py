"""Streams: the recording's pace, dropped frames, a clean end; in virtual time, and once with a real server."""

import asyncio
import re
from dataclasses import replace
from pathlib import Path
from unittest import mock

import httpx
import pytest
from sdk_scripts import STATE, problem

import roomlight_client as sdk
from http_servers import RunningServer
from roomlight.captures import CaptureOptions, open_capture
from roomlight.engine.session import SessionOptions
from roomlight.errors import OptionError
from roomlight.placement import point_at_pixel
from roomlight.wire.frame_message import parse
from roomlight_cli.shared_options import print_recovery, refuse_local_model
from roomlight_cli.stream import Clock, StreamOptions, Tally, stream
from roomlight_client import AsyncClient, RecoveryEvent, _waiting
from rooms import BoxRoom, pan
from written_captures import edited_copy, write_capture

PROBE = (0.4, 1.2, -0.3)
RATE = 10.0


@pytest.fixture(scope="module")
def untimed(tmp_path_factory) -> Path:
    return write_capture(tmp_path_factory.mktemp("captures") / "untimed", pan(BoxRoom(), 6, width=48, height=36))


@pytest.fixture(scope="module")
def timed(untimed) -> Path:
    def give_times(index):
        for number, frame in enumerate(index["frames"]):
            frame["timestamp_s"] = 7.0 + number / RATE

    return edited_copy(untimed, untimed.parent / "timed", give_times)


class FakeServer:
    """A server and a clock: frame n is answered after `takes_s[n]` seconds, with `outcomes[n]` if given."""

    def __init__(self, *, takes_s=None, outcomes=None, last_index=None):
        self.tally = Tally()
        self.now_s = 100.0
        self.arrived, self.bodies, self.deleted = {}, {}, 0
        self._takes_s, self._outcomes = takes_s or {}, outcomes or {}
        self._state = STATE | {"frames": STATE["frames"] | {"last_index": last_index}}
        self._due, self._changed = {}, asyncio.Event()

    async def _answer(self, request):
        name = request.url.path.rpartition("/")[2]
        if request.method == "DELETE":
            self.deleted += 1
            return httpx.Response(204)
        if "/frames/" in request.url.path:
            return await self._frame(int(name), request.content)
        if request.method == "POST":
            values = [
                {"coefficients": [1.0] * 27, "layout": "interleaved", "phase": "positive", "quantity": "radiance"},
                {"direction": [0.0, 1.0, 0.0], "intensity": [3.0, 2.0, 1.0]},
            ]
            forms = [
                {"format": kind, "media_type": "application/json", "values": value}
                for kind, value in zip(("sh", "main_light"), values, strict=True)
            ]
            one = {"position": PROBE, "coverage": 0.25, "etag": "e", "forms": forms}
            return httpx.Response(200, json={"frame": 0, "results": [one]})
        return httpx.Response(200, json=self._state)

    async def _frame(self, index, body):
        self.arrived[index], self.bodies[index] = self.now_s, body
        released = asyncio.Event()
        self._due[index] = (self.now_s + self._takes_s.get(index, 0.0), released)
        self._release()
        self._changed.set()
        await released.wait()
        outcome = self._outcomes.get(index, "processed")
        if isinstance(outcome, Exception):
            raise outcome
        if isinstance(outcome, httpx.Response):
            return httpx.Response(outcome.status_code, headers=outcome.headers, content=outcome.content)
        return httpx.Response(200, json={"index": index, "status": outcome})

    def _release(self):
        for due_s, released in self._due.values():
            if due_s <= self.now_s + 1e-9:
                released.set()

    async def sleep(self, seconds):
        """Advance the time and answer the frames that are due by then."""
        await self._settled()
        self.now_s += seconds
        self._release()
        await self._settled()

    async def _settled(self):
        while self._unanswered() != sum(not released.is_set() for _, released in self._due.values()):
            self._changed.clear()
            await self._changed.wait()

    def _unanswered(self):
        t = self.tally
        return t.sent - t.processed - t.superseded - t.busy - t.overtaken - t.refused - t.lost

    async def play(self, path, options, show=None):
        def shown(tally):
            self._changed.set()
            if show:
                show(tally)

        transport = httpx.MockTransport(self._answer)
        clock = Clock(now=lambda: self.now_s, sleep=self.sleep)
        once = sdk.Retry(attempts=1)
        with mock.patch.object(_waiting, "wait_async", self.sleep):
            async with AsyncClient("http://room.test", transport=transport, reconnect=once) as client:
                return await stream(path, client, options, tally=self.tally, show=shown, clock=clock)


def played(path, options=None, show=None, **room):
    room = FakeServer(**room)
    asyncio.run(room.play(path, options or StreamOptions(), show))
    return room


def test_a_recording_keeps_its_own_pace(timed):
    room = played(timed)
    assert room.arrived == pytest.approx({n: 100 + n / RATE for n in range(6)})
    tally = room.tally
    assert (tally.frames, tally.due, tally.sent, tally.processed, tally.dropped) == (6, 6, 6, 6, 0)
    assert tally.pace == 1.0
    assert tally.rate(room.now_s) == pytest.approx(RATE)
    assert tally.rate(room.now_s + 60) == 0.0
    assert tally.light is not None
    assert tally.light.coverage == 0.25
    assert room.deleted == 1


def test_fps_leaves_frames_out_and_keeps_the_pace(timed):
    assert played(timed, StreamOptions(fps=3.0)).arrived == pytest.approx({0: 100.0, 3: 100.3})


def test_without_times_fps_is_the_pace(untimed):
    assert played(untimed, StreamOptions(fps=4.0)).arrived == pytest.approx({n: 100 + n / 4 for n in range(6)})
    two = StreamOptions(capture=CaptureOptions(max_frames=2))
    assert played(untimed, two).arrived == pytest.approx({0: 100, 1: 100 + 1 / 3})


@pytest.mark.parametrize(("in_flight", "sent"), [(1, [0, 3, 4, 5]), (2, [0, 1, 3, 4, 5])])
def test_a_frame_due_while_others_are_unanswered_is_dropped(timed, in_flight, sent):
    room = played(timed, StreamOptions(in_flight=in_flight), takes_s={0: 0.25, 1: 0.15})
    assert list(room.arrived) == sent
    assert room.tally.dropped == 6 - len(sent)
    assert room.tally.frame_ms[-1] == 0.0
    assert max(room.tally.frame_ms) == pytest.approx(300)  # looked at once every tenth of a second


def test_each_outcome_is_counted_once_and_nothing_is_resent(timed):
    outcomes = {
        0: "superseded",
        1: problem(429, "session-full", retry_after="5"),
        2: problem(409, "frame-conflict"),
        3: problem(422, "bad-frame", field="depth", rule="some"),
        4: httpx.ReadTimeout("slow"),
        5: "skipped",
    }
    room = played(timed, outcomes=outcomes)
    tally = room.tally
    assert (tally.superseded, tally.busy, tally.overtaken, tally.refused, tally.lost) == (1, 1, 1, 2, 1)
    assert (tally.sent, tally.processed, tally.light) == (6, 0, None)
    assert "000003.jpg" in tally.reasons[0]
    assert "depth" in tally.reasons[0]
    assert list(room.arrived) == list(range(6))


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        ({2: problem(401, "unauthorized")}, sdk.UnauthorizedError),
        ({2: problem(409, "session-failed")}, sdk.ConflictError),
        (dict.fromkeys(range(6), httpx.ConnectError("refused")), sdk.UnreachableError),
    ],
)
def test_a_fatal_error_is_raised_and_the_session_deleted(timed, outcomes, expected):
    room = FakeServer(outcomes=outcomes)
    with pytest.raises(expected):
        asyncio.run(room.play(timed, StreamOptions()))
    assert room.deleted == 1


def test_an_interrupted_stream_deletes_its_session(timed):
    async def main():
        room = FakeServer(takes_s={2: 1e6})

        def stop(tally):
            if tally.sent == 3:
                playing.cancel()

        playing = asyncio.create_task(room.play(timed, StreamOptions(), stop))
        with pytest.raises(asyncio.CancelledError):
            await playing
        return room

    room = asyncio.run(main())
    assert room.tally.processed <= 2
    assert room.deleted == 1


def test_an_existing_session_is_continued_and_kept(timed):
    room = played(timed, StreamOptions(session="room", keep=True), last_index=41)
    assert list(room.arrived) == list(range(42, 48))
    assert room.deleted == 0


def test_a_slow_reader_plays_slower_and_reports_its_pace(timed):
    room = FakeServer()
    due = []

    def dawdle(tally):
        if tally.due > len(due):
            due.append(tally.due)
            room.now_s += 0.3

    asyncio.run(room.play(timed, StreamOptions(), dawdle))
    assert room.tally.sent == 6
    assert room.tally.pace == pytest.approx(1 / 3, abs=0.01)


@pytest.mark.parametrize(("colour", "encoding"), [("jpeg", "jpeg"), ("png", "png"), ("exact", "linear_f32")])
def test_colour_selects_the_frame_encoding(timed, colour, encoding):
    room = played(timed, StreamOptions(CaptureOptions(max_frames=1), colour=colour))
    assert parse(room.bodies[0]).header.colour.encoding == encoding


def test_bad_frames_of_the_recording_are_counted(timed, tmp_path):
    copy = edited_copy(timed, tmp_path / "bad", lambda _: None)
    (copy / "depth" / "000001.png").write_bytes(b"no PNG")
    room = played(copy)
    assert (room.tally.unreadable, room.tally.sent, room.tally.frames) == (1, 5, 6)


@pytest.mark.parametrize("options", [{"fps": 0.0}, {"fps": float("nan")}, {"in_flight": 0}])
def test_impossible_options_are_refused(options):
    with pytest.raises(OptionError, match="must be"):
        StreamOptions(**options)


def test_the_probe_is_a_position_a_pixel_or_a_default(timed):
    first = next(iter(open_capture(timed)))
    assert StreamOptions(probe=PROBE).probe_position(first) == PROBE
    pixel = StreamOptions(pixel=(20.0, 10.0), above_m=0.3)
    assert pixel.probe_position(first) == point_at_pixel(first, 20.0, 10.0, above_m=0.3)
    assert StreamOptions().probe_position(first)[1] == pytest.approx(first.camera_to_world[1, 3], abs=1e-3)


# --- the command, and a real server -----------------------------------------------------------------------------


def test_the_command_against_a_real_server(timed, roomlight):
    with RunningServer(model="classical") as running:
        url = f"http://127.0.0.1:{running.port}"
        arguments = ["stream", str(timed), "--server", url, "--height", "16", "--session", "film", "--keep"]
        arguments += ["--fps", "1000", "--in-flight", "8", "--colour", "exact", "--model", "classical"]
        result = roomlight(*arguments)
        assert result.code == 0, result.err
        state = running.state("film")
        assert "film" in result.out
        assert "6 of 6 frames sent" in result.out
        assert "main light" in result.out
        counted = state["frames"]["accepted"] + state["frames"]["refused"]
        uncounted = sum(map(int, re.findall(r"(\d+) (?:overtaken|lost)", result.out)))  # each frame has a connection
        assert counted <= 6 <= counted + uncounted
        assert set(state["probes"]) == {"stream"}


@pytest.mark.parametrize(
    ("error", "options", "code", "said"),
    [
        (KeyboardInterrupt(), [], 130, "stopped; the session is deleted"),
        (KeyboardInterrupt(), ["--keep"], 130, "stopped; the session stays"),
        (sdk.UnreachableError("no answer"), [], 1, "error: no answer"),
    ],
)
def test_an_end_before_the_last_frame_prints_what_was_done(timed, monkeypatch, roomlight, error, options, code, said):
    async def ended(*_, tally, show):
        tally.frames, tally.sent, tally.processed, tally.busy, tally.session_id = 6, 3, 2, 1, "room"
        tally.frame_ms += [1.0, 2.0, 10.0]
        show(replace(tally, pace=0.5))
        raise error

    monkeypatch.setattr("roomlight_cli.commands.stream.play", ended)
    result = roomlight("stream", timed, *options)
    assert result.code == code
    assert result.err.strip() == said
    assert "3 of 6 frames sent, 2 in the light" in result.out
    assert "frame latency: 2 ms (median), 9 ms (95 %)" in result.out
    assert "1 server busy" in result.out


@pytest.mark.parametrize("options", [{"weights": Path("w")}, {"parts": Path("p")}, {"provider": "cpu"}])
def test_engine_options_are_refused_for_a_server(options):
    with pytest.raises(OptionError, match="roomlight serve"):
        refuse_local_model("http://room.test", SessionOptions(**options))
    refuse_local_model("http://room.test", SessionOptions())


# --- a server that is started again -----------------------------------------------------------------------------


def test_a_lost_session_is_opened_again_and_the_stream_goes_on(timed):
    room = FakeServer()
    answer, lost = room._answer, []

    async def lose_once(request):
        if request.url.path.endswith("/frames/2") and not lost:
            lost.append(True)
        if lost and len(lost) < 3:
            lost.append(True)
            return problem(404, "session-not-found")
        return await answer(request)

    room._answer = lose_once
    asyncio.run(room.play(timed, StreamOptions(in_flight=1)))
    assert (room.tally.sent, room.tally.processed, room.tally.lost) == (6, 6, 0)


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (
            RecoveryEvent("waiting", error=sdk.UnreachableError("refused")),
            "the server is away; waiting for it (refused)",
        ),
        (RecoveryEvent("restored"), "the server is back with the session"),
        (RecoveryEvent("restored", resent=1), "the server is back with the session; 1 frame sent again"),
        (
            RecoveryEvent("restored", reopened=True, resent=3, incomplete=True),
            "the server is back: it had lost the session, which was opened again; 3 frames sent again; "
            "older frames are lost: the light differs from one without the interruption",
        ),
    ],
)
def test_the_terminal_says_what_became_of_the_server(event, line, capsys):
    print_recovery(event)
    assert capsys.readouterr().err == line + "\n"
