// Recordings that are dropped on the page or chosen.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { launch, openPage, waitForLight } from "./support.mjs";

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
  await page.click("#play-sample");
  await waitForLight(page);
  assert.match(await page.title(), /^Sample-room-/);
  await page.waitForFunction(() => location.hash.includes("probe="));
  const { page: other } = await openPage(browser, { url: page.url() });
  await waitForLight(other);
  assert.equal(await other.title(), await page.title());
  await other.close();
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
});

test("a chosen .r3d file is uploaded and played", async () => {
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
  assert.match(await error.innerText(), /r3d|archive|zip|recording/i);
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
