"""Objects and composites over a real socket: uploads, refusals, limits, layers, and damaged files."""

import hashlib
import io
import json
import queue
import re
import zipfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from gltf_files import packed, textured_quad

from http_servers import OTHER, TETRAHEDRON, TOKEN, Held, InThread, RunningServer, box_shot
from present import present
from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.materials import Material
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.objects.virtual_object import TriangleMesh, VirtualObject
from roomlight.compositing.picture.layer_files import LAYER_FILES
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.memory import release_free_memory
from roomlight.engine.session import Session, SessionOptions
from roomlight.images import decode_colour
from roomlight.wire.compositing import CompositeRequest
from roomlight_server.answers import composites
from roomlight_server.work.object_packing import object_bytes, pack_object, unpack_object
from rooms import BoxRoom, camera_at

BALL = {"shape": "sphere", "size_m": 0.4, "material": {"kind": "diffuse"}, "position": [0.2, 1.1, -0.4]}
COMPOSITE = "/v1/sessions/room/composite"
WORKING_BYTES = 192 * 2**20
"""Memory of the process besides: blocks of rays, panoramas at the objects, Embree's own."""


@pytest.fixture(scope="module")
def server():
    with RunningServer() as running:
        running.open()
        assert running.push(0).status == 200
        yield running


def composite(server, *objects, **options):
    return server.call("POST", COMPOSITE, {"objects": list(objects), **options})


def upload(server, body=TETRAHEDRON, path="/v1/objects?kind=obj", **more):
    return server.call("POST", path, body, **more)


def pixels_of(answer):
    return decoded(answer.body, cv2.IMREAD_COLOR)[..., ::-1]


def decoded(data, flags):
    return present(cv2.imdecode(np.frombuffer(data, np.uint8), flags))


def test_an_object_is_uploaded_once_and_listed(server):
    first, again = upload(server), upload(server)
    assert (first.status, again.status) == (201, 200)
    assert first.json == again.json
    assert first.json["id"] == hashlib.sha256(TETRAHEDRON).hexdigest()
    assert (first.json["triangles"], first.json["lower_m"], first.json["size_m"]) == (4, [0, 0, 0], [1, 1, 1])
    path = f"/v1/objects/{first.json['id']}"
    assert server.call("GET", path).json == first.json
    listed = server.call("GET", "/v1/objects").json
    assert first.json in listed["objects"]
    assert listed["bytes"] == sum(one["bytes"] for one in listed["objects"]) < listed["limit_bytes"]
    assert server.call("DELETE", path).status == 204
    assert server.call("GET", path).kind == "object-not-found"
    assert server.call("DELETE", path).kind == "object-not-found"


def test_an_uploaded_object_is_put_into_the_frame(server):
    held = upload(server).json["id"]
    answer = composite(server, {"object": held, "size_m": 0.5, "position": [0.2, 1.1, -0.4], "name": "tetra"})
    assert (answer.status, answer.headers["content-type"]) == (200, "image/png")
    assert answer.headers["roomlight-frame"] == "0"
    pose = np.reshape(json.loads(answer.headers["roomlight-poses"])["tetra"], (4, 4)).T
    assert np.allclose(pose[:3, :3], np.eye(3))
    plain = linear_to_srgb8(np.clip(box_shot(0).image, 0, 1))
    changed = np.abs(pixels_of(answer).astype(int) - plain).max(axis=-1) > 8
    assert 0.01 < changed.mean() < 0.6


def test_a_returned_pose_keeps_the_object_where_it_is(server):
    at_pixel = composite(server, {**BALL, "position": None, "pixel": [24, 30], "name": "ball"})
    assert at_pixel.status == 200, at_pixel.json
    pose = json.loads(at_pixel.headers["roomlight-poses"])["ball"]
    again = composite(server, {**BALL, "position": None, "pose": pose, "anchor": "origin", "name": "ball"})
    assert np.abs(json.loads(again.headers["roomlight-poses"])["ball"] - np.array(pose)).max() < 1e-5


