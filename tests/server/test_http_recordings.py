"""Recordings: upload in pieces over real sockets, limits, hostile paths and files, replay into a session."""

import asyncio
import shutil
import threading
from pathlib import Path
from unittest.mock import AsyncMock, Mock
from urllib.parse import quote

import pytest

from http_servers import LONG_S, OTHER, TOKEN, InThread, RunningServer
from roomlight import sample_capture
from roomlight.errors import ServerError
from roomlight.wire.recordings import RecordingRequest
from roomlight_server.base.problems import ProblemError
from roomlight_server.recordings import player as recording_player
from roomlight_server.recordings import store as recording_store
from roomlight_server.recordings.files import MAX_PIECE_BYTES, RecordingFiles, append, check_path
from roomlight_server.routes import recordings as recording_routes
from roomlight_server.routes.context import Context
from server_processes import Process
from written_captures import edited_copy

URL = "/v1/recordings"


@pytest.fixture
def server(tmp_path):
    with RunningServer(recordings_folder=tmp_path) as running:
        yield running


def announce(server, size, files=1, name="room.r3d", **more):
    answer = server.call("POST", URL, {"name": name, "bytes": size, "files": files}, **more)
    assert answer.status == 201, answer
    return f"{URL}/{answer.json['id']}"


def put(server, url, path, data, offset=0, **more):
    return server.call("PUT", f"{url}/files/{quote(path)}", data, headers={"Upload-Offset": str(offset)}, **more)


