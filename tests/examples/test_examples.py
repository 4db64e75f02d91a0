"""Every script of `examples/` runs as its docstring says, and what it writes is plausible light."""

import ast
import csv
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import cv2
import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, GltfFile
from js_package import build, run

import roomlight as rl
from http_servers import RunningServer
from roomlight.conventions import panorama_directions, srgb8_to_linear
from roomlight.images import read_colour, read_panorama, write_exr
from roomlight.light.light import Light
from roomlight_client import Client

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


def run_example(name: str, *arguments: object, cwd: Path) -> str:
    """Run a script in `cwd`, where it writes to `out/` by default, and return its standard output."""
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=800)
    assert done.returncode == 0, done.stderr
    return done.stdout


def assert_indoor_light(path: Path) -> np.ndarray:
    """Check that a panorama has the engine's size and the radiance of a room whose white walls are near 1."""
    panorama = read_panorama(path)
    assert panorama.shape == (120, 240, 3)
    assert np.isfinite(panorama).all()
    assert panorama.min() >= 0
    assert 0.05 < panorama.mean() < 2
    assert panorama.std() > 0.02
    return panorama


def assert_background(
    picture: Path, panorama: np.ndarray, forward: np.ndarray, *, fov_deg: float, pixels: tuple[tuple[int, int], ...]
) -> None:
    """Check that a render of 64 x 64 shows the panorama in the direction of each pixel (column, row)."""
    srgb = cv2.imread(str(picture))
    assert srgb is not None
    assert srgb.shape == (64, 64, 3)
    right = np.array([1.0, 0, 0])
    up = np.cross(right, forward)
    for column, row in pixels:
        across, down = ((at + 0.5) / 32 - 1 for at in (column, row))
        x, y, z = forward + np.tan(np.radians(fov_deg / 2)) * (across * right - down * up)
        u, v = 0.5 + np.arctan2(z, x) / (2 * np.pi), np.arccos(y / np.sqrt(x * x + y * y + z * z)) / np.pi
        at_row, at_column = int(v * 120), int(u * 240)
        expected = panorama[at_row - 3 : at_row + 4, at_column - 3 : at_column + 4].mean(axis=(0, 1))
        mean_srgb = srgb[row - 2 : row + 3, column - 2 : column + 3, ::-1].mean(axis=(0, 1)) / 255
        shown = ((mean_srgb + 0.055) / 1.055) ** 2.4
        np.testing.assert_allclose(shown, expected, rtol=0.15, atol=0.01)


def test_every_example_has_a_test_and_a_row_in_the_readme() -> None:
    readme, tests = (EXAMPLES / "README.md").read_text(), Path(__file__).read_text()
    for path in [*EXAMPLES.glob("*.py"), *EXAMPLES.glob("*.html")]:
        assert f"[`{path.name}`]({path.name})" in readme
        assert f'"{path.stem}"' in tests or path.name in tests


@pytest.mark.slow
def test_the_notebook_shows_a_frame_the_session_its_light_and_a_composite() -> None:
    """Run the cells as Jupyter does, without it: each shows its last expression."""
    names: dict[str, object] = {}
    shown: list[object] = []
    for cell in json.loads((EXAMPLES / "notebook.ipynb").read_text())["cells"]:
        if cell["cell_type"] == "code":
            *statements, last = ast.parse("".join(cell["source"])).body
            assert isinstance(last, ast.Expr)
            exec(compile(ast.Module(statements, []), "notebook", "exec"), names)
            shown.append(eval(compile(ast.Expression(last.value), "notebook", "eval"), names))
    assert [type(value).__name__ for value in shown] == ["Frame", "Session", "Light", "Composite"]
    for value in shown:
        picture = getattr(value, "_repr_png_", getattr(value, "_repr_html_", None))
        assert picture is not None
        assert len(picture()) > 1000


@pytest.mark.slow
def test_replay_folder(tmp_path: Path) -> None:
    printed = run_example("replay_folder", "--frames", 3, cwd=tmp_path)
    files = sorted((tmp_path / "out/replay_folder").iterdir())
    assert [path.name for path in files] == ["light.000000.exr", "light.000001.exr", "light.000002.exr"]
    first, *_, last = [assert_indoor_light(path) for path in files]
    assert not np.array_equal(first, last)
    assert printed.count("% of the directions observed") == 3


@pytest.mark.slow
def test_virtual_object(tmp_path: Path) -> None:
    printed = run_example("virtual_object", "--frames", 2, cwd=tmp_path)
    files = sorted((tmp_path / "out/virtual_object").iterdir())
    assert [path.name for path in files] == ["000000.jpg", "000001.jpg"]
    room = next(iter(rl.open_capture(rl.sample_capture()))).image
    picture = cv2.imread(str(files[0]))
    assert picture is not None
    assert picture.shape == room.shape
    covered = [float(line.rpartition("covers ")[2].partition("%")[0]) for line in printed.splitlines()]
    assert all(0.5 < share < 30 for share in covered)