def test_formats_and_layers_agree(server):
    png, exr = composite(server, BALL), composite(server, BALL, format="exr")
    jpeg, layers = composite(server, BALL, format="jpeg"), composite(server, BALL, format="layers")
    assert jpeg.headers["content-type"] == "image/jpeg"
    assert pixels_of(jpeg).shape == (36, 48, 3)
    linear, _ = decode_colour(exr.body, "answer")
    with zipfile.ZipFile(io.BytesIO(layers.body)) as archive:
        assert archive.namelist() == list(LAYER_FILES)
        assert archive.read("image.png") == png.body
        objects, _ = decode_colour(archive.read("objects.exr"), "objects")
        shadow, _ = decode_colour(archive.read("shadow.exr"), "shadow")
        alpha = decoded(archive.read("alpha.png"), cv2.IMREAD_UNCHANGED)[..., None] / 65535
        frame, _ = decode_colour(archive.read("frame.exr"), "frame")
    assert alpha.max() > 0.9
    assert np.abs(frame * shadow * (1 - alpha) + objects * alpha - linear).max() < 2e-3 * linear.max()


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"position": [0.2, 1.1, 3.2]}, "behind the camera"),
        ({"position": None, "pixel": [500, 4]}, "must lie in the image of 48 x 36 pixels"),
        ({"position": [9.0, 1.1, -0.4]}, "outside the picture"),
    ],
)
def test_a_bad_place_is_refused_and_the_session_stays(server, changes, rule):
    answer = composite(server, {**BALL, **changes})
    assert (answer.status, answer.kind) == (422, "bad-place")
    assert rule in answer.json["detail"]
    assert server.state()["probes"] == {}
    assert composite(server, BALL).status == 200


@pytest.mark.parametrize(
    "wrong",
    [
        {"shape": None},
        {"size_m": -1},
        {"pixel": [3, 3]},
        {"position": None},
        {"material": {"kind": "velvet"}},
        {"material": {"kind": "mirror", "roughness": 0.5}},
        {"position": None, "pose": [1.0] * 16},
        {"anchor": "base", "position": None, "pixel": [3, 3]},
        {"object": "0" * 63},
        {"colour": "red"},
    ],
)
def test_a_wrong_field_is_refused(server, wrong):
    answer = composite(server, {**BALL, **wrong})
    assert answer.status == 422, answer
    assert answer.kind in ("invalid", "bad-place")


def test_an_unknown_object_is_not_found(server):
    answer = composite(server, {"object": "0" * 64, "position": [0, 1, 0]})
    assert (answer.status, answer.kind, answer.json["field"]) == (404, "object-not-found", "object")


def test_a_session_without_frames_has_no_composite(server):
    server.open("empty")
    answer = server.call("POST", "/v1/sessions/empty/composite", {"objects": [BALL]})
    assert (answer.status, answer.kind) == (409, "no-frame")


def test_a_large_object_gets_fewer_paths_and_is_not_refused(monkeypatch):
    monkeypatch.setattr(composites, "MAX_PATHS", 1)
    engine = Session(SessionOptions(model="classical", height=16))
    engine.push(box_shot(0))
    scene = composites.scene_of(CompositeRequest.model_validate({"objects": [BALL]}), {}, 1.0)
    assert composites.make(engine, box_shot(0), scene, "good").picture.samples == 1


@pytest.mark.slow
def test_a_composite_that_needs_too_much_memory_is_refused_before_it_is_made(monkeypatch):
    monkeypatch.setattr(composites, "_TRIANGLE_BYTES", 2**24)  # as if the tetrahedron had many triangles
    with RunningServer(max_pending_bytes=2**27) as server:
        server.open()
        assert server.push(0).status == 200
        place = {"object": upload(server).json["id"], "size_m": 0.4, "position": [0.2, 1.1, -0.4]}
        assert composite(server, place).status == 200
        answer = composite(server, place, place)
        assert (answer.status, answer.kind, answer.json["field"]) == (422, "invalid", "objects")
        assert "simplify the objects" in answer.json["detail"]


