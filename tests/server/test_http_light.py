"""Light over a real socket: forms, ETags, named probes, batches."""

import base64
import inspect
import io
from typing import get_args

import cv2
import numpy as np
import pytest

from http_servers import SMALL, RunningServer, frame
from present import present
from roomlight.images import decode_colour
from roomlight.light.cube import CubeMap
from roomlight.light.light import Light
from roomlight.light.main_light import MainLight
from roomlight.light.prior import prior_panorama
from roomlight.light.resample import panorama_to_cube
from roomlight.light.spherical_harmonics import project
from roomlight.wire.light_message import MEDIA_TYPE, parse_light
from roomlight.wire.messages import MAX_FORMS, HarmonicsBasis, HarmonicsKind, LightForm, LightFormat, LightResponse
from roomlight_server.answers import light_forms

POINT = {"position": [0.2, 1.2, -0.2]}


@pytest.fixture(scope="module")
def server():
    with RunningServer(max_probes=3) as running:
        running.open()
        assert running.push(0).status == 200
        yield running


def get(server, query="", *, path="/probe?x=0.2&y=1.2&z=-0.2", name="room", **more):
    return server.call("GET", f"/v1/sessions/{name}{path}{query}", **more)


def post(server, body, *, name="room", **more):
    return server.call("POST", f"/v1/sessions/{name}/probes", body, **more)


def decode_png(body):
    return present(cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED))


def panorama(server):
    answer = get(server, "&format=npy")
    assert answer.headers["content-type"] == "application/x-npy"
    return np.load(io.BytesIO(answer.body))


def test_npy_is_exact_and_exr_is_its_half_precision(server):
    exact = panorama(server)
    assert (exact.shape, exact.dtype) == ((16, 32, 3), np.float32)
    half, _ = decode_colour(get(server).body, "exr")
    np.testing.assert_array_equal(half, exact.astype(np.float16).astype(np.float32))
    rough, _ = decode_colour(get(server, "&format=hdr").body, "hdr")
    np.testing.assert_allclose(rough, exact, atol=exact.max() / 128)


def test_every_form_comes_in_its_media_type(server):
    exact = panorama(server)
    for kind, media_type, magic in (
        ("exr", "image/x-exr", b"\x76\x2f\x31\x01"),
        ("hdr", "image/vnd.radiance", b"#?"),
        ("png", "image/png", b"\x89PNG"),
        ("ktx2", "image/ktx2", b"\xabKTX 20"),
        ("specular", "image/ktx2", b"\xabKTX 20"),
        ("confidence", "image/png", b"\x89PNG"),
    ):
        answer = get(server, f"&format={kind}&size=16")
        assert (answer.status, answer.headers["content-type"]) == (200, media_type)
        assert answer.body.startswith(magic)
        assert 0 < float(answer.headers["roomlight-coverage"]) < 1
        assert answer.headers["roomlight-frame"] == "0"
    cube = np.frombuffer(get(server, "&format=cube&size=16").body, "<f2").reshape(6, 16, 16, 4)
    np.testing.assert_array_equal(cube[..., :3], CubeMap.from_panorama(exact, size=16).rgba16f()[..., :3])
    assert 0 <= cube[..., 3].min() < cube[..., 3].max() <= 1
    assert decode_png(get(server, "&format=png&size=8").body).shape == (8, 16, 3)


def test_harmonics_and_main_light_match_the_panorama(server):
    exact = panorama(server)
    values = get(server, "&format=sh").json
    assert values["coefficients"] == project(exact).flat("interleaved").tolist()
    assert (values["layout"], values["phase"], values["kind"]) == ("interleaved", "condon-shortley", "total")
    light = get(server, "&format=main_light").json
    main = MainLight.from_json({name: value for name, value in light.items() if name not in ("lights", "coverage")})
    planar = get(server, "&format=sh&basis=arkit&kind=ambient").json
    assert planar["coefficients"] == project(exact, kind="ambient", light=main).flat("planar").tolist()
    positive = get(server, "&format=sh&basis=threejs").json
    assert positive["coefficients"] == project(exact, phase="positive").flat("interleaved").tolist()
    assert np.linalg.norm(main.direction) == pytest.approx(1)
    assert light["coverage"] == pytest.approx(float(get(server).headers["roomlight-coverage"]), abs=1e-4)


