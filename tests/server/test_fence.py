"""Servers that share a state directory: one of them owns a session, and those before it neither answer nor write."""

import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest
from websockets.exceptions import ConnectionClosed

from http_servers import SMALL, HeldSession, InThread, RunningServer, frame, server_on, wait_until
from roomlight.errors import ServerError
from roomlight_server.app import create_app
from roomlight_server.base.settings import ServerSettings
from roomlight_server.state import fence as fences
from roomlight_server.state import store
from roomlight_server.state.fence import Fence

KEY = "0f3a9c"
YAWS = (0, 12, 24, 36, 48)
PROBE = {"position": [0.2, 1.2, -0.5]}
LIGHT = "/v1/sessions/room/probes/table?format=npy"


@pytest.fixture
def fence(tmp_path):
    return Fence(tmp_path)


# --- the fence ----------------------------------------------------------------------------------------------------


def test_claims_at_once_have_different_epochs(tmp_path):
    Fence(tmp_path)
    with ThreadPoolExecutor(8) as pool:
        leases = list(pool.map(lambda _: Fence(tmp_path).claim(KEY), range(40)))
    assert sorted(lease.record.epoch for lease in leases) == list(range(1, 41))
    assert sum(Fence(tmp_path).holds(lease) for lease in leases) == 1


def test_a_claim_waits_for_a_running_write(fence):
    order, lease = [], fence.claim(KEY)
    writing, finish = threading.Event(), threading.Event()

    def write():
        with fence.guarded(lease):
            writing.set()
            finish.wait()
            order.append("written")

    def claim():
        found = fence.claim(KEY)
        order.append("claimed")
        return found

    writer = InThread(write)
    writing.wait()
    claiming = InThread(claim)
    finish.set()
    writer.result()
    assert claiming.result().record.epoch == 2
    assert order == ["written", "claimed"]


def test_a_claim_does_not_wait_for_ever(fence, monkeypatch):
    monkeypatch.setattr(fences, "LOCK_WAIT_S", 0.01)
    lease = fence.claim(KEY)
    with fence.guarded(lease), pytest.raises(TimeoutError, match="is locked by another server"):
        fence.claim(KEY)
    assert fence.holds(lease)


def test_a_released_session_is_not_taken_over(fence):
    assert not fence.claim(KEY).taken_over
    second = fence.claim(KEY)
    assert second.taken_over
    fence.release(second)
    assert not fence.holds(second)
    third = fence.claim(KEY)
    assert (third.taken_over, third.record.epoch) == (False, 3)
    fence.release(second)  # it is not the owner any more
    assert fence.holds(third)


def test_a_damaged_record_is_owned_by_nobody(fence, tmp_path, caplog):
    lease = fence.claim(KEY)
    (tmp_path / "owners" / KEY).write_bytes(b"\0" * 40)
    assert not fence.holds(lease)
    assert "is damaged" in caplog.text
    new = fence.claim(KEY)
    assert fence.holds(new)
    assert not fence.holds(lease)  # its epoch is 1 too
    assert new.taken_over


def test_records_of_erased_sessions_are_removed(fence, tmp_path):
    lease, other = fence.claim(KEY), fence.claim("another")
    fence.forget(0.0, set())
    assert fence.holds(lease)
    fence.forget(1e12, {"another"})
    assert not fence.holds(lease)
    assert fence.holds(other)
    assert sorted(path.name for path in (tmp_path / "owners").iterdir()) == ["another", "locks"]


# --- servers ------------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def requests_alone_notice_a_loss(monkeypatch):
    monkeypatch.setattr(store, "LEASE_PERIOD_S", 1e6)


shared_server = partial(server_on, state_shared=True)


@pytest.fixture
def pair(tmp_path):
    """Two servers that share a state directory."""
    with shared_server(tmp_path) as first, shared_server(tmp_path) as second:
        yield first, second


def refused_writes(server):
    """Return how many writes were refused; also of a server that has stopped."""
    registry = server.app.state.context.metrics.registry
    return registry.get_sample_value("roomlight_state_writes_total", {"outcome": "refused"})


def filled(server, count=3):
    server.open()
    assert server.call("PUT", "/v1/sessions/room/probes/table", PROBE).status == 201
    for index in range(count):
        assert server.push(index, frame(YAWS[index])).json["status"] == "processed"


def wait_until_quiet(server):
    """Ask until nothing is to be saved now."""
    states = server.app.state.context.states
    server.wait_until(
        lambda: not states._saving and not any(live.journal.is_due(3600.0) for _, live in server.registry.items())
    )


def moved(answer):
    return (answer.status, answer.kind, answer.headers["retry-after"]) == (503, "session-moved", "1")


def test_each_request_finds_that_the_session_moved(pair):
    first, second = pair
    filled(first)
    first.wait_until_saved(2)
    for path in ("/frames/3", "", "/probes/table?format=sh"):
        assert second.state()["frames"]["last_index"] == 2  # restores it there
        method, body = ("PUT", frame(YAWS[3])) if "frames" in path else ("GET", None)
        assert moved(first.call(method, f"/v1/sessions/room{path}", body))
        first, second = second, first


