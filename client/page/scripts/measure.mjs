// First paint, frame rate and Lighthouse's scores of a page that is being served:
//   node scripts/measure.mjs http://127.0.0.1:8090/
// Stream a recording at the same time (`roomlight stream`) for a frame rate while frames arrive. Without a graphics
// processor Chromium renders in software, and the frame rate is far below that of a real screen.

import { existsSync } from "node:fs";
import lighthouse from "lighthouse";
import { chromium } from "playwright-core";

const LOADS = 5;
const WATCHED_S = 8;
const PORT = 9333;
const url = process.argv[2] ?? "http://127.0.0.1:8090/";
const executablePath = process.env.CHROMIUM ?? ["/usr/bin/chromium", "/usr/bin/google-chrome"].find((path) => existsSync(path));
const software = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const browser = await chromium.launch({
  executablePath,
  args: ["--no-sandbox", `--remote-debugging-port=${PORT}`, ...(process.env.GPU ? [] : software)],
});

const page = await browser.newPage({ viewport: { width: 1440, height: 900 } });
await page.goto(url);
await page.waitForSelector("#workspace:not([hidden])", { timeout: 60_000 });
const before = await page.textContent("#timeline-text");
const arrives = (text) => document.getElementById("timeline-text").textContent !== text;
await page.waitForFunction(arrives, before, { timeout: 20_000 }).catch(() => undefined);
const rate = await page.evaluate(
  (seconds) =>
    new Promise((resolve) => {
      const gaps = [];
      const first = globalThis.roomlightPage.frames;
      const shown = document.getElementById("timeline-text").textContent;
      let last = performance.now();
      const end = last + 1000 * seconds;
      const tick = (now) => {
        gaps.push(now - last);
        last = now;
        if (now < end) {
          return requestAnimationFrame(tick);
        }
        gaps.sort((a, b) => a - b);
        resolve({
          fps: gaps.length / seconds,
          longest_ms: gaps.at(-1),
          p95_ms: gaps[Math.floor(0.95 * gaps.length)],
          draws: globalThis.roomlightPage.frames - first,
          moved: shown !== document.getElementById("timeline-text").textContent,
        });
      };
      requestAnimationFrame(tick);
    }),
  WATCHED_S,
);
console.log(
  `${rate.moved ? "while frames arrive" : "no frames arrive"}: ${rate.fps.toFixed(1)} frames/s of the page, 95 % within ` +
    `${rate.p95_ms.toFixed(0)} ms, longest ${rate.longest_ms.toFixed(0)} ms; the room was drawn ${rate.draws} times in ${WATCHED_S} s`,
);
await page.close();

const paints_ms = [];
for (let load = 0; load < LOADS; load++) {
  const context = await browser.newContext(); // nothing cached
  const page = await context.newPage();
  await page.goto(url);
  paints_ms.push(
    await page.evaluate(
      () =>
        new Promise((resolve) =>
          new PerformanceObserver((list) =>
            list.getEntriesByName("first-contentful-paint").forEach(({ startTime }) => resolve(startTime)),
          ).observe({ type: "paint", buffered: true }),
        ),
    ),
  );
  await context.close();
}
paints_ms.sort((a, b) => a - b);
console.log(`first contentful paint: ${paints_ms.map((ms) => ms.toFixed(0)).join(", ")} ms`);

const { lhr } = await lighthouse(url, {
  port: PORT,
  onlyCategories: ["accessibility", "best-practices", "performance"],
  formFactor: "desktop",
  screenEmulation: { mobile: false, width: 1440, height: 900, deviceScaleFactor: 1, disabled: false },
  throttlingMethod: "provided",
});
for (const { title, score } of Object.values(lhr.categories)) {
  console.log(`Lighthouse ${title}: ${score === null ? "none" : Math.round(100 * score)}`);
}
for (const { id, score, scoreDisplayMode } of Object.values(lhr.audits)) {
  if (scoreDisplayMode === "binary" && score === 0) {
    console.log(`  failed: ${id}`);
  }
}
await browser.close();