@pytest.mark.slow
def test_light_one_photo(tmp_path: Path) -> None:
    run_example("light_one_photo", cwd=tmp_path)
    out = tmp_path / "out/light_one_photo"
    assert_indoor_light(out / "light.exr")
    assert (out / "light.hdr").read_bytes().startswith(b"#?RADIANCE")
    assert cv2.imread(str(out / "light.png")) is not None
    light = json.loads((out / "light.json").read_text())
    assert np.linalg.norm(light["main_light"]["direction"]) == pytest.approx(1, abs=1e-5)
    assert len(light["harmonics"]["coefficients"]) == 27
    assert light["position"][2] < 0  # in front of the camera


@pytest.mark.slow
def test_stream_to_server(tmp_path: Path) -> None:
    with RunningServer() as server:
        url = f"http://127.0.0.1:{server.port}"
        printed = run_example("stream_to_server", "--server", url, "--frames", 2, cwd=tmp_path)
    assert printed.count("main light from") == 2
    assert_indoor_light(tmp_path / "out/stream_to_server/light.exr")


@pytest.mark.slow
def test_batch_of_recordings(tmp_path: Path) -> None:
    run_example("batch_of_recordings", rl.sample_capture(), rl.sample_capture(), "--frames", 2, cwd=tmp_path)
    with (tmp_path / "out/batch_of_recordings/lights.csv").open() as file:
        row, again = csv.DictReader(file)
    assert (row["recording"], again["file"]) == (again["recording"], row["file"].replace(".exr", "-2.exr"))
    assert 0.1 < float(row["coverage"]) < 1
    assert np.linalg.norm([float(row[f"direction_{axis}"]) for axis in "xyz"]) == pytest.approx(1, abs=1e-3)
    assert_indoor_light(tmp_path / f"out/batch_of_recordings/{row['file']}")


@pytest.mark.slow
def test_own_capture_format(tmp_path: Path) -> None:
    run_example("own_capture_format", "--frames", 2, cwd=tmp_path)
    converted = assert_indoor_light(tmp_path / "out/own_capture_format/light.exr")
    # The foreign recording was made from the sample room: converted back, it gives the sample's own light.
    session = rl.Session()
    frames = list(rl.open_capture(rl.sample_capture(), rl.CaptureOptions(max_frames=2)))
    for frame in frames:
        session.push(frame)
    direct = session.light_at(rl.point_in_view(frames[0])).panorama
    assert np.abs(converted - direct).mean() < 0.01 * direct.mean()  # 8-bit colour, and half floats in the file


def test_write_capture(tmp_path: Path) -> None:
    run_example("write_capture", "--frames", 2, cwd=tmp_path)
    capture = rl.open_capture(tmp_path / "out/write_capture")
    assert len(list(capture)) == 2
    assert capture.skipped == []
    assert capture.probes[0].panorama().mean() > 0.05


@pytest.mark.slow
def test_own_weights(tmp_path: Path) -> None:
    printed = run_example("own_weights", "--frames", 2, cwd=tmp_path)
    network = assert_indoor_light(tmp_path / "out/own_weights/model.exr")
    classical = assert_indoor_light(tmp_path / "out/own_weights/classical.exr")
    assert not np.array_equal(network, classical)
    assert 0 < float(printed.split()[-1]) < 1


