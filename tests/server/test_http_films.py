"""Films of uploaded recordings with objects in them: limits, progress, the file, cancelling, what is refused."""

import io
import json
import shutil

import av
import pytest

from http_servers import OTHER, TOKEN, RunningServer
from roomlight import sample_capture
from roomlight.wire.recordings import MAX_FILM_FRAMES
from roomlight_server.recordings import film as recording_film
from roomlight_server.recordings.worker import film_rate

URL = "/v1/recordings"
SPHERE = {"shape": "sphere", "size_m": 0.2, "material": {"kind": "mirror"}, "position": [-1.9, 0.2, -0.5]}
FILM = {"objects": [SPHERE], "frames": 2}


@pytest.fixture
def server(tmp_path):
    with RunningServer(recordings_folder=tmp_path) as running:
        yield running


def add(server, frames=4, **more):
    """Upload the first frames of the sample room and return the URL of the recording."""
    index = json.loads((sample_capture() / "capture.json").read_text())
    index["frames"], index["probes"] = index["frames"][:frames], []
    named = {path for frame in index["frames"] for path in frame.values() if isinstance(path, str)}
    files = {path: (sample_capture() / path).read_bytes() for path in sorted(named)}
    files["capture.json"] = json.dumps(index).encode()
    body = {"name": "room", "bytes": sum(map(len, files.values())), "files": len(files)}
    url = f"{URL}/{server.call('POST', URL, body, **more).json['id']}"
    for path, data in files.items():
        assert server.call("PUT", f"{url}/files/{path}", data, **more).status == 200
    return url


def settled(server, url, **more):
    """Wait until the film is no longer being made, and return it."""
    while (film := server.call("GET", url, **more).json["film"])["status"] in ("reading", "making"):
        assert film["frame"] <= max(film["frames"], 0)
    return film


@pytest.mark.slow
def test_a_film_has_the_frames_that_were_asked_for(server):
    url = add(server)
    answer = server.call("PUT", f"{url}/film", FILM | {"first": 1})
    assert (answer.status, answer.json["film"]["status"]) == (202, "reading")
    assert server.call("GET", f"{url}/film").kind == "film-not-found"
    film = settled(server, url)
    assert (film["status"], film["frame"], film["frames"], film["problem"]) == ("ready", 2, 2, None)
    made = server.call("GET", f"{url}/film")
    assert (made.status, made.headers["content-type"], len(made.body)) == (200, "video/mp4", film["bytes"])
    with av.open(io.BytesIO(made.body), "r") as container:
        stream = container.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert stream.average_rate == 3
    assert [picture.shape for picture in pictures] == [(240, 320, 3)] * 2
    taken = server.call("GET", URL).json["bytes"]
    assert server.call("DELETE", f"{url}/film").json["film"] is None
    assert server.call("GET", f"{url}/film").kind == "film-not-found"
    assert taken - server.call("GET", URL).json["bytes"] == film["bytes"]


@pytest.mark.slow
def test_a_film_is_stopped_and_replaced(server):
    url = add(server)
    root = next(server.settings.recordings_folder.iterdir())
    body = FILM | {"frames": MAX_FILM_FRAMES}
    assert server.call("PUT", f"{url}/film", body).status == 202
    for busy in (url, add(server)):  # the recording itself, the server
        refused = server.call("PUT", f"{busy}/film", body)
        assert (refused.status, refused.kind, refused.headers["retry-after"]) == (429, "film-running", "30")
    assert "at most 1 films" in refused.json["rule"]
    while server.call("GET", url).json["film"]["status"] != "making":
        pass
    assert server.call("DELETE", f"{url}/film").json["film"] is None
    assert not list(root.glob("*-film"))
    assert server.call("PUT", f"{url}/film", FILM).status == 202
    assert server.call("DELETE", url).status == 204  # stops the film first
    assert not list(root.glob("*-film"))


