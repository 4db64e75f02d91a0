// The panels of a session: probes, timeline, light, downloads, the room.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { browser, errors, noNotices, openAgainNext, page } from "./room.mjs";
import { control, difference, nextDrawing, openPage, pixelsOf, waitForChange, waitForFrame, waitForLight, waitForState } from "./support.mjs";

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

test("a session without a recording has no film, and says why", async () => {
  await page.click("#open-film");
  await page.waitForFunction(() => document.getElementById("film-refusal").textContent.includes("record the room, and open the recording here"));
  assert.ok(await page.isDisabled("#film-make"));
  await page.click("#film-dialog [data-closes]");
});

test("the dialog of a phone shows the server's advice, its error, and an address without a code", async () => {
  const shown = async (text) => {
    await page.click("#open-phone");
    await page.waitForFunction((text) => document.getElementById("phone-body").textContent.includes(text), text);
    await page.click("#phone-dialog [data-closes]");
  };
  await shown("reached from this machine only");
  await page.route("**/v1/pairing", (route) => route.fulfill({ status: 429, body: "ten codes wait" }), { times: 1 });
  await shown("ten codes wait");
  const json = { url: "http://a.server/phone", qr_svg: null, fingerprint: null, expires_in_s: null, advice: null };
  await page.route("**/v1/pairing", (route) => route.fulfill({ json }), { times: 1 });
  await shown("a.server");
  assert.doesNotMatch(await page.textContent("#phone-body"), /minutes/);
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

test("a click on a wall of the room places an object, and with the tool Probe a probe", async () => {
  const before = await pixelsOf(page, "#picture-image");
  await page.click("#view-camera");
  const box = await page.locator("#room-canvas").boundingBox();
  const position = { x: 0.25 * box.width, y: 0.58 * box.height }; // beside the probe, in the picture, not in a corner
  await page.click("#room-canvas", { position });
  await page.waitForSelector("#objects .chip");
  await waitForChange(page, "#picture-image", before);

  await page.check('input[name="tool"][value="probe"]', { force: true });
  for (const x of [0.65, 0.75]) {
    await page.mouse.click(box.x + x * box.width, box.y + 0.6 * box.height); // the second before the answer to the first
  }
  for (const left of [2, 1]) {
    await page.waitForFunction((count) => document.getElementById("probe-select").options.length === count, left + 1);
    await page.selectOption("#probe-select", `probe-${left + 1}`);
    await page.click("#probe-remove:not(:disabled)");
  }
  await page.waitForFunction(() => document.getElementById("probe-select").options.length === 1);
  openAgainNext();
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
  const [x, , z] = (await control("state", { session: "room" })).probes["probe-1"];
  await page.fill("#probe-y", "0.4");
  await page.keyboard.press("Tab");
  await waitForChange(page, "#panorama-canvas", before);
  const { probes } = await waitForState("room", ({ probes }) => probes["probe-1"][1] === 0.4);
  assert.deepEqual(probes["probe-1"], [x, 0.4, z]); // not as the fields round them
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
  for (const [label, name] of [["HDR", "room-probe-1-8.hdr"], ["Picture", "room-8.jpg"]]) {
    const download = page.waitForEvent("download");
    await page.click(`#downloads button:text-is("${label}")`);
    assert.equal((await download).suggestedFilename(), name);
  }
  assert.ok(await page.isDisabled('#downloads button:text-is("EXR")'));
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
  const arrows = () => page.evaluate(() => {
    const meshes = globalThis.roomlightPage.view.scene.getObjectsByProperty("type", "Mesh");
    return meshes.filter(({ geometry }) => geometry.type === "ConeGeometry").map(({ material }) => material.uuid);
  });
  const before = new Set(await arrows());
  assert.ok(before.size > 1);
  await control("push", { session: "room", count: 1 });
  await waitForFrame(page, "#panorama-canvas", frames.last_index + 2);
  assert.ok((await arrows()).some((material) => before.has(material))); // three.js compiles a shader for a new one
});

test("probes that another client adds and removes come and go with the next frame", async () => {
  for (const [method, count] of [["PUT", 2], ["DELETE", 1]]) {
    const body = method === "PUT" ? JSON.stringify({ position: [0.2, 1, 0.1] }) : undefined;
    await page.evaluate((request) => fetch("v1/sessions/room/probes/other", request), { method, body, headers: { "content-type": "application/json" } });
    await control("push", { session: "room", count: 1 });
    await page.waitForFunction((count) => document.getElementById("probe-select").options.length === count, count);
  }
});

test("a probe that is dragged back to its place shows the light of new frames", async () => {
  const from = await page.evaluate(() => globalThis.roomlightPage.probeAt("probe-1"));
  for (let press = 0; press < 3; press++) {
    await page.mouse.move(from.x, from.y); // the first press leaves the probe on a whole millimetre, where it returns to exactly
    await page.mouse.down();
    await page.mouse.move(from.x + 2, from.y);
    await page.mouse.move(from.x, from.y);
    await page.mouse.up();
  }
  await control("push", { session: "room", count: 1 });
  const { frames } = await control("state", { session: "room" });
  await waitForFrame(page, "#panorama-canvas", frames.last_index);
});

test("a second finger does not move the probe that the first one holds", async () => {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, hasTouch: true });
  const phone = await context.newPage();
  await phone.goto(page.url());
  await waitForLight(phone);
  const { x, y } = await phone.evaluate(() => globalThis.roomlightPage.probeAt("probe-1"));
  const devtools = await context.newCDPSession(phone);
  const touch = (type, ...touchPoints) => devtools.send("Input.dispatchTouchEvent", { type, touchPoints });
  const before = (await control("state", { session: "room" })).probes;
  const first = { x, y, id: 1 };
  await touch("touchStart", first);
  await phone.waitForFunction(() => !globalThis.roomlightPage.view.controls.enabled);
  await touch("touchStart", first, { x: x + 150, y: y + 60, id: 2 });
  for (let step = 1; step <= 5; step++) {
    await touch("touchMove", first, { x: x + 150 + 10 * step, y: y + 60 + 5 * step, id: 2 });
  }
  await touch("touchEnd");
  await phone.waitForFunction(() => globalThis.roomlightPage.view.controls.enabled);
  await control("push", { session: "room", count: 1 });
  const { frames, probes } = await control("state", { session: "room" });
  await waitForFrame(phone, "#panorama-canvas", frames.last_index);
  assert.deepEqual(probes, before);
  await context.close();
});

