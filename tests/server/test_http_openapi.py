"""Conformance to the OpenAPI document: schemathesis sends valid and invalid requests over a real socket."""

import subprocess
import sys

import pytest

from http_servers import RunningServer

TOKEN = "token-of-the-openapi-test"


CONFIG = """
# Valid requests must succeed, except here: the schema of a frame or an object is any bytes, and most are none (422).
[[operations]]
include-operation-id = ["put_frame", "upload_object"]
checks.positive_data_acceptance.enabled = false

# A size is 8 to 512, but cube maps accept only 16, 32, 64, 128 and 256: a schema cannot relate two parameters.
[[operations]]
include-operation-id = ["probe", "named_probe", "probes"]
checks.positive_data_acceptance.enabled = false

# How large a recording may be is a setting. The paths of its files must be relative,
# and probes have names of some letters only.
[[operations]]
include-operation-id = ["add_recording", "put_piece", "start_replay"]
checks.positive_data_acceptance.enabled = false

# Nothing that HTTP can send breaks the schema of any bytes and a header of any text.
[[operations]]
include-operation-id = ["upload_object"]
generation.mode = "positive"

# A new recording has no film until one is made.
[[operations]]
include-operation-id = ["get_film"]
checks.ensure_resource_availability.enabled = false

# An object has exactly one of position, pose and pixel.
[[operations]]
include-operation-id = ["composite", "put_scene", "make_film"]
checks.positive_data_acceptance.enabled = false
"""


@pytest.mark.slow
def test_the_server_conforms_to_its_openapi_document(tmp_path):
    """Run every check of schemathesis.

    No 5xx; no undocumented status, header or body; invalid requests are rejected; tokens are required; valid requests
    succeed, except for the operations whose schema cannot express validity.
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
