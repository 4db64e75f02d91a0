// Recordings that are dropped on the page or chosen.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { launch, openPage, waitForLight, waitForState } from "./support.mjs";

const { FOLDER, ARCHIVE } = process.env;
let browser, page;

before(async () => {
  browser = await launch();
  ({ page } = await openPage(browser));
  await page.waitForSelector("#empty:not([hidden])");
});
after(() => browser?.close());

/** The recording was played to its end; how many of its frames were dropped depends on its pace. */
const finished = (name) =>
  page.waitForFunction(
    (name) => [...document.querySelectorAll(".upload")].some(({ textContent }) => textContent.startsWith(name) && /Played [1-9]\d* frames/.test(textContent)),
    name,
  );

test("the sample room is played", async () => {
  const replay = page.waitForRequest((request) => request.url().endsWith("/replay"));
  await page.click("#play-sample");
  await waitForLight(page);
  assert.match(await page.title(), /^Sample-room-/);
  assert.equal((await replay).headers()["x-session-id"], (await page.title()).split(" ")[0]); // several servers: all goes to the session's
  await page.waitForFunction(() => location.hash.includes("probe="));
  const { page: other } = await openPage(browser, { url: page.url() });
  await waitForLight(other);
  assert.equal(await other.title(), await page.title());
  await other.locator(".upload", { hasText: "Sample room" }).waitFor(); // listed for other pages and after a reload
  await other.close();
});

test("a recording that is on the server can be played", async () => {
  await page.evaluate(() => fetch("v1/sample-recording", { method: "POST" }));
  const { page: other } = await openPage(browser, { url: page.url() });
  const session = await page.title();
  await other.click('button[aria-label="Play Sample room"]');
  await other.waitForFunction((title) => document.title !== title && document.title.startsWith("Sample-room-"), session);
  other.once("dialog", (dialog) => dialog.accept());
  await other.click(`button[aria-label="Delete ${(await other.title()).split(" ")[0]}"]`);
  await other.waitForFunction((title) => document.title === title, session);
  await other.close();
});

test("a film of the recording is made with the placed objects, refused beforehand, and cancelled", async () => {
  await finished("Sample room");
  const refusal = (text) => page.waitForFunction((text) => document.getElementById("film-refusal").textContent.includes(text), text);
  await page.click("#open-film");
  await refusal("Place an object first");
  assert.ok(await page.isDisabled("#film-make"));
  await page.click("#film-dialog [data-closes]");
  const { width, height } = await page.locator("#picture-image").boundingBox();
  await page.click("#picture-button", { position: { x: 0.5 * width, y: 0.8 * height } });
  const session = await page.evaluate(() => new URLSearchParams(location.hash.slice(1)).get("session"));
  await waitForState(session, ({ objects }) => objects.length === 1, "scene");

  await page.click("#open-film");
  await page.fill("#film-from", "11");
  await refusal("to before 10.3 s, where the recording ends");
  await page.fill("#film-from", "1");
  await page.fill("#film-length", "101");
  await refusal("at most 100.0 s of this recording");
  await page.fill("#film-length", "1");
  await page.route("**/film", (route) => route.fulfill({ status: 503, body: "no film now" }), { times: 1 });
  await page.click("#film-make:not(:disabled)");
  await page.waitForFunction(() => document.getElementById("film-text").textContent.includes("no film now"));
  await page.dblclick("#film-make:not(:disabled)");
  await page.waitForSelector("#film-progress:not([hidden])");
  await page.waitForSelector("#film-save:not([hidden])");
  assert.equal(await page.innerText("#film-text"), "The film is ready");
  const download = page.waitForEvent("download");
  await page.click("#film-save");
  const file = await download;
  assert.equal(file.suggestedFilename(), `${session}.mp4`);
  assert.equal(readFileSync(await file.path()).toString("latin1", 4, 8), "ftyp");

  await page.selectOption("#film-quality", "final");
  await page.fill("#film-length", "10");
  await page.click("#film-make:not(:disabled)");
  await page.click("#film-cancel:not([hidden])");
  await page.waitForSelector("#film-cancel", { state: "hidden" });
  assert.ok(await page.isHidden("#film-save"));
  const { recordings } = await page.evaluate(async () => (await fetch("v1/recordings")).json());
  assert.equal(recordings.find((recording) => recording.session === session).film, null);
  await page.click("#film-dialog [data-closes]");
});

