// Virtual objects of a session: placed, moved, kept, seen by everyone, uploaded, downloaded.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { browser, errors, noNotices, openAgain, openAgainNext, page, ROOM } from "./room.mjs";
import { control, difference, nextDrawing, openPage, pixelsOf, waitForChange, waitForLight, waitForState } from "./support.mjs";

/** Wait until the server keeps objects as wanted; returns them. */
const kept = async (isWanted) => (await waitForState("room", ({ objects }) => isWanted(objects), "scene")).objects;
/** One object, and where it is; one that is elsewhere than at its first pose. */
const poseKept = async () => (await kept(({ length }) => length === 1))[0].pose;
const isMoved = (first) => kept(([object]) => object?.pose[12] !== first[12]);

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

test("a placed object is turned and moved, and both are undone", async () => {
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.selectOption("#object-shape", "cube");
  assert.equal(await page.inputValue("#object-material"), "diffuse");
  let before = await pixelsOf(page, "#picture-image");
  await page.click("#picture-button", { position: { x: 0.5 * width, y: 0.75 * height } });
  const placed = await waitForChange(page, "#picture-image", before);
  await page.click("#objects .chip-name");
  before = placed;
  const yawOf = ({ pose }) => Math.atan2(pose[8], pose[10]);
  const yaw = yawOf({ pose: await poseKept() });
  const turned = page.waitForRequest("**/composite");
  for (const act of [
    () => page.click("#object-right"),
    () => page.click("#picture-button", { position: { x: 0.35 * width, y: 0.8 * height } }),
  ]) {
    await act();
    before = await waitForChange(page, "#picture-image", before);
  }
  assert.equal(await page.locator("#objects .chip").count(), 1);
  const turn = yawOf((await turned).postDataJSON().objects[0]) - yaw;
  assert.equal(Math.round(100 * Math.sin(turn)), -26); // 15 degrees clockwise, seen from above
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
  for (const [step, size] of [["undo", "20"], ["redo", "35"]]) {
    await page.click(`#object-${step}`);
    assert.equal(await page.inputValue("#object-size"), size);
  }
  await page.focus("#share");
  await page.keyboard.press("Delete");
  await page.focus("#objects .chip-name");
  assert.equal(await page.locator("#objects .chip").count(), 1);
  await page.keyboard.press("Backspace");
  await page.waitForFunction(() => document.getElementById("objects").children.length === 0);
  await page.focus("#object-material");
  await page.keyboard.press("Control+z");
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
  const first = await poseKept();

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
  await isMoved(first);
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

test("an object behind something real has an outline, also one that is in the picture in part", async () => {
  await page.evaluate(async () => {
    const { camera_to_world: pose, intrinsics } = await (await fetch("v1/sessions/room/camera")).json();
    const aside = (30 * (intrinsics.width - intrinsics.cx)) / intrinsics.fx + 1; // its middle is out of the picture
    const position = [0, 1, 2].map((axis) => pose[12 + axis] - 30 * pose[8 + axis] + aside * pose[axis]); // behind the wall
    const body = JSON.stringify({ objects: [{ name: "far", shape: "cube", size_m: 4, position, anchor: "centre" }] });
    await fetch("v1/sessions/room/scene", { method: "PUT", body, headers: { "content-type": "application/json" } });
  });
  await page.waitForSelector('#picture-outlines [data-name="far"]', { state: "attached" });
  await noNotices();
});

test("what another program has placed outside the picture stays in the scene", async () => {
  await page.evaluate(async () => {
    const { camera_to_world: pose } = await (await fetch("v1/sessions/room/camera")).json();
    const at = (ahead_m) => [0, 1, 2].map((axis) => pose[12 + axis] - ahead_m * pose[8 + axis]);
    const objects = [["seen", 0.8], ["behind", -2]].map(([name, ahead_m]) => ({ name, shape: "sphere", size_m: 0.2, position: at(ahead_m), anchor: "centre" }));
    const body = JSON.stringify({ objects });
    await fetch("v1/sessions/room/scene", { method: "PUT", body, headers: { "content-type": "application/json" } });
  });
  const [, behind] = await kept(([first]) => first?.pose || first?.name !== "seen");
  assert.deepEqual([behind?.name, behind?.pose ?? null], ["behind", null]);
  await noNotices();
});

test("objects of other programs have the server's sizes, and any of its shapes is selected", async () => {
  await page.evaluate(async () => {
    const { camera_to_world: pose } = await (await fetch("v1/sessions/room/camera")).json();
    const ahead = [...pose.slice(0, 12), ...[0, 1, 2].map((axis) => pose[12 + axis] - 0.8 * pose[8 + axis]), 1];
    const body = JSON.stringify({ objects: ["sphere", "teapot", "plane"].map((shape) => ({ name: shape, shape, pose: ahead, anchor: "origin" })) });
    await fetch("v1/sessions/room/scene", { method: "PUT", body, headers: { "content-type": "application/json" } });
  });
  for (const [name, size_cm] of [["sphere", "20"], ["teapot", "30"], ["plane", "50"]]) {
    await page.click(`#objects [data-name="${name}"]`);
    await page.waitForSelector(`#objects [data-name="${name}"][aria-pressed="true"]`);
    assert.equal(await page.inputValue("#object-size"), size_cm);
  }
  const radii = () => globalThis.roomlightPage.view.scene.children.flatMap(({ children: [shape] }) => shape?.geometry?.parameters?.radius ?? []);
  await page.waitForFunction((radii) => new Function(`return (${radii})()`)().length === 1, String(radii));
  assert.deepEqual(await page.evaluate(radii), [0.1]);
  assert.deepEqual(errors, []);
});

test("a finger drags an object, and a size has limits", async () => {
  const context = await browser.newContext({ viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  const phone = await context.newPage();
  await phone.goto(ROOM);
  await waitForLight(phone);
  const before = await pixelsOf(phone, "#picture-image");
  await phone.fill("#object-size", "20000");
  await phone.press("#object-size", "Tab");
  assert.equal(await phone.inputValue("#object-size"), "10000");
  await phone.fill("#object-size", "20");
  await phone.locator("#picture-button").scrollIntoViewIfNeeded();
  const { x, y, width, height } = await phone.locator("#picture-image").boundingBox();
  await phone.touchscreen.tap(x + 0.5 * width, y + 0.75 * height);
  await waitForChange(phone, "#picture-image", before);
  const first = await poseKept();
  const devtools = await context.newCDPSession(phone);
  const touch = (type, ...touchPoints) => devtools.send("Input.dispatchTouchEvent", { type, touchPoints });
  await touch("touchStart", { x: x + 0.5 * width, y: y + 0.775 * height });
  for (let step = 1; step <= 6; step++) {
    await touch("touchMove", { x: x + (0.5 - 0.025 * step) * width, y: y + 0.775 * height });
  }
  await touch("touchEnd");
  await isMoved(first);
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

/** A tetrahedron as a GLB file, its points packed by meshopt, with a texture in KTX2, or with a lamp. */
function tetrahedron({ meshopt = false, ktx2 = false, lamp = false } = {}) {
  const points = Buffer.from(Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1).buffer);
  const faces = Uint16Array.of(0, 2, 1, 0, 3, 2, 0, 1, 3, 1, 2, 3);
  const packed = meshopt ? meshoptOf(points, 12) : Buffer.alloc(0);
  const picture = Buffer.alloc(ktx2 ? 160 : 0);
  if (ktx2) {
    picture.set([0xab, ...Buffer.from("KTX 20"), 0xbb, 13, 10, 26, 10]);
    Uint32Array.of(37, 1, 1, 1, 0, 0, 1, 1, 0).forEach((value, field) => picture.writeUInt32LE(value, 12 + 4 * field)); // plain RGBA
  }
  const data = Buffer.concat([points, Buffer.from(faces.buffer), picture, packed]);
  const used = [...(meshopt ? ["EXT_meshopt_compression"] : []), ...(ktx2 ? ["KHR_texture_basisu"] : []), ...(lamp ? ["KHR_lights_punctual"] : [])];
  const unpacked = { buffer: 0, byteOffset: 0, byteLength: 48 };
  const stored = { buffer: 0, byteOffset: 72 + picture.length, byteLength: packed.length, byteStride: 12, count: 4, mode: "ATTRIBUTES" };
  const document = JSON.stringify({
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    animations: [{ channels: [], samplers: [] }],
    nodes: [{ mesh: 0, ...(lamp && { extensions: { KHR_lights_punctual: { light: 0 } } }) }],
    ...(lamp && { extensions: { KHR_lights_punctual: { lights: [{ type: "point" }] } } }),
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
  assert.equal(await page.inputValue("#object-size"), "100");
  const [file] = await kept(({ length }) => length === 1);
  assert.equal(file.size_m ?? null, null); // its own metres
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
  const nearest_px = await page.evaluate(async () => {
    const [{ pose }] = (await (await fetch("v1/sessions/room/scene")).json()).objects;
    const { camera_to_world: camera, intrinsics } = await (await fetch("v1/sessions/room/camera")).json();
    const [x, y, z] = [0, 4, 8].map((column) => [0, 1, 2].reduce((sum, axis) => sum + camera[column + axis] * (pose[12 + axis] - camera[12 + axis]), 0));
    const origin = [intrinsics.cx - (intrinsics.fx * x) / z, intrinsics.cy + (intrinsics.fy * y) / z];
    const corners = document.querySelector('#picture-outlines [data-name="corner-1"]').getAttribute("d").matchAll(/([-\d.e]+) ([-\d.e]+)/g);
    return Math.min(...[...corners].map(([, u, v]) => Math.hypot(u * intrinsics.width - origin[0], v * intrinsics.height - origin[1])));
  });
  assert.ok(nearest_px < 0.1, `the origin is a corner of the box, ${nearest_px} pixels from the outline's nearest`);

  // another page says what is missing, and places other objects
  await kept(([object]) => object?.size_m === 0.6);
  await openAgain();
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
  openAgainNext();
});

test("without a chosen GLB file nothing is placed, and a button asks for one", async () => {
  await Promise.all([page.waitForEvent("filechooser"), page.selectOption("#object-shape", "file")]); // no dialog in Safari
  await page.click("#picture-button");
  assert.match(await page.locator(".notice").innerText(), /Nothing is placed: choose a GLB file/);
  assert.equal(await page.locator("#objects .chip").count(), 0);
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.click("#object-choose")]);
  await chooser.setFiles({ name: "corner.glb", mimeType: "model/gltf-binary", buffer: tetrahedron() });
  await page.waitForFunction(() => document.getElementById("object-shape").selectedOptions[0].textContent === "corner.glb");
  await page.selectOption("#object-shape", "sphere");
  assert.ok(await page.isHidden("#object-choose"));
  openAgainNext();
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

test("the 3D view shows a GLB file that meshopt has packed, without its lamps", async () => {
  await placeFile({ name: "packed.glb", mimeType: "model/gltf-binary", buffer: tetrahedron({ meshopt: true, lamp: true }) });
  await page.waitForFunction(() => globalThis.roomlightPage.litObjects.length === 1);
  assert.deepEqual(await page.evaluate(() => globalThis.roomlightPage.view.scene.getObjectsByProperty("isLight", true)), []);
  await noNotices();
  openAgainNext();

  // a lost graphics context comes back with all of the 3D view
  const drawn = () => page.evaluate(() => globalThis.roomlightPage.frames);
  for (let last = -1; last !== (last = await drawn()); ) {
    await page.waitForResponse((response) => response.url().endsWith("/v1/sessions"));
  }
  const picture = () => page.locator("#room-canvas").screenshot();
  const before = await picture();
  await page.evaluate(async () => {
    const canvas = document.getElementById("room-canvas");
    const context = canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
    const heard = (type) => new Promise((resolve) => canvas.addEventListener(type, () => setTimeout(resolve), { once: true }));
    await Promise.all([heard("webglcontextlost"), context.loseContext()]);
    await Promise.all([heard("webglcontextrestored"), context.restoreContext()]);
  });
  while (!before.equals(await picture())) {
    await nextDrawing(page);
  }
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
