"""The page `/docs`: Swagger UI whose files all come from the server itself, so that it works without the internet."""

import re

from http_servers import RunningServer

TOKEN = "token-of-the-docs-test"


def test_the_docs_page_needs_no_other_host_and_no_token():
    with RunningServer(tokens=(TOKEN,)) as server:
        page = server.call("GET", "/docs")
        assert page.status == 200
        text = page.body.decode()
        assert "://" not in text
        assets = re.findall(r"""(?:src|href)=["']([^"']+)["']""", text)
        assert sorted(path.rsplit(".", 1)[1] for path in assets) == ["css", "js", "png"]
        for path in [*assets, "/openapi.json"]:
            assert re.match("/[^/]", path), path
            answer = server.call("GET", path)
            assert answer.status == 200, path
            assert answer.body, path
            if path.endswith(".css"):
                references = re.findall(r"url\(([^)]*)\)", answer.body.decode())
                assert all(each.strip("\"'").startswith("data:") for each in references)
        assert "url: '/openapi.json'" in text


def test_only_the_files_of_the_docs_page_are_open():
    with RunningServer(tokens=(TOKEN,)) as server:
        for path in ("/docs-assets/../v1/sessions/room", "/docs-assets/%2e%2e/core.py", "/docs-assets/core.py"):
            answer = server.call("GET", path)
            assert (answer.status, answer.kind) == (404, "not-found")
        assert server.call("GET", "/v1/sessions/room").status == 401
