// The panels of a session: objects, probes, timeline, light, downloads.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, afterEach, before, beforeEach, test } from "node:test";
import { control, difference, launch, openPage, PAGE_URL, pixelsOf, SELDOM, waitForChange, waitForFrame, waitForLight, waitForState } from "./support.mjs";

const ROOM = `${PAGE_URL}/#session=room`;
let browser, page, errors;
let isLoadedAgain = true; // for the next test; without, it joins the session again, which forgets all but the forms

before(async () => {
  browser = await launch();
  await control("push", { session: "room", count: 8 });
  await control("push", { session: "between", count: 1 });
});
after(() => browser?.close());
beforeEach(async () => {
  await control("clear");
  if (isLoadedAgain) {
    await page?.close();
    ({ page, errors } = await openPage(browser, { url: ROOM }));
  } else {
    await page.click('[data-session="between"]');
    await page.waitForFunction(() => document.title.startsWith("between"));
    await page.click('[data-session="room"]');
    errors.length = 0;
  }
  isLoadedAgain = false;
  await waitForLight(page);
});
afterEach(({ passed }) => (isLoadedAgain ||= !passed));

/** Wait until the server keeps one object; until it is elsewhere than at its first pose. */
const isKept = (tab) =>
  tab.waitForFunction(async () => (await (await fetch("v1/sessions/room/scene")).json()).objects.length === 1, null, SELDOM);
const isMoved = (tab, first) =>
  tab.waitForFunction(async (x) => (await (await fetch("v1/sessions/room/scene")).json()).objects[0].pose[12] !== x, first[12], SELDOM);

const noNotices = async () => assert.deepEqual(await page.locator(".notice:not(.calm)").allInnerTexts(), []);

test("a session without probes gets one, and all panels fill", async () => {
  assert.equal(await page.locator("#connection").innerText(), "Live");
  assert.equal(await page.locator(".session[aria-current]").count(), 1);
  assert.equal(await page.inputValue("#probe-select"), "probe-1");
  assert.match(await page.locator("#camera-frame").innerText(), /Frame 7/);
  assert.match(await page.locator("#light-coverage").innerText(), /^\d+ % seen$/);
  assert.ok((await page.locator("#stages li").count()) >= 5);
  assert.match(await page.locator("#counts").innerText(), /Processed\s*8/);
  await noNotices();
  assert.deepEqual(errors, []);
});

test("a click on the picture places an object there", async () => {
  const before = await pixelsOf(page, "#picture-image");
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.click("#picture-button", { position: { x: 0.5 * width, y: 0.75 * height } });
  assert.match(await page.locator("#objects .chip").innerText(), /sphere-1, mirror/);
  const placed = await waitForChange(page, "#picture-image", before);
  const changed = placed.map((value, at) => Math.abs(value - before[at]) > 8);
  const rows = changed.flatMap((is, at) => (is ? [Math.floor(at / 4 / 64)] : []));
  assert.ok(Math.min(...rows) > 6, `the object is near the click, not in row ${Math.min(...rows)} of 32`);
  await page.click('#objects .chip button[aria-label^="Remove"]');
  await page.waitForFunction(() => document.getElementById("objects").children.length === 0);
  await noNotices();
});

