"""What a session has seen: list, picture, camera, room mesh, history, USDZ; over real sockets."""

import io
import json
import struct
from dataclasses import replace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from http_servers import OTHER, TOKEN, RunningServer, box_shot, frame, header_of, with_parts
from present import present
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.wire.frame_encoding import CameraFrame, pack_camera_frame
from roomlight_server.answers.room_mesh import _without_copies, room_mesh, to_glb

ROOM = "/v1/sessions/room"


@pytest.fixture(scope="module")
def server():
    with RunningServer() as running:
        running.open()
        assert running.call("PUT", f"{ROOM}/probes/table", {"position": [0.2, 1.0, -0.5]}).status == 201
        for index, yaw in ((0, 0), (2, 60), (3, 120)):
            assert running.push(index, frame(yaw)).status == 200
        yield running


def opened(server, name, **options):
    """Open another session than `room`; returns its path."""
    server.open(name, **options)
    return f"/v1/sessions/{name}"


def glb_arrays(data):
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    text_bytes = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + text_bytes])
    binary = data[20 + text_bytes + 8 :]
    kinds = {5126: "<f4", 5123: "<u2", 5125: "<u4"}
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        values = np.frombuffer(
            binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]], kinds[accessor["componentType"]]
        )
        arrays.append(values.reshape(accessor["count"], -1))
    return document, arrays


def test_a_token_lists_its_own_sessions():
    with RunningServer(tokens=(TOKEN, OTHER)) as server:
        server.open("first", token=TOKEN)
        server.open("second", token=TOKEN)
        server.open("hidden", token=OTHER)
        server.push(4, name="first", token=TOKEN)
        listed = server.call("GET", "/v1/sessions", token=TOKEN).json
        assert [each["id"] for each in listed["sessions"]] == ["first", "second"]  # last used first
        first = listed["sessions"][0]
        assert (first["frames"]["processed"], first["frames"]["last_index"], first["model"]) == (1, 4, "classical")
        assert listed["max_sessions"] == server.settings.max_sessions / 2  # the share of one of several tokens
        assert [each["id"] for each in server.call("GET", "/v1/sessions", token=OTHER).json["sessions"]] == ["hidden"]


def test_the_picture_is_the_last_frame_as_it_was_sent(server):
    shot = box_shot(0)
    jpeg = cv2.imencode(".jpg", np.full((36, 48, 3), 120, np.uint8))[1].tobytes()
    body = pack_camera_frame(CameraFrame(jpeg, shot.depth_m.astype(np.float32), shot.intrinsics, shot.camera_to_world))
    room = opened(server, "picture")
    assert server.call("GET", f"{room}/colour").kind == "no-frame"
    server.push(0, body, "picture")
    answer = server.call("GET", f"{room}/colour")
    assert (answer.body, answer.headers["content-type"]) == (jpeg, "image/jpeg")
    assert answer.headers["roomlight-frame"] == "0"
    etag = answer.headers["etag"]
    assert server.call("GET", f"{room}/colour", headers={"If-None-Match": etag}).status == 304
    server.push(1, body, "picture")
    assert server.call("GET", f"{room}/colour", headers={"If-None-Match": etag}).status == 200


@pytest.mark.parametrize("kind", ["jpeg", "png"])
def test_a_picture_that_its_exif_turns_is_sent_without_exif(server, kind):
    shot, exif, file = box_shot(0), Image.Exif(), io.BytesIO()
    exif[ExifTags.Base.Orientation] = 6
    Image.new("RGB", (48, 36), "red").save(file, kind, exif=exif)
    camera = (shot.depth_m.astype(np.float32), shot.intrinsics, shot.camera_to_world)
    room = opened(server, f"turned-{kind}")
    assert server.push(0, pack_camera_frame(CameraFrame(file.getvalue(), *camera)), f"turned-{kind}").status == 200
    answer = server.call("GET", f"{room}/colour")
    with Image.open(io.BytesIO(answer.body)) as picture:
        assert (answer.headers["content-type"], picture.size, dict(picture.getexif())) == ("image/jpeg", (48, 36), {})


def test_a_raw_picture_is_sent_as_jpeg(server):
    answer = server.call("GET", f"{ROOM}/colour")
    shown = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_COLOR)
    assert answer.headers["content-type"] == "image/jpeg"
    assert shown is not None
    assert shown.shape == (36, 48, 3)