test("a session without a history, as after a restart, has its counts", async () => {
  const other = await browser.newPage();
  const empty = { stride: 1, bytes: 0, limit_bytes: 1, entries: [] };
  await other.route("**/history?*", (route) => route.fulfill({ json: empty }));
  await other.route("**/v1/sessions", async (route) => {
    const { sessions } = await (await route.fetch()).json();
    sessions.forEach(({ frames }) => (frames.gaps = 7));
    await route.fulfill({ json: { sessions } });
  });
  await other.goto(page.url());
  await other.waitForFunction(() => /^None kept/.test(document.getElementById("timeline-text").textContent));
  await other.waitForFunction(() => document.querySelectorAll("#counts dd")[2].textContent === "7");
  const asked = [];
  for (let poll = 0; poll < 4; poll++) {
    asked.length = 0;
    await other.waitForResponse((response) => response.url().endsWith("/v1/sessions"));
    other.on("request", (request) => /camera|history/.test(request.url()) && asked.push(request.url()));
  }
  assert.deepEqual(asked, []); // without new frames nothing of the session
  await other.close();
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

test("a browser that gives noise in place of pixels tints nothing", async () => {
  const other = await browser.newPage();
  await other.addInitScript(() => {
    const { prototype } = OffscreenCanvasRenderingContext2D;
    prototype.getImageData = (_x, _y, width, height) => new ImageData(new Uint8ClampedArray(4 * width * height).fill(77), width, height);
  });
  await other.goto(page.url());
  await waitForLight(other);
  const panorama = () => other.evaluate(() => document.getElementById("panorama-canvas").toDataURL());
  const before = await panorama();
  await other.check("#coverage-tint");
  await nextDrawing(other);
  assert.equal(await panorama(), before);
  await other.close();
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

test("the last probe is removed, and stays so", async () => {
  await page.click("#probe-remove");
  await page.waitForFunction(() => document.getElementById("probe-select").options.length === 0);
  for (let frame = 0; frame < 2; frame++) {
    await control("push", { session: "room", count: 1 });
    const { frames } = await control("state", { session: "room" });
    await waitForFrame(page, "#picture-image", frames.last_index);
  }
  assert.deepEqual((await control("state", { session: "room" })).probes, {});
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