test("a placed object is turned and moved, and both are undone", async () => {
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.selectOption("#object-shape", "cube");
  assert.equal(await page.inputValue("#object-material"), "diffuse");
  let before = await pixelsOf(page, "#picture-image");
  await page.click("#picture-button", { position: { x: 0.5 * width, y: 0.75 * height } });
  const placed = await waitForChange(page, "#picture-image", before);
  await page.click("#objects .chip-name");
  before = placed;
  for (const act of [
    () => page.click("#object-right"),
    () => page.click("#picture-button", { position: { x: 0.35 * width, y: 0.8 * height } }),
  ]) {
    await act();
    before = await waitForChange(page, "#picture-image", before);
  }
  assert.equal(await page.locator("#objects .chip").count(), 1);
  await page.click("#object-undo");
  before = await waitForChange(page, "#picture-image", before);
  let answer;
  await page.route("**/composite", (route) => new Promise((resolve) => (answer = resolve)).then(() => route.continue()), { times: 1 });
  const moveTo = (x) => page.click("#picture-button", { position: { x: x * width, y: 0.8 * height } });
  const [, second] = [await Promise.all([page.waitForRequest("**/composite"), moveTo(0.35)]), page.waitForRequest("**/composite")];
  await moveTo(0.6); // while the composite of the first move is made
  answer();
  assert.ok((await second).postDataJSON().objects[0].pixel?.[0] > 0);
  before = await waitForChange(page, "#picture-image", before);
  await page.fill("#object-size", "35");
  await page.press("#object-size", "Tab");
  before = await waitForChange(page, "#picture-image", before);
  await page.focus("#objects .chip-name");
  await page.keyboard.press("Delete");
  await page.waitForFunction(() => document.getElementById("objects").children.length === 0);
  await page.click("#object-undo");
  await page.waitForSelector("#objects .chip");
  await page.click('#objects .chip button[aria-label^="Remove"]');
  await page.selectOption("#object-shape", "sphere"); // with its usual size and material
  await noNotices();
});

test("placed objects are kept with the session and seen by everyone, who can move and remove them", async () => {
  const before = await pixelsOf(page, "#picture-image");
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.click("#picture-button", { position: { x: 0.5 * width, y: 0.75 * height } });
  const placed = await waitForChange(page, "#picture-image", before);
  const pose = async () => (await control("scene")).objects[0]?.pose;
  await isKept(page);
  const first = await pose();

  const { page: other } = await openPage(browser, { url: ROOM });
  await other.waitForSelector("#objects .chip");
  assert.match(await other.locator("#objects .chip").innerText(), /sphere-1, mirror/);
  await waitForChange(other, "#picture-image", before);

  // a drag in the picture moves it over the surfaces, here and there
  const { x, y } = await page.locator("#picture-image").boundingBox();
  await page.mouse.move(x + 0.5 * width, y + 0.775 * height);
  await page.mouse.down();
  await page.mouse.move(x + 0.35 * width, y + 0.78 * height, { steps: 4 });
  assert.equal(await page.locator('#picture-outlines [data-name="sphere-1"]').count(), 1);
  await page.mouse.up();
  await waitForChange(page, "#picture-image", placed);
  await isMoved(page, first);
  assert.equal(await page.locator("#objects .chip").count(), 1);

  await other.click('#objects .chip button[aria-label^="Remove"]');
  await page.waitForFunction(() => document.getElementById("objects").children.length === 0);
  await other.close();
  await noNotices();
});

test("what two place at once is kept, and each undoes its own", async () => {
  const { page: other, errors: heard } = await openPage(browser, { url: ROOM });
  await waitForLight(other);
  const shownIn = (tab, names) =>
    tab.waitForFunction(
      (wanted) => [...document.querySelectorAll("#objects .chip-name")].map(({ textContent }) => textContent).sort().join("; ") === wanted,
      names.map((name) => `${name}, mirror`).join("; "),
    );
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await Promise.all([
    page.click("#picture-button", { position: { x: 0.35 * width, y: 0.8 * height } }),
    other.click("#picture-button", { position: { x: 0.65 * width, y: 0.8 * height } }),
  ]);
  await Promise.all([page, other].map((tab) => shownIn(tab, ["sphere-1", "sphere-2"])));
  const placed = (await control("scene")).objects;
  await page.click("#object-undo");
  await Promise.all([page, other].map((tab) => tab.waitForFunction(() => document.querySelectorAll("#objects .chip").length === 1)));
  await other.click("#object-undo");
  await Promise.all([page, other].map((tab) => shownIn(tab, [])));
  await page.click("#object-redo");
  await page.waitForSelector("#objects .chip");
  await other.click("#object-redo");
  await Promise.all([page, other].map((tab) => shownIn(tab, ["sphere-1", "sphere-2"])));
  const again = (await control("scene")).objects;
  assert.deepEqual(new Set(again.map(({ pose }) => String(pose))), new Set(placed.map(({ pose }) => String(pose))));
  assert.deepEqual([...errors, ...heard].filter((text) => !text.includes("412")), []);
  await other.close();
  await noNotices();
});