def test_the_etag_changes_if_and_only_if_the_light_does(server):
    server.open("tagged")
    server.push(0, name="tagged")
    first = get(server, "&format=sh", name="tagged")
    tag = first.headers["etag"]
    known = {"If-None-Match": f'"other", W/{tag}'}
    same = get(server, "&format=sh", name="tagged", headers=known)
    assert (same.status, same.body, same.headers["etag"]) == (304, b"", tag)
    assert get(server, "&format=exr", name="tagged", headers=known).status == 200
    assert get(server, "&format=sh&kind=ambient", name="tagged", headers=known).status == 200
    server.push(1, frame(tracking_state="not_available"), name="tagged")
    assert get(server, "&format=sh", name="tagged", headers=known).status == 304
    server.push(2, frame(40), name="tagged")
    changed = get(server, "&format=sh", name="tagged", headers=known)
    assert changed.status == 200
    assert changed.headers["etag"] != tag


def test_named_probes_are_tracked_moved_and_deleted(server):
    server.open("named")
    path = "/v1/sessions/named/probes"
    assert server.call("PUT", f"{path}/table", POINT).status == 201
    early = get(server, path="/probes/table", name="named")
    assert (early.status, early.headers["roomlight-frame"], early.headers["roomlight-coverage"]) == (
        200,
        "-1",
        "0.0000",
    )
    first = server.push(0, name="named").json
    assert 0 < first["coverage"]["table"] < 1
    server.push(1, frame(30), name="named")
    assert get(server, "?format=npy", path="/probes/table", name="named").status == 200
    assert server.call("PUT", f"{path}/table", POINT).status == 200  # unchanged
    assert server.call("PUT", f"{path}/table", {"position": [0.0, 1.0, 0.0]}).status == 200
    assert server.call("PUT", f"{path}/late", POINT).status == 201
    state = server.state("named")
    assert state["probes"] == {"table": [0.0, 1.0, 0.0], "late": POINT["position"]}
    assert all(0 < value < 1 for value in state["coverage"].values())
    assert server.push(2, frame(60), name="named").json["coverage"].keys() == {"table", "late"}
    assert server.call("PUT", f"{path}/third", POINT).status == 201
    full = server.call("PUT", f"{path}/fourth", POINT)
    assert (full.status, full.kind) == (409, "too-many-probes")
    assert server.call("DELETE", f"{path}/table").status == 204
    gone = server.call("DELETE", f"{path}/table")
    assert (gone.status, gone.kind) == (404, "probe-not-found")
    assert get(server, path="/probes/table", name="named").status == 404
    assert server.call("PUT", f"{path}/fourth", POINT).status == 201


def test_a_batch_answers_in_order_after_the_same_frame(server):
    body = {
        "probes": [POINT, {"position": [0, 1, 0]}],
        "forms": [{"format": "sh"}, {"format": "exr"}, {"format": "cube"}],
    }
    answer = post(server, body)
    assert answer.status == 200
    assert answer.json["frame"] == 0
    assert [result["position"] for result in answer.json["results"]] == [POINT["position"], [0, 1, 0]]
    first = answer.json["results"][0]
    assert [form["format"] for form in first["forms"]] == ["sh", "exr", "cube"]
    assert base64.b64decode(first["forms"][1]["data"]) == get(server).body
    assert get(server).headers["etag"].strip('"').startswith(first["etag"])
    binary = post(server, body, headers={"Accept": MEDIA_TYPE})
    assert binary.headers["content-type"] == MEDIA_TYPE
    response, parts = parse_light(binary.body, LightResponse)
    assert parts[0][0] is None
    assert response.results[0].forms[0].values == first["forms"][0]["values"]
    assert parts[0][1] == get(server).body
    assert len(parts[1][2] or b"") == 6 * 32 * 32 * 8


