"""The TypeScript client: its own tests under Node, then against a real server, from Node and from a page in Chromium.

Run by `pytest -m js`, which wants Node 20 or newer, `npm ci` in client/js, and Debian's chromium (or the path of
another in CHROMIUM); plain `pytest` leaves them out.
"""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from http_servers import RunningServer
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import pack

pytestmark = pytest.mark.js

CLIENT = Path(__file__).parents[2] / "client/js"
TOKEN = "a-token-for-the-js-tests"
NODE = ["node", "--experimental-websocket"]
TESTS = [*NODE, "--test", "--test-timeout=60000", "--test-reporter=spec"]


def run(command, **more):
    """Standard output of a command in client/js; what it wrote, if it fails."""
    done = subprocess.run(command, cwd=CLIENT, capture_output=True, text=True, check=False, timeout=200, **more)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout[-8000:]}\n{done.stderr[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def built():
    assert (CLIENT / "node_modules").is_dir(), "run `npm ci` in client/js first"
    run(["npm", "run", "--silent", "build:tests"])


@pytest.fixture(scope="module")
def server():
    with RunningServer(tokens=(TOKEN,), allow_origins=("*",)) as running:
        yield os.environ | {"ROOMLIGHT_SERVER": f"http://127.0.0.1:{running.port}", "ROOMLIGHT_TOKEN": TOKEN}


@pytest.mark.usefixtures("built")
def test_its_own_tests():
    run([*TESTS, *sorted(path.relative_to(CLIENT) for path in CLIENT.glob("build/test/*.test.js"))])


@pytest.mark.usefixtures("built")
@pytest.mark.parametrize("name", ["streaming", "browser"])
def test_against_the_server(name, server):
    run([*TESTS, f"build/test/real_server/{name}.test.js"], env=server)


PACK_EACH = """
import { packFrame } from "roomlight";
let text = "";
for await (const chunk of process.stdin) text += chunk;
for (const { colour, depth, ...rest } of JSON.parse(text)) {
  const [pixels, values] = [new Uint8Array(colour.bytes), new Uint8Array(depth.bytes)];
  const frame = { ...rest, colour: { ...colour, data: pixels }, depth: { ...depth, data: values } };
  console.log(Buffer.from(await packFrame(frame)).toString("hex"));
}
"""


@pytest.mark.usefixtures("built")
def test_any_number_is_written_as_python_writes_it():
    random = np.random.default_rng(5)
    headers = []
    for at in range(200):
        numbers = random.normal(size=24) * 10.0 ** random.integers(-12, 9, 24)
        numbers[: at % 8] = np.round(numbers[: at % 8])
        headers.append(
            {
                "index": at,
                "colour": {"encoding": "rgb8", "bytes": 12},
                "depth": {"format": "uint16_mm", "width": 2, "height": 2, "bytes": 8},
                "intrinsics": dict(zip(("fx", "fy", "cx", "cy"), numbers[:4].tolist(), strict=True))
                | {"width": 2, "height": 2},
                "camera_to_world": numbers[4:20].tolist(),
                "timestamp_s": float(numbers[20]),
                "exposure": float(np.float32(np.clip(abs(numbers[21]), 2e-6, 1e6))),
            }
        )
    packed = run([*NODE, "--input-type=module", "--eval", PACK_EACH], input=json.dumps(headers)).split()
    wanted = [pack(FrameHeader.model_validate_json(json.dumps(one)), bytes(12), bytes(8)).hex() for one in headers]
    assert packed == wanted


def test_the_lock_file_names_no_host_and_the_package_depends_on_nothing():
    assert "resolved" not in (CLIENT / "package-lock.json").read_text()
    package = json.loads((CLIENT / "package.json").read_text())
    assert "dependencies" not in package
    assert package["peerDependenciesMeta"] == {"three": {"optional": True}}
