"""Phones on real sockets: a code pairs one phone, each has sessions of its own, and who paired them sees all."""

import inspect
import json
import os
import signal
import stat
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from http_servers import SMALL, TETRAHEDRON, RunningServer, frame, metric
from roomlight.errors import ServerError
from roomlight_server.base.problems import ProblemError
from roomlight_server.serving import _phone_link
from roomlight_server.transport.phones import LINK_S, MAX_PHONES, Phones
from server_processes import BOUND_S, Process

OPERATOR, OTHER = "the-token-of-the-operator", "a-token-of-somebody-else"
DAY_S = 86_400.0


@pytest.fixture
def server(tmp_path):
    with running(on_lan=True, phones_file=tmp_path / "phones.json") as made:
        yield made


def running(**settings):
    return RunningServer(tokens=(OPERATOR, OTHER), public_url="https://room.local:8090", **settings)


def code_of(server, token=OPERATOR):
    return server.call("POST", "/v1/pairing", token=token).json["url"].partition("/phone#pair=")[2]


def paired(server, token=OPERATOR):
    answer = server.call("POST", "/v1/phones", {"code": code_of(server, token)})
    assert (answer.status, answer.headers["cache-control"]) == (201, "no-store")
    return answer.json["id"], answer.json["token"]


def listed(server, token):
    return [each["id"] for each in server.call("GET", "/v1/sessions", token=token).json["sessions"]]


def test_phones_neither_read_nor_delete_sessions_of_others(server):
    (_, first), (_, second) = paired(server), paired(server)
    server.open("of-first", token=first)
    server.push(0, name="of-first", token=first)
    for stranger in (second, OTHER):
        assert listed(server, stranger) == []
        for method, path in (("GET", ""), ("DELETE", ""), ("GET", "/camera"), ("GET", "/colour")):
            assert server.call(method, f"/v1/sessions/of-first{path}", token=stranger).kind == "session-not-found"
        assert server.push(1, name="of-first", token=stranger).kind == "session-not-found"
    assert server.open("of-first", token=second).status == 201  # an id of its own
    assert listed(server, first) == ["of-first"]


def test_the_operator_uses_and_deletes_what_its_phones_have(server):
    _, phone = paired(server)
    server.open("room", token=phone)
    server.push(0, token=phone)
    assert listed(server, OPERATOR) == ["room"]
    assert server.call("GET", "/v1/sessions/room/colour", token=OPERATOR).status == 200
    assert server.open(token=OPERATOR).status == 200  # it joins
    with server.stream(token=OPERATOR) as stream:
        stream.send(json.dumps({"type": "track", "name": "table", "position": [0, 1, 0]}))
        assert json.loads(stream.recv())["probes"] == {"table": [0.0, 1.0, 0.0]}
    assert list(server.state(token=phone)["probes"]) == ["table"]
    assert server.call("DELETE", "/v1/sessions/room", token=OPERATOR).status == 204
    assert listed(server, phone) == []


def test_the_operator_uses_and_deletes_objects_and_recordings_of_its_phones(server):
    """Its list of objects and recordings was empty, and a phone's object could not be put into a phone's session."""
    (_, phone), (_, second) = paired(server), paired(server)
    kind = {"Content-Type": "model/obj"}
    uploaded = [
        server.call("POST", "/v1/objects", TETRAHEDRON, token=token, headers=kind).json for token in (phone, second)
    ]
    recorded = server.call("POST", "/v1/recordings", {"name": "hall", "bytes": 10, "files": 1}, token=phone).json
    for path, key, made in (("objects", "objects", uploaded[0]), ("recordings", "recordings", recorded)):
        seen = server.call("GET", f"/v1/{path}", token=OPERATOR).json
        assert ([item["id"] for item in seen[key]], seen["bytes"]) == ([made["id"]], 0)
        assert server.call("GET", f"/v1/{path}", token=OTHER).json[key] == []
        assert server.call("GET", f"/v1/{path}/{made['id']}", token=OTHER).status == 404
        assert server.call("GET", f"/v1/{path}/{made['id']}", token=OPERATOR).json["id"] == made["id"]
    assert server.call("GET", "/v1/recordings", token=second).json["recordings"] == []
    assert server.call("GET", "/v1/objects", token=second).json["bytes"] == uploaded[1]["bytes"]
    assert server.call("DELETE", f"/v1/recordings/{recorded['id']}", token=OPERATOR).status == 204
    assert server.call("GET", "/v1/recordings", token=phone).json["recordings"] == []
    for _ in range(2):  # one of each phone
        assert server.call("DELETE", f"/v1/objects/{uploaded[0]['id']}", token=OPERATOR).status == 204
    assert server.call("GET", f"/v1/objects/{uploaded[0]['id']}", token=phone).kind == "object-not-found"


