"""Sessions on disk: restored with the same bits after a restart; damaged, foreign and unwritable ones stay apart."""

import asyncio
import errno
import json
import os
import re
import shutil
import stat
from pathlib import Path
from unittest.mock import Mock

import pytest

from http_servers import (
    OTHER,
    SMALL,
    TOKEN,
    Held,
    HeldSession,
    InThread,
    RunningServer,
    frame,
    metric,
    server_on,
    wait_until,
)
from roomlight.engine.state.records import FORMAT
from roomlight.errors import OutputError, ServerError
from roomlight.wire.frame_message import parse
from roomlight_server.app import create_app
from roomlight_server.base.settings import ServerSettings
from roomlight_server.sessions.frame_queue import Entry, FrameQueue
from roomlight_server.state import session_folder, store
from roomlight_server.state.ages import SavedAges
from roomlight_server.state.journal import Journal

YAWS = (0, 12, 24, 36, 48, 60)
PROBE = {"position": [0.2, 1.2, -0.5]}
FULL = OutputError("state: cannot be written")
FULL.__cause__ = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
LIGHTS = ("/probes/table?format=npy", "/probe?x=0.1&y=1.1&z=-0.2&format=npy")


def wait_until_saved(server, index, name="room", **more):
    """Ask until the frame is on disk; returns the state."""
    server.wait_until(
        lambda: server.state(name, **more)["frames"]["durable_index"] == index and _unsaved_s(server) == 0
    )
    return server.state(name, **more)


def _unsaved_s(server):
    states = server.app.state.context.states
    lives = dict(server.registry.items()).values()
    return max([live.journal.unsaved_s for live in lives] + [len(states._saving)])


def lights(server, name="room", **more):
    found = [server.call("GET", f"/v1/sessions/{name}{path}", **more) for path in LIGHTS]
    assert {answer.status for answer in found} == {200}
    return [(answer.body, answer.headers["etag"]) for answer in found]


def filled(server, name="room", count=4, **more):
    """Open a session with a probe and frames; returns its state once all of it is on disk."""
    server.open(name, **more)
    assert server.call("PUT", f"/v1/sessions/{name}/probes/table", PROBE, **more).status == 201
    for index, yaw in enumerate(YAWS[:count]):
        assert server.push(index, frame(yaw), name=name, **more).status == 200
    return wait_until_saved(server, count - 1, name, **more)


