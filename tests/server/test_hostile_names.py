"""Names that are markup: sessions and probes have none, and pages and pictures show the names of files as text.

The live page is shown in a browser by `client/page/test/recordings.test.mjs`.
"""

from pathlib import Path

import pytest

from http_servers import RunningServer

PAGE = Path(__file__).parents[2] / "client/page/src"


@pytest.mark.parametrize("name", ["<b>", "a&b", "a'b", 'a"b', "a b", "é"])
def test_names_of_sessions_and_probes_have_no_markup(name):
    with RunningServer() as server:
        path = "".join(f"%{byte:02x}" for byte in name.encode())
        assert server.call("PUT", f"/v1/sessions/{path}", {"model": "classical"}).kind == "invalid"
        server.open()
        place = {"position": [0, 1, 0]}
        assert server.call("PUT", f"/v1/sessions/room/probes/{path}", place).kind == "invalid"


def test_the_page_makes_no_element_from_text():
    sources = [path for path in PAGE.rglob("*.ts") if "vendor" not in path.parts]
    assert len(sources) > 10
    for path in sources:
        text = path.read_text("utf-8")
        for call in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "createContextualFragment"):
            assert call not in text, path
