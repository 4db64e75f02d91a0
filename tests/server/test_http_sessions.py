"""Sessions over a real socket: opening, joining, ownership, expiry, limits."""

import pytest

from http_servers import OTHER, SMALL, TOKEN, RunningServer, frame
from roomlight.engine.networks.graphs import SHIPPED


def test_opening_with_the_same_options_changes_nothing(server):
    first = server.open("twice")
    again = server.open("twice")
    assert (first.status, again.status) == (201, 200)
    assert first.json == again.json
    assert server.call("PUT", "/v1/sessions/default").json["options"]["model"] == "auto"


@pytest.mark.parametrize(
    ("changes", "field", "value", "rule"),
    [
        ({"height": 32}, "height", "32", "must be 16, as when the session was opened"),
        ({"model": "auto"}, "model", '"auto"', 'must be "classical", as when the session was opened'),
        ({"reference_exposure": None}, "reference_exposure", "null", "must be 1.0, as when the session was opened"),
        ({"use_limited_tracking": True}, "use_limited_tracking", "true", "must be false, as when"),
    ],
)
def test_a_conflict_names_the_option_and_both_values(server, changes, field, value, rule):
    server.open("taken")
    other = server.call("PUT", "/v1/sessions/taken", SMALL | changes)
    assert (other.status, other.kind) == (409, "session-conflict")
    assert (other.json["field"], other.json["value"]) == (field, value)
    assert other.json["rule"].startswith(rule)


def test_a_conflict_lists_every_option_that_differs(server):
    server.open("taken")
    other = server.call("PUT", "/v1/sessions/taken", SMALL | {"height": 32, "min_confidence": 2})
    assert "height 16 (requested: 32), min_confidence 1 (requested: 2)" in other.json["detail"]
    assert other.json["field"] == "height"


def test_a_session_is_joined_by_its_id_alone(server):
    opened = server.open("shared", SMALL | {"height": 24})
    joined = server.call("GET", "/v1/sessions/shared")
    assert joined.status == 200
    assert joined.json == opened.json
    assert joined.json["options"]["height"] == 24
    again = server.call("PUT", "/v1/sessions/shared", joined.json["options"])
    assert again.status == 200


def test_the_state_has_memory_and_its_upper_bound(server):
    server.open("sized")
    empty = server.state("sized")
    assert empty["memory"]["bytes"] == 0
    assert empty["volume"] is None
    server.push(0, name="sized")
    state = server.state("sized")
    assert 10**6 < state["memory"]["bytes"] < state["memory"]["bound_bytes"] == empty["memory"]["bound_bytes"]
    assert state["volume"]["shape"] == [64, 60, 84]
    assert state["frames"] == {
        "accepted": 1, "processed": 1, "superseded": 0, "skipped": 0, "queued": 0, "gaps": 0, "replayed": 0,
        "refused": 0, "last_index": 0, "durable_index": None,
    }  # fmt: skip


def test_deleting_ends_a_session(server):
    server.open("brief")
    assert server.call("DELETE", "/v1/sessions/brief").status == 204
    for method, path in (("GET", ""), ("DELETE", ""), ("PUT", "/frames/0"), ("GET", "/probe?x=0&y=0&z=0")):
        answer = server.call(method, f"/v1/sessions/brief{path}", frame() if method == "PUT" else None)
        assert (answer.status, answer.kind) == (404, "session-not-found")


@pytest.mark.parametrize("name", ["a.b", "%2e%2e", "a%20b", "a%0a", "%C3%A9", "x" * 65, "a%00", "*"])
def test_a_session_id_with_other_characters_is_rejected(server, name):
    answer = server.call("PUT", f"/v1/sessions/{name}", SMALL)
    assert (answer.status, answer.json["field"]) == (422, "session_id")


@pytest.mark.parametrize(
    "path", ["/v1/sessions/..%2f..%2fetc", "/v1/sessions/a%2f", "/v1/sessions/", "/../x", "/nothing"]
)
def test_an_unknown_path_is_not_found(server, path):
    answer = server.call("PUT", path, SMALL)
    assert answer.status == 404
    assert answer.kind == "not-found"
    assert answer.json["detail"].startswith("PUT /")


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"model": "magic"}, "model"),
        ({"height": 8}, "height"),
        ({"height": 120.5}, "height"),
        ({"height": "120"}, "height"),
        ({"reference_exposure": 0}, "reference_exposure"),
        ({"hieght": 120}, "hieght"),
    ],
)
def test_an_invalid_option_is_rejected_by_name(server, options, field):
    answer = server.call("PUT", "/v1/sessions/picky", options)
    assert (answer.status, answer.kind, answer.json["field"]) == (422, "invalid", field)
    assert answer.json["rule"]
    assert server.call("GET", "/v1/sessions/picky").status == 404


def test_the_old_name_of_the_model_is_refused_with_a_hint(server):
    opened = server.call("PUT", "/v1/sessions/old", {"mode": "single"})
    replayed = server.call("PUT", "/v1/recordings/r-0123456789abcdef/replay", {"session": "old", "mode": "single"})
    for answer in (opened, replayed):
        assert (answer.status, answer.json["field"]) == (422, "mode")
        assert answer.json["rule"] == "`mode` is called `model`"


def test_a_body_that_is_not_json_is_rejected(server):
    for body in (b"{", b"\xff", b"[" * 5000, b'{"height": ' + b"9" * 5000 + b"}", b'{"reference_exposure": NaN}'):
        answer = server.call("PUT", "/v1/sessions/json", body, headers={"Content-Type": "application/json"})
        assert answer.status in (400, 422)
        assert answer.kind in ("bad-request", "invalid")
    long = server.call("PUT", "/v1/sessions/json", b" " * 70_000, headers={"Content-Type": "application/json"})
    assert (long.status, long.kind) == (413, "too-large")