def test_every_form_comes_in_one_request(server):
    harmonics = [
        {"format": "sh", "kind": kind, "basis": basis}
        for kind in get_args(HarmonicsKind)
        for basis in get_args(HarmonicsBasis)
    ]
    forms = [{"format": name} for name in get_args(LightFormat) if name != "sh"] + harmonics
    assert len(forms) == 18 <= MAX_FORMS
    answer = post(server, {"probes": [POINT], "forms": forms})
    assert answer.status == 200, answer.json
    assert [form["format"] for form in answer.json["results"][0]["forms"]] == [form["format"] for form in forms]
    most = forms + forms[: MAX_FORMS - len(forms)]
    assert post(server, {"probes": [POINT], "forms": most}).status == 200
    over = post(server, {"probes": [POINT], "forms": [*most, forms[0]]})
    assert (over.status, over.json["field"]) == (422, "forms")


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"probes": [], "forms": [{"format": "sh"}]}, "probes"),
        ({"probes": [POINT] * 65, "forms": [{"format": "sh"}]}, "probes"),
        ({"probes": [POINT], "forms": []}, "forms"),
        ({"probes": [{}], "forms": [{"format": "sh"}]}, "probes.0"),
        ({"probes": [POINT | {"name": "a"}], "forms": [{"format": "sh"}]}, "probes.0"),
        ({"probes": [{"position": [0, 1]}], "forms": [{"format": "sh"}]}, "probes.0.position"),
        ({"probes": [{"position": [0, 1, 2000]}], "forms": [{"format": "sh"}]}, "probes.0.position.2"),
        ({"probes": [{"name": "../x"}], "forms": [{"format": "sh"}]}, "probes.0.name"),
        ({"probes": [{"name": "nobody"}], "forms": [{"format": "sh"}]}, "name"),
        ({"probes": [POINT], "forms": [{"format": "gif"}]}, "forms.0.format"),
        ({"probes": [POINT], "forms": [{"format": "cube", "size": 33}]}, "forms.0.size"),
        ({"probes": [POINT], "forms": [{"format": "exr", "size": 4096}]}, "forms.0.size"),
        ({"probes": [POINT] * 64, "forms": [{"format": "specular", "size": 256}] * 8}, "forms"),
        ({"probes": [POINT], "forms": [{"format": "png", "exposure_ev": 99}]}, "forms.0.exposure_ev"),
    ],
)
def test_an_invalid_batch_is_rejected_by_field(server, body, field):
    answer = post(server, body)
    assert answer.status in (404, 422)
    assert answer.json["field"] == field, answer.json


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("x=nan&y=0&z=0", "x"), ("x=inf&y=0&z=0", "x"), ("x=0&y=0", "z"), ("x=0&y=0&z=1e9", "z"), ("x=a&y=0&z=0", "x"),
        ("x=0&y=0&z=0&format=bmp", "format"), ("x=0&y=0&z=0&size=7", "size"), ("x=0&y=0&z=0&kind=some", "kind"),
        ("x=0&y=0&z=0&format=cube&size=100", "size"),
    ],
)  # fmt: skip
def test_an_invalid_query_is_rejected_by_field(server, query, field):
    answer = get(server, path=f"/probe?{query}")
    assert (answer.status, answer.kind, answer.json.get("field", "")) == (422, "invalid", field)


def test_before_the_first_frame_there_is_a_default_light(server):
    server.open("dark", SMALL)
    server.call("PUT", "/v1/sessions/dark/probes/table", POINT)
    anywhere = get(server, "&format=npy", name="dark")
    assert (anywhere.headers["roomlight-frame"], anywhere.headers["roomlight-coverage"]) == ("-1", "0.0000")
    np.testing.assert_array_equal(np.load(io.BytesIO(anywhere.body)), prior_panorama(16))
    known = {"If-None-Match": anywhere.headers["etag"]}
    assert get(server, "?format=npy", path="/probes/table", name="dark", headers=known).status == 304
    batch = {"probes": [POINT, {"name": "table"}], "forms": [{"format": "sh"}, {"format": "main_light"}]}
    answer = post(server, batch, name="dark").json
    assert answer["frame"] == -1
    assert [result["coverage"] for result in answer["results"]] == [0, 0]
    assert answer["results"][0]["forms"][1]["values"]["direction"][1] > 0.99
    observed = decode_png(get(server, "&format=confidence", name="dark").body)
    assert observed.shape == (16, 32)
    assert not observed.any()
    missing = post(server, {"probes": [{"name": "nobody"}], "forms": [{"format": "sh"}]}, name="dark")
    assert (missing.status, missing.kind) == (404, "probe-not-found")
    assert server.push(0, name="dark", body=b"no frame").status == 422
    assert get(server, "&format=npy", name="dark", headers=known).status == 304
    assert server.push(0, name="dark").status == 200
    seen = get(server, "&format=npy", name="dark", headers=known)
    assert (seen.status, seen.headers["roomlight-frame"]) == (200, "0")
    assert post(server, batch, name="dark").json["frame"] == 0


def test_a_ready_server_has_prepared_the_usual_cube_sizes():
    """The resampling matrices of the usual sizes, 0.25 s each, are cached."""
    inspect.unwrap(light_forms.warm_up)()
    before = panorama_to_cube.cache_info().misses
    light = Light((0.0, 0.0, 0.0), prior_panorama(120), np.zeros((120, 240), np.float32), 0.0)
    for size in (16, 32, 64):
        light_forms.encode(light, LightForm(format="cube", size=size))
    assert panorama_to_cube.cache_info().misses == before
