"""Retries, delays, refusals and requests of both clients, against scripted responses: no socket, no sleeping."""

import asyncio
import base64
import inspect
import io
import json
import pickle
import re
from dataclasses import replace
from datetime import UTC, datetime

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sdk_scripts import OPENED, STATE, Script, problem

import roomlight_client as sdk
from roomlight.errors import OptionError, RoomLightError, WireError
from roomlight.wire.frame_message import parse
from roomlight.wire.light_message import MEDIA_TYPE
from roomlight.wire.messages import LightForm
from roomlight_client import AsyncClient, AsyncSession, Client, Retry, Session, Timeouts
from roomlight_client.calls import SessionCalls, session_request
from roomlight_client.errors import refusal
from roomlight_client.retry import parse_retry_after
from rooms import BoxRoom, pan

BOTH = pytest.mark.parametrize("kind", ["sync", "async"])
ORIGIN = (0.0, 0.0, 0.0)
FRAME = pan(BoxRoom(), 1, width=16, height=12)[0]


def ask_state(session):
    return session.state()


def run(script, kind, work, **options):
    """Open a session and return the result of `work(session)`."""

    async def main():
        async with script.client(kind, **options) as client:
            return await work(await client.open("room"))

    return asyncio.run(main())


def refused(script, kind, work, **options):
    with pytest.raises(RoomLightError) as caught:
        run(script, kind, work, **options)
    return caught.value


# --- retries ----------------------------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize(
    "first",
    [httpx.ConnectError("no route"), httpx.ReadTimeout("slow"), problem(429, "session-full"), problem(503, "x")],
)
def test_temporary_failures_are_retried_with_the_same_bytes(kind, first):
    script = Script(OPENED, first, problem(502, "x"), httpx.Response(200, json=STATE))
    state = run(script, kind, ask_state)
    assert state.id == "room"
    assert len(script.requests) == 4
    assert {(request.method, request.url.path, request.content) for request in script.requests[1:]} == {
        ("GET", "/v1/sessions/room", b"")
    }
    assert len(script.waits_s) == 2
    assert 0.1 <= script.waits_s[0] <= 0.2 <= script.waits_s[1] <= 0.4


@BOTH
def test_a_server_that_stops_is_away_until_one_is_ready(kind):
    """It gives the session's state until its end, so that the client said in turn that it is back and away."""
    away, events = problem(503, "stopping"), []
    pushed = httpx.Response(200, json={"index": 0, "status": "processed"})
    script = Script(OPENED, away, away, httpx.Response(200), httpx.Response(200, json=STATE), pushed)
    run(script, kind, lambda session: session.push(FRAME), on_recovery=events.append)
    assert [event.state for event in events] == ["waiting", "restored"]
    ready = ("GET", "/readyz")
    assert [(request.method, request.url.path) for request in script.requests[2:5]] == [
        *(ready, ready),
        ("GET", "/v1/sessions/room"),
    ]


@BOTH
def test_a_recovery_that_fails_is_begun_again_by_the_next_push(kind):
    def pushed(index):
        return httpx.Response(200, json={"index": index, "status": "processed"})

    async def work(session):
        await session.push(FRAME)
        with pytest.raises(sdk.UnreachableError):
            await session.state()
        await session.push(replace(FRAME, index=1))

    lost = [problem(404, "session-not-found")] * 2
    again = [OPENED, httpx.ConnectError("cut"), httpx.Response(200, json=STATE), pushed(0), pushed(1)]
    script = Script(OPENED, pushed(0), *lost, *again)
    run(script, kind, work, retry=Retry(attempts=1))
    requests = [f"{request.method} {request.url.path.rpartition('/')[2]}" for request in script.requests[4:]]
    assert requests == ["PUT room", "PUT 0", "GET room", "PUT 0", "PUT 1"]


