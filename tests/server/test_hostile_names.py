"""Names that are markup: sessions and probes have none, and pages and pictures show the names of files as text.

The live page is shown in a browser by `client/page/test/recordings.test.mjs`.
"""

from pathlib import Path

PAGE = Path(__file__).parents[2] / "client/page/src"


def test_the_page_makes_no_element_from_text():
    sources = [path for path in PAGE.rglob("*.ts") if "vendor" not in path.parts]
    assert len(sources) > 10
    for path in sources:
        text = path.read_text("utf-8")
        for call in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "createContextualFragment"):
            assert call not in text, path