test("a session without a recording has no film, and says why", async () => {
  await page.click("#open-film");
  await page.waitForFunction(() => document.getElementById("film-refusal").textContent.includes("record the room, and open the recording here"));
  assert.ok(await page.isDisabled("#film-make"));
  await page.click("#film-dialog [data-closes]");
});

test("an object behind something real has an outline", async () => {
  await page.evaluate(async () => {
    const { camera_to_world: pose } = await (await fetch("v1/sessions/room/camera")).json();
    const position = [0, 1, 2].map((axis) => pose[12 + axis] - 30 * pose[8 + axis]); // behind the wall
    const body = JSON.stringify({ objects: [{ name: "far", shape: "cube", size_m: 4, position, anchor: "centre" }] });
    await fetch("v1/sessions/room/scene", { method: "PUT", body, headers: { "content-type": "application/json" } });
  });
  await page.waitForSelector('#picture-outlines [data-name="far"]', { state: "attached" });
  await noNotices();
});

test("a session is renamed, and its address is shared", async () => {
  page.once("dialog", (dialog) => {
    page.once("dialog", (again) => again.accept(`Living room${again.defaultValue().slice(80)}`)); // what was typed is kept
    void dialog.accept("x".repeat(80) + "s");
  });
  await page.hover('[aria-label="Rename room"]');
  await page.mouse.down();
  await page.evaluate(async () => {
    const scene = await (await fetch("v1/sessions/room/scene")).json();
    const body = JSON.stringify({ ...scene, title: "Kitchen" });
    await fetch("v1/sessions/room/scene", { method: "PUT", body, headers: { "content-type": "application/json" } });
  });
  for (let polls = 0; polls < 2; polls++) {
    await page.waitForResponse((response) => response.url().endsWith("/v1/sessions"));
  }
  await page.mouse.up(); // on the button that was pressed, though the list has changed
  await page.waitForFunction(() => document.querySelector('[data-session="room"] b').textContent === "Living rooms");
  await page.waitForSelector('[aria-label="Delete Living rooms"]');
  await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
  await page.click("#share");
  await page.waitForSelector(".notice.calm");
  const address = await page.evaluate(() => navigator.clipboard.readText());
  assert.match(address, /#session=room&probe=probe-1$/);

  await control("push", { session: "newer", count: 2 }); // the list begins with it
  await page.waitForSelector('[data-session="newer"]');
  const { page: other } = await openPage(browser, { url: address });
  await waitForLight(other);
  assert.equal(await other.title(), "room · RoomLight");
  assert.equal(other.url(), address);
  await other.evaluate(() => (location.hash = "#session=newer"));
  await other.waitForFunction(() => document.title === "newer · RoomLight");
  await other.click('[data-session="room"]');
  await other.waitForFunction(() => document.title === "room · RoomLight");
  await other.goBack();
  await other.waitForFunction(() => document.title === "newer · RoomLight");
  await other.close();
  const { page: moved } = await openPage(browser, { url: address.replace("probe-1", "gone") });
  await moved.waitForSelector(".notice");
  assert.match(await moved.textContent(".notice"), /names the probe gone, which this session does not have: probe-1 is shown/);
  assert.equal(moved.url(), address);
  await moved.close();
  const { page: lost } = await openPage(browser, { url: address.replace("room", "no-such") });
  await lost.waitForSelector("#ended:not([hidden])");
  await lost.close();
  await page.evaluate(() => fetch("v1/sessions/newer", { method: "DELETE" }));
});

test("a finger drags an object, and a size has limits", async () => {
  const context = await browser.newContext({ viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  const phone = await context.newPage();
  await phone.goto(ROOM);
  await waitForLight(phone);
  const before = await pixelsOf(phone, "#picture-image");
  await phone.fill("#object-size", "400");
  await phone.press("#object-size", "Tab");
  assert.equal(await phone.inputValue("#object-size"), "300");
  await phone.fill("#object-size", "20");
  await phone.locator("#picture-button").scrollIntoViewIfNeeded();
  const { x, y, width, height } = await phone.locator("#picture-image").boundingBox();
  await phone.touchscreen.tap(x + 0.5 * width, y + 0.75 * height);
  await waitForChange(phone, "#picture-image", before);
  const placed = async () => (await control("scene")).objects[0]?.pose;
  await isKept(phone);
  const first = await placed();
  const devtools = await context.newCDPSession(phone);
  const touch = (type, ...touchPoints) => devtools.send("Input.dispatchTouchEvent", { type, touchPoints });
  await touch("touchStart", { x: x + 0.5 * width, y: y + 0.775 * height });
  for (let step = 1; step <= 6; step++) {
    await touch("touchMove", { x: x + (0.5 - 0.025 * step) * width, y: y + 0.775 * height });
  }
  await touch("touchEnd");
  await isMoved(phone, first);
  await context.close();
});

/** Vertices in meshopt's codec of attributes: for each byte of a vertex a group of raw differences, then a first vertex of zeros. */
function meshoptOf(vertices, stride) {
  const count = vertices.length / stride;
  const at = (vertex, byte) => (vertex < 0 ? 0 : vertices[vertex * stride + byte]);
  const zigzag = (difference) => ((difference << 1) ^ ((difference << 24) >> 31)) & 0xff;
  const groups = Array.from({ length: stride }, (_, byte) => [
    3, // 16 raw bytes
    ...Array.from({ length: 16 }, (_, vertex) => (vertex < count ? zigzag(at(vertex, byte) - at(vertex - 1, byte)) : 0)),
  ]);
  return Buffer.from([0xa0, ...groups.flat(), ...Array(32).fill(0)]);
}

/** A tetrahedron as a GLB file, its points packed by meshopt, or with a texture in KTX2. */
function tetrahedron({ meshopt = false, ktx2 = false } = {}) {
  const points = Buffer.from(Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1).buffer);
  const faces = Uint16Array.of(0, 2, 1, 0, 3, 2, 0, 1, 3, 1, 2, 3);
  const packed = meshopt ? meshoptOf(points, 12) : Buffer.alloc(0);
  const picture = Buffer.alloc(ktx2 ? 160 : 0);
  if (ktx2) {
    picture.set([0xab, ...Buffer.from("KTX 20"), 0xbb, 13, 10, 26, 10]);
    Uint32Array.of(37, 1, 1, 1, 0, 0, 1, 1, 0).forEach((value, field) => picture.writeUInt32LE(value, 12 + 4 * field)); // plain RGBA
  }
  const data = Buffer.concat([points, Buffer.from(faces.buffer), picture, packed]);
  const used = [...(meshopt ? ["EXT_meshopt_compression"] : []), ...(ktx2 ? ["KHR_texture_basisu"] : [])];
  const unpacked = { buffer: 0, byteOffset: 0, byteLength: 48 };
  const stored = { buffer: 0, byteOffset: 72 + picture.length, byteLength: packed.length, byteStride: 12, count: 4, mode: "ATTRIBUTES" };
  const document = JSON.stringify({
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    animations: [{ channels: [], samplers: [] }],
    nodes: [{ mesh: 0 }],
    extensionsUsed: used,
    extensionsRequired: used,
    materials: [{ pbrMetallicRoughness: { baseColorFactor: [0.8, 0.1, 0.1, 1], metallicFactor: 0, ...(ktx2 && { baseColorTexture: { index: 0 } }) } }],
    ...(ktx2 && { textures: [{ extensions: { KHR_texture_basisu: { source: 0 } } }], images: [{ bufferView: 2, mimeType: "image/ktx2" }] }),
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1, material: 0 }] }],
    accessors: [
      { bufferView: 0, componentType: 5126, count: 4, type: "VEC3", min: [0, 0, 0], max: [1, 1, 1] },
      { bufferView: 1, componentType: 5123, count: 12, type: "SCALAR" },
    ],
    bufferViews: [
      meshopt ? { ...unpacked, byteStride: 12, extensions: { EXT_meshopt_compression: stored } } : unpacked,
      { buffer: 0, byteOffset: 48, byteLength: 24 },
      ...(ktx2 ? [{ buffer: 0, byteOffset: 72, byteLength: picture.length }] : []),
    ],
    buffers: [{ byteLength: data.length }],
  });
  const text = Buffer.from(document.padEnd(Math.ceil(document.length / 4) * 4));
  const chunk = (kind, body) => Buffer.concat([Buffer.from(Uint32Array.of(body.length, kind).buffer), body]);
  const body = Buffer.concat([chunk(0x4e4f534a, text), chunk(0x004e4942, data)]);
  return Buffer.concat([Buffer.from("glTF"), Buffer.from(Uint32Array.of(2, 12 + body.length).buffer), body]);
}