def copied(folder, target):
    """Return a copy of a state directory, as a killed server leaves it."""
    return shutil.copytree(folder, target)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A state directory with the session `room`; its state, its light, its light after two more frames."""
    folder = tmp_path_factory.mktemp("saved") / "state"
    with server_on(folder) as server:
        state, light = filled(server), lights(server)
        kept = copied(folder, folder.with_name("kept"))
        for index, yaw in enumerate(YAWS[4:], start=4):
            server.push(index, frame(yaw))
        later = lights(server)
    return kept, state, light, later


def test_a_restored_session_is_the_same(saved, tmp_path):
    kept, state, light, later = saved
    with server_on(copied(kept, tmp_path / "state")) as server:
        found = server.state()
        same = ("options", "model", "probes", "coverage", "keyframes", "volume", "idle_expiry_s")
        assert {name: found[name] for name in same} == {name: state[name] for name in same}
        assert found["frames"] == state["frames"]
        assert found["frames"]["last_index"] == found["frames"]["durable_index"] == 3
        assert lights(server) == light
        for index, yaw in enumerate(YAWS[4:], start=4):
            assert server.push(index, frame(yaw)).json["status"] == "processed"
        assert lights(server) == later


def test_frames_after_a_restart_keep_their_order(saved, tmp_path):
    with server_on(copied(saved[0], tmp_path / "state")) as server:
        first = server.push(3, frame(YAWS[3]))
        assert (first.status, first.json["replay"], first.json["status"]) == (200, True, "processed")
        other = server.push(3, frame(YAWS[0]))
        assert (other.status, other.kind) == (409, "frame-conflict")
        old = server.push(1, frame(YAWS[1]))
        assert (old.status, old.json["rule"]) == (409, "must be above 3, or 3 with the same bytes")
        assert server.push(9, frame(YAWS[4])).status == 200
        assert server.state()["frames"]["gaps"] == 5


def test_opening_joins_the_saved_session_whose_composite_needs_no_new_frame(saved, tmp_path):
    body = {"objects": [{"shape": "sphere", "size_m": 0.2, "pixel": [24, 24]}], "quality": "preview"}
    with server_on(copied(saved[0], tmp_path / "state")) as server:
        assert server.registry.items() == []
        assert server.call("POST", "/v1/sessions/room/composite", body).status == 200
        conflict = server.call("PUT", "/v1/sessions/room", SMALL | {"height": 24})
        assert (conflict.status, conflict.kind) == (409, "session-conflict")
        assert server.open().status == 200
        assert server.state()["frames"]["processed"] == 4
        assert server.call("GET", "/v1/sessions/another").status == 404


def test_requests_at_once_restore_a_session_once(saved, tmp_path, monkeypatch):
    reads = []
    original = store.read_session
    monkeypatch.setattr(store, "read_session", lambda *args: reads.append(1) or original(*args))
    with server_on(copied(saved[0], tmp_path / "state")) as server:
        calls = [InThread(server.state) for _ in range(8)]
        assert {call.result()["frames"]["processed"] for call in calls} == {4}
        assert len(reads) == 1


def test_only_this_user_can_read_the_files(saved):
    for path in [saved[0], *saved[0].rglob("*")]:
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_messages_of_keyframes_are_kept_as_they_came(saved):
    found = sorted(path.read_bytes() for path in saved[0].rglob("*.frame"))
    assert found
    assert set(found) <= {frame(yaw) for yaw in YAWS}


def test_deleting_erases_the_files(saved, tmp_path):
    folder = copied(saved[0], tmp_path / "state")
    with server_on(folder) as server:
        assert server.state()["frames"]["processed"] == 4
        assert server.call("DELETE", "/v1/sessions/room").status == 204
        assert list((folder / "sessions").iterdir()) == []
        assert server.call("GET", "/v1/sessions/room").status == 404
        assert server.call("DELETE", "/v1/sessions/room").status == 404
    folder = copied(saved[0], tmp_path / "again")
    with server_on(folder) as server:  # without restoring it
        assert server.call("DELETE", "/v1/sessions/room").status == 204
        assert list((folder / "sessions").iterdir()) == []


def test_the_disk_of_a_token_is_limited(tmp_path):
    """What is saved stays and goes on; there is room again when a session is deleted."""
    with server_on(tmp_path, tokens=(TOKEN, OTHER), max_owner_state_bytes=2**16) as server:
        server.open(token=TOKEN)
        server.push(0, token=TOKEN)
        server.wait_until_saved(0, token=TOKEN)
        answer = server.call("PUT", "/v1/sessions/second", SMALL, token=TOKEN)
        assert (answer.status, answer.kind, answer.json["field"]) == (429, "owner-quota", "session")
        assert server.push(1, token=TOKEN).json["status"] == "processed"
        server.open("second", token=OTHER)
        server.call("DELETE", "/v1/sessions/room", token=TOKEN)
        assert server.open("second", token=TOKEN).status == 201


def test_a_session_beyond_the_quota_is_not_restored(saved, tmp_path, monkeypatch):
    """Each attempt restored all of it before it was refused."""
    read = Mock()
    monkeypatch.setattr(store, "read_session", read)
    with server_on(copied(saved[0], tmp_path / "state"), max_owner_sessions=1) as server:
        server.open("another")
        assert server.call("GET", "/v1/sessions/room").kind == "owner-quota"
    assert not read.called


def test_the_owner_is_kept_and_the_token_is_not(tmp_path):
    with server_on(tmp_path / "state", tokens=(TOKEN, OTHER)) as server:
        filled(server, count=1, token=TOKEN)
    with server_on(tmp_path / "state", tokens=(TOKEN, OTHER)) as server:
        assert server.call("GET", "/v1/sessions/room", token=OTHER).status == 404
        assert server.state(token=TOKEN)["frames"]["processed"] == 1
    for path in (tmp_path / "state").rglob("*"):
        data = path.name.encode() + (path.read_bytes() if path.is_file() else b"")
        assert not any(token.encode() in data for token in (TOKEN, OTHER))


def test_a_session_of_another_owner_is_refused(saved, tmp_path):
    folder = copied(saved[0], tmp_path / "state")
    (own,) = (folder / "sessions").iterdir()
    with server_on(folder) as server:
        filled(server, "other", count=1)
    (other,) = (path for path in (folder / "sessions").iterdir() if path != own)
    shutil.rmtree(other)
    own.rename(other)
    with server_on(folder) as server:
        answer = server.call("GET", "/v1/sessions/other")
        assert (answer.status, answer.kind) == (409, "state-refused")
        assert "belongs to another session" in answer.json["detail"]


def _flip(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)


def _other_weights(path):
    """State other weights, as a server with another network for clipped pixels would have written it."""
    records = session_folder.unpack_records(path.read_bytes(), "state")
    for record in records:
        if record.tag == "SESS":
            record.values["networks"]["clipping"] = 64 * "0"
    path.write_bytes(session_folder.pack_records(records))


def _other_version(path):
    path.write_bytes(path.read_bytes().replace(b"RLSTATE3", b"RLSTATE9", 1))


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        ("state", _flip, "is damaged"),
        ("state", _other_version, f"version '9'; this release reads version {FORMAT}"),
        ("state", _other_weights, "saved with a network for clipped pixels 0000000000000000"),
        ("*.frame", _flip, "is damaged (its checksum differs)"),
        ("*.frame", lambda path: path.unlink(), "is missing"),
    ],
)
def test_what_is_damaged_or_foreign_is_refused_by_name(saved, tmp_path, caplog, name, damage, message):
    folder = copied(saved[0], tmp_path / "state")
    damage(next((folder / "sessions").glob(f"*/{name}")))
    with server_on(folder) as server:
        for method, path in (("GET", ""), ("PUT", ""), ("GET", LIGHTS[0])):
            answer = server.call(method, f"/v1/sessions/room{path}", SMALL if method == "PUT" else None)
            assert (answer.status, answer.kind) == (409, "state-refused")
            assert "saved state of session room" in answer.json["detail"]
            assert message in answer.json["detail"]
        assert any(message in record.getMessage() for record in caplog.records)
        assert server.open("neighbour").status == 201
        assert server.push(0, name="neighbour").status == 200
        assert server.call("DELETE", "/v1/sessions/room").status == 204
        assert server.open().status == 201


def test_what_a_kill_leaves_half_written_is_ignored(saved, tmp_path):
    folder = copied(saved[0], tmp_path / "state")
    one = next((folder / "sessions").iterdir())
    (one / ".state.part").write_bytes((one / "state").read_bytes()[:1000])
    (one / "77-0123456789abcdef.frame").write_bytes(b"RLF1")
    with server_on(folder) as server:
        assert lights(server) == saved[2]
        server.push(4, frame(YAWS[4]))
        wait_until_saved(server, 4)
    assert {path.suffix for path in one.iterdir() if path.name != "state"} == {".frame"}
    assert not (one / "77-0123456789abcdef.frame").exists()


def test_a_state_that_cannot_be_read_now_is_asked_for_again(saved, tmp_path, monkeypatch):
    broken = [True]

    def breaking(original):
        def read(path, *args, **kwargs):
            if broken and path.parent.parent.name == "sessions":
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return original(path, *args, **kwargs)

        return read

    monkeypatch.setattr(Path, "read_bytes", breaking(Path.read_bytes))
    monkeypatch.setattr(Path, "stat", breaking(Path.stat))
    with server_on(copied(saved[0], tmp_path / "state")) as server:
        answer = server.call("GET", "/v1/sessions/room")
        assert (answer.status, answer.kind, answer.headers["retry-after"]) == (503, "state-unavailable", "5")
        broken.clear()
        assert server.state()["frames"]["processed"] == 4


@pytest.mark.parametrize(("error", "reason"), [(MemoryError(), "MemoryError"), (FULL, "No space left on device")])
def test_an_error_of_saving_is_stated_and_does_not_end_it(tmp_path, monkeypatch, error, reason):
    original, broken = store.write_session, [True]

    def write(*args):
        if broken:
            raise error
        return original(*args)

    monkeypatch.setattr(store, "write_session", write)
    with server_on(tmp_path / "state") as server:
        server.open()
        server.wait_until(lambda: server.call("GET", "/readyz").json["state"] == f"not saved: {reason}")
        assert server.push(0).json["durable_index"] is None
        broken.clear()
        wait_until_saved(server, 0)
        assert server.call("GET", "/readyz").json["state"] == "saved"


def test_nobody_waits_for_a_slow_disk(tmp_path, monkeypatch):
    """Frames waited for a copy of their session, and lists and new sessions, behind the writes of two others."""
    slow = []
    write = Held(store.write_session, lambda *_: slow)
    monkeypatch.setattr(store, "write_session", write)
    with server_on(tmp_path / "state") as server:
        for name in ("first", "second", "room"):
            server.open(name)
        server.wait_until(lambda: _unsaved_s(server) == 0)
        slow.append(True)
        for name in ("first", "second"):
            server.push(0, name=name)
            write.wait_entered()
        server.push(0)
        server.wait_until(lambda: ("anyone", "room") in server.app.state.context.states._saving)
        assert server.push(1).json["status"] == "processed"
        server.open("another")
        assert len(server.call("GET", "/v1/sessions").json["sessions"]) == 4
        slow.clear()
        write.release(4)


@pytest.mark.slow
def test_large_messages_are_kept_as_pixels(tmp_path, monkeypatch):
    for module in ("journal", "session_folder"):
        monkeypatch.setattr(f"roomlight_server.state.{module}.MAX_MESSAGE_BYTES", 1000)
    with server_on(tmp_path / "state") as server:
        filled(server, count=3)
        light = lights(server)
        kept = copied(tmp_path / "state", tmp_path / "kept")
    assert not list(kept.rglob("*.frame"))
    with server_on(kept) as server:
        assert lights(server) == light


def test_messages_are_bounded_while_a_write_hangs():
    """Those of keyframes that the engine had dropped stayed."""
    journal = Journal(lambda: 0.0)
    for index in range(9):
        journal.processed(index, parse(frame(0)), keyframe=True, most=4)
    assert list(journal.messages) == [5, 6, 7, 8]


def test_stopping_saves_the_last_frames(tmp_path):
    with server_on(tmp_path / "state", state_interval_s=3600.0) as server:
        server.open()
        assert server.call("PUT", "/v1/sessions/room/probes/table", PROBE).status == 201
        server.push(0, frame(YAWS[0]))
        assert server.state()["frames"]["durable_index"] is None
        light = lights(server)
    with server_on(tmp_path / "state") as server:
        assert server.state()["frames"]["last_index"] == 0
        assert lights(server) == light


def test_a_failed_session_does_not_count_as_unsaved(tmp_path, monkeypatch, caplog):
    HeldSession.serve(monkeypatch)
    HeldSession.broken = {0: MemoryError()}
    HeldSession.release()
    with server_on(tmp_path / "state", state_interval_s=3600.0) as server:
        server.open()
        server.wait_until(lambda: _unsaved_s(server) == 0)
        assert server.push(0).kind == "engine-failed"
    assert "not saved" not in caplog.text


def test_idle_sessions_leave_memory_and_come_back(tmp_path):
    now_s = [1000.0]
    with server_on(tmp_path / "state", clock=lambda: now_s[0], idle_expiry_s=100.0) as server:
        server.open()
        now_s[0] += 10
        server.push(0, frame(YAWS[0]))

        def saved_later():
            now_s[0] += 0.1
            return server.state()["frames"]["durable_index"] == 0

        wait_until(saved_later)
        assert server.state()["idle_expiry_s"] == 86_400.0
        light = server.call("GET", f"/v1/sessions/room{LIGHTS[1]}").body
        with server.stream() as socket:
            # accepted before the session is looked up: it would be restored
            server.wait_until(lambda: "roomlight_streams 1.0" in server.call("GET", "/metrics").body.decode())
            now_s[0] += 201
            socket.send(frame(YAWS[1], index=1))
            for index in (1, None):
                message = json.loads(socket.recv())
                assert (message.get("index"), message["problem"]["status"]) == (index, 410)
                assert re.search("idle.* it is saved, and goes on", message["problem"]["detail"])
            assert server.call("GET", "/v1/sessions").json["sessions"][0]["status"] == "saved"
        assert idle_times(server)["room"] >= 200
        (state,) = (tmp_path / "state/sessions").glob("*/state")
        server.open("another")
        now_s[0] += 50
        os.utime(state)  # as one that another server has just used
        assert list(idle_times(server)) == ["room", "another"]
        assert server.call("GET", f"/v1/sessions/room{LIGHTS[1]}").body == light
        text = server.call("GET", "/metrics").body.decode()
        assert 'roomlight_sessions_ended_total{reason="saved"} 1.0' in text


@pytest.mark.parametrize(
    ("fails", "most"), [(False, 2), (True, 2), (True, 1)], ids=["slow disk", "full disk", "full disk and server"]
)
def test_an_idle_session_that_is_not_saved_is_kept_or_said_to_be_lost(tmp_path, monkeypatch, caplog, fails, most):
    """It left memory as one that is saved."""
    slow, now_s, original, is_kept = [], [1000.0], store.write_session, fails and most > 1
    write = Held(Mock(side_effect=FULL) if fails else original, lambda *_: slow)
    with server_on(tmp_path / "state", clock=lambda: now_s[0], idle_expiry_s=100.0, max_sessions=most) as server:
        server.open()
        server.wait_until(lambda: list((tmp_path / "state/sessions").glob("*/state")))
        monkeypatch.setattr(store, "write_session", write)
        slow.extend([] if fails else [True])
        now_s[0] += 1
        server.push(0)
        server.wait_until(lambda: write.calls or server.app.state.context.states.failing)
        now_s[0] += 201
        if is_kept:
            assert status(server) == "open"
            monkeypatch.setattr(store, "write_session", original)
            now_s[0] += 1
        wait_until(lambda: status(server) == "saved")  # or as it was before
        slow.clear()
        write.release()
        assert metric(server, f'roomlight_sessions_ended_total{{reason="{"saved" if is_kept else "lost"}"}}') == 1
    assert ("leaves memory before it is saved" in caplog.text) == (not is_kept)


def status(server):
    """Return the status of the only session."""
    (session,) = server.call("GET", "/v1/sessions").json["sessions"]
    return session["status"]


def idle_times(server):
    """Return the idle time of each session, in the order of the list."""
    return {one["id"]: one["idle_s"] for one in server.call("GET", "/v1/sessions").json["sessions"]}


@pytest.mark.slow
def test_sessions_of_the_default_model_on_disk_are_listed(tmp_path):
    with server_on(tmp_path, model="auto") as server:
        assert server.call("PUT", "/v1/sessions/room", {"height": 16}).json["model"] == "single"
        server.push(0, frame(YAWS[0]))
    with server_on(tmp_path, model="auto") as server:
        (listed,) = server.call("GET", "/v1/sessions").json["sessions"]
        assert (listed["model"], listed["status"]) == ("single", "saved")


def test_sessions_on_disk_are_listed(saved, tmp_path):
    folder = copied(saved[0], tmp_path / "state")
    with server_on(folder) as server:
        server.open("another")
        server.push(0, name="another")
        listed = {one["id"]: one for one in server.call("GET", "/v1/sessions").json["sessions"]}
        assert {name: one["status"] for name, one in listed.items()} == {"room": "saved", "another": "open"}
        state = saved[1]
        for field in ("model", "keyframes"):
            assert listed["room"][field] == state[field]
        assert listed["room"]["probes"] == ["table"]
        assert listed["room"]["frames"] == state["frames"]
        assert [key for key, _ in server.registry.items()] == [("anyone", "another")]  # listing restores nothing
        assert server.state()["frames"]["processed"] == 4
        listed = server.call("GET", "/v1/sessions").json["sessions"]
        assert [(one["id"], one["status"]) for one in listed] == [("room", "open"), ("another", "open")]
        assert server.call("DELETE", "/v1/sessions/room").status == 204
        assert [one["id"] for one in server.call("GET", "/v1/sessions").json["sessions"]] == ["another"]
    with server_on(folder, tokens=(TOKEN, OTHER)) as server:
        assert server.call("GET", "/v1/sessions", token=TOKEN).json["sessions"] == []


def test_a_damaged_file_is_not_listed(saved, tmp_path):
    folder = copied(saved[0], tmp_path / "state")
    state = next((folder / "sessions").glob("*/state"))
    for damage in (b"", state.read_bytes()[:60]):
        state.write_bytes(damage)
        with server_on(folder) as server:
            assert server.call("GET", "/v1/sessions").json["sessions"] == []


def test_saved_sessions_expire_while_others_are_saved(saved, tmp_path, monkeypatch):
    erase = Held(store.erase)
    monkeypatch.setattr(store, "erase", erase)
    folder, now_s = copied(saved[0], tmp_path / "state"), [1000.0]
    state = next((folder / "sessions").glob("*/state"))
    (folder / "another file").write_text("not ours")
    (folder / "sessions" / "link").symlink_to(tmp_path)
    with server_on(folder, clock=lambda: now_s[0], state_expiry_s=60.0) as server:

        def later(condition):
            now_s[0] += 0.1 * (folder / "ages.json").exists()
            return condition()

        server.open("another")
        server.wait_until(lambda: later(lambda: erase.calls))
        assert now_s[0] > 1060.0
        server.push(0, name="another")
        server.wait_until(lambda: later(lambda: server.state("another")["frames"]["durable_index"] == 0))
        erase.release()
        server.wait_until(lambda: not state.parent.exists())
        assert server.call("GET", "/v1/sessions/room").status == 404
    assert (folder / "another file").exists()
    assert (folder / "sessions" / "link").is_symlink()


def test_ages_count_the_time_of_servers_alone(tmp_path):
    now_s = 1000.0
    ages = SavedAges(tmp_path / "ages.json", lambda: now_s)
    assert ages.advance({"a": "1", "b": "1", "c": "1"}, ()) == {"a": 0.0, "b": 0.0, "c": 0.0}
    now_s += 60
    assert ages.advance({"a": "1", "b": "2", "c": "1"}, {"c"}) == {"a": 60.0, "b": 0.0, "c": 0.0}
    now_s = 5.0  # another server: the machine was off for a year
    ages = SavedAges(tmp_path / "ages.json", lambda: now_s)
    now_s += 10
    assert ages.advance({"a": "1", "b": "2"}, ()) == {"a": 70.0, "b": 10.0}
    now_s -= 5  # a clock that is set back makes nothing younger
    assert ages.advance({"a": "1", "b": "2"}, ()) == {"a": 70.0, "b": 10.0}
    for damaged in ("", "[]", '{"a": 1}', '{"a": ["1", "x"]}'):
        (tmp_path / "ages.json").write_text(damaged)
        assert SavedAges(tmp_path / "ages.json", lambda: now_s).advance({"a": "1"}, ()) == {"a": 0.0}


def test_the_folder_of_a_session_is_not_followed_if_it_is_a_link(saved, tmp_path):
    """A linked folder was followed, and files in it that the session did not name were removed."""
    folder = copied(saved[0], tmp_path / "state")
    session = next((folder / "sessions").glob("*"))
    elsewhere = tmp_path / "elsewhere"
    session.rename(elsewhere)
    (elsewhere / "notes.txt").write_text("not ours")
    session.symlink_to(elsewhere)
    with server_on(folder) as server:
        assert server.call("GET", "/v1/sessions").json["sessions"] == []
        assert server.call("GET", "/v1/sessions/room").kind == "state-refused"
        assert server.call("DELETE", "/v1/sessions/room").status == 204
        assert not session.exists()
    assert (elsewhere / "notes.txt").exists()
    assert (elsewhere / "state").exists()


def test_a_waiting_frame_is_left_to_the_client(tmp_path, monkeypatch):
    HeldSession.serve(monkeypatch)
    with server_on(tmp_path / "state") as server:
        server.open()
        HeldSession.release()
        assert server.push(0, frame(YAWS[0])).status == 200
        HeldSession.wait_entered()
        later = [InThread(server.push, 1, frame(YAWS[1]))]
        HeldSession.wait_entered()  # frame 1 is being processed
        for index in (2, 3):
            later.append(InThread(server.push, index, frame(YAWS[index])))
            server.wait_until_accepted(index)
        assert later[1].result().json["status"] == "superseded"
        skipped = frame(YAWS[4], tracking_state="limited")
        assert server.push(5, skipped).json["status"] == "skipped"
        live = dict(server.registry.items())["anyone", "room"]
        saved = live._queue.saved()
        assert saved.last_index == 2  # 3 waits, and 5 came after it
        assert (saved.counts["superseded"], saved.counts["skipped"], saved.counts["gaps"]) == (1, 0, 0)
        HeldSession.release(2)
        assert later[2].result().json["status"] == "processed"
        assert live._queue.saved().last_index == 5
        assert live._queue.saved().counts["gaps"] == 1


def test_gaps_after_a_first_frame_that_waits_are_left_to_the_client():
    async def main():
        queue = FrameQueue()
        for index, message in ((3, parse(frame(0))), (6, None), (8, None)):
            queue.accept(Entry(index, b"", message=message))
        return queue.counts(), queue.saved()

    counts, saved = asyncio.run(main())
    assert (counts.gaps, counts.skipped) == (3, 2)
    assert saved.last_index is None
    assert (saved.counts["gaps"], saved.counts["skipped"]) == (0, 0)


def test_without_a_directory_nothing_is_durable():
    with RunningServer() as server:
        server.open()
        assert server.push(0).json["durable_index"] is None
        assert server.state()["frames"]["durable_index"] is None
        assert "state" not in server.call("GET", "/readyz").json


def test_a_directory_without_locks_is_not_said_to_be_used(tmp_path, monkeypatch):
    monkeypatch.setattr("fcntl.flock", Mock(side_effect=OSError(errno.ENOLCK, "No locks available")))
    with pytest.raises(ServerError, match=r"state: cannot be locked \(No locks available\); choose a folder"):
        server_on(tmp_path / "state")


def test_a_directory_that_cannot_be_used_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ServerError, match=r"state_dir: .*file: cannot be used"):
        create_app(ServerSettings(state_dir=tmp_path / "file"))