def test_a_cancelled_call_leaves_the_recovery_to_the_others():
    requests: list[str] = []

    async def main():
        lost, resending, released = asyncio.Event(), asyncio.Event(), asyncio.Event()

        async def answer(request: httpx.Request) -> httpx.Response:
            name = f"{request.method} {request.url.path.rpartition('/')[2]}"
            requests.append(name)
            if lost.is_set() and "PUT room" not in requests:
                return problem(404, "session-not-found")
            if not name.endswith("room"):
                if lost.is_set():
                    resending.set()
                    await released.wait()
                return httpx.Response(200, json={"index": int(name.split()[1]), "status": "processed"})
            return httpx.Response(200, json=STATE)

        async with AsyncClient("http://room.test", transport=httpx.MockTransport(answer)) as client:
            session = await client.open("room")
            for index in range(2):
                await session.push(replace(FRAME, index=index))
            lost.set()
            requests.clear()
            cancelled = asyncio.create_task(session.state())
            await resending.wait()
            other = asyncio.create_task(session.state())
            cancelled.cancel()
            with pytest.raises(asyncio.CancelledError):
                await cancelled
            released.set()
            await other

    asyncio.run(main())
    assert requests == ["GET room", "GET room", "PUT room", "PUT 0", "PUT 1", "GET room"]


@BOTH
def test_retry_after_is_waited_for_unless_it_is_too_long(kind):
    script = Script(
        OPENED, problem(429, "session-full", retry_after="7"), problem(503, "server-full", retry_after="60")
    )
    error = refused(script, kind, ask_state, retry=Retry(max_retry_after_s=30.0))
    assert isinstance(error, sdk.BusyError)
    assert (error.kind, error.retry_after_s) == ("server-full", 60.0)
    assert len(script.waits_s) == 1
    assert 7.0 <= script.waits_s[0] <= 7.7


@BOTH
def test_the_number_of_attempts_is_limited(kind):
    script = Script(OPENED, httpx.ConnectError("connection refused"))
    error = refused(script, kind, ask_state, retry=Retry(attempts=3))
    assert isinstance(error, sdk.UnreachableError)
    assert "room.test" in str(error)
    assert "3 attempts" in str(error)
    assert "connection refused" in str(error)
    assert len(script.requests) == 1 + 3
    script = Script(OPENED, problem(429, "session-full"))
    assert isinstance(refused(script, kind, ask_state), sdk.BusyError)
    assert len(script.requests) == 1 + 4


@BOTH
@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 410, 413, 422, 500])
def test_permanent_refusals_are_not_retried(kind, status):
    script = Script(OPENED, problem(status, "no"))
    refused(script, kind, ask_state)
    assert len(script.requests) == 2


@BOTH
def test_an_error_in_a_session_block_is_not_hidden_and_deletes_the_session(kind):
    script = Script(OPENED, httpx.ConnectError("gone"), problem(404, "session-not-found"))

    async def main():
        async with script.client(kind) as client:
            session = await client.open("room")
            with pytest.raises(KeyError, match="mine"):
                async with session:
                    raise KeyError("mine")
            with pytest.raises(sdk.GoneError):
                await session.state()

    asyncio.run(main())
    assert [request.method for request in script.requests] == ["PUT", "DELETE", "GET"]
    assert script.waits_s == []


@BOTH
@pytest.mark.parametrize("answer", [httpx.Response(204), problem(404, "session-not-found"), problem(410, "closed")])
@pytest.mark.parametrize("delete", [lambda session: session.close(), lambda session: session.untrack("lamp")])
def test_deleting_what_is_missing_succeeds(kind, answer, delete):
    run(Script(OPENED, httpx.ReadError("cut"), answer), kind, delete)