test("an uploaded GLB file is placed, and the 3D view shows it in the light of its place", async () => {
  await placeFile({ name: "corner.glb", mimeType: "model/gltf-binary", buffer: tetrahedron() });
  assert.equal(await page.inputValue("#object-material"), "own");
  await page.click("#object-notes summary");
  assert.match(await page.locator("#object-notes li").innerText(), /animations: the object stands in its pose at rest; export the pose you want/);
  await page.waitForFunction(() => globalThis.roomlightPage.litObjects.includes("corner-1"));
  await noNotices();

  // a server that was started again has lost the file: the page that has it sends it again
  const deleteFile = () => page.evaluate(async () => {
    const { objects } = await (await fetch("v1/objects")).json();
    await Promise.all(objects.map(({ id }) => fetch(`v1/objects/${id}`, { method: "DELETE" })));
  });
  let before = await pixelsOf(page, "#picture-image");
  await deleteFile();
  await page.click("#objects .chip-name");
  await page.fill("#object-size", "60");
  await page.press("#object-size", "Tab");
  before = await waitForChange(page, "#picture-image", before);
  await noNotices();

  // another page says what is missing, and places other objects
  await page.waitForFunction(async () => (await (await fetch("v1/sessions/room/scene")).json()).objects[0]?.size_m === 0.6, null, SELDOM);
  await page.close();
  ({ page, errors } = await openPage(browser, { url: ROOM }));
  await waitForLight(page);
  await page.waitForSelector("#objects .chip");
  assert.equal(await page.isVisible("#object-right"), true);
  const saved = page.waitForEvent("download");
  await page.getByRole("button", { name: "Scene", exact: true }).click();
  assert.equal(JSON.parse(readFileSync(await (await saved).path(), "utf8")).objects[0].file, "corner-1.glb");
  assert.match(await page.locator(".notice.calm p").innerText(), /names corner-1.glb: put the files of these objects beside it/);
  await deleteFile();
  await page.click("#objects .chip-name");
  await page.click("#object-right");
  await page.waitForFunction(() => document.getElementById("notices").textContent.includes("no longer has the file of corner-1"));
  await page.click("#objects .chip-name");
  before = await pixelsOf(page, "#picture-image");
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.click("#picture-button", { position: { x: 0.35 * width, y: 0.8 * height } });
  await waitForChange(page, "#picture-image", before);
  isLoadedAgain = true;
});