test("a session is deleted after a question", async () => {
  const session = (await page.title()).split(" ")[0];
  page.once("dialog", (dialog) => dialog.accept());
  await page.click(`button[aria-label="Delete ${session}"]`);
  await page.waitForSelector("#empty:not([hidden])");
  assert.equal(await page.locator(".upload").count(), 0);
});

test("a 3D object is no recording", async () => {
  await page.setInputFiles("#file-input", { name: "chair.glb", mimeType: "model/gltf-binary", buffer: Buffer.from("glTF") });
  await page.waitForFunction(() => document.getElementById("notices").textContent.includes("chair.glb is a 3D object"));
  assert.equal(await page.locator(".upload", { hasText: "chair.glb" }).count(), 0);
});

test("a dropped folder is uploaded and played", async () => {
  const { x, y } = { x: 600, y: 400 };
  const devtools = await page.context().newCDPSession(page);
  const data = { items: [], files: [FOLDER], dragOperationsMask: 1 };
  await devtools.send("Input.dispatchDragEvent", { type: "dragEnter", x, y, data });
  await page.waitForSelector("#drop:not([hidden])");
  await devtools.send("Input.dispatchDragEvent", { type: "drop", x, y, data });
  await waitForLight(page);
  assert.match(await page.title(), /^kitchen-/);
  await finished("kitchen");
  assert.ok(await page.isHidden("#drop"));
  const notes = page.locator(".upload", { hasText: "kitchen" }).locator("details");
  assert.equal(await notes.locator("summary").innerText(), "1 note on kitchen");
  assert.ok(await notes.locator("li").isHidden());
  await notes.locator("summary").click();
  assert.match(await notes.locator("li").innerText(), /timestamps .*read as nanoseconds; store seconds/);
});

test("a chosen .r3d file is uploaded and played, also by a server that is busy for a moment", async () => {
  const busy = { status: 503, headers: { "retry-after": "0" }, body: "busy" };
  await page.route("**/files/**", (route) => route.fulfill(busy), { times: 1 });
  await page.route("**/v1/recordings/*", (route) => route.fulfill({ status: 503 }), { times: 1 }); // of a proxy
  await page.click("#open-recording");
  await page.setInputFiles("#file-input", ARCHIVE);
  await finished("hall.r3d");
  await page.waitForFunction(() => document.title.startsWith("hall-"));
  await waitForLight(page);
  await page.click('button[aria-label="Clear hall.r3d"]');
  await page.waitForFunction(() => document.querySelectorAll(".upload").length === 1);
});

test("a file that is no recording is refused with the reason", async () => {
  const file = { name: "broken.r3d", mimeType: "application/octet-stream", buffer: Buffer.from("no archive") };
  await page.setInputFiles("#file-input", file);
  const error = page.locator(".upload .error");
  await error.waitFor();
  assert.match(await error.locator("summary").innerText(), /recording/i);
  assert.ok(await error.locator("p").isHidden());
  await error.locator("summary").click();
  assert.match(await error.locator("p").innerText(), /broken\.r3d.*archive/s);
  // its session, without a frame, is gone
  await page.waitForFunction(() => ![...document.querySelectorAll(".session")].some(({ dataset }) => dataset.session.startsWith("broken-")));
  assert.doesNotMatch(await page.title(), /^broken-/);
});

test("markup in the name of a file is shown as text", async () => {
  const name = `<img src=x onerror="document.body.dataset.taken=1">.r3d`;
  await page.setInputFiles("#file-input", { name, mimeType: "application/octet-stream", buffer: Buffer.from("no archive") });
  await page.waitForFunction((name) => [...document.querySelectorAll(".upload")].some(({ textContent }) => textContent.includes(name)), name);
  assert.equal(await page.locator("img[src=x]").count(), 0);
  assert.equal(await page.evaluate(() => document.body.dataset.taken), undefined);
});

test("an upload can be cancelled", async () => {
  let release;
  const held = new Promise((resolve) => (release = resolve));
  await page.route("**/files/**", (route) => held.then(() => route.abort()).catch(() => undefined));
  const sent = page.waitForRequest("**/files/**");
  await page.setInputFiles("#file-input", ARCHIVE);
  await sent;
  const isDelete = (request) => request.method() === "DELETE" && request.url().includes("/v1/recordings/");
  const deleted = page.waitForRequest(isDelete);
  await page.click('button[aria-label="Cancel hall.r3d"]');
  await deleted;
  release();
  assert.equal(await page.locator('button[aria-label="Cancel hall.r3d"]').count(), 0);
});