def test_an_id_that_several_phones_have_is_named(server):
    phones = [paired(server) for _ in range(2)]
    for _, token in phones:
        server.open("room", token=token)
    answer = server.call("GET", "/v1/sessions/room", token=OPERATOR)
    assert answer.kind == "session-conflict"
    assert all(phone in answer.json["detail"] for phone, _ in phones)
    assert listed(server, OPERATOR) == ["room", "room"]


def test_a_code_works_once_and_for_ten_minutes():
    passed_s = 0.0
    with RunningServer(clock=lambda: passed_s, tokens=(OPERATOR,), public_url="https://room.local") as server:
        used, late = code_of(server), code_of(server)
        assert server.call("POST", "/v1/phones", {"code": used}).status == 201
        passed_s = LINK_S + 1
        for code in (used, late, "guessed"):
            answer = server.call("POST", "/v1/phones", {"code": code})
            assert (answer.status, answer.kind) == (401, "unauthorized")
            assert "10 minutes" in answer.json["detail"]
        assert metric(server, 'roomlight_unauthorized_total{reason="wrong"}') == 3


def test_a_page_of_another_site_pairs_nothing(server):
    headers = {"Origin": "https://evil.example"}
    assert server.call("POST", "/v1/phones", {"code": code_of(server)}, headers=headers).kind == "forbidden-origin"


def test_phones_pair_and_list_none(server):
    phone, token = paired(server)
    paths = (("POST", "/v1/pairing"), ("GET", "/v1/phones"), ("DELETE", f"/v1/phones/{phone}"), ("GET", "/metrics"))
    for method, path in paths:
        assert server.call(method, path, token=token).kind == "operator-only"
    assert [each["id"] for each in server.call("GET", "/v1/phones", token=OPERATOR).json["phones"]] == [phone]
    assert server.call("GET", "/v1/phones", token=OTHER).json == {"phones": []}
    assert server.call("DELETE", f"/v1/phones/{phone}", token=OTHER).kind == "phone-not-found"


def test_a_removed_phone_is_disconnected_and_its_sessions_stay(server):
    phone, token = paired(server)
    server.open("room", token=token)
    with server.stream(token=token) as stream:
        stream.send(json.dumps({"type": "track", "name": "table", "position": [0, 1, 0]}))
        stream.recv()
        assert server.call("DELETE", f"/v1/phones/{phone}", token=OPERATOR).status == 204
        with pytest.raises(ConnectionClosed):
            stream.recv()
    assert server.call("GET", "/v1/sessions", token=token).kind == "unauthorized"
    assert listed(server, OPERATOR) == ["room"]


def test_phones_and_their_saved_sessions_survive_a_restart(tmp_path):
    with running(state_dir=tmp_path) as server:
        (_, kept), (gone, removed) = paired(server), paired(server)
        for number, token in enumerate((kept, removed)):
            server.open(f"room-{number}", token=token)
            server.push(0, name=f"room-{number}", token=token)
        server.call("DELETE", f"/v1/phones/{gone}", token=OPERATOR)
    stored = tmp_path / "phones.json"
    assert stat.S_IMODE(stored.stat().st_mode) == 0o600
    assert not [token for token in (kept, removed, OPERATOR) if token in stored.read_text()]
    with running(state_dir=tmp_path) as server:
        assert listed(server, kept) == ["room-0"]
        assert server.call("GET", "/v1/sessions", token=removed).status == 401
        assert sorted(listed(server, OPERATOR)) == ["room-0", "room-1"]
        assert server.state("room-1", token=OPERATOR)["frames"]["last_index"] == 0
        assert server.call("DELETE", "/v1/sessions/room-1", token=OPERATOR).status == 204
        assert listed(server, OPERATOR) == ["room-0"]


