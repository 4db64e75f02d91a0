"""The live page's files, and who may reach them: Host, Origin, tokens."""

import gzip
from pathlib import Path

import pytest

from http_servers import TOKEN, RunningServer
from roomlight_server.routes import page as page_routes


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A small built page, served in this module."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "assets").mkdir()
    (folder / "index.html").write_text("<!doctype html><title>RoomLight</title>" + " " * 500)
    (folder / "phone.html").write_text("<!doctype html><title>Phone</title>")
    (folder / "assets" / "index-1a2b.js").write_text("export {};")
    (folder / "assets" / "icon.svg").write_text("<svg/>")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page_routes, "page_folder", lambda: folder)
        yield folder


@pytest.fixture(scope="module")
def server(page):
    assert page.is_dir()
    with RunningServer() as running:
        yield running


@pytest.mark.usefixtures("page")
def test_the_page_is_served_without_a_token():
    with RunningServer(tokens=(TOKEN,)) as server:
        for path, title in (("/", "RoomLight"), ("/phone", "Phone")):
            answer = server.call("GET", path)
            assert (answer.status, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
            assert f"<title>{title}</title>" in answer.body.decode()
            assert answer.headers["cache-control"] == "no-cache"
        assert server.call("GET", "/v1/sessions").status == 401


def test_assets_are_cached_for_ever(server):
    answer = server.call("GET", "/assets/index-1a2b.js")
    assert answer.body == b"export {};"
    assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert answer.headers["content-type"] == "text/javascript; charset=utf-8"
    assert server.call("GET", "/assets/icon.svg").headers["content-type"] == "image/svg+xml"


def test_a_page_is_sent_once_and_compressed_where_that_is_accepted(server):
    plain = server.call("GET", "/")
    again = server.call("GET", "/", headers={"If-None-Match": plain.headers["etag"]})
    assert (again.status, again.body) == (304, b"")
    packed = server.call("GET", "/", headers={"Accept-Encoding": "gzip, br"})
    assert (packed.headers["content-encoding"], packed.headers["vary"]) == ("gzip", "Accept-Encoding")
    assert len(packed.body) < len(plain.body)
    assert gzip.decompress(packed.body) == plain.body


def test_the_page_may_load_from_its_own_server_only(server):
    headers = server.call("GET", "/").headers
    policy = dict(each.split(" ", 1) for each in headers["content-security-policy"].split("; "))
    assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == policy["form-action"] == "'none'"
    for sources in policy.values():
        assert set(sources.split()) <= {"'none'", "'self'", "'wasm-unsafe-eval'", "blob:", "data:"}
    assert "data:" not in policy["script-src"]
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"


def test_a_missing_page_says_how_to_build_it(tmp_path, monkeypatch):
    monkeypatch.setattr(page_routes, "page_folder", lambda: tmp_path / "none")
    with RunningServer() as server:
        answer = server.call("GET", "/")
        assert (answer.status, answer.kind) == (404, "page-not-built")
        assert "npm run build" in answer.json["detail"]


@pytest.mark.parametrize("path", ["/assets/..%2findex.html", "/assets/../../app.py", "/assets/", "/assets/none.js"])
def test_no_other_file_is_served_beside_the_page(server, path):
    answer = server.call("GET", path)
    assert (answer.status, answer.kind) == (404, "not-found")


def test_unusable_pages_are_refused(tmp_path, monkeypatch):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "map.tiles").write_bytes(b"1" * 200)
    with pytest.raises(ValueError, match=r"no media type is known for \.tiles"):
        page_routes.page_files.__wrapped__(tmp_path)
    monkeypatch.setattr(page_routes, "MAX_PAGE_BYTES", 100)
    with pytest.raises(ValueError, match="at most 100"):
        page_routes.page_files.__wrapped__(tmp_path)


@pytest.mark.usefixtures("page")
@pytest.mark.parametrize(
    ("token", "allowed", "answered", "refused"),
    [
        (
            TOKEN,
            ("room.local", "10.0.0.7", "fe80::1"),
            ("room.local:8090", "10.0.0.7", "[fe80::1]:8090"),
            ("evil.example", "room.local.evil.example", "127.0.0.1"),
        ),
        (None, ("Box.lan",), ("box.lan:8090", "BOX.LAN", "127.0.0.1"), ("evil.example",)),
    ],
    ids=["token", "no token"],
)
def test_allowed_hosts_are_checked_with_a_token_and_without(token, allowed, answered, refused):
    with RunningServer(tokens=() if token is None else (token,), allow_hosts=allowed) as server:
        for hosts, status in ((answered, 200), (refused, 403)):
            for host in hosts:
                assert server.call("GET", "/v1/sessions", token=token, headers={"Host": host}).status == status, host


@pytest.mark.parametrize("method", ["GET", "PUT", "DELETE"])
@pytest.mark.parametrize("origin", ["https://evil.example", "http://localhost:3000", "null"])
def test_pages_of_other_sites_are_refused(server, method, origin):
    body = {} if method == "PUT" else None
    answer = server.call(method, "/v1/sessions/foreign", body, headers={"Origin": origin})
    assert (answer.status, answer.kind, answer.json["field"]) == (403, "forbidden-origin", "Origin")
    assert server.call("GET", "/v1/sessions/foreign").status == 404


@pytest.mark.parametrize(
    ("site", "status"), [("cross-site", 403), ("same-site", 403), ("same-origin", 200), ("none", 200)]
)
def test_requests_without_origin_are_judged_by_their_site(server, site, status):
    """A page of another site can load `/v1/..` as an image or a script: no Origin is sent then."""
    answer = server.call("GET", "/v1/sessions", headers={"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"})
    assert answer.status == status


def test_the_own_page_is_allowed(server):
    own = {"Origin": f"http://127.0.0.1:{server.port}", "Sec-Fetch-Site": "same-origin"}
    assert server.call("PUT", "/v1/sessions/room", {}, headers=own).status == 201


def test_the_page_makes_no_element_from_text():
    """Names of files may be markup; `client/page/test/recordings.test.mjs` shows one in a browser."""
    sources = list((Path(__file__).parents[2] / "client/page/src").rglob("*.ts"))
    assert len(sources) > 10
    for path in sources:
        text = path.read_text("utf-8")
        for call in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "createContextualFragment"):
            assert call not in text, path