def test_the_camera_has_path_and_volume(server):
    view = server.call("GET", f"{ROOM}/camera").json
    sent = header_of(box_shot(120))
    assert view["frame"] == 3
    assert view["camera_to_world"] == pytest.approx(sent["camera_to_world"])
    assert view["intrinsics"] == sent["intrinsics"]
    assert [each["index"] for each in view["path"]] == [0, 2, 3]
    for each, yaw in zip(view["path"], (0, 60, 120), strict=True):
        assert each["camera_to_world"] == pytest.approx(header_of(box_shot(yaw))["camera_to_world"])
    assert view["volume"]["volume_to_world"] == pytest.approx(header_of(box_shot(0))["camera_to_world"])
    size = np.subtract(view["volume"]["upper_m"], view["volume"]["lower_m"])
    depth_max_m = server.state()["volume"]["depth_max_m"]
    assert size == pytest.approx(depth_max_m * np.array([2.2, 1.6, 1.7]))


def test_the_exposure_of_the_camera_is_against_the_first_frame(server):
    room = opened(server, "exposed", options={"model": "classical", "height": 16})
    for index, exposure in enumerate((0.5, 2.0)):
        server.push(index, frame(0, exposure=exposure), "exposed")
        assert server.call("GET", f"{room}/camera").json["exposure"] == pytest.approx(exposure / 0.5)


def test_a_session_without_a_frame_has_no_camera(server):
    room = opened(server, "empty")
    view = server.call("GET", f"{room}/camera").json
    expected = {"frame": -1, "intrinsics": None, "camera_to_world": None, "exposure": None}
    assert view == expected | {"path": [], "volume": None}
    assert server.call("GET", f"{room}/mesh").kind == "no-frame"
    assert server.call("GET", f"{room}/history").json["entries"] == []


def test_the_mesh_shows_the_walls_of_the_room(server):
    answer = server.call("GET", f"{ROOM}/mesh")
    assert answer.headers["content-type"] == "model/gltf-binary"
    assert answer.headers["roomlight-keyframes"] == "3"
    document, (positions, colours, faces) = glb_arrays(answer.body)
    assert document["materials"][0]["doubleSided"] is True
    assert faces.size > 1000
    assert faces.max() < len(positions) == len(colours)
    on_wall = np.minimum(abs(abs(positions[:, 0]) - 2.0), abs(abs(positions[:, 2]) - 1.8))
    height = np.minimum(abs(positions[:, 1]), abs(positions[:, 1] - 2.6))
    assert np.minimum(on_wall, height).max() < 0.03  # vertices of one 2 cm cell are averaged
    assert (colours[:, 3] == 65535).all()
    assert colours[:, :3].max() > 1000


def exposed(exposure):
    """Return the frame at yaw 0, taken with an exposure."""
    return with_parts(({}, linear_to_srgb8(np.clip(exposure * box_shot(0).image, 0, 1)).tobytes()), exposure=exposure)


def test_the_mesh_changes_with_the_keyframes_and_their_light_only(server):
    room = opened(server, "keyframes")
    server.push(0, exposed(3), "keyframes")
    etag = server.call("GET", f"{room}/mesh").headers["etag"]
    server.push(1, exposed(3), "keyframes")  # shows nothing new
    assert server.call("GET", f"{room}/mesh", headers={"If-None-Match": etag}).status == 304
    assert server.push(2, exposed(1), "keyframes").json["keyframe"] is False  # shows what was clipped
    brighter = server.call("GET", f"{room}/mesh", headers={"If-None-Match": etag})
    assert brighter.status == 200
    server.push(3, frame(90), "keyframes")
    assert server.call("GET", f"{room}/mesh", headers={"If-None-Match": brighter.headers["etag"]}).status == 200


def test_the_mesh_keeps_to_its_bound(server):
    answer = server.call("GET", f"{ROOM}/mesh?triangles=1000")
    faces = glb_arrays(answer.body)[1][2]
    assert 0 < faces.size // 3 <= 1000
    assert server.call("GET", f"{ROOM}/mesh?triangles=999").kind == "invalid"
    assert server.call("GET", f"{ROOM}/mesh?triangles=100001").kind == "invalid"


def test_merging_equal_meshes_gives_each_triangle_once():
    mesh = FrameMesh(box_shot(0))
    once, twice = room_mesh([mesh]), room_mesh([mesh, mesh])
    assert len(twice.faces) == len(once.faces)
    np.testing.assert_allclose(twice.vertices, once.vertices, atol=1e-5)
    np.testing.assert_allclose(twice.colours, once.colours, atol=1e-5)


@pytest.mark.parametrize("most", [1000, 100_000])
def test_a_surface_within_a_cell_is_not_lost(most):
    shot = box_shot(0)
    pose = shot.camera_to_world + np.pad(np.full((3, 1), 0.01), ((0, 1), (3, 0)))  # the middle of a cell
    mesh = FrameMesh(replace(shot, depth_m=shot.depth_m * 1e-3, camera_to_world=pose))
    made = room_mesh([mesh], max_triangles=most)
    assert most / 2 < len(made.faces) <= most or len(made.faces) == len(mesh.faces)
    assert len(glb_arrays(to_glb(made))[1][2]) == made.faces.size