@given(
    failed=st.integers(1, 200),
    jitter=st.floats(0, 1),
    retry_after_s=st.none() | st.floats(0, 1e4),
    retry=st.builds(
        Retry,
        attempts=st.integers(1, 300),
        first_delay_s=st.floats(0, 10),
        max_delay_s=st.floats(0, 100),
        max_retry_after_s=st.floats(0, 1e3),
    ),
)
def test_delays_are_bounded_and_respect_retry_after(failed, jitter, retry_after_s, retry):
    wait_s = retry.delay_s(failed, retry_after_s=retry_after_s, jitter=jitter)
    if wait_s is None:
        assert failed >= retry.attempts or (retry_after_s or 0) > retry.max_retry_after_s
    else:
        assert wait_s >= (retry_after_s or 0)
        assert wait_s <= max(retry.max_delay_s, 1.1 * (retry_after_s or 0))


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        (None, None), ("", None), ("3", 3.0), (" 12 ", 12.0), ("soon", None), ("-1", None), ("1e9", None), ("²", None),
        ("Sat, 21 Nov 2026 08:00:30 GMT", 30.0), ("Sat, 21 Nov 2026 07:00:00 GMT", 0.0),
        ("Sat, 21 Nov 2026 08:00:30 -0000", 30.0),
    ],
)  # fmt: skip
def test_retry_after_is_seconds_or_a_date(text, seconds):
    assert parse_retry_after(text, now=datetime(2026, 11, 21, 8, tzinfo=UTC)) == seconds


# --- refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "kind", "expected"),
    [
        (401, "unauthorized", sdk.UnauthorizedError),
        (403, "forbidden-origin", sdk.UnauthorizedError),
        (404, "session-not-found", sdk.GoneError),
        (410, "session-closed", sdk.GoneError),
        (409, "frame-conflict", sdk.ConflictError),
        (409, "session-failed", sdk.ConflictError),
        (413, "too-large", sdk.InvalidError),
        (422, "bad-frame", sdk.InvalidError),
        (418, "teapot", sdk.InvalidError),
        (429, "session-full", sdk.BusyError),
        (503, "stopping", sdk.BusyError),
        (500, "engine-failed", sdk.ServerFailedError),
        (599, "odd", sdk.ServerFailedError),
    ],
)
def test_each_problem_becomes_its_error_class(status, kind, expected):
    answer = problem(status, kind, field="depth.width", value="9", rule="at most 8", extension="ignored")
    error = refusal(status, answer.content)
    assert isinstance(error, sdk.RefusedError)
    assert type(error) is expected
    assert (error.status, error.kind) == (status, kind)
    assert (error.field, error.value, error.rule) == ("depth.width", "9", "at most 8")
    for part in ("because", "depth.width", "at most 8", "got 9", str(status)):
        assert part in str(error)


@pytest.mark.parametrize(
    "error",
    [
        WireError("bad-header", field="depth.width", value=9, rule="at most 8"),
        refusal(503, problem(503, "stopping").content, retry_after_s=5.0),
    ],
    ids=["WireError", "RefusedError"],
)
def test_errors_pass_between_processes(error):
    """An error of a task ended the whole pool of processes."""
    copied = pickle.loads(pickle.dumps(error))
    assert (type(copied), str(copied), vars(copied)) == (type(error), str(error), vars(error))


@pytest.mark.parametrize("body", [b"<html>Bad Gateway</html>", b"", b"[1]", b'"text"', b"\xff\xfe", b'{"status": []}'])
def test_a_refusal_without_problem_details_shows_its_status(body):
    error = refusal(502, body)
    assert isinstance(error, sdk.BusyError)
    assert "502" in str(error)


def test_an_unexpected_status_is_a_bad_reply():
    assert isinstance(refusal(302, b""), sdk.BadReplyError)


@BOTH
@pytest.mark.parametrize("body", [b"<html>", b"{}", b"[]", b""])
def test_another_service_at_the_address_is_a_bad_reply(kind, body):
    script = Script(OPENED, httpx.Response(200, content=body))
    assert isinstance(refused(script, kind, ask_state), sdk.BadReplyError)
    assert isinstance(refused(script, kind, lambda session: session.light_at(ORIGIN)), sdk.BadReplyError)
    script = Script(httpx.Response(200, content=body))
    assert isinstance(refused(script, kind, ask_state), sdk.BadReplyError)