@pytest.mark.slow
def test_mitsuba_render(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    run_example("mitsuba_render", "--size", 64, cwd=tmp_path)
    out = tmp_path / "out/mitsuba_render"
    panorama = assert_indoor_light(out / "light.exr")
    forward = np.array([0, -0.6, -1.6]) / np.hypot(0.6, 1.6)
    assert_background(out / "render.png", panorama, forward, fov_deg=50, pixels=((50, 3), (55, 5)))


with_blender = pytest.mark.skipif(
    shutil.which("blender") is None and importlib.util.find_spec("bpy") is None,
    reason="neither Blender nor its module bpy is installed",
)


def run_in_blender(script: Path, *arguments: object, cwd: Path) -> None:
    """Run a script in Blender, or in its module `bpy`."""
    blender = shutil.which("blender")
    command = [blender, "--background", "--python-exit-code", "1", "--python"] if blender else [sys.executable]
    command += [str(script), "--"]
    subprocess.run([*command, *map(str, arguments)], cwd=cwd, check=True, timeout=800)


RENDER_FRAMES = """
import sys
import bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[sys.argv.index("--") + 1])
scene = bpy.context.scene
bpy.ops.object.camera_add(location=(0, 0, -50))  # looks down, away from Blender's cube
scene.camera = bpy.context.object
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
scene.render.resolution_x = scene.render.resolution_y = 4
scene.render.image_settings.file_format = "OPEN_EXR"
for frame in (3, 5, 7, 9):
    scene.frame_set(frame)
    scene.render.filepath = bpy.path.abspath(f"//../shown-{frame}.exr")
    bpy.ops.render.render(write_still=True)
"""


@with_blender
@pytest.mark.slow
def test_blender_replay(tmp_path: Path) -> None:
    colours = {0: (1.0, 2.0, 0.5), 3: (4.0, 0.5, 0.25), 7: (0.25, 8.0, 1.0)}
    for frame, colour in colours.items():
        write_exr(tmp_path / f"light/probe-00/light.{frame:06d}.exr", np.full((4, 8, 3), colour, np.float32))
    (tmp_path / "render.py").write_text(RENDER_FRAMES)
    run_in_blender(EXAMPLES / "blender_replay.py", cwd=tmp_path)
    run_in_blender(tmp_path / "render.py", tmp_path / "out/blender_replay.blend", cwd=tmp_path)
    for frame, wanted in ((3, 3), (5, 3), (7, 7), (9, 7)):
        shown = read_colour(tmp_path / f"shown-{frame}.exr")[0]
        np.testing.assert_allclose(shown.mean(axis=(0, 1)), colours[wanted], rtol=0.02)


RENDER_USD = """
import json, sys
import bpy, mathutils
package, directions = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("room")  # takes the dome's place
bpy.ops.wm.usd_import(filepath=package)
bpy.ops.object.camera_add()
scene.camera = camera = bpy.context.object
camera.data.angle, camera.rotation_mode = 0.05, "QUATERNION"
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
scene.render.resolution_x = scene.render.resolution_y = 4
scene.render.image_settings.file_format = "OPEN_EXR"
for number, (x, y, z) in enumerate(json.loads(directions)):
    camera.rotation_quaternion = mathutils.Vector((x, -z, y)).to_track_quat("-Z", "Y")  # its world has z up
    scene.render.filepath = f"{package}.{number}.exr"
    bpy.ops.render.render(write_still=True)
"""


@with_blender
@pytest.mark.slow
def test_blender_shows_the_dome_of_a_usdz_where_it_is(tmp_path: Path) -> None:
    """The panorama's colours are its directions, and so are those of Blender's world after the import."""
    Light((0.0, 0.0, 0.0), (panorama_directions(64) + 1).astype(np.float32)).save(tmp_path / "light.usdz")
    (tmp_path / "render.py").write_text(RENDER_USD)
    directions = [(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0.6, 0.3, 0.742), (-0.36, -0.48, -0.8)]
    run_in_blender(tmp_path / "render.py", tmp_path / "light.usdz", json.dumps(directions), cwd=tmp_path)
    for number, direction in enumerate(directions):
        shown = read_colour(tmp_path / f"light.usdz.{number}.exr")[0].mean(axis=(0, 1)) - 1
        np.testing.assert_allclose(shown, direction, atol=0.02)


@with_blender
@pytest.mark.slow
def test_blender_render(tmp_path: Path) -> None:
    run_example("light_one_photo", cwd=tmp_path)
    run_in_blender(EXAMPLES / "blender_render.py", "--size", "64", "--samples", "8", cwd=tmp_path)
    panorama = read_panorama(tmp_path / "out/light_one_photo/light.exr")
    pixels = ((3, 3), (20, 3), (3, 20), (60, 30))
    assert_background(tmp_path / "out/blender_render.png", panorama, np.array([0, 0, -1]), fov_deg=39.6, pixels=pixels)


PAGE_VIEWS = """
import { chromium } from "playwright-core";
const [executablePath, address, small, huge] = process.argv.slice(1);
const browser = await chromium.launch({ executablePath, args: [
  "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
const page = await browser.newPage();
const errors = [];
page.on("pageerror", (error) => errors.push(String(error)));
const rendered = () =>
  page.waitForFunction("document.title === 'rendered'", undefined, { timeout: 100000 }).catch((error) => {
    throw new Error(`${error} ${errors}`);
  });
const seen = () => page.evaluate(() => {
  const { pose, view } = placed();
  const views = [...document.querySelectorAll("canvas, img")].map((picture) => {
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [160, 120];
    const context = copy.getContext("2d");
    context.drawImage(picture, 0, 0, 160, 120);
    return [...context.getImageData(0, 0, 160, 120).data];
  });
  return { pose, view, views, text: document.querySelector("#text").value };
});
await page.goto(address);
await rendered();
await page.selectOption("#shown", "server");
const shown = [await page.isHidden("canvas"), await page.isVisible("img")];
const sphere = await seen();
const seenAfter = async (step) => {
  await page.evaluate(() => (document.title = "waiting"));
  await step();
  await rendered();
  return seen();
};
const file = await seenAfter(() => page.setInputFiles("#file", small));
const refused = await seenAfter(() => page.setInputFiles("#file", huge));
const sized = await seenAfter(() => page.fill("#size", "0.4").then(() => page.press("#size", "Enter")));
await page.setViewportSize({ width: 390, height: 844 });
const width = await page.evaluate(() => document.documentElement.scrollWidth);
console.log(JSON.stringify({ shown, sphere, file, refused, sized, width }));
await browser.close();
"""


def red_box(width: float) -> bytes:
    """Return a GLB file of a box whose origin is a corner."""
    box = GltfFile()
    red = box.material(pbrMetallicRoughness={"baseColorFactor": [0.8, 0.02, 0.02, 1], "metallicFactor": 0})
    box.node(mesh=box.mesh(width * CUBE, CUBE_FACES, material=red))
    return box.glb()


@pytest.fixture(scope="module")
def three_js_page(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what `three_js.html` shows of the sample room with its sphere, and then with files of red boxes."""
    build()
    files = [tmp_path_factory.mktemp("box") / name for name in ("small.glb", "huge.glb")]
    for file, width in zip(files, (0.2, 2000.0), strict=True):
        file.write_bytes(red_box(width))
    web = ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(ROOT)))
    thread = Thread(target=web.serve_forever)
    thread.start()
    url = f"http://127.0.0.1:{web.server_port}"
    try:
        with RunningServer(allow_origins=(url,)) as server:
            address = f"http://127.0.0.1:{server.port}"
            with Client(address) as client:
                session = client.open("room")
                for frame in rl.open_capture(rl.sample_capture(), rl.CaptureOptions(max_frames=3)):
                    session.push(frame)
            command = ["node", "--input-type=module", "--eval", PAGE_VIEWS]
            command += [os.environ.get("CHROMIUM", "/usr/bin/chromium")]
            command += [f"{url}/examples/three_js.html?server={address}#token=unused", *map(str, files)]
            return json.loads(run(command))
    finally:
        web.shutdown()
        thread.join()
        web.server_close()


def linear_views(seen: dict[str, Any]) -> list[np.ndarray]:
    """Return the linear pictures of three.js and of the compositor."""
    return [srgb8_to_linear(np.array(view, np.uint8).reshape(120, 160, 4)[..., :3]) for view in seen["views"]]


@pytest.mark.js
def test_three_js_page(three_js_page: dict[str, Any]) -> None:
    """Frame, sphere and shadow are where the compositor has them; the sphere is as bright."""
    answer = three_js_page["sphere"]
    three, ours = linear_views(answer)
    assert answer["text"] == "Frame 2: click a surface, or drag the object"
    assert three_js_page["shown"] == [True, True]
    assert abs(three[:40] - ours[:40]).mean() < 0.01  # the frame, far from the object
    lens, camera = answer["view"]["intrinsics"], np.reshape(answer["view"]["camera_to_world"], (4, 4)).T
    x, y, z, _ = np.linalg.inv(camera) @ answer["pose"][12:]
    scale = 160 / lens["width"]
    column, row = scale * (lens["cx"] - lens["fx"] * x / z), scale * (lens["cy"] + lens["fy"] * y / z)
    rows, columns = np.mgrid[:120, :160]
    radius = np.hypot(columns - column, rows - row) / (scale * lens["fx"] * 0.1 / -z)
    ball, around = radius < 0.9, (radius > 1.2) & (radius < 2.5) & (rows > row)
    assert ball.sum() > 200
    assert three[ball].mean() == pytest.approx(ours[ball].mean(), rel=0.1)
    assert three[around].mean() == pytest.approx(ours[around].mean(), rel=0.15)


@pytest.mark.js
def test_three_js_page_shows_a_glb_file(three_js_page: dict[str, Any]) -> None:
    """A file that the compositor refuses leaves the one before, until its size is given."""
    small, refused, sized = (
        [view[..., 0] > 4 * view[..., 1:].max(axis=-1) for view in linear_views(three_js_page[name])]
        for name in ("file", "refused", "sized")
    )
    for three, ours in (small, sized):
        assert ours.sum() > 200
        assert (three & ours).sum() > 0.85 * (three | ours).sum()
    assert "size_m" in three_js_page["refused"]["text"]
    np.testing.assert_array_equal(refused, small)
    assert sized[1].sum() > 2 * small[1].sum()
    assert three_js_page["width"] == 390
