"""The TypeScript client: its own tests in Node, then against a real server, from Node and from a page in Chromium.

`pytest -m js` runs them. They need Node 20 or newer, `npm ci` in client/js, and Chromium at /usr/bin/chromium (or its
path in CHROMIUM).
"""

import io
import json
import os
import zipfile

import cv2
import numpy as np
import pytest
from js_package import PACKAGE, build, run
from light_rooms import lit, room

from http_servers import SMALL, RunningServer, box_shot
from roomlight.conventions import panorama_directions
from roomlight.images import decode_colour
from roomlight.light.light import Light
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import column_major, pack

pytestmark = pytest.mark.js

TOKEN = "a-token-for-the-js-tests"
NODE = ["node", "--experimental-websocket"]
TESTS = [*NODE, "--test", "--test-timeout=600000", "--test-reporter=spec"]


@pytest.fixture(scope="module")
def built() -> None:
    build()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with RunningServer(tokens=(TOKEN,), allow_origins=("*",)) as running:
        file = tmp_path_factory.mktemp("sphere") / "sphere.json"
        file.write_text(json.dumps(composited_sphere(running)))
        yield os.environ | {
            "ROOMLIGHT_SERVER": f"http://127.0.0.1:{running.port}",
            "ROOMLIGHT_TOKEN": TOKEN,
            "ROOMLIGHT_SPHERE": str(file),
        }


def composited_sphere(server):
    """Put a matte sphere into a frame: what a renderer needs to draw it, and the composite's pixels inside it."""
    shot, name, place, size_m = box_shot(0), "sphere", [0.2, 1.4, -0.4], 0.5
    server.open(name, SMALL | {"height": 60}, token=TOKEN)
    assert server.push(0, name=name, token=TOKEN).status == 200
    ball = {"shape": "sphere", "size_m": size_m, "position": place, "anchor": "centre"}
    ball["material"] = {"kind": "diffuse", "base_colour": [0.5, 0.5, 0.5]}
    request = {"objects": [ball], "format": "layers", "quality": "good"}
    made = server.call("POST", f"/v1/sessions/{name}/composite", request, token=TOKEN)
    assert made.status == 200, made
    with zipfile.ZipFile(io.BytesIO(made.body)) as layers:
        objects, _ = decode_colour(layers.read("objects.exr"), "objects")
        alpha = cv2.imdecode(np.frombuffer(layers.read("alpha.png"), np.uint8), cv2.IMREAD_UNCHANGED)
    assert alpha is not None
    inside = np.repeat(cv2.erode(alpha, np.ones((3, 3)))[::-1, :, None] == 65535, 3, axis=2).reshape(-1)
    k = shot.intrinsics
    view = {
        "position": place,
        "radius_m": size_m / 2,
        "albedo": 0.5,
        "camera_to_world": column_major(shot.camera_to_world),
        "fov_degrees": float(np.degrees(2 * np.arctan(k.height / 2 / k.fy))),
        "width": k.width,
        "height": k.height,
    }
    radiance = objects[::-1].reshape(-1)[inside].tolist()
    return {"session": name, "view": view, "inside": np.flatnonzero(inside).tolist(), "radiance": radiance}


@pytest.mark.usefixtures("built")
def test_the_tests_of_the_package():
    run([*TESTS, *sorted(path.relative_to(PACKAGE) for path in PACKAGE.glob("build/test/*.test.js"))])