def test_a_token_of_a_phone_expires():
    now_s = 1e9
    phones = Phones(None, expiry_s=30 * DAY_S, now=lambda: now_s)
    phone, token = phones.pair(phones.link("operator"))
    now_s += 29 * DAY_S
    assert phones.find(token) == phone
    now_s += 2 * DAY_S
    assert phones.find(token) is None
    assert phones.listed("operator") == []
    assert phones.owners("operator") == [phone.owner]


def test_the_number_of_phones_is_limited_and_a_server_starts_all_the_same(caplog):
    phones = Phones(None, expiry_s=DAY_S)
    phone, _ = [phones.pair(phones.link("operator")) for _ in range(MAX_PHONES)][-1]
    with pytest.raises(ProblemError, match="remove one first"):
        phones.link("operator")
    settings = SimpleNamespace(on_lan=True, tokens=("a token",))
    context = SimpleNamespace(settings=settings, phones=phones, tokens=SimpleNamespace(owners=["operator"]))
    with caplog.at_level("WARNING"):
        assert inspect.unwrap(_phone_link)(context, "https://box.lan:8090") is None
    assert "no phone can be paired: at most 64 phones are paired; remove one first" in caplog.text
    phones.revoke("operator", phone.id)
    assert "/phone#pair=" in inspect.unwrap(_phone_link)(context, "https://box.lan:8090")


def test_servers_that_share_a_file_keep_the_phones_of_each_other(tmp_path, monkeypatch):
    """Two servers of one user lost the phones that the other had paired, and served those that it had removed."""
    file, operator = tmp_path / "state" / "phones.json", "operator"
    first, second = Phones(file, expiry_s=DAY_S), Phones(file, expiry_s=DAY_S)
    paired = [phones.pair(phones.link(operator)) for phones in (first, second, first)]
    with monkeypatch.context() as unreadable:
        unreadable.setattr("roomlight_server.transport.phones._read", Mock(side_effect=OSError))
        assert second.find(paired[2][1]) is None
    for phones in (first, second, Phones(file, expiry_s=DAY_S)):
        assert all(phones.find(token) for _, token in paired)
    second.revoke(operator, paired[0][0].id)
    assert first.find(paired[0][1]) is None
    first.revoke(operator, paired[1][0].id)
    second.pair(second.link(operator))
    for phones in (first, second, Phones(file, expiry_s=DAY_S)):
        assert [bool(phones.find(token)) for _, token in paired] == [False, False, True]


def test_a_damaged_file_of_phones_is_named(tmp_path):
    (tmp_path / "phones.json").write_text('{"a": {}}')
    with pytest.raises(ServerError, match="pair the phones again"):
        Phones(tmp_path / "phones.json", expiry_s=DAY_S)


@pytest.mark.slow
def test_sighup_reads_the_tokens_again(tmp_path):
    """Without a terminal: the token that is gone is refused and its stream ends, the new one is accepted."""
    tokens = tmp_path / "tokens"
    tokens.write_text(f"{OPERATOR}\n{OTHER}\n")
    with Process("--token-file", str(tokens)) as server:
        assert server.call("PUT", "/v1/sessions/room", SMALL, token=OTHER)[0] == 201
        url = f"ws://127.0.0.1:{server.port}/v1/sessions/room/stream"
        with connect(url, additional_headers={"Authorization": f"Bearer {OTHER}"}, compression=None) as stream:
            stream.send(frame(0))
            stream.recv(timeout=BOUND_S)
            tokens.write_text("short\n")
            os.kill(server.pid, signal.SIGHUP)
            server.wait_for_line("the tokens stay as they are")
            assert server.call("GET", "/v1/sessions", token=OTHER)[0] == 200
            tokens.write_text(f"{OPERATOR}\na-third-token-that-is-new\n")
            os.kill(server.pid, signal.SIGHUP)
            with pytest.raises(ConnectionClosed):
                stream.recv(timeout=BOUND_S)
        assert server.call("GET", "/v1/sessions", token=OTHER)[0] == 401
        assert server.call("GET", "/v1/sessions", token=OPERATOR)[0] == 200
        assert server.call("GET", "/v1/sessions", token="a-third-token-that-is-new")[0] == 200
