"""The OpenAPI document against the server: schemathesis makes requests of it, right and wrong, over a real socket."""

import subprocess
import sys

from http_servers import RunningServer

TOKEN = "token-of-the-openapi-test"


def test_requests_made_of_the_document_find_what_it_says():
    """No 5xx, no status, header or body that is not described, wrong requests refused, tokens asked for.

    `positive_data_acceptance` is left out: a frame that is only right by its schema is no frame.
    """
    with RunningServer(tokens=(TOKEN,), max_sessions=10_000) as server:
        done = subprocess.run(
            [
                *(sys.executable, "-m", "schemathesis.cli", "run", f"http://127.0.0.1:{server.port}/openapi.json"),
                *("--header", f"Authorization: Bearer {TOKEN}", "--max-examples", "15", "--seed", "5"),
                *("--exclude-checks", "positive_data_acceptance", "--no-color"),
            ],
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
        text = server.call("GET", "/metrics").body.decode()
        assert 'status="500"' not in text
        assert 'status="201"' in text