def upload(server, folder: Path, **more):
    """Send a folder, each file in pieces of 40,000 bytes; return the URL of the recording."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    url = announce(server, sum(file.stat().st_size for file in files), len(files), name=folder.name, **more)
    for file in files:
        data = file.read_bytes()
        for start in range(0, max(1, len(data)), 40_000):
            answer = put(server, url, str(file.relative_to(folder)), data[start : start + 40_000], start, **more)
            assert answer.status == 200, answer
    return url


def test_the_sample_room_is_a_recording(server):
    answer = server.call("POST", "/v1/sample-recording")
    assert (answer.status, answer.json["status"], answer.json["name"]) == (201, "ready", "Sample room")
    url = f"{URL}/{answer.json['id']}"
    assert server.call("PUT", f"{url}/replay", {"session": "sample", "model": "classical", "height": 16}).status == 202
    while (playing := server.call("GET", url).json)["frame"] == 0:
        assert playing["status"] == "playing", playing
    assert server.call("DELETE", f"{url}/replay").json["frames"] == 31


def finished(server, url, status="finished", **more):
    """Wait for the end of a replay on the event loop itself, and return the recording."""
    while (described := server.call("GET", url, **more).json)["status"] == "playing":
        pass
    assert described["status"] == status, described
    return described


def short_sample(folder, first, step):
    """Return a copy of the first six frames of the sample capture with other timestamps."""

    def edit(index):
        index["frames"] = index["frames"][:6]
        for number, frame in enumerate(index["frames"]):
            frame["timestamp_s"] = first + number * step

    return edited_copy(sample_capture(), folder / "sample", edit)


def test_an_upload_arrives_in_pieces(server):
    url = announce(server, 10, files=2)
    assert put(server, url, "a/b.bin", b"12345").json["received"] == 5
    state = put(server, url, "a/b.bin", b"678", offset=5).json
    assert (state["received"], state["files_received"], state["status"]) == (8, 1, "uploading")
    state = put(server, url, "empty", b"").json
    assert (state["files_received"], state["status"]) == (2, "uploading")
    state = put(server, url, "a/b.bin", b"90", offset=8).json
    assert (state["received"], state["status"]) == (10, "ready")
    (folder,) = next(iter(server.settings.recordings_folder.iterdir())).iterdir()
    assert (folder / "a" / "b.bin").read_bytes() == b"1234567890"
    assert (folder / "empty").read_bytes() == b""
    assert folder.stat().st_mode & 0o077 == 0


def test_a_piece_must_continue_its_file(server):
    url = announce(server, 10)
    put(server, url, "a", b"12345")
    for offset in (0, 4, 6):
        answer = put(server, url, "a", b"1", offset=offset)
        assert (answer.status, answer.kind, answer.headers["upload-offset"]) == (409, "upload-offset", "5")
    assert put(server, url, "a", b"67890", offset=5).json["status"] == "ready"


def test_a_piece_is_written_to_its_end_when_its_client_disconnects(tmp_path, monkeypatch):
    files = RecordingFiles(tmp_path / "upload", RecordingRequest(name="room.r3d", bytes=4, files=1))
    context, begun, disconnected = Mock(spec=Context, recordings=Mock()), threading.Event(), threading.Event()
    context.recordings.find.return_value = Mock(files=files)

    def write(*piece):
        begun.set()
        assert disconnected.wait(LONG_S)
        append(*piece)

    async def disconnect():
        put_piece = recording_routes.put_piece(context, "", Mock(), Mock(), "r-0123456789abcdef", "a")
        handler = asyncio.create_task(put_piece)
        await asyncio.to_thread(begun.wait)
        handler.cancel()
        await asyncio.wait([handler])
        with pytest.raises(ProblemError, match="another piece of it is being written"), files.piece("a", 0, 4):
            pass
        disconnected.set()
        while not files.complete:
            await asyncio.sleep(0)

    monkeypatch.setattr(recording_routes, "append", write)
    monkeypatch.setattr(recording_routes, "read_body", AsyncMock(return_value=b"1234"))
    asyncio.run(disconnect())
    assert (files.folder / "a").read_bytes() == b"1234"


@pytest.mark.parametrize(
    "path",
    [
        *("../evil", "a/../../evil", "/etc/passwd", "a//b", ".", "..", ".ssh/keys", "a/.hidden", "a\\b", "a\x00b"),
        *("/".join("abcdefghi"), "x" * 201, "a/"),
    ],
)
def test_paths_that_lead_elsewhere_are_refused(server, path):
    url = announce(server, 10)
    answer = server.call("PUT", f"{url}/files/{quote(path, safe='')}", b"1234")
    assert (answer.status, answer.kind, answer.json["field"]) == (422, "invalid", "path")
    assert server.call("GET", url).json["received"] == 0
    assert not [each for each in server.settings.recordings_folder.rglob("*") if each.is_file()]


@pytest.mark.parametrize("path", ["a\nb", "a\x1b[2J", "a\u202eb", "a\ud800"])
def test_control_characters_are_refused(path):
    with pytest.raises(ProblemError, match="control characters"):
        check_path(path)


def test_paths_with_spaces_and_letters_are_kept():
    assert check_path("Küche 2/rgb (1).jpg") == ("Küche 2", "rgb (1).jpg")


def test_no_more_than_announced_is_stored(server):
    url = announce(server, 4, files=1)
    answer = put(server, url, "a", b"12345")
    assert (answer.status, answer.kind) == (422, "invalid")
    assert "at most 4 bytes" in answer.json["rule"]
    assert put(server, url, "a", b"12").status == 200
    answer = put(server, url, "b", b"3")
    assert "at most 1 files" in answer.json["rule"]


def test_a_file_cannot_become_a_folder(server):
    url = announce(server, 9, files=3)
    put(server, url, "a/b", b"1")
    assert "different names" in put(server, url, "a", b"2").json["rule"]
    assert "different names" in put(server, url, "a/b/c", b"2").json["rule"]


def test_a_piece_has_at_most_8_mib(server):
    url = announce(server, MAX_PIECE_BYTES + 1)
    answer = put(server, url, "a", bytes(MAX_PIECE_BYTES + 1))
    assert (answer.status, answer.kind) == (413, "too-large")
    assert put(server, url, "a", bytes(MAX_PIECE_BYTES)).status == 200


@pytest.mark.parametrize(
    ("settings", "kind"),
    [
        ({"max_recording_bytes": 2000}, "invalid"),
        ({"max_owner_recording_bytes": 5000}, "too-many-recordings"),
        ({"max_all_recording_bytes": 5000}, "recording-memory"),
    ],
)
def test_quotas_count_what_is_announced(tmp_path, settings, kind):
    with RunningServer(recordings_folder=tmp_path, **settings) as server:
        first = server.call("POST", URL, {"name": "a", "bytes": 3000, "files": 1})
        second = server.call("POST", URL, {"name": "b", "bytes": 3000, "files": 1})
        assert second.kind == kind
        assert first.status == (422 if kind == "invalid" else 201)
        if first.status == 201:
            assert server.call("DELETE", f"{URL}/{first.json['id']}").status == 204
            assert server.call("POST", URL, {"name": "b", "bytes": 3000, "files": 1}).status == 201


def test_the_number_of_recordings_is_limited(server, monkeypatch):
    monkeypatch.setattr(recording_store, "MAX_RECORDINGS", 2)
    announce(server, 1)
    announce(server, 1)
    assert server.call("POST", URL, {"name": "c", "bytes": 1, "files": 1}).kind == "too-many-recordings"


def test_a_full_disk_is_reported_before_the_upload(server, monkeypatch):
    usage = shutil.disk_usage("/")._replace(free=recording_store.SPARE_DISK_BYTES + 100)
    monkeypatch.setattr(recording_store.shutil, "disk_usage", lambda _: usage)
    announce(server, 60)
    answer = server.call("POST", URL, {"name": "b", "bytes": 60, "files": 1})  # the first has not arrived yet
    assert (answer.status, answer.kind) == (503, "recording-memory")
    assert "has 40 bytes for recordings" in answer.json["detail"]


def test_a_disk_that_fails_during_a_piece_keeps_the_file_as_it_was(server, monkeypatch):
    url = announce(server, 4)
    put(server, url, "a", b"12")
    with monkeypatch.context() as patch:
        full = OSError(28, "No space left on device")
        patch.setattr("roomlight_server.routes.recordings.append", Mock(side_effect=full))
        answer = put(server, url, "a", b"34", offset=2)
        assert (answer.status, answer.kind) == (503, "recording-memory")
        assert "No space left" in answer.json["detail"]
    assert put(server, url, "a", b"34", offset=2).json["status"] == "ready"


def test_a_folder_that_cannot_be_used_is_named_at_the_start(tmp_path):
    """The server was ready, and each upload was answered 500."""
    (tmp_path / "file").write_text("")
    with pytest.raises(ServerError, match=r"recordings_folder: .*/file: cannot be used \(File exists\)"):
        RunningServer(recordings_folder=tmp_path / "file")
    RunningServer(recordings_folder=tmp_path / "new" / "folder")
    assert (tmp_path / "new" / "folder").stat().st_mode & 0o777 == 0o700


def test_a_folder_that_is_removed_while_the_server_runs_is_made_again(tmp_path):
    """Programs remove old files of the folder for temporary files."""
    with RunningServer(recordings_folder=tmp_path / "uploads") as server:
        url = announce(server, 4)
        shutil.rmtree(tmp_path / "uploads")
        for path in (url, f"{url}/replay"):
            assert server.call("DELETE", path).kind == "recording-not-found"
        assert put(server, announce(server, 4), "a", b"1234").json["status"] == "ready"
        assert len(server.call("GET", URL).json["recordings"]) == 1
        shutil.rmtree(tmp_path / "uploads")
        (tmp_path / "uploads").write_text("")
        for answer in (
            server.call("POST", URL, {"name": "b", "bytes": 4, "files": 1}),
            server.call("POST", "/v1/sample-recording"),
        ):
            assert (answer.status, answer.kind) == (503, "recording-memory")
            assert "File exists; retry later" in answer.json["detail"]


def test_a_failed_piece_is_overwritten(tmp_path):
    file = tmp_path / "a" / "b"
    append(file, 0, b"12")
    with file.open("ab") as stream:
        stream.write(b"left over from a piece that failed")
    append(file, 2, b"34")
    assert file.read_bytes() == b"1234"


def test_two_pieces_of_a_file_are_not_written_at_once(tmp_path):
    files = RecordingFiles(tmp_path / "r", RecordingRequest(name="a", bytes=10, files=1))
    with files.piece("a", 0, 2), pytest.raises(ProblemError, match="another piece"), files.piece("a", 0, 2):
        pass


def test_files_that_arrive_after_a_deletion_are_deleted(tmp_path):
    files = RecordingFiles(tmp_path / "r", RecordingRequest(name="a", bytes=10, files=1))
    with files.piece("a/b", 0, 2) as file:
        files.delete()
        append(file, 0, b"12")
    assert not (tmp_path / "r").exists()


def test_tokens_do_not_see_the_recordings_of_others(tmp_path):
    with RunningServer(tokens=(TOKEN, OTHER), recordings_folder=tmp_path) as server:
        url = announce(server, 4, token=TOKEN)
        assert server.call("GET", URL, token=OTHER).json["recordings"] == []
        for method, path in (("GET", url), ("DELETE", url), ("PUT", f"{url}/files/a"), ("DELETE", f"{url}/replay")):
            body = b"1" if method == "PUT" else None
            assert server.call(method, path, body, token=OTHER).kind == "recording-not-found"
        assert len(server.call("GET", URL, token=TOKEN).json["recordings"]) == 1


def test_an_unused_recording_expires_and_its_files_go(tmp_path):
    now = [0.0]
    with RunningServer(clock=lambda: now[0], recordings_folder=tmp_path, recording_expiry_s=100) as server:
        url = announce(server, 4)
        put(server, url, "a", b"1234")
        now[0] = 99.0
        assert server.call("GET", url).json["expires_in_s"] == 100
        now[0] = 200.0
        assert server.call("GET", url).kind == "recording-not-found"
        server.wait_until(lambda: list(next(tmp_path.iterdir()).iterdir()) == [])


def test_all_files_go_when_the_server_stops(tmp_path):
    with RunningServer(recordings_folder=tmp_path) as server:
        put(server, announce(server, 4), "a", b"1234")
        assert list(tmp_path.iterdir())
    assert list(tmp_path.iterdir()) == []


def test_an_incomplete_recording_is_not_played(server):
    url = announce(server, 4)
    answer = server.call("PUT", f"{url}/replay", {"session": "room"})
    assert (answer.status, answer.kind) == (409, "recording-not-ready")
    assert "0 of 4 bytes" in answer.json["detail"]


@pytest.mark.slow
def test_a_folder_is_uploaded_and_played(tmp_path):
    with RunningServer(recordings_folder=tmp_path) as server:
        url = upload(server, short_sample(tmp_path, 65_505_280_000_000, 33_333_333))
        assert server.call("GET", url).json["notes"] == []
        answer = server.call("PUT", f"{url}/replay", {"session": "room", "model": "classical", "height": 16, "fps": 60})
        assert (answer.status, answer.json["status"], answer.json["session"]) == (202, "playing", "room")
        described = finished(server, url)
        assert (described["frame"], described["frames"], described["unreadable"]) == (6, 6, 0)
        (note,) = described["notes"]
        assert "read as nanoseconds" in note
        assert str(tmp_path) not in note
        state = server.state()
        assert state["frames"]["accepted"] == 6
        assert state["frames"]["gaps"] == 0
        assert set(state["probes"]) == {"view", "probe-1", "probe-2", "probe-3"}
        # a second replay goes into another session
        again = server.call("PUT", f"{url}/replay", {"session": "room", "model": "classical", "height": 16})
        assert (again.kind, again.json["title"]) == ("session-conflict", "Session conflicts with the request")
        probes = {"here": [0.0, 1.0, 0.0]}
        server.call("PUT", f"{url}/replay", {"session": "two", "height": 16, "fps": 60, "probes": probes})
        finished(server, url)
        assert server.state("two")["probes"] == probes


@pytest.mark.slow
def test_a_replay_is_stopped(tmp_path):
    with RunningServer(recordings_folder=tmp_path) as server:
        url = upload(server, short_sample(tmp_path, 0.0, 3000.0))  # the second frame is due in an hour
        body = {"session": "room", "model": "classical", "height": 16}
        assert server.call("PUT", f"{url}/replay", body).status == 202
        assert server.call("PUT", f"{url}/replay", body | {"session": "two"}).kind == "recording-playing"
        while server.call("GET", url).json["frame"] == 0:
            pass
        stopped = server.call("DELETE", f"{url}/replay").json
        assert (stopped["status"], stopped["frame"]) == ("finished", 1)
        assert server.state()["frames"]["accepted"] == 1  # the session stays
        server.call("PUT", f"{url}/replay", body | {"session": "two"})
        deleted = InThread(server.call, "DELETE", url)  # a replay that runs is stopped first
        assert deleted.result().status == 204
        assert server.call("GET", url).kind == "recording-not-found"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ({"notes.txt": b"nothing"}, "no capture format recognised"),
        ({"room.ZIP": b"PK"}, "unpack it, and send its files"),
    ],
)
def test_what_is_no_recording_fails_with_a_reason(server, files, reason):
    url = announce(server, sum(map(len, files.values())), len(files))
    for path, data in files.items():
        put(server, url, path, data)
    assert server.call("PUT", f"{url}/replay", {"session": "room"}).status == 202
    problem = finished(server, url, "failed")["problem"]
    assert problem["type"].endswith("bad-recording")
    assert reason in problem["detail"]
    assert str(server.settings.recordings_folder) not in problem["detail"]  # no paths of the server


def test_a_process_that_cannot_start_fails_a_replay_and_a_film(server, monkeypatch):
    """The replay was finished, and the film was read for ever."""
    monkeypatch.setattr(asyncio, "create_subprocess_exec", AsyncMock(side_effect=BlockingIOError("no process")))
    url = f"{URL}/{server.call('POST', '/v1/sample-recording').json['id']}"
    server.call("PUT", f"{url}/replay", {"session": "room", "model": "classical"})
    assert finished(server, url, "failed")["problem"]["type"].endswith("internal")
    sphere = {"shape": "sphere", "size_m": 0.2, "position": [0, 1, 0]}
    server.call("PUT", f"{url}/film", {"objects": [sphere]})
    server.wait_until(lambda: server.call("GET", url).json["film"]["status"] == "failed")


@pytest.mark.slow
def test_a_reader_that_hangs_is_killed(server, monkeypatch):
    monkeypatch.setattr(recording_player, "READ_TIMEOUT_S", 0.01)  # the process takes longer to start
    url = announce(server, 1)
    put(server, url, "a", b"1")
    server.call("PUT", f"{url}/replay", {"session": "room"})
    assert "more than 0.01 s" in finished(server, url, "failed")["problem"]["detail"]


@pytest.mark.slow
def test_uploads_of_a_killed_server_are_removed_by_the_next(tmp_path, caplog):
    """Pictures of a room stayed in the folder for temporary files for ever."""
    (tmp_path / "roomlight-recordings-link").symlink_to(tmp_path / "mine")
    (tmp_path / "mine").mkdir()
    with Process(ROOMLIGHT_RECORDINGS_FOLDER=str(tmp_path)) as killed:
        announced = {"name": "room", "bytes": 4, "files": 1}
        status, recording = killed.call("POST", "/v1/recordings", announced)
        assert status == 201
        (upload,) = tmp_path.glob(f"*/{recording['id']}")
        with RunningServer(recordings_folder=tmp_path):
            assert upload.is_dir()  # its server lives
    with RunningServer(recordings_folder=tmp_path):
        assert [each.name for each in tmp_path.iterdir() if not each.is_symlink()] == ["mine"]
    assert (tmp_path / "roomlight-recordings-link").is_symlink()
    assert "uploads of a server that was killed are removed" in [each.getMessage() for each in caplog.records]