def test_text_that_is_not_json_is_named_with_its_place(server):
    headers = {"Content-Type": "application/json"}
    answer = server.call("PUT", "/v1/sessions/new", b'{"height": }', headers=headers)
    assert (answer.status, answer.json["field"], answer.json["value"]) == (422, "body", "'}'")
    assert answer.json["detail"] == "body: must be JSON (expecting value at character 11)"


def test_a_session_belongs_to_the_token_that_opened_it():
    with RunningServer(tokens=(TOKEN, OTHER)) as server:
        mine, yours = TOKEN, OTHER
        basic = {"Authorization": "Basic x"}
        for token, headers in ((None, None), ("third-token-of-this-test", None), ("", None), (None, basic)):
            answer = server.call("PUT", "/v1/sessions/room", SMALL, token=token, headers=headers)
            assert (answer.status, answer.kind) == (401, "unauthorized")
            assert answer.headers["www-authenticate"] == "Bearer"
        assert server.open(token=mine).status == 201
        assert server.call("GET", "/v1/sessions/room", token=yours).status == 404
        assert server.open(token=yours).status == 201  # another session of the same id
        server.push(0, token=mine)
        assert server.state(token=mine)["frames"]["processed"] == 1
        assert server.state(token=yours)["frames"]["processed"] == 0
        assert server.call("DELETE", "/v1/sessions/room", token=yours).status == 204
        assert server.call("GET", "/v1/sessions/room", token=mine).status == 200
        for path in ("/healthz", "/readyz", "/metrics", "/openapi.json"):
            assert server.call("GET", path).status in (200, 503)


def test_idle_sessions_expire_and_used_ones_do_not():
    now_s = [1000.0]
    with RunningServer(clock=lambda: now_s[0], idle_expiry_s=100.0) as server:
        server.open("used")
        server.open("idle")
        now_s[0] += 60
        assert server.state("used")["status"] == "open"
        now_s[0] += 60
        assert server.call("GET", "/v1/sessions/used").status == 200
        assert server.call("GET", "/v1/sessions/idle").status == 404
        text = server.call("GET", "/metrics").body.decode()
        assert 'roomlight_sessions_ended_total{reason="expired"} 1.0' in text
        assert "\nroomlight_sessions 1.0" in text


def test_a_full_server_answers_with_retry_after():
    now_s = [1000.0]
    with RunningServer(clock=lambda: now_s[0], max_sessions=2, idle_expiry_s=30.0) as server:
        server.open("one")
        server.open("two")
        full = server.call("PUT", "/v1/sessions/three", SMALL)
        assert (full.status, full.kind) == (503, "server-full")
        assert full.headers["retry-after"] == "30"
        assert all(name in full.json["detail"] for name in ("GET /v1/sessions", "--max-sessions", "--idle-expiry-s"))
        assert server.open("one").status == 200
        server.call("DELETE", "/v1/sessions/two")
        assert server.open("three").status == 201
        now_s[0] += 31
        assert server.open("four").status == 201


def test_a_session_that_could_grow_too_large_is_rejected():
    with RunningServer(max_session_bytes=230 * 2**20) as server:
        assert server.open("low").status == 201
        answer = server.call("PUT", "/v1/sessions/high", SMALL | {"height": 512})
        assert (answer.status, answer.json["field"]) == (422, "height")


def test_an_allowed_origin_opens_a_session():
    with RunningServer(allow_origins=("https://app.example",)) as server:
        headers = {"Origin": "https://app.example"}
        answer = server.call("PUT", "/v1/sessions/page", SMALL, headers=headers)
        assert answer.status == 201
        assert answer.headers["access-control-allow-origin"] == "https://app.example"
        assert "Upload-Offset" in answer.headers["access-control-expose-headers"]
        for path, name in (("sessions/page", "authorization"), ("recordings/r-0/files/a", "upload-offset")):
            asked = {"Access-Control-Request-Method": "PUT", "Access-Control-Request-Headers": name}
            assert server.call("OPTIONS", f"/v1/{path}", headers=headers | asked).status == 200
        refused = server.call("OPTIONS", "/v1/sessions/page", headers={**asked, "Origin": "https://other.example"})
        assert (refused.status, refused.kind) == (403, "forbidden-origin")
        assert "allow_origins" in refused.json["detail"]


def test_an_unknown_method_is_answered_with_the_allowed_ones(server):
    answer = server.call("PATCH", "/v1/sessions/room")
    assert (answer.status, answer.kind, answer.headers["allow"]) == (
        405,
        "method-not-allowed",
        "DELETE, GET, HEAD, PUT",
    )
    assert answer.json["detail"] == "PATCH /v1/sessions/room: Method Not Allowed"


def test_a_model_without_weights_is_answered_with_409():
    with RunningServer(weights=SHIPPED / "single") as server:
        answer = server.call("PUT", "/v1/sessions/untrained", {"model": "video"})
        assert (answer.status, answer.kind, answer.json["field"]) == (409, "model-not-here", "model")
        assert "auto" in answer.json["rule"]
        assert server.call("GET", "/v1/sessions/untrained").status == 404


def test_a_session_has_the_model_that_it_asks_for():
    with RunningServer() as server:
        for model in ("classical", "single", "video"):
            opened = server.call("PUT", f"/v1/sessions/{model}", SMALL | {"model": model})
            assert (opened.status, opened.json.get("model")) == (201, model), opened
