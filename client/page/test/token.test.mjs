// A server with a token: asked for, or given in the address.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { control, launch, openPage, PAGE_URL, waitForLight } from "./support.mjs";

let browser;

before(async () => {
  browser = await launch();
  await control("push", { session: "room", count: 2 });
});
after(() => browser?.close());

test("the page asks for the token, and again for a wrong one", async () => {
  const { page } = await openPage(browser);
  await page.fill("#token-input", "a wrong token");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.getElementById("token-error").textContent !== "");
  await page.fill("#token-input", process.env.PAGE_TOKEN);
  await page.keyboard.press("Enter");
  await waitForLight(page);
  await page.reload();
  await waitForLight(page); // kept for this tab
});

test("a token in the address is used and removed from it", async () => {
  const { page } = await openPage(browser, { url: `${PAGE_URL}/#token=${process.env.PAGE_TOKEN}` });
  await waitForLight(page);
  assert.equal(new URL(page.url()).hash, "");
});