@pytest.mark.usefixtures("built")
@pytest.mark.parametrize("name", ["streaming", "browser"])
def test_against_a_real_server(name, server):
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
def test_random_numbers_are_written_as_python_writes_them():
    random = np.random.default_rng(5)
    headers = []
    for index in range(200):
        numbers = random.normal(size=24) * 10.0 ** random.integers(-12, 9, 24)
        numbers[: index % 8] = np.round(numbers[: index % 8])
        headers.append(
            {
                "index": index,
                "colour": {"encoding": "rgb8", "bytes": 12},
                "depth": {"format": "uint16_mm", "width": 2, "height": 2, "bytes": 8},
                "intrinsics": dict(zip(("fx", "fy", "cx", "cy"), numbers[:4].tolist(), strict=True))
                | {"width": 2, "height": 2},
                "camera_to_world": numbers[4:20].tolist(),
                "timestamp_s": float(numbers[20]),
                "exposure": float(np.float32(np.clip(abs(numbers[21]), 2e-6, 1e6))),
            }
        )
    packed = run([*NODE, "--input-type=module", "--eval", PACK_EACH], text=json.dumps(headers)).split()
    expected = [pack(FrameHeader.model_validate_json(json.dumps(one)), bytes(12), bytes(8)).hex() for one in headers]
    assert packed == expected


READ_EQUIRECT = """
import { DataUtils } from "three";
import { KTX2Loader } from "three/examples/jsm/loaders/KTX2Loader.js";
let text = "";
for await (const chunk of process.stdin) text += chunk;
const { file, directions } = JSON.parse(text);
const loader = new KTX2Loader();
loader.workerConfig = {}; // detectSupport needs a renderer, and only for compressed files
const texture = await new Promise((done, failed) => loader.parse(Uint8Array.from(file).buffer, done, failed));
const { data, width, height } = texture.image;
const colours = directions.map(([x, y, z]) => {
  const [u, v] = [Math.atan2(z, x) / (2 * Math.PI) + 0.5, Math.asin(y) / Math.PI + 0.5]; // three.js: equirectUv
  const at = 4 * (Math.floor(v * height) * width + Math.floor(u * width));
  return [...data.slice(at, at + 4)].map(DataUtils.fromHalfFloat);
});
console.log(JSON.stringify({ colours, space: texture.colorSpace, flipY: texture.flipY }));
"""


def test_three_reads_the_panorama_in_a_ktx2_file():
    directions = panorama_directions(16)[1::5, ::7].reshape(-1, 3)
    panorama = room(16)
    light = Light((0.0, 0.0, 0.0), panorama)
    sent = json.dumps({"file": list(light.file("equirect")), "directions": directions.tolist()})
    read = json.loads(run([*NODE, "--input-type=module", "--eval", READ_EQUIRECT], text=sent))
    assert (read["space"], read["flipY"]) == ("srgb-linear", False)
    np.testing.assert_allclose(np.array(read["colours"])[:, :3], panorama[1::5, ::7].reshape(-1, 3), rtol=2**-10)
    assert np.all(np.array(read["colours"])[:, 3] == 1)


READ_LIGHTS = """
import { Vector3 } from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
let text = "";
for await (const chunk of process.stdin) text += chunk;
const { scene } = await new GLTFLoader().parseAsync(Uint8Array.from(JSON.parse(text)).buffer, "");
const lights = [];
scene.updateMatrixWorld(true);
scene.traverse((light) => {
  if (!light.isDirectionalLight) return;
  const [from, to] = [light, light.target].map((at) => at.getWorldPosition(new Vector3()));
  lights.push({ toward: from.sub(to).toArray(), sheds: light.color.toArray().map((part) => part * light.intensity) });
});
console.log(JSON.stringify(lights));
"""


def test_three_reads_the_lights_of_a_glb_file():
    light = Light((0.0, 0.0, 0.0), lit(32, [((0.6, 0.3, 0.742), 8, 90.0), ((-0.5, 0.7, -0.51), 8, 40.0)], level=0.2))
    read = json.loads(
        run([*NODE, "--input-type=module", "--eval", READ_LIGHTS], text=json.dumps(list(light.file("glb"))))
    )
    for found, wanted in zip(read, light.lights, strict=True):
        np.testing.assert_allclose(found["toward"], wanted.direction, atol=1e-5)
        np.testing.assert_allclose(found["sheds"], wanted.intensity, rtol=1e-4)
