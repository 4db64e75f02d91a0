"""The live page in Chromium against a real server: `pytest -m js tests/page`.

Needs Node 20.19 or newer, `npm ci` in client/page, and Chromium at /usr/bin/chromium (or its path in CHROMIUM).
"""

import json
import os
import subprocess
from pathlib import Path

import formats
import pytest
from page_control import PageServer

pytestmark = pytest.mark.js

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "client/page"
BUILT = ROOT / "server/roomlight_server/page"
TOKEN = "a-token-for-the-page"


def run(*command, **env):
    assert (PAGE / "node_modules").is_dir(), "run `npm ci` in client/page first"
    done = subprocess.run(
        command, cwd=PAGE, env=os.environ | env, capture_output=True, text=True, check=False, timeout=620
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-12000:]}\n{done.stderr[-4000:]}"


def drive(name, server, **env):
    """Run one file of browser tests against a server."""
    test = ("node", "--test", "--test-timeout=600000", "--test-reporter=spec", f"test/{name}.test.mjs")
    run(*test, PAGE_URL=server.url, CONTROL_URL=server.control_url, **env)


def test_types():
    run("npm", "run", "--silent", "check")


def test_the_committed_build_is_the_build_of_the_sources(tmp_path):
    run("npm", "run", "--silent", "build", PAGE_OUT=str(tmp_path / "page"))
    fresh, committed = (
        {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path / "page", BUILT)
    )
    assert fresh.keys() == committed.keys(), "run `npm run build` in client/page and commit the result"
    assert [name for name in fresh if fresh[name] != committed[name]] == []


def test_the_build_names_no_other_host():
    """Namespaces of XML and addresses in licence comments are names, not requests."""
    for path in BUILT.rglob("*"):
        if path.suffix in (".html", ".css"):
            text = path.read_text()
            assert "http://" not in text, path
            assert "https://" not in text, path


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["objects", "accessibility", "connection", "panels"])  # after the longest a short one
def test_in_chromium(name):
    with PageServer() as server:
        drive(name, server)


@pytest.mark.parametrize("name", ["token", "phone"])
def test_with_a_token(name):
    with PageServer(tokens=(TOKEN,), public_url="http://a.server") as server:
        drive(name, server, PAGE_TOKEN=TOKEN)


def test_recordings(tmp_path):
    views = formats.scene()
    folder = formats.roomlight(tmp_path / "kitchen", views)
    index = json.loads((folder / "capture.json").read_text())
    for number, stated in enumerate(index["frames"]):
        stated["timestamp_s"] = number * 100_000_000  # nanoseconds, which is a note
    (folder / "capture.json").write_text(json.dumps(index))
    archive = formats.record3d(tmp_path / "hall.r3d", views)
    with PageServer(pace=4) as server:
        drive("recordings", server, FOLDER=str(folder), ARCHIVE=str(archive))