@pytest.mark.parametrize(
    ("url", "token"),
    [
        ("room.test:8090", None), ("ftp://room.test", None), ("http://", None), ("http://room.test:99999", None),
        ("http://[::1", None), ("", None), ("http://me:secret@room.test", None), ("http://room.test", ""),
        ("http://room.test", "a\nb"), ("http://room.test", "tökén"),
    ],
)  # fmt: skip
def test_invalid_addresses_and_tokens_are_rejected(url, token):
    with pytest.raises(OptionError) as caught:
        Client(url, token=token)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        (Retry, {"attempts": 0}, "attempts"),
        *((Retry, {delay: -1.0}, "delays") for delay in ("first_delay_s", "max_delay_s", "max_retry_after_s")),
        *((Timeouts, {limit: 0.0}, limit) for limit in ("connect_s", "write_s", "read_s")),
    ],
)
def test_invalid_timeouts_and_retries_are_rejected(kind, value, message):
    with pytest.raises(OptionError, match=message):
        kind(**value)


@BOTH
@pytest.mark.parametrize("work", [ask_state, lambda session: session.push(FRAME), lambda session: session.stream()])
def test_a_closed_client_says_so_at_once(kind, work):
    script = Script(OPENED)

    async def main():
        async with script.client(kind) as client:
            session = await client.open("room")
        with pytest.raises(sdk.RemoteError, match="the client was closed"):
            await work(session)

    asyncio.run(main())
    assert len(script.requests) == 1
    assert not script.waits_s


def test_an_async_client_names_its_event_loop():
    client = AsyncClient("http://127.0.0.1:9", retry=sdk.Retry(attempts=1))
    with pytest.raises(sdk.UnreachableError):
        asyncio.run(client.ready())
    with pytest.raises(sdk.RemoteError, match=r"another event loop: make one in each asyncio\.run"):
        asyncio.run(client.ready())
    own = AsyncClient("http://room.test", transport=httpx.MockTransport(lambda _: httpx.Response(200)))
    assert asyncio.run(own.ready())
    assert asyncio.run(own.ready())


# --- requests ---------------------------------------------------------------------------------------------------


@BOTH
def test_requests_carry_token_session_and_options(kind):
    script = Script(*[OPENED] * 4, httpx.Response(200, json={"objects": [], "bytes": 0, "limit_bytes": 1}))

    async def main():
        async with script.client(kind, token="t" * 16) as client:
            await client.open("room", height=64, unknown_depth="far")
            await client.join("room")
            await client.open()
            await client.delete_object("ball", session_id="room")
            await client.objects(session_id="room")

    asyncio.run(main())
    opened, joined, fresh, *of_objects = script.requests
    assert opened.headers["authorization"] == "Bearer " + "t" * 16
    assert {request.headers["x-session-id"] for request in (opened, joined, *of_objects)} == {"room"}
    assert (opened.method, joined.method) == ("PUT", "GET")
    sent = json.loads(opened.content)
    assert (sent["height"], sent["unknown_depth"], sent["model"]) == (64, "far", "auto")
    made = fresh.url.path.removeprefix("/v1/sessions/")
    assert len(made) == 32
    assert int(made, 16) >= 0


@BOTH
@pytest.mark.parametrize(
    "work",
    [
        lambda session: session.light_at((0.0, float("nan"), 0.0)),
        lambda session: session.light_at((0.0, 5000.0, 0.0)),
        lambda session: session.light_at("a/../b"),
        lambda session: session.light_at(ORIGIN, ()),
        lambda session: session.lights_at([]),
        lambda session: session.lights_at([ORIGIN] * 65),
        lambda session: session.file("a b"),
        lambda session: session.track("../x", ORIGIN),
        lambda session: session.track("x", (0.0, 0.0, float("inf"))),
        lambda session: session.untrack("x/y"),
    ],
)
def test_invalid_requests_are_not_sent(kind, work):
    script = Script(OPENED)
    error = refused(script, kind, work)
    assert not isinstance(error, sdk.RemoteError)
    assert len(script.requests) == 1