@pytest.mark.slow
@pytest.mark.parametrize(("quality", "width"), [("preview", 1024), ("good", 512)])
def test_a_composite_takes_no_more_memory_than_estimated(quality, width):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:  # nothing else allocates there
        peak, estimate = pool.submit(peak_of_composite, quality, width).result()
    assert peak < estimate + WORKING_BYTES


def peak_of_composite(quality, width):
    """Composite a textured strip of 125,000 triangles and glass that fills the picture; return (peak, estimate), bytes.

    The peak is this process's `VmHWM`: what it takes for the composite beyond what it has before.
    """
    edge = np.linspace(-0.5, 0.5, 251, dtype=np.float32)
    x, z = np.meshgrid(edge, edge)
    at = np.arange(250 * 250) // 250 * 251 + np.arange(250 * 250) % 250
    faces = np.concatenate(
        [np.stack(corners, -1) for corners in ((at, at + 251, at + 1), (at + 1, at + 251, at + 252))]
    )
    mesh = TriangleMesh(
        np.stack([x, 0.02 * np.sin(20 * x), z], -1).reshape(-1, 3),
        np.tile(np.array([0, 1, 0], np.float32), (251 * 251, 1)),
        np.stack([x, z], -1).reshape(-1, 2) + np.float32(0.5),
        faces.astype(np.int32),
    )
    texture = Texture(np.full((2048, 2048, 4), 30_000, np.uint16))
    held = VirtualObject("object", ((mesh, Material(base_colour_texture=texture)),), ())
    engine = Session(SessionOptions(model="classical", height=32))
    room = BoxRoom(size_m=(4.0, 2.6, 3.6), lamp=((0.5, 2.6, 0.3), 0.3))
    shot = room.frame(camera_at((0.2, 1.4, 0.8)), width=width, height=3 * width // 4)
    engine.push(shot)
    glass = [BALL | {"size_m": 1.0, "material": {"kind": "glass"}}] * 4
    place = {"object": "0" * 64, "size_m": 0.4, "position": [0.2, 1.1, -0.4]}
    request = CompositeRequest.model_validate({"objects": [*glass, place], "quality": quality})
    scene = composites.scene_of(request, {"0" * 64: held}, 1.0)
    composites.make(engine, shot.resized(64, 48), scene, quality)  # kernels are compiled
    release_free_memory()
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before = status_bytes("VmRSS")
    composites.encode(composites.make(engine, shot, scene, quality).picture, "layers")
    estimate = composites.memory_of((width, 3 * width // 4), quality, [held], [held])
    return status_bytes("VmHWM") - before, estimate


def status_bytes(name):
    """Return an entry of this process's status."""
    line = re.search(rf"{name}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert line is not None
    return int(line[1]) * 1024


def test_one_composite_a_session_at_a_time_and_one_waits(server, monkeypatch):
    make, answers = Held(composites.make), queue.SimpleQueue()
    monkeypatch.setattr("roomlight_server.routes.composites.make", make)
    for _ in range(3):
        InThread(lambda: answers.put(composite(server, BALL)))
    refused = answers.get()
    assert (refused.status, refused.kind, refused.headers["retry-after"]) == (429, "composite-running", "1")
    make.wait_entered()
    server.open("neighbour")
    assert server.push(0, name="neighbour").json["status"] == "processed"  # other sessions do not wait
    make.release(2)
    assert [answers.get().status for _ in range(2)] == [200, 200]
    assert server.call("GET", "/v1/sessions/room/probe?x=0&y=1&z=0&format=sh").status == 200


def test_an_unexpected_error_leaves_the_session_open(server, monkeypatch):
    monkeypatch.setattr("roomlight_server.routes.composites.make", Mock(side_effect=MemoryError))
    answer = composite(server, BALL)
    assert (answer.status, answer.kind) == (500, "engine-failed")
    monkeypatch.undo()
    assert server.state()["status"] == "open"
    assert composite(server, BALL).status == 200


def test_objects_belong_to_their_token_and_have_limits():
    limits = {"max_owner_object_bytes": 2**16, "max_object_bytes": 2**16, "max_object_file_bytes": 2**16}
    now = [0.0]
    with RunningServer(tokens=(TOKEN, OTHER), clock=lambda: now[0], **limits) as server:
        assert upload(server).kind == "unauthorized"
        held = upload(server, token=TOKEN).json["id"]
        assert server.call("GET", f"/v1/objects/{held}", token=OTHER).kind == "object-not-found"
        assert server.call("GET", "/v1/objects", token=OTHER).json["objects"] == []
        too_large = upload(server, bytes(2**16 + 1), token=TOKEN)
        assert (too_large.status, too_large.kind) == (413, "too-large")
        points = b"".join(b"v %d 0 %d\n" % (n, n % 2) for n in range(1202))
        # a flat strip, so that corners share vertices
        wide = points + b"".join(b"f %d %d %d\n" % (n, n + 1 + n % 2, n + 2 - n % 2) for n in range(1, 1201))
        assert upload(server, wide, token=TOKEN).status == 201
        store = server.app.state.context.objects
        key, stored = list(store._stored.items())[-1]
        assert store.add(*key, stored.virtual_object) == stored.info  # of two uploads at once
        other = wide + b"f 5 8 7\n"  # 53 kB each
        full = upload(server, other, token=TOKEN)
        assert (full.status, full.kind) == (409, "too-many-objects")
        busy = upload(server, other, token=OTHER)
        assert (busy.status, busy.kind) == (503, "object-memory")
        assert int(busy.headers["retry-after"]) >= 1
        now[0] = server.settings.object_expiry_s + 1
        assert upload(server, other, token=OTHER).status == 201
        assert server.call("GET", "/v1/objects", token=TOKEN).json == {"objects": [], "bytes": 0, "limit_bytes": 2**16}


@pytest.mark.parametrize(
    ("body", "path"),
    [(TETRAHEDRON.replace(b"v 1 0 0", b"v nan 0 0"), "/v1/objects?kind=obj"), (packed(b"{}", b""), "/v1/objects")],
)
def test_a_hostile_object_is_refused_with_the_rule(server, body, path):
    answer = upload(server, body, path)
    assert (answer.status, answer.kind) == (422, "bad-object")
    assert answer.json["rule"]
    assert "got" not in answer.json["detail"]


def test_an_object_beyond_the_time_limit_is_refused():
    with RunningServer(object_timeout_s=0.001) as server:
        answer = upload(server, textured_quad().glb(), "/v1/objects")
        assert (answer.status, answer.kind) == (422, "bad-object")
        assert answer.json["rule"] == "must decode within 0.001 s"


def test_a_packed_object_is_the_same_object():
    file = textured_quad()
    file.tree["samplers"] = [{"wrapT": 33071}]
    file.tree["textures"][0]["sampler"] = 0
    body = file.glb()
    text, data = pack_object(body, None, {})
    held, direct = unpack_object(json.loads(json.dumps(text)), data), load_object(body)
    assert object_bytes(held) == object_bytes(direct) == len(data)
    for (mesh, material), (own_mesh, own_material) in zip(held.parts, direct.parts, strict=True):
        for name in ("vertices", "normals", "uvs", "faces"):
            assert (getattr(mesh, name) == getattr(own_mesh, name)).all()
        assert material.base_colour == own_material.base_colour
        texture, own_texture = material.base_colour_texture, own_material.base_colour_texture
        assert texture is not None
        assert own_texture is not None
        assert (texture.texels == own_texture.texels).all()
        assert texture.clamped == own_texture.clamped == (False, True)
    text, data = pack_object(b"v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n", "obj", {})
    coloured = unpack_object(json.loads(json.dumps(text)), data).parts[0][1].base_colour_texture
    assert coloured is not None
    assert coloured.by_triangle
