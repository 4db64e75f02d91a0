"""The TypeScript client's stream and pushes while a real server is killed and started again on the same port."""

import json
import subprocess

import pytest
from js_package import PACKAGE, run
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
const reconnect = { attempts: 400, firstDelay_s: 0.05, maxDelay_s: 0.25 };
const session = await new RoomLight(process.argv[1], { reconnect }).open({ model: "classical", height: 16 });
let open;
const stream = await session.stream({
  onStatus: (status) => status.state === "open" && open?.(status),
});
stream.track("table", [0, 0, -0.5]);
say(await stream.push(plain(0)));
await next(); // killed
const reopened = new Promise((resolve) => (open = resolve));
const pushed = stream.push(plain(1));
say({ reopened: (await reopened).reopened, result: await pushed });
const { frames, probes } = await session.state();
say({ processed: frames.processed, probes });
stream.close();
say("killed again?");
await next();
say(await session.push(plain(2)));
say({ processed: (await session.state()).frames.processed });
await session.delete();
process.exit(0);
"""


def test_streams_and_pushes_survive_a_killed_server():
    run(["npm", "run", "--silent", "build"])
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

            def heard():
                return json.loads(answers.readline())

            def restart():
                server.kill()
                told.write("killed\n")
                told.flush()
                server.start()

            assert heard()["status"] == "processed"
            restart()
            answer = heard()
            assert answer["reopened"] is True
            assert (answer["result"]["index"], answer["result"]["status"]) == (1, "processed")
            assert heard() == {"processed": 2, "probes": {"table": [0, 0, -0.5]}}
            assert heard() == "killed again?"
            restart()
            assert heard()["index"] == 2
            assert heard() == {"processed": 3}
            assert node.wait(60) == 0
