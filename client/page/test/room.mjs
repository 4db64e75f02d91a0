// A page that shows the session `room`, for each test of a file that imports this.

import assert from "node:assert/strict";
import { after, afterEach, before, beforeEach } from "node:test";
import { control, launch, openPage, PAGE_URL, waitForLight } from "./support.mjs";

export const ROOM = `${PAGE_URL}/#session=room`;
export let browser, page, errors;
let isOpenedAgain = true; // for the next test; without, it joins the session again, which forgets all but the forms

/** Open the page again before the next test. */
export const openAgainNext = () => (isOpenedAgain = true);

/** Close the page and open it in a new window. */
export async function openAgain() {
  await page?.close();
  ({ page, errors } = await openPage(browser, { url: ROOM }));
}

before(async () => {
  browser = await launch();
  await control("push", { session: "room", count: 8 });
  await control("push", { session: "between", count: 1 });
});
after(() => browser?.close());
beforeEach(async () => {
  await control("clear");
  if (isOpenedAgain) {
    await openAgain();
  } else {
    await page.click('[data-session="between"]');
    await page.waitForFunction(() => document.title.startsWith("between"));
    await page.click('[data-session="room"]');
    errors.length = 0;
  }
  isOpenedAgain = false;
  await waitForLight(page);
});
afterEach(({ passed }) => (isOpenedAgain ||= !passed));

export const noNotices = async () => assert.deepEqual(await page.locator(".notice:not(.calm)").allInnerTexts(), []);
