// Sessions that come and go, and a server that is started again.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { control, launch, nextDrawing, openPage, PAGE_URL, waitForFrame, waitForLight } from "./support.mjs";

let browser, page;

before(async () => {
  browser = await launch();
  ({ page } = await openPage(browser));
});
after(() => browser?.close());

const connection = (text) => page.waitForFunction((text) => document.getElementById("connection").textContent.startsWith(text), text);

test("an empty server says how to start", async () => {
  await page.waitForSelector("#empty:not([hidden])");
  assert.match(await page.locator("#empty").innerText(), /sample room[\s\S]*\.r3d[\s\S]*phone/i);
  await connection("Connected");
});

test("without a session, a lost server is said in place of the ways to start", async () => {
  await control("stop");
  await page.waitForSelector("#loading:not([hidden])");
  assert.match(await page.locator("#loading").innerText(), /does not answer[\s\S]*connects by itself/);
  await control("start");
  await page.waitForSelector("#empty:not([hidden])");
});

test("the first session is shown by itself", async () => {
  await control("push", { session: "room", count: 3 });
  await waitForLight(page);
  await connection("Live");
});

test("a session on disk is shown once the server has a place for it", async () => {
  const other = await browser.newPage();
  await other.route("**/v1/sessions", async (route) => {
    const { sessions } = await (await route.fetch()).json();
    await route.fulfill({ json: { sessions: sessions.map((session) => ({ ...session, status: "saved" })) } });
  });
  const full = { type: "urn:roomlight:problem:server-full", title: "Server is full", status: 503, detail: "delete a session" };
  await other.route("**/v1/sessions/room", (route) => route.fulfill({ status: 503, contentType: "application/problem+json", json: full }));
  await other.goto(`${PAGE_URL}/#session=room`);
  await other.waitForSelector("#ended:not([hidden])");
  assert.match(await other.locator("#ended-text").innerText(), /tries again while the server lists it/);
  await other.unroute("**/v1/sessions/room");
  await waitForLight(other);
  await other.locator(".notice.calm", { hasText: "room is back" }).waitFor();
  await other.close();
});

test("a page without WebSockets seldom tries again, and does not say that its session is back", async () => {
  const other = await browser.newPage();
  await other.addInitScript(() => {
    globalThis.sockets = 0;
    globalThis.WebSocket = class extends WebSocket {
      constructor(url, protocols) {
        globalThis.sockets++;
        super(url.replace("/v1/", "/no/"), protocols); // as through a proxy that knows none
      }
    };
  });
  await other.goto(`${PAGE_URL}/#session=room`);
  await other.waitForSelector("#ended:not([hidden])");
  let polls = 0;
  await other.waitForResponse((response) => response.url().endsWith("/v1/sessions") && ++polls > 5);
  const sockets = await other.evaluate(() => globalThis.sockets);
  assert.ok(sockets < polls - 2, `${sockets} attempts in ${polls} looks at the list`);
  assert.equal(await other.locator(".notice").count(), 0);
  await other.close();
});

test("the timeline of a server that was started again with its sessions is the server's", async () => {
  const other = await browser.newPage();
  let socket;
  await other.routeWebSocket(/v1/, (made) => (socket = made).connectToServer());
  await other.goto(`${PAGE_URL}/#session=room`);
  await waitForLight(other);
  await other.waitForFunction(() => document.getElementById("timeline-text").textContent.startsWith("Frame 2"));
  await other.route("**/history?*", (route) => route.fulfill({ json: { stride: 1, bytes: 0, limit_bytes: 1, entries: [] } }));
  await socket.close({ code: 1012 });
  await other.waitForFunction(() => document.getElementById("timeline-text").textContent.startsWith("None kept"));
  await other.close();
});

test("another session is a click away", async () => {
  await control("push", { session: "hall", count: 1 });
  await page.click('[data-session="hall"]');
  await waitForLight(page);
  assert.match(await page.title(), /^hall/);
  await page.click('[data-session="room"]');
  await waitForLight(page);
});

test("a page that the Back button brings back joins its session again", async () => {
  const send = (type) => page.evaluate((type) => dispatchEvent(new PageTransitionEvent(type, { persisted: true })), type);
  await page.evaluate(() => {
    globalThis.closings = 0;
    const close = WebSocket.prototype.close;
    WebSocket.prototype.close = function (...reason) {
      globalThis.closings++;
      return close.apply(this, reason);
    };
  });
  await send("pagehide");
  await page.waitForFunction(() => globalThis.closings > 0);
  await send("pageshow");
  await control("push", { session: "room", count: 1 });
  await page.waitForFunction(() => document.getElementById("camera-frame").textContent === "Frame 3");
  await connection("Live");
});