/** Upload a GLB file and place it on the floor. */
async function placeFile(file) {
  const before = await pixelsOf(page, "#picture-image");
  await page.setInputFiles("#object-file", file);
  await page.waitForFunction(() => document.getElementById("object-shape").value === "file");
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.click("#picture-button", { position: { x: 0.5 * width, y: 0.75 * height } });
  await waitForChange(page, "#picture-image", before);
}

test("the 3D view shows a GLB file that meshopt has packed", async () => {
  await placeFile({ name: "packed.glb", mimeType: "model/gltf-binary", buffer: tetrahedron({ meshopt: true }) });
  await page.waitForFunction(() => globalThis.roomlightPage.litObjects.length === 1);
  await noNotices();
  isLoadedAgain = true;
});

test("a box stands for a GLB file that only the server unpacks, and a notice says so", async () => {
  await placeFile({ name: "textured.glb", mimeType: "model/gltf-binary", buffer: tetrahedron({ ktx2: true }) });
  await page.waitForFunction(() => globalThis.roomlightPage.litObjects.length === 1);
  assert.match(await page.locator(".notice p").innerText(), /A box stands for textured.glb here: only the server unpacks/);
  await page.click(".notice button");
});

test("the keyboard places an object", async () => {
  const before = await pixelsOf(page, "#picture-image");
  await page.selectOption("#object-shape", "cube");
  await page.selectOption("#object-material", "diffuse");
  await page.focus("#picture-button");
  for (const key of ["ArrowDown", "ArrowLeft", "Shift+ArrowRight", "Enter"]) {
    await page.keyboard.press(key);
  }
  assert.match(await page.locator("#objects .chip").innerText(), /cube-1, diffuse/);
  await waitForChange(page, "#picture-image", before);
});