def frame_of(index):
    """Return a frame with an index of any type, unchecked as in an app."""
    frame = replace(FRAME)
    object.__setattr__(frame, "index", index)
    return frame


@pytest.mark.parametrize("given", [5, 5.0, np.int64(5)])
@pytest.mark.filterwarnings("error")
def test_an_index_of_any_whole_type_is_sent_as_an_integer(given):
    session_calls = SessionCalls("room")
    index = session_calls.reserve(frame_of(given), None)
    assert (type(index), session_calls.next_index) == (int, 6)
    call = session_calls.push(FRAME, index, colour="exact", wait=True)
    assert call.path.endswith("/frames/5")
    assert parse(call.content or b"").header.index == 5


@BOTH
@pytest.mark.parametrize("index", [-1, 1.5, "5", 2**53, float("nan")])
def test_what_is_no_index_is_refused_and_not_used_up(kind, index):
    async def work(session):
        with pytest.raises(WireError, match=rf"index: must be a whole number, 0 to .*; got {re.escape(repr(index))}"):
            await session.push(frame_of(index))
        assert session.next_index == 0

    script = Script(OPENED)
    run(script, kind, work)
    assert len(script.requests) == 1


def test_options_may_be_numpy_scalars():
    request = session_request(height=np.int64(64), min_confidence=np.uint8(2), use_limited_tracking=np.bool_(True))
    assert (request.height, request.min_confidence, request.use_limited_tracking) == (64, 2, True)


async def open_with(kind, session_id="room", **options):
    async with Script(OPENED).client(kind) as client:
        await client.open(session_id, **options)


@BOTH
@pytest.mark.parametrize("session_id", ["", "a/b", "..", "x" * 65, "a\n"])
def test_invalid_session_ids_are_rejected(kind, session_id):
    with pytest.raises(OptionError, match="session_id"):
        asyncio.run(open_with(kind, session_id))


@pytest.mark.parametrize(("field", "value"), [("height", 5), ("model", "magic")])
def test_invalid_options_name_the_field(field, value):
    with pytest.raises(WireError) as caught:
        asyncio.run(open_with("async", **{field: value}))
    assert caught.value.field == field


@BOTH
def test_an_unchanged_file_is_none(kind):
    script = Script(OPENED, httpx.Response(304, headers={"ETag": '"abc-exr"'}))
    assert run(script, kind, lambda session: session.file((1.0, 2.0, -0.5), "exr", if_none_match="abc-exr")) is None
    request = script.requests[-1]
    assert request.headers["if-none-match"] == '"abc-exr"'
    assert dict(request.url.params) == {"format": "exr", "x": "1.0", "y": "2.0", "z": "-0.5"}


# --- light ------------------------------------------------------------------------------------------------------


def light_json(*forms, probes=1):
    one = {"position": [0, 1, 2], "coverage": 0.5, "etag": "e", "forms": list(forms)}
    return httpx.Response(200, json={"frame": 3, "results": [one] * probes})


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return {"format": "npy", "media_type": "x", "data": base64.b64encode(stream.getvalue()).decode()}


@BOTH
def test_light_as_json_is_parsed_after_answers_that_did_not_come_in_time(kind):
    panorama = np.arange(48, dtype=np.float32).reshape(2, 4, 6)[:, :, :3]
    script = Script(OPENED, httpx.ReadTimeout("slow"), problem(504, "x"), light_json(npy(panorama)))
    light = run(script, kind, lambda session: session.light_at((0.0, 1.0, 2.0), ("npy",)))
    assert script.requests[-1].headers["accept"] == MEDIA_TYPE
    assert (light.panorama == panorama).all()
    assert (light.position, light.frame, light.coverage, light.etag) == ((0.0, 1.0, 2.0), 3, 0.5, "e")