@pytest.mark.slow
def test_a_film_begins_before_the_end(server):
    url = add(server)
    assert server.call("PUT", f"{url}/film", FILM | {"first": 4}).status == 202  # the recording is not opened yet
    film = settled(server, url)
    assert film["status"] == "failed"
    assert "no usable frame from number 4 on" in film["problem"]["detail"]
    server.call("PUT", f"{url}/replay", {"session": "room", "model": "classical", "height": 16, "fps": 60})
    while (described := server.call("GET", url).json)["status"] == "playing":
        pass
    assert (described["film_frames"], described["film_fps"]) == (4, pytest.approx(3.0))
    answer = server.call("PUT", f"{url}/film", FILM | {"first": 4})
    assert (answer.status, answer.json["field"], answer.json["value"]) == (422, "first", "4")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "reason"), [({"composite_timeout_s": 0.01}, "more than 0.01 s"), ({}, "capture.json")]
)
def test_a_film_that_fails_says_why(tmp_path, settings, reason):
    with RunningServer(recordings_folder=tmp_path, **settings) as server:
        url = add(server)
        if not settings:
            next(tmp_path.glob("*/r-*/capture.json")).write_text("{")
        assert server.call("PUT", f"{url}/film", FILM).status == 202
        film = settled(server, url)
        assert film["status"] == "failed"
        assert reason in film["problem"]["detail"]
        assert str(tmp_path) not in film["problem"]["detail"]
        assert not list(tmp_path.glob("*/*-film"))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"frames": MAX_FILM_FRAMES + 1}, "frames"),
        ({"frames": 0}, "frames"),
        ({"first": -1}, "first"),
        ({"objects": []}, "objects"),
        ({"objects": [{"shape": "cube", "size_m": 0.1, "pixel": [1, 1]}]}, "a pixel belongs to one frame"),
        ({"quality": "best"}, "quality"),
    ],
)
def test_values_out_of_range_are_refused(server, change, field):
    answer = server.call("PUT", f"{add(server, 1)}/film", FILM | change)
    assert (answer.status, answer.kind) == (422, "invalid")
    assert field in answer.json["detail"]


def test_what_is_not_there_is_refused(server):
    url = add(server, 1)
    answer = server.call("PUT", f"{url}/film", {"objects": [{"object": "0" * 64, "position": [0, 0, 0]}]})
    assert answer.kind == "object-not-found"
    started = server.call("POST", URL, {"name": "a", "bytes": 3, "files": 1}).json["id"]
    assert server.call("PUT", f"{URL}/{started}/film", FILM).kind == "recording-not-ready"
    for method in ("PUT", "GET", "DELETE"):
        answer = server.call(method, f"{URL}/r-{'0' * 16}/film", FILM if method == "PUT" else None)
        assert answer.kind == "recording-not-found"


def test_a_film_needs_room_in_the_quota(tmp_path, monkeypatch):
    limit = recording_film.MAX_FILM_BYTES
    with RunningServer(recordings_folder=tmp_path, max_owner_recording_bytes=limit) as server:
        answer = server.call("PUT", f"{add(server, 1)}/film", FILM)
        assert (answer.status, answer.kind, answer.json["value"]) == (409, "too-many-recordings", str(limit))
    with RunningServer(recordings_folder=tmp_path, max_all_recording_bytes=limit) as server:
        assert server.call("PUT", f"{add(server, 1)}/film", FILM).kind == "recording-memory"
    with RunningServer(recordings_folder=tmp_path) as server:
        url = add(server, 1)
        usage = shutil.disk_usage("/")._replace(free=limit)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
        assert server.call("PUT", f"{url}/film", FILM).kind == "recording-memory"


def test_tokens_do_not_see_the_films_of_others(tmp_path):
    with RunningServer(tokens=(TOKEN, OTHER), recordings_folder=tmp_path) as server:
        url = add(server, 1, token=TOKEN)
        for method in ("PUT", "GET", "DELETE"):
            body = FILM if method == "PUT" else None
            assert server.call(method, f"{url}/film", body, token=OTHER).kind == "recording-not-found"


@pytest.mark.parametrize(
    ("rate", "shown"),
    [(None, (1, 10)), (30.0, (1, 30)), (60.0, (2, 30)), (59.9, (2, 29.95)), (3.0, (1, 3)), (0.01, (1, 0.1))],
)
def test_films_have_at_most_30_frames_a_second(rate, shown):
    assert film_rate(rate) == pytest.approx(shown)