test("a click on a wall of the room places an object, and with the tool Probe a probe", async () => {
  const before = await pixelsOf(page, "#picture-image");
  await page.click("#view-camera");
  const box = await page.locator("#room-canvas").boundingBox();
  const position = { x: 0.25 * box.width, y: 0.58 * box.height }; // beside the probe, in the picture, not in a corner
  await page.click("#room-canvas", { position });
  await page.waitForSelector("#objects .chip");
  await waitForChange(page, "#picture-image", before);

  await page.check('input[name="tool"][value="probe"]', { force: true });
  await page.click("#room-canvas", { position: { x: 0.65 * box.width, y: 0.6 * box.height } });
  await page.waitForFunction(() => document.getElementById("probe-select").options.length === 2);
  await page.waitForFunction(() => document.getElementById("probe-x").value !== "");
  await page.click("#probe-remove");
  await page.waitForFunction(() => document.getElementById("probe-select").options.length === 1);
  isLoadedAgain = true;
});

test("a probe that is dragged gets other light, and the server tracks it there", async () => {
  const before = await pixelsOf(page, "#panorama-canvas");
  const x = await page.inputValue("#probe-x");
  const from = await page.evaluate(() => globalThis.roomlightPage.probeAt("probe-1"));
  await page.mouse.move(from.x, from.y);
  await page.waitForFunction(() => document.getElementById("room-canvas").classList.contains("over"));
  await page.mouse.down();
  await page.mouse.move(from.x + 60, from.y + 10, { steps: 6 });
  await waitForChange(page, "#panorama-canvas", before);
  await page.mouse.up();
  const moved = await page.inputValue("#probe-x");
  assert.notEqual(moved, x);
  await waitForState("room", ({ probes }) => probes["probe-1"][0].toFixed(2) === moved);
});

test("a probe moves by its numbers", async () => {
  const before = await pixelsOf(page, "#panorama-canvas");
  await page.fill("#probe-y", "0.4");
  await page.keyboard.press("Tab");
  await waitForChange(page, "#panorama-canvas", before);
  await waitForState("room", ({ probes }) => probes["probe-1"][1] === 0.4);
});