@BOTH
@pytest.mark.parametrize(
    ("form", "read"),
    [
        (npy(np.zeros((2, 4), np.float32)), "panorama"),
        (npy(np.zeros((2, 4, 3))), "panorama"),
        ({"format": "npy", "media_type": "x", "data": "AAAA"}, "panorama"),
        ({"format": "npy", "media_type": "x"}, "panorama"),
        ({"format": "exr", "media_type": "x", "data": "AAAA"}, "panorama"),
        ({"format": "confidence", "media_type": "x", "data": "AAAA"}, "observed"),
        ({"format": "cube", "media_type": "x", "data": "AAAA"}, "cube"),
        ({"format": "sh", "media_type": "x", "values": {}}, "harmonics"),
        ({"format": "sh", "media_type": "x", "values": {"coefficients": [1, 2]}}, "harmonics"),
        ({"format": "main_light", "media_type": "x", "values": {"direction": [0, 1, 0]}}, "main_light"),
        ({"format": "main_light", "media_type": "x", "values": {"direction": 1, "intensity": "x"}}, "main_light"),
    ],
)
def test_a_malformed_form_raises_when_it_is_accessed(kind, form, read):
    light = run(Script(OPENED, light_json(form)), kind, lambda session: session.light_at((0.0, 1.0, 2.0)))
    with pytest.raises(sdk.BadReplyError, match=form["format"]):
        _ = light.cube() if read == "cube" else getattr(light, read)


@BOTH
@pytest.mark.parametrize(
    "answer",
    [
        light_json(probes=2),
        light_json({"format": "npy", "media_type": "x", "data": "no base64!"}),
        httpx.Response(200, content=b"RLL1\xff\xff\xff\xff{}", headers={"Content-Type": MEDIA_TYPE}),
        httpx.Response(200, content=b"{}", headers={"Content-Type": MEDIA_TYPE}),
    ],
)
def test_answers_that_do_not_match_the_request(kind, answer):
    error = refused(Script(OPENED, answer), kind, lambda session: session.light_at((0.0, 1.0, 2.0)))
    assert isinstance(error, sdk.BadReplyError)


@BOTH
def test_a_name_by_itself_is_one_form_or_one_probe(kind):
    async def work(session):
        assert len(await session.lights_at("table", "sh")) == 1
        await session.light_at(ORIGIN, LightForm(format="sh"))

    script = Script(OPENED, light_json())
    run(script, kind, work)
    named, placed = (json.loads(request.content) for request in script.requests[1:])
    assert [probe["name"] for probe in named["probes"]] == ["table"]
    for sent in (named, placed):
        assert [form["format"] for form in sent["forms"]] == ["sh"]


# --- both clients are one ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("one", "other"), [(Client, AsyncClient), (Session, AsyncSession)])
def test_both_clients_have_the_same_names_and_arguments(one, other):
    def public(kind):
        return {name for name in vars(kind) if not name.startswith("_")}

    assert public(one) == public(other)
    for name in public(one) - {"next_index"}:
        ours, theirs = (inspect.signature(getattr(kind, name)) for kind in (one, other))
        assert list(ours.parameters.values()) == list(theirs.parameters.values()), name
        assert inspect.iscoroutinefunction(inspect.unwrap(getattr(other, name)))


@BOTH
@pytest.mark.parametrize(
    ("outcome", "raised", "text"),
    [
        (httpx.ReadTimeout("slow"), sdk.UnreachableError, "one attempt"),
        (httpx.Response(504, text="Gateway Time-out"), sdk.BusyError, "Gateway Time-out"),
    ],
)
def test_a_composite_has_its_own_time_limit_and_is_not_repeated_after_it(kind, outcome, raised, text):
    """After the 504 of a proxy the servers made it once more for each attempt."""
    script = Script(OPENED, outcome)
    place = {"shape": "sphere", "size_m": 0.2, "pixel": [3, 4]}
    with pytest.raises(raised, match=text):
        run(script, kind, lambda session: session.composite([place]))
    assert [request.extensions["timeout"]["read"] for request in script.requests] == [60.0, 130.0]