@pytest.mark.slow
def test_lost_frames_are_asked_for_and_light_is_the_same(tmp_path):
    with RunningServer() as whole:
        filled(whole, 5)
        light = whole.call("GET", LIGHT).body
    with shared_server(tmp_path, state_interval_s=3600) as first, shared_server(tmp_path) as second:
        filled(first, 1)

        def saved_by_a_probe():  # which is urgent: it is saved, with the frames before it
            first.call("PUT", "/v1/sessions/room/probes/other", {"position": [0.1, 1.0, -0.4]})
            first.call("DELETE", "/v1/sessions/room/probes/other")
            return first.state()["frames"]["durable_index"] == 0

        wait_until(saved_by_a_probe)
        wait_until_quiet(first)  # from now on nothing is saved for an hour
        for index in (1, 2, 3):
            assert first.push(index, frame(YAWS[index])).status == 200
        gap = second.push(4, frame(YAWS[4]))
        assert moved(gap)
        assert gap.json["detail"] == "this server took the session over after frame 0; send the frames after it again"
        assert second.state()["frames"]["last_index"] == 0
        for index in (1, 2, 3, 4):
            assert second.push(index, frame(YAWS[index])).json["epoch"] == 2
        assert second.call("GET", LIGHT).body == light


def test_a_session_that_is_opened_again_may_begin_anywhere(tmp_path):
    with shared_server(tmp_path) as server:
        filled(server, 1)
        server.wait_until_saved(0)
        assert server.call("DELETE", "/v1/sessions/room").status == 204
        server.open()
        assert server.push(7, frame(YAWS[1])).json["epoch"] == 3  # deleting claims it too


def test_a_write_after_the_loss_is_refused(tmp_path):
    with shared_server(tmp_path, state_interval_s=3600) as first:
        filled(first, 2)
        fence = Fence(tmp_path)
        for folder in (tmp_path / "owners").iterdir():
            if folder.is_file():
                fence.claim(folder.name)
        before = [path.read_bytes() for path in (tmp_path / "sessions").glob("*/state")]
        first.stop()
        assert [path.read_bytes() for path in (tmp_path / "sessions").glob("*/state")] == before
        assert refused_writes(first) == 1


def test_a_frame_in_the_engine_is_not_answered_after_a_loss(tmp_path, monkeypatch):
    HeldSession.serve(monkeypatch)
    with shared_server(tmp_path) as first:
        first.open()
        pushed = InThread(first.push, 0)
        HeldSession.wait_entered()
        fence = Fence(tmp_path)
        key = next(path.name for path in (tmp_path / "owners").iterdir() if path.is_file())
        fence.claim(key)
        HeldSession.release()
        assert moved(pushed.result())


def test_a_stopped_server_releases_its_sessions(tmp_path):
    with shared_server(tmp_path, state_interval_s=3600) as first:
        filled(first)
    with shared_server(tmp_path) as second:
        found = second.push(9, frame(YAWS[3]))  # a gap of the client's own
        assert (found.status, found.json["epoch"]) == (200, 2)


def test_deleting_on_another_server_ends_the_session(tmp_path, pair):
    first, second = pair
    filled(first)
    first.wait_until_saved(2)
    assert second.call("DELETE", "/v1/sessions/room").status == 204
    assert moved(first.push(3, frame(YAWS[3])))
    assert first.call("GET", "/v1/sessions/room").status == 404
    assert list((tmp_path / "sessions").iterdir()) == []


def test_a_moved_session_leaves_memory_without_requests(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "LEASE_PERIOD_S", 500.0)
    now_s = [1000.0]
    with shared_server(tmp_path, clock=lambda: now_s[0]) as first, shared_server(tmp_path) as second:
        filled(first)

        def saved_later():
            now_s[0] += 0.1
            return first.state()["frames"]["durable_index"] == 2

        wait_until(saved_later)
        second.state()
        now_s[0] += 500
        first.wait_until(lambda: first.registry.items() == [])


def test_a_stream_of_a_moved_session_is_closed(pair):
    first, second = pair
    filled(first)
    first.wait_until_saved(2)
    with first.stream() as socket:
        second.state()
        socket.send(frame(YAWS[3], index=3))
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv()
    assert closed.value.rcvd is not None
    assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (4503, "session-moved")


@pytest.mark.parametrize("shared", [(False, True), (True, False)])
def test_sharing_must_be_set_for_all_servers(tmp_path, shared):
    with (
        RunningServer(state_dir=tmp_path, state_shared=shared[0]),
        pytest.raises(ServerError, match=r"state_dir: .*: is used by another server; .* set state_shared for all"),
    ):
        create_app(ServerSettings(state_dir=tmp_path, state_shared=shared[1]))


def test_a_single_server_has_no_epochs(tmp_path):
    with RunningServer(state_dir=tmp_path) as server:
        server.open(options=SMALL)
        assert server.push(0).json["epoch"] is None
    assert not (tmp_path / "owners").exists()