test("scrubbing shows an earlier frame, Live the newest", async () => {
  await control("push", { session: "room", count: 2 }); // frames after which the probe is in the history
  await page.waitForFunction(() => document.getElementById("scrub").max === "9");
  await waitForFrame(page, "#picture-image", 9);
  await waitForFrame(page, "#panorama-canvas", 9);
  const [picture, light] = [await pixelsOf(page, "#picture-image"), await pixelsOf(page, "#panorama-canvas")];
  await page.focus("#scrub");
  await page.keyboard.press("ArrowLeft");
  await waitForFrame(page, "#picture-image", 8);
  assert.ok(difference(picture, await pixelsOf(page, "#picture-image")) > 8);
  assert.match(await page.locator("#camera-frame").innerText(), /Frame 8, thumbnail/);
  assert.match(await page.locator("#timeline-text").innerText(), /Frame 8/);
  assert.equal(await page.getAttribute("#go-live", "aria-pressed"), "false");
  assert.ok(await page.isDisabled("#picture-button"));
  assert.match(await page.locator("#picture-help").innerText(), /press Live to place/);
  await waitForFrame(page, "#panorama-canvas", 8);
  assert.ok(difference(light, await pixelsOf(page, "#panorama-canvas")) > 2);
  await page.click("#go-live");
  await waitForFrame(page, "#picture-image", 9);
  assert.equal(await page.locator("#camera-frame").innerText(), "Frame 9");
  assert.ok(difference(picture, await pixelsOf(page, "#picture-image")) < 8);
});

test("Play runs through the history to the newest frame", async () => {
  await page.evaluate(() => {
    const text = document.getElementById("timeline-text");
    globalThis.played = [];
    new MutationObserver(() => globalThis.played.push(text.textContent.split(" · ")[0])).observe(text, { childList: true });
  });
  await page.click("#play");
  await page.waitForFunction(() => globalThis.played.length > 0 && document.getElementById("play").textContent === "Play");
  await page.waitForFunction(() => document.getElementById("go-live").getAttribute("aria-pressed") === "true");
  const played = await page.evaluate(() => globalThis.played);
  const { frames } = await control("state", { session: "room" });
  assert.ok(played.includes("Frame 0"), `${played}`);
  assert.equal(played.at(-1), `Frame ${frames.last_index}`);
});

test("a new frame appears by itself", async () => {
  const { frames } = await control("state", { session: "room" });
  await control("push", { session: "room", count: 1 });
  const text = `Frame ${frames.last_index + 1}`;
  await page.waitForFunction((text) => document.getElementById("camera-frame").textContent === text, text);
  await page.waitForFunction((text) => document.getElementById("timeline-text").textContent.startsWith(text), text);
});

test("exposure, false colour and the tint change the panorama", async () => {
  let shown = await pixelsOf(page, "#panorama-canvas");
  await page.focus("#exposure");
  for (let press = 0; press < 8; press++) {
    await page.keyboard.press("ArrowLeft");
  }
  shown = await waitForChange(page, "#panorama-canvas", shown);
  await page.click("#exposure-auto");
  shown = await waitForChange(page, "#panorama-canvas", shown);
  await page.check("#coverage-tint");
  shown = await waitForChange(page, "#panorama-canvas", shown);
  await page.check("#false-colour");
  await waitForChange(page, "#panorama-canvas", shown);
  assert.ok(await page.isVisible("#legend"));
  assert.ok(await page.isVisible("#coverage-legend"));
  await page.click(".menu summary");
  assert.ok(await page.isChecked("#show-coverage"));
  await page.uncheck("#show-coverage");
  assert.equal(await page.isChecked("#coverage-tint"), false);
  assert.ok(await page.isHidden("#coverage-legend"));
});

