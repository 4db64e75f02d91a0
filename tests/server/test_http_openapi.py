"""The OpenAPI document against the server: schemathesis makes requests of it, right and wrong, over a real socket."""

import subprocess
import sys

from http_servers import RunningServer

TOKEN = "token-of-the-openapi-test"


CONFIG = """
# A right request must be taken, except here. To a schema a frame is bytes, and bytes of any kind are no frame: 422.
[[operations]]
include-operation-id = "put_frame"
checks.positive_data_acceptance.enabled = false

# A size is 8 to 512, of which cube maps take 16, 32, 64, 128 and 256: one parameter's schema cannot look at another.
[[operations]]
include-operation-id = ["probe", "named_probe", "probes"]
checks.positive_data_acceptance.enabled = false
"""


def test_requests_made_of_the_document_find_what_it_says(tmp_path):
    """Every check of schemathesis: no 5xx, no status, header or body that is not described, wrong requests refused,
    tokens asked for, and right requests taken, but for the four operations whose schema cannot say what is right.
    """
    config = tmp_path / "schemathesis.toml"
    config.write_text(CONFIG)
    with RunningServer(tokens=(TOKEN,), max_sessions=10_000) as server:
        done = subprocess.run(
            [
                *(sys.executable, "-m", "schemathesis.cli", "--config-file", config, "run"),
                f"http://127.0.0.1:{server.port}/openapi.json",
                *("--header", f"Authorization: Bearer {TOKEN}", "--max-examples", "15", "--seed", "5", "--no-color"),
            ],
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
        text = server.call("GET", "/metrics").body.decode()
        assert 'status="500"' not in text
        assert 'status="201"' in text
