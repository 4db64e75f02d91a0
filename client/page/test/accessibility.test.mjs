// axe finds nothing, in light and dark, wide and narrow; nothing is cut off on a narrow screen.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { control, launch, openPage, violations, waitForLight } from "./support.mjs";

let browser;

before(async () => {
  browser = await launch();
});
after(() => browser?.close());

const VIEWS = [
  { width: 1440, height: 900, colorScheme: "light" },
  { width: 1024, height: 768, colorScheme: "dark" },
  { width: 390, height: 844, colorScheme: "light" },
  { width: 390, height: 844, colorScheme: "dark" },
  { width: 844, height: 390, colorScheme: "light" },
];

test("the first link leads the keyboard to the panels, and the page stays", async () => {
  const { page } = await openPage(browser);
  await page.waitForSelector("#empty:not([hidden])");
  await page.evaluate(() => (globalThis.isSamePage = true));
  await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => location.hash === "#main" && document.activeElement.id === "main");
  assert.ok(await page.evaluate(() => globalThis.isSamePage));
  await page.close();
});

/** Look at a page in each view. */
async function inEachView(page, look) {
  for (const { colorScheme, ...size } of VIEWS) {
    await page.emulateMedia({ colorScheme });
    await page.setViewportSize(size);
    assert.deepEqual(await violations(page), [], `${colorScheme}, ${size.width} px wide`);
    await look?.(size);
  }
  await page.close();
}

test("the page without a session", async () => {
  const { page } = await openPage(browser);
  await page.waitForSelector("#empty:not([hidden])");
  await inEachView(page);
});

test("the panels of a session", async () => {
  await control("push", { session: "room", count: 4 });
  const { page } = await openPage(browser);
  await waitForLight(page);
  await page.click("#picture-button");
  await page.waitForSelector("#objects .chip");
  await page.check("#false-colour");
  await inEachView(page, async (view) => {
    const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(overflow <= 0, `${overflow} px are cut off at ${view.width} px`);
    const { height } = await page.locator("#room-canvas").boundingBox();
    assert.ok(height < 0.8 * view.height, `a room of ${height} px leaves nothing to scroll by at ${view.height} px`);
  });
});

test("the dialogs, and a menu that closes with Escape, and by a click elsewhere", async () => {
  const { page } = await openPage(browser);
  for (const [button, dialog] of [["open-recording", "recording-dialog"], ["open-phone", "phone-dialog"], ["open-film", "film-dialog"]]) {
    await page.click(`#${button}`);
    await page.waitForFunction(() => !document.querySelector("dialog[open]").innerText.includes("Loading"));
    assert.deepEqual(await violations(page), [], dialog);
    await page.keyboard.press("Escape");
    await page.waitForFunction((id) => !document.getElementById(id).open, dialog);
  }
  await page.click(".menu summary");
  await page.check("#show-coverage");
  await page.keyboard.press("Escape");
  await page.waitForSelector(".menu:not([open])");
  assert.ok(await page.evaluate(() => document.activeElement.matches(".menu summary")));
  await page.keyboard.press("Enter");
  await page.waitForSelector(".menu[open]");
  await page.click("#room-title");
  await page.waitForSelector(".menu:not([open])");
  await page.close();
});

test("every control is reached with the keyboard, in the order of the page", async () => {
  const { page } = await openPage(browser);
  await waitForLight(page);
  const reached = [];
  for (let press = 0; press < 60; press++) {
    await page.keyboard.press("Tab");
    reached.push(await page.evaluate(() => document.activeElement?.id || document.activeElement?.getAttribute("data-session") || document.activeElement?.name));
  }
  const wanted = ["open-recording", "room", "tool", "drag", "room-canvas", "picture-button", "object-shape", "exposure", "probe-x", "play", "scrub"];
  const at = wanted.map((name) => reached.indexOf(name));
  assert.ok(at.every((place) => place >= 0), `reached ${reached.join(", ")}`);
  assert.deepEqual(at, [...at].sort((a, b) => a - b));
});