def test_vertices_have_the_colour_of_their_pixel():
    shot = box_shot(0)
    mesh = FrameMesh(shot)
    merged = room_mesh([mesh])
    cells = np.floor(mesh.vertices[np.unique(mesh.faces)] / 0.02)
    assert len(merged.vertices) == len(np.unique(cells, axis=0))
    glb = glb_arrays(to_glb(merged))[1]
    assert np.abs(glb[1][:, :3].mean(axis=0) / 65535 - np.clip(shot.image, 0, 1).mean(axis=(0, 1))).max() < 0.05


def test_the_history_tells_each_frame(server):
    listed = server.call("GET", f"{ROOM}/history").json
    assert listed["stride"] == 1
    assert 0 < listed["bytes"] <= listed["limit_bytes"] == 16 * 2**20
    first, second, third = listed["entries"]
    assert [each["index"] for each in (first, second, third)] == [0, 2, 3]
    assert first["seconds"] == 0.0 <= second["seconds"] <= third["seconds"]
    assert (first["gaps"], second["gaps"]) == (0, 1)
    assert {"volume", "mesh", "blend"} <= third["stage_ms"].keys()
    (probe,) = third["probes"]
    assert (probe["name"], probe["position"]) == ("table", [0.2, 1.0, -0.5])
    assert first["probes"][0]["coverage"] < probe["coverage"] <= 1
    now = server.call("GET", f"{ROOM}/probes/table?format=main_light").json
    for recorded, light in zip(probe["lights"], now["lights"], strict=True):  # as the session's own estimate has them
        assert (recorded["direction"], recorded["number"]) == (light["direction"], light["number"])
    later = server.call("GET", f"{ROOM}/history?after=2").json["entries"]
    assert [each["index"] for each in later] == [3]


def test_the_history_has_pictures_and_panoramas(server):
    picture = server.call("GET", f"{ROOM}/history/2/colour")
    shown = present(cv2.imdecode(np.frombuffer(picture.body, np.uint8), cv2.IMREAD_COLOR))
    assert shown.shape == (36, 48, 3)
    panorama = server.call("GET", f"{ROOM}/history/3/probes/table")
    assert panorama.headers["content-type"] == "image/vnd.radiance"
    recorded = present(cv2.imdecode(np.frombuffer(panorama.body, np.uint8), cv2.IMREAD_UNCHANGED))
    body = server.call("GET", f"{ROOM}/probes/table?format=npy").body
    seen = server.call("GET", f"{ROOM}/probes/table?format=confidence").body
    measured = cv2.imdecode(np.frombuffer(seen, np.uint8), cv2.IMREAD_GRAYSCALE) == 255
    assert measured.mean() > 0.1
    now = np.load(io.BytesIO(body))
    np.testing.assert_allclose(recorded[measured][:, ::-1], now[measured], rtol=0.02, atol=0.02)
    again = server.call("GET", f"{ROOM}/history/2/colour", headers={"If-None-Match": picture.headers["etag"]})
    assert again.status == 304


@pytest.mark.parametrize("path", ["1/colour", "9/colour", "2/probes/none"])
def test_what_the_history_lacks_is_not_found(server, path):
    answer = server.call("GET", f"{ROOM}/history/{path}")
    assert (answer.status, answer.kind) == (404, "history-not-found")


def test_a_history_of_no_bytes_keeps_nothing():
    with RunningServer(history_bytes=0) as server:
        server.open()
        server.push(0)
        assert server.call("GET", f"{ROOM}/history").json == {
            "stride": 1, "bytes": 0, "limit_bytes": 0, "entries": [],
        }  # fmt: skip


def test_a_session_goes_on_when_a_frame_is_not_recorded(server, monkeypatch):
    monkeypatch.setattr("roomlight_server.sessions.history._lights", Mock(side_effect=RuntimeError("no memory")))
    room = opened(server, "unrecorded")
    assert server.push(0, name="unrecorded").json["status"] == "processed"
    assert server.push(1, name="unrecorded").json["status"] == "processed"
    assert server.call("GET", f"{room}/history").json["entries"] == []


def test_a_mesh_is_made_once_for_all_clients(server, monkeypatch):
    first = server.call("GET", f"{ROOM}/mesh?triangles=2000")
    monkeypatch.setattr("roomlight_server.routes.room.room_mesh", Mock(side_effect=AssertionError("made again")))
    assert server.call("GET", f"{ROOM}/mesh?triangles=2000").body == first.body


def test_faces_are_unique_for_any_number_of_vertices():
    few = np.array([[0, 1, 2], [0, 2, 1], [0, 1, 2]])
    for faces in (few, few + 2**21):
        assert _without_copies(faces).tolist() == [faces[0].tolist(), faces[1].tolist()]
    assert _without_copies(np.zeros((0, 3), np.int64)).shape == (0, 3)
