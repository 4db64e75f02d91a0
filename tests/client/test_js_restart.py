"""The TypeScript client's stream and pushes while a real server is killed and started again on the same port."""

import json
import subprocess

import pytest
from js_package import PACKAGE, build
from server_process import ServerProcess

pytestmark = pytest.mark.js

SCRIPT = """
import { RoomLight } from "roomlight";
const plain = (index) => ({
  index,
  colour: { encoding: "rgb8", data: new Uint8Array(36).fill(128 + index) },
  depth: { format: "uint16_mm", width: 4, height: 3, data: new Uint16Array(12).fill(1500) },
  intrinsics: { fx: 3.5, fy: 3.5, cx: 2, cy: 1.5, width: 4, height: 3 },
  camera_to_world: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
});
const say = (value) => console.log(JSON.stringify(value));
const next = () => new Promise((resolve) => process.stdin.once("data", resolve));
const SMALL = { model: "classical", height: 16 };
const reconnect = { attempts: 400, firstDelay_s: 0.05, maxDelay_s: 0.25 };
const server = new RoomLight(process.argv[1], { reconnect });
const [session, other] = [await server.open(SMALL), await server.open(SMALL)];
let open;
const stream = await session.stream({
  onStatus: (status) => status.state === "open" && open?.(status),
});
stream.track("table", [0, 0, -0.5]);
say([await stream.push(plain(0)), await other.push(plain(0))]);
await next(); // killed
const reopened = new Promise((resolve) => (open = resolve));
const results = await Promise.all([stream.push(plain(1)), other.push(plain(1))]);
const [{ frames, probes }, pushed] = [await session.state(), await other.state()];
say({ reopened: (await reopened).reopened, results, processed: [frames.processed, pushed.frames.processed], probes });
stream.close();
await Promise.all([session.delete(), other.delete()]);
process.exit(0);
"""


def test_streams_and_pushes_survive_a_killed_server():
    build()
    with ServerProcess() as server:
        node = subprocess.Popen(
            ["node", "--experimental-websocket", "--input-type=module", "--eval", SCRIPT, server.url],
            cwd=PACKAGE,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        with node:
            told, answers = node.stdin, node.stdout
            assert told is not None
            assert answers is not None

            assert [result["status"] for result in json.loads(answers.readline())] == ["processed"] * 2
            server.kill()
            told.write("killed\n")
            told.flush()
            server.start()
            answer = json.loads(answers.readline())
            assert answer["reopened"] is True
            assert [(result["index"], result["status"]) for result in answer["results"]] == [(1, "processed")] * 2
            assert (answer["processed"], answer["probes"]) == ([2, 2], {"table": [0, 0, -0.5]})
            assert node.wait(600) == 0