test("a lost server is shown, and the page connects again", async () => {
  await control("stop");
  await page.waitForFunction(() => ["reconnecting", "disconnected"].includes(document.getElementById("connection").dataset.state));
  await page.waitForSelector("#gone:not([hidden])");
  await control("start");
  await page.waitForSelector("#ended:not([hidden])"); // the new server has no session
  await control("push", { session: "room", count: 2 });
  await waitForLight(page);
  await connection("Live");
  assert.ok(await page.isHidden("#gone"));
  assert.match(await page.locator("#camera-frame").innerText(), /Frame 1/);
});

test("a session that is replaced stays on the screen until its next frame", async () => {
  await waitForFrame(page, "#picture-image", 1);
  await waitForFrame(page, "#panorama-canvas", 1);
  await page.waitForFunction(() => document.querySelectorAll("#thumbnails canvas").length === 2);
  await page.evaluate(() => {
    globalThis.before = [...document.querySelectorAll("#thumbnails canvas")];
    globalThis.shown = new Set();
    const observe = (id, what, options) => {
      const element = document.getElementById(id);
      new MutationObserver(() => globalThis.shown.add(what(element))).observe(element, options);
    };
    observe("workspace", ({ hidden }) => (hidden ? "ended" : "picture-image 0"), { attributeFilter: ["hidden"] });
    observe("notices", ({ textContent }) => textContent, { childList: true });
    for (const id of ["picture-image", "panorama-canvas"]) {
      observe(id, ({ dataset }) => `${id} ${dataset.frame}`, { attributeFilter: ["data-frame"] });
    }
  });
  await fetch(`${PAGE_URL}/v1/sessions/room`, { method: "DELETE" });
  await control("push", { session: "room", count: 1 });
  await waitForFrame(page, "#picture-image", 0);
  await waitForFrame(page, "#panorama-canvas", 0);
  assert.deepEqual(await page.evaluate(() => [...globalThis.shown].sort()), ["panorama-canvas 0", "picture-image 0"]);
  await page.waitForFunction(() => {
    const [thumbnail, ...others] = document.querySelectorAll("#thumbnails canvas");
    return thumbnail && others.length === 0 && !globalThis.before.includes(thumbnail);
  });
  await connection("Live");
});

test("what is placed while the server is away is kept once it is back, and is removed with the keyboard", async () => {
  const place = async (count) => {
    await page.focus("#picture-button");
    await page.keyboard.press("Shift+ArrowLeft");
    await page.keyboard.press("Enter");
    await page.waitForFunction((count) => document.querySelectorAll("#objects .chip").length === count, count);
  };
  const kept = async (count) => {
    while ((await control("scene", { session: "room" })).objects.length !== count) {
      await nextDrawing(page);
    }
  };
  await place(1);
  await kept(1);
  await page.route("**/v1/**", (route) => route.abort());
  await page.waitForSelector("#gone:not([hidden])");
  const failed = page.waitForEvent("requestfailed", (request) => request.url().endsWith("/composite"));
  await place(2);
  await failed;
  assert.doesNotMatch(await page.locator("#notices").innerText(), /no connection|no answer/);
  await page.unroute("**/v1/**");
  await kept(2);
  const focused = () => page.evaluate(() => document.activeElement.getAttribute("aria-label") ?? document.activeElement.id);
  await page.focus('[aria-label="Remove sphere-1, mirror"]');
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.querySelectorAll("#objects .chip").length === 1);
  assert.equal(await focused(), "Remove sphere-2, mirror");
  await page.keyboard.press("Enter");
  await kept(0);
  assert.equal(await focused(), "main");
});

test("an expired session leaves the page usable", async () => {
  while (await page.isHidden("#ended")) {
    await control("expire"); // again, if a request of the page was in the way
    await nextDrawing(page);
  }
  assert.match(await page.locator("#ended-text").innerText(), /idle/);
  const asked = new Promise((resolve) => page.on("request", (request) => request.url().includes("/v1/sessions") && resolve(request.url())));
  assert.equal(await asked, `${PAGE_URL}/v1/sessions`); // nothing of the session
  const { page: other } = await openPage(browser, { url: `${PAGE_URL}/#session=never-opened&probe=table` });
  await other.waitForSelector("#ended:not([hidden])");
  assert.match(await other.locator("#ended").innerText(), /There is no session of this name[\s\S]*never-opened/);
  await other.click("#ended-close");
  await page.click("#ended-close");
  await page.waitForSelector("#empty:not([hidden])");
  await control("push", { session: "next", count: 2 });
  await waitForLight(page);
  assert.match(await page.title(), /^next/);
  await waitForLight(other);
  assert.deepEqual(await other.locator(".notice").allInnerTexts(), []); // the probe was of the other session
  await other.route("**/assets/room-*", (route) => route.abort());
  await other.reload();
  await other.waitForFunction(() => document.getElementById("room-waiting").textContent.startsWith("The room is not shown: Failed to fetch"));
  await other.close();
});
