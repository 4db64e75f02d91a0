// Chromium, the control server of tests/page/page_control.py, and axe.

import { existsSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const EXECUTABLES = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
const ARGUMENTS = [
  ...["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run"],
  ...["--disable-background-networking", "--disable-component-update", "--disable-sync"],
];
const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

const PATIENCE_MS = 150_000; // the first composite of a process may compile kernels
/** For conditions that cost more than a look at an element: they are not asked with each drawing. */
const SELDOM = { polling: 100 };

export const PAGE_URL = process.env.PAGE_URL;

export function launch(...more) {
  const executablePath = process.env.CHROMIUM ?? EXECUTABLES.find((path) => existsSync(path));
  if (!executablePath) {
    throw new Error(`Chromium is needed, at one of ${EXECUTABLES.join(", ")} or at the path in CHROMIUM`);
  }
  return chromium.launch({ executablePath, args: [...ARGUMENTS, ...more] });
}

/** Give a command to the server's control; see page_control.py. */
export async function control(command, parameters = {}) {
  const response = await fetch(`${process.env.CONTROL_URL}/${command}?${new URLSearchParams(parameters)}`, { method: "POST" });
  return response.json();
}

/** A new window with the page. `errors` collects what the page's scripts report. */
export async function openPage(browser, { width = 1440, height = 900, colorScheme = "light", url = PAGE_URL } = {}) {
  const page = await browser.newPage({ viewport: { width, height }, colorScheme });
  page.setDefaultTimeout(PATIENCE_MS);
  const errors = [];
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  await page.goto(url);
  return { page, errors };
}

/** Wait until the panels show a session with its room, its picture and the light of a probe. */
export async function waitForLight(page) {
  await page.waitForFunction(() => document.getElementById("room-waiting").hidden);
  await page.waitForSelector("#picture-image[data-frame]");
  await page.waitForFunction(() => document.getElementById("lights").children.length > 0);
}

/** What axe finds in the page. */
export async function violations(page) {
  await page.evaluate(AXE);
  const { violations: found } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  return found.map(({ id, nodes }) => `${id}: ${nodes.map(({ target, failureSummary }) => `${target} ${failureSummary}`).join("; ")}`);
}

/** Wait until a canvas shows a frame's picture or light: `frame`, or any. */
export async function waitForFrame(page, selector, frame) {
  const isShown = ([selector, frame]) => {
    const shown = document.querySelector(selector).dataset.frame;
    return frame === undefined ? shown !== undefined : shown === String(frame);
  };
  await page.waitForFunction(isShown, [selector, frame], { timeout: PATIENCE_MS });
}

/** The pixels of a canvas, 64 x 32. Waits until it shows a picture, and one that differs from `before` by more than `least`. */
async function readPixels(page, selector, before, least) {
  const isShown = ([selector, before, least]) => {
    const canvas = document.querySelector(selector);
    if (canvas.dataset.frame === undefined) {
      return null;
    }
    const copy = new OffscreenCanvas(64, 32).getContext("2d");
    copy.drawImage(canvas, 0, 0, 64, 32);
    const now = [...copy.getImageData(0, 0, 64, 32).data];
    return before === null || now.some((value, at) => Math.abs(value - before[at]) > least) ? now : null;
  };
  const read = await page.waitForFunction(isShown, [selector, before, least], { timeout: PATIENCE_MS, ...SELDOM });
  return read.jsonValue();
}

/** The pixels of a canvas that shows a picture, 64 x 32. Waits until it shows one. */
export const pixelsOf = (page, selector) => readPixels(page, selector, null, 0);

/** Wait until the page draws again: a pause between two questions to the server, which works on the same processor. */
export const nextDrawing = (page) => page.evaluate(() => new Promise(requestAnimationFrame));

/** Wait until the server's state of a session, or its `scene`, is as wanted; returns it. `waitForFunction` awaits no answer. */
export async function waitForState(session, isWanted, what = "state") {
  const end = Date.now() + PATIENCE_MS;
  for (;;) {
    const state = await control(what, { session });
    if (isWanted(state)) {
      return state;
    }
    if (Date.now() > end) {
      throw new Error(`the ${what} of ${session} stays ${JSON.stringify(state)}`);
    }
    await new Promise(setImmediate);
  }
}

/** The largest difference of two lists of pixels. */
export function difference(one, other) {
  return Math.max(...one.map((value, at) => Math.abs(value - other[at])));
}

/** Wait until the pixels differ from `before` by more than `least`; returns them. */
export async function waitForChange(page, selector, before, least = 8) {
  try {
    return await readPixels(page, selector, before, least);
  } catch (error) {
    const notices = await page.locator(".notice").allInnerTexts();
    throw new Error(`${selector} did not change (${error}); notices: ${notices.join("; ") || "none"}`);
  }
}
