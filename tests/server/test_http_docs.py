"""The page `/docs`: Swagger UI whose files all come from the server itself, so that it works without the internet."""

import re

import pytest

from http_servers import RunningServer


@pytest.fixture(scope="module")
def server():
    with RunningServer(tokens=("token-of-the-docs-test",)) as running:
        yield running


def test_the_docs_page_needs_no_other_host_and_no_token(server):
    page = server.call("GET", "/docs")
    assert page.status == 200
    text = page.body.decode()
    assert "://" not in text
    assets = re.findall(r"""(?:src|href)=["']([^"']+)["']""", text)
    assert sorted(path.rsplit(".", 1)[1] for path in assets) == ["css", "js", "png"]
    assert "url: '/openapi.json'" in text
    for path in [*assets, "/openapi.json"]:
        assert re.match("/[^/]", path), path
        answer = server.call("GET", path)
        assert answer.status == 200, path
        assert answer.body, path
        if path.endswith(".css"):
            references = re.findall(r"url\(([^)]*)\)", answer.body.decode())
            assert all(each.strip("\"'").startswith("data:") for each in references)


@pytest.mark.parametrize("path", ["/../v1/sessions/room", "/%2e%2e/core.py", "/core.py"])
def test_no_other_file_is_served_beside_the_docs_assets(server, path):
    answer = server.call("GET", f"/docs-assets{path}")
    assert (answer.status, answer.kind) == (404, "not-found")
    assert server.call("GET", "/v1/sessions/room").status == 401
