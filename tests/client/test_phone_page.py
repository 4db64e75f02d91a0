"""The phone's page, built from its sources, in Chromium against a real server. `pytest -m js` runs it.

It needs `npm ci` in client/page and Chromium at /usr/bin/chromium, or its path in CHROMIUM.
"""

import os

import pytest
from js_package import PACKAGE, run

from http_servers import RunningServer

pytestmark = pytest.mark.js

PAGE = PACKAGE.parent / "page"
TOKEN = "a-token-for-the-phone-tests"


def test_the_phone_page_in_chromium(tmp_path, monkeypatch):
    assert (PAGE / "node_modules").is_dir(), "run `npm ci` in client/page first"
    built = tmp_path / "page"
    run(["npx", "vite", "build", "--logLevel", "warn"], folder=PAGE, env=os.environ | {"PAGE_OUT": str(built)})
    monkeypatch.setattr("roomlight_server.routes.page.page_folder", lambda: built)
    with RunningServer(public_url="http://a.server", tokens=(TOKEN,), model="classical") as running:
        env = os.environ | {"ROOMLIGHT_SERVER": f"http://127.0.0.1:{running.port}", "ROOMLIGHT_TOKEN": TOKEN}
        run(["node", "--test", "--test-timeout=90000", "test/phone.test.mjs"], folder=PAGE, env=env)
