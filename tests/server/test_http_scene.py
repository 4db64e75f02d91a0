"""Title and placed objects of a session: the same for all who look at it, within limits, and on disk."""

import pytest

from http_servers import OTHER, TOKEN, RunningServer, server_on
from roomlight.wire.compositing import MAX_COMPOSITE_OBJECTS

SCENE = "/v1/sessions/room/scene"
BALL = {"name": "ball", "shape": "sphere", "size_m": 0.4, "position": [0.2, 1.1, -0.4]}
KEPT = {"title": "Kitchen, Küche", "objects": [BALL]}


def stated(scene):
    """Return a scene without the fields that have their default."""
    plain = (None, 0.0, "y")
    objects = [{key: item[key] for key in item if item[key] not in plain} for item in scene["objects"]]
    return {**scene, "objects": objects}


def test_everyone_who_looks_at_a_session_sees_what_was_kept_last():
    with RunningServer() as server:
        server.open()
        empty = server.call("GET", SCENE)
        assert empty.json == {"title": "", "objects": []}
        assert server.call("PUT", SCENE, KEPT).status == 200
        seen = server.call("GET", SCENE, headers={"If-None-Match": empty.headers["etag"]})
        assert stated(seen.json) == KEPT
        assert server.call("GET", SCENE, headers={"If-None-Match": seen.headers["etag"]}).status == 304
        assert server.call("GET", "/v1/sessions").json["sessions"][0]["title"] == KEPT["title"]
        server.push(0)
        assert server.call("POST", "/v1/sessions/room/composite", {"objects": seen.json["objects"]}).status == 200
        assert server.call("PUT", SCENE, {}).json == empty.json


def test_a_scene_that_was_changed_since_it_was_read_is_not_replaced():
    with RunningServer() as server:
        server.open()
        read = {"If-Match": server.call("GET", SCENE).headers["etag"]}
        kept = server.call("PUT", SCENE, KEPT, headers=read)
        assert kept.headers["etag"] == server.call("GET", SCENE).headers["etag"] != read["If-Match"]
        late = server.call("PUT", SCENE, {}, headers=read)
        assert (late.status, late.kind, late.json["field"]) == (412, "scene-changed", "If-Match")
        assert stated(server.call("GET", SCENE).json) == KEPT
        assert server.call("PUT", SCENE, {}, headers={"If-Match": f"W/{kept.headers['etag']}"}).status == 200


def test_another_token_reads_and_writes_its_own_sessions_alone():
    with RunningServer(tokens=(TOKEN, OTHER)) as server:
        server.open(token=TOKEN)
        for method, body in (("GET", None), ("PUT", KEPT)):
            assert server.call(method, SCENE, body, token=OTHER).kind == "session-not-found"
        assert server.call("GET", SCENE, token=TOKEN).json["objects"] == []


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        ({"title": "x" * 81}, "80"),
        ({"title": "two\nlines"}, "title"),
        ({"objects": [{**BALL, "position": None, "pixel": [3, 4]}]}, "a pixel belongs to one frame"),
        ({"objects": [BALL] * (MAX_COMPOSITE_OBJECTS + 1)}, str(MAX_COMPOSITE_OBJECTS)),
        ({"objects": [{**BALL, "size_m": -1}]}, "size_m"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_what_a_scene_cannot_have_is_refused_with_the_rule(server, scene, said):
    server.open()
    server.call("PUT", SCENE, KEPT)
    refused = server.call("PUT", SCENE, scene)
    assert (refused.status, refused.kind) == (422, "invalid")
    assert said in refused.body.decode()
    assert stated(server.call("GET", SCENE).json) == KEPT


def test_a_scene_is_saved_with_its_session(tmp_path):
    with server_on(tmp_path / "state") as server:
        server.open()
        server.push(0)
        server.call("PUT", SCENE, KEPT)
    with server_on(tmp_path / "state") as server:
        listed = server.call("GET", "/v1/sessions").json["sessions"]
        assert [(item["title"], item["status"]) for item in listed] == [(KEPT["title"], "saved")]
        assert stated(server.call("GET", SCENE).json) == KEPT