test("the placed objects are downloaded as a scene for the command line", async () => {
  const before = await pixelsOf(page, "#picture-image");
  assert.ok(await page.isDisabled('#downloads button:text-is("Scene")'));
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.click("#picture-button", { position: { x: 0.5 * width, y: 0.75 * height } });
  await waitForChange(page, "#picture-image", before);
  const download = page.waitForEvent("download");
  await page.click('#downloads button:text-is("Scene")');
  const { objects } = JSON.parse(readFileSync(await (await download).path()));
  const [{ name, shape, pose, anchor }] = objects;
  assert.deepEqual([name, shape, anchor, pose.length, pose[3]], ["sphere-1", "sphere", "origin", 4, [0, 0, 0, 1]]);
});

test("files are downloaded", async () => {
  const starts = { EXR: [0x76, 0x2f, 0x31, 0x01], HDR: [0x23, 0x3f], PNG: [0x89, 0x50], KTX2: [0xab, 0x4b], USDZ: [0x50, 0x4b], GLB: [0x67, 0x6c], Mesh: [0x67, 0x6c], SH: [0x7b], Picture: [] };
  for (const [label, start] of Object.entries(starts)) {
    const download = page.waitForEvent("download");
    await page.click(`#downloads button:text-is("${label}")`);
    const file = await download;
    assert.match(file.suggestedFilename(), /^room[-.]/);
    const bytes = readFileSync(await file.path());
    assert.deepEqual([...bytes.subarray(0, start.length)], start, label);
    assert.ok(bytes.length > 100, label);
  }
  await noNotices();
});

test("a page without new frames draws nothing", async () => {
  const drawn = () => page.evaluate(() => globalThis.roomlightPage.frames);
  let [before, now] = [0, await drawn()];
  for (let poll = 0; poll < 10 && now !== before; poll++) {
    await page.waitForResponse((response) => response.url().endsWith("/v1/sessions"));
    [before, now] = [now, await drawn()];
  }
  assert.ok(now > 0);
  assert.equal(now, before);
});

test("without a graphics processor the room is coarser while it is turned, and sharp at rest", async () => {
  assert.ok(await page.evaluate(() => globalThis.roomlightPage.view.isSoftware), "Chromium draws these tests in software");
  const share = (least, most) =>
    page.waitForFunction(
      ([least, most]) => {
        const canvas = document.getElementById("room-canvas");
        const share = canvas.width / canvas.clientWidth;
        return least < share && share < most;
      },
      [least, most],
    );
  await share(0.99, 1.01);
  await page.evaluate(() => {
    const canvas = document.getElementById("room-canvas");
    globalThis.turning = setInterval(() => canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" })));
  });
  await share(0.4, 0.7);
  await page.evaluate(() => clearInterval(globalThis.turning));
  await share(0.99, 1.01);
});

test("a picture that is decoded late does not replace a newer one", async () => {
  await page.evaluate(() => {
    const decode = globalThis.createImageBitmap;
    globalThis.held = [];
    globalThis.createImageBitmap = async (picture) => {
      const bitmap = await decode(picture);
      if (picture.type === "image/jpeg" && document.title.startsWith("late") && globalThis.held.length === 0) {
        await new Promise((resolve) => globalThis.held.push(resolve));
      }
      return bitmap;
    };
  });
  await control("push", { session: "late", count: 1 });
  await page.click('[data-session="late"]');
  await page.waitForFunction(() => globalThis.held.length === 1);
  await control("push", { session: "late", count: 1 });
  await waitForFrame(page, "#picture-image", 1);
  const shown = await pixelsOf(page, "#picture-image");
  await page.evaluate(async () => {
    globalThis.held[0]();
    await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
  });
  assert.equal(await page.getAttribute("#picture-image", "data-frame"), "1");
  assert.equal(difference(shown, await pixelsOf(page, "#picture-image")), 0);
});
