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
  const { page } = await openPage(browser, { url: `${PAGE_URL}/#token=wrong&session=room` });
  await page.waitForFunction(() => document.getElementById("token-error").textContent.includes("does not know"));
  await page.fill("#token-input", "secret…");
  await page.keyboard.press("Enter");
  assert.match(await page.locator("#token-error").innerText(), /plain letters/);
  await page.keyboard.press("Escape");
  await page.keyboard.press("Escape");
  await page.fill("#token-input", process.env.PAGE_TOKEN);
  await page.keyboard.press("Enter");
  await waitForLight(page);
  assert.equal(await page.locator(".notice").count(), 0);
  await page.reload();
  await waitForLight(page); // kept for this tab
});

test("a browser that keeps nothing shows the page with the token of the address", async () => {
  const page = await browser.newPage();
  await page.addInitScript(() => {
    const get = () => {
      throw new DOMException("The operation is insecure.", "SecurityError"); // cookies are blocked
    };
    ["sessionStorage", "localStorage"].forEach((name) => Object.defineProperty(globalThis, name, { get }));
  });
  await page.goto(`${PAGE_URL}/#token=${process.env.PAGE_TOKEN}&session=room`);
  await waitForLight(page);
  await page.close();
});

test("a token in the address is used and removed from it; a phone that has been paired is listed and removed", async () => {
  const headers = { authorization: `Bearer ${process.env.PAGE_TOKEN}`, "content-type": "application/json" };
  const { url } = await (await fetch(`${PAGE_URL}/v1/pairing`, { method: "POST", headers })).json();
  const paired = { method: "POST", headers, body: JSON.stringify({ code: url.split("#pair=")[1] }) };
  const { id } = await (await fetch(`${PAGE_URL}/v1/phones`, paired)).json();
  const { page } = await openPage(browser, { url: `${PAGE_URL}/#token=${process.env.PAGE_TOKEN}` });
  await waitForLight(page);
  assert.doesNotMatch(page.url(), /token/);
  await page.click("#open-phone");
  assert.match(await page.locator("#phone-body .address").first().innerText(), /\/phone#pair=/);
  assert.doesNotMatch(await page.locator("#phone-body").innerText(), /certificate/); // not of this server
  await page.locator(".phones li", { hasText: id }).getByRole("button", { name: "Remove" }).click();
  await page.locator(".phones li", { hasText: id }).waitFor({ state: "detached" });
  assert.deepEqual((await (await fetch(`${PAGE_URL}/v1/phones`, { headers })).json()).phones, []);
});
