"""The page `/docs`: Swagger UI whose files all come from the server itself, so that it works without the internet."""

import re

import pytest

from http_servers import RunningServer
from roomlight_server.base.problems import RESTORE_PROBLEMS


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


def test_the_openapi_document_has_schemas_of_all_answers_and_messages_and_the_headers_of_etags(server):
    document = server.call("GET", "/openapi.json").json
    for path, operations in document["paths"].items():
        for operation in operations.values():
            answers = operation["responses"]
            contents = [content for answer in answers.values() for content in answer.get("content", {}).values()]
            assert all(content["schema"] for content in contents), operation["summary"]
            headers = {entry["name"] for entry in operation.get("parameters", ()) if entry["in"] == "header"}
            assert ("If-None-Match" in headers) == ("304" in answers), operation["summary"]
            for status, answer in answers.items():
                if status.startswith(("4", "5")) and status != "503":
                    assert "application/problem+json" in answer["content"], (operation["summary"], status)
            names = re.findall("`([a-z-]+)`: ", " ".join(answer["description"] for answer in answers.values()))
            assert len(set(names)) == len(names), operation["summary"]
            if path.startswith("/v1/sessions/{session_id}") and operation["operationId"] != "delete_session":
                assert set(RESTORE_PROBLEMS) <= set(names), operation["summary"]
    assert {"FrameHeader", "Problem", "LightingUpdate", "Subscribe"} <= document["components"]["schemas"].keys()
    film = document["paths"]["/v1/recordings/{recording_id}/film"]["get"]["responses"]["200"]
    assert film["content"]["video/mp4"]["schema"] == {"type": "string", "format": "binary"}


@pytest.mark.parametrize("path", ["/../v1/sessions/room", "/%2e%2e/core.py", "/core.py"])
def test_no_other_file_is_served_beside_the_docs_assets(server, path):
    answer = server.call("GET", f"/docs-assets{path}")
    assert (answer.status, answer.kind) == (404, "not-found")
    assert server.call("GET", "/v1/sessions/room").status == 401
