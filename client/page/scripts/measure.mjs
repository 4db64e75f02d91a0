// First paint, frame rate and Lighthouse's scores of the live page:
//   node scripts/measure.mjs                          with a server and a stream of its own; needs `roomlight` in PATH
//   node scripts/measure.mjs http://127.0.0.1:8090/   of a page that is being served
// Chromium renders in software unless GPU=1 is set; then the frame rate is below that of a real screen, and says what the
// processor can do. PROFILE=1 lists functions by time, TRACE=FILE writes a trace of DevTools while frames arrive.

import { existsSync } from "node:fs";
import { cpus, loadavg } from "node:os";
import lighthouse from "lighthouse";
import { chromium } from "playwright-core";
import { sampleStream } from "./sample_stream.mjs";

const LOADS = 5;
const WATCHED_S = 8;
const PORT = 9333;
const TRACED = ["devtools.timeline", "disabled-by-default-devtools.timeline.frame", "toplevel", "cc", "gpu", "viz", "benchmark"];
const stream = process.argv[2] ? null : await sampleStream();
const url = process.argv[2] ?? stream.url;
const executablePath = process.env.CHROMIUM ?? ["/usr/bin/chromium", "/usr/bin/google-chrome"].find((path) => existsSync(path));
const software = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const browser = await chromium.launch({
  executablePath,
  ignoreDefaultArgs: ["--disable-back-forward-cache"],
  args: ["--no-sandbox", `--remote-debugging-port=${PORT}`, ...(process.env.GPU ? [] : software)],
});

/** Processor time of the page's main thread so far, by kind, milliseconds. Waiting for a processor is not in it. */
async function mainThread(devtools) {
  const { metrics } = await devtools.send("Performance.getMetrics");
  const ms = (name) => 1000 * metrics.find((metric) => metric.name === name).value;
  const [script, layout, style, all] = ["ScriptDuration", "LayoutDuration", "RecalcStyleDuration", "TaskDuration"].map(ms);
  return { script, layout, style, other: all - script - layout - style };
}

/** Frames of the screen for some seconds, and what the page did meanwhile. */
const watch = (seconds) =>
  new Promise((resolve) => {
    const { roomlightPage } = globalThis;
    const first = { draws: roomlightPage.frames, parts: structuredClone(roomlightPage.parts) };
    const gaps = [];
    let arrived = 0;
    const pictures = new MutationObserver(() => arrived++);
    pictures.observe(document.getElementById("picture-image"), { attributeFilter: ["data-frame"] });
    let last = performance.now();
    const end = last + 1000 * seconds;
    const tick = (now) => {
      gaps.push(now - last);
      last = now;
      if (now < end) {
        return requestAnimationFrame(tick);
      }
      const parts = [...roomlightPage.parts].map(([part, { count, total_ms, longest_ms }]) => {
        const before = first.parts.get(part) ?? { count: 0, total_ms: 0 };
        return { part, count: count - before.count, total_ms: total_ms - before.total_ms, longest_ms };
      });
      pictures.disconnect();
      gaps.sort((a, b) => a - b);
      resolve({
        ticks: gaps.length,
        late: gaps.filter((gap) => gap > 25).length,
        p95_ms: gaps[Math.floor(0.95 * gaps.length)],
        longest_ms: gaps.at(-1),
        draws: roomlightPage.frames - first.draws,
        arrived,
        parts,
      });
    };
    requestAnimationFrame(tick);
  });

/** Turn the room's view all the time, as a drag does. */
const turn = () => {
  const step = () => {
    document.getElementById("room-canvas").dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
    globalThis.turning = requestAnimationFrame(step);
  };
  step();
};

async function measureFrames(page, devtools, what) {
  const before = await mainThread(devtools);
  const { ticks, late, p95_ms, longest_ms, draws, arrived, parts } = await page.evaluate(watch, WATCHED_S);
  const after = await mainThread(devtools);
  console.log(
    `${what}: ${(ticks / WATCHED_S).toFixed(1)} frames/s of the page, 95 % within ${p95_ms.toFixed(0)} ms, ${late} ` +
      `later than 25 ms, longest ${longest_ms.toFixed(0)} ms; ${arrived} frames of the stream, ${draws} drawings of the room in ${WATCHED_S} s`,
  );
  const kinds = Object.entries(after).map(([kind, ms]) => [kind, ms - before[kind]]);
  const all = kinds.reduce((sum, [, ms]) => sum + ms, 0);
  const each = (count) => (count > 0 ? `${(all / count).toFixed(1)} ms` : "no");
  console.log(
    `  main thread, processor time: ${each(ticks)} a frame of the page, ${each(arrived)} a frame of the stream ` +
      `(${kinds.map(([kind, ms]) => `${kind} ${(ms / ticks).toFixed(2)}`).join(", ")} ms a frame of the page)`,
  );
  for (const { part, count, total_ms, longest_ms: longest } of parts.filter(({ count }) => count > 0)) {
    console.log(`  ${part}: ${count} times, ${(total_ms / count).toFixed(2)} ms each, longest ${longest.toFixed(1)} ms`);
  }
}

console.log(`${new Date().toISOString()}: ${browser.version()}, ${cpus().length} cores, ${cpus()[0].model}`);
console.log(`processes that want a core before the start: ${loadavg()[0].toFixed(1)} on average over the last minute`);
const page = await browser.newPage({ viewport: { width: 1440, height: 900 } });
page.on("console", (message) => message.type() === "error" && console.log(`error in the console: ${message.text()} ${message.location().url}`));
await page.goto(url);
await page.waitForSelector("#workspace:not([hidden])", { timeout: 60_000 });
await page.waitForFunction(() => document.getElementById("room-waiting").hidden, undefined, { timeout: 60_000 });
const drawnBy = await page.evaluate(() => (globalThis.roomlightPage.view.isSoftware ? "the processor" : "a graphics processor"));
console.log(`the room is drawn by ${drawnBy}`);
const devtools = await page.context().newCDPSession(page);
await devtools.send("Performance.enable", { timeDomain: "threadTicks" });
const before = await page.textContent("#timeline-text");
const arrives = (text) => document.getElementById("timeline-text").textContent !== text;
const moves = await page.waitForFunction(arrives, before, { timeout: 20_000 }).then(
  () => "while frames arrive",
  () => "no frames arrive",
);
if (process.env.TRACE) {
  await browser.startTracing(page, { path: process.env.TRACE, categories: TRACED });
}
await measureFrames(page, devtools, moves);
if (process.env.TRACE) {
  await browser.stopTracing();
}
await page.evaluate(turn);
await measureFrames(page, devtools, `${moves}, the view turns`);
if (process.env.PROFILE) {
  await devtools.send("Profiler.enable");
  await devtools.send("Profiler.start");
  await page.evaluate(watch, WATCHED_S);
  const { profile } = await devtools.send("Profiler.stop");
  const self = new Map();
  profile.samples.forEach((id, at) => self.set(id, (self.get(id) ?? 0) + profile.timeDeltas[at] / 1000));
  const byName = new Map();
  for (const { id, callFrame } of profile.nodes) {
    const name = `${callFrame.functionName || "anonymous"} ${callFrame.url.split("/").at(-1)}:${callFrame.lineNumber}:${callFrame.columnNumber}`;
    byName.set(name, (byName.get(name) ?? 0) + (self.get(id) ?? 0));
  }
  for (const [name, ms] of [...byName].sort((a, b) => b[1] - a[1]).slice(0, 25)) {
    console.log(`  ${ms.toFixed(0)} ms ${name}`);
  }
}
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

stream?.pause(); // Lighthouse's Speed Index counts each change of the picture as a page that is not complete
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
const metrics = lhr.categories.performance.auditRefs.filter(({ weight }) => weight > 0).map(({ id }) => lhr.audits[id]);
for (const { title, displayValue, score } of metrics) {
  console.log(`  ${title}: ${displayValue ?? "none"} (${score === null ? "none" : Math.round(100 * score)})`);
}
for (const { id, score, scoreDisplayMode, displayValue, details } of Object.values(lhr.audits)) {
  const isMetric = metrics.some((metric) => metric.id === id);
  if (!isMetric && score !== null && score < 0.9 && scoreDisplayMode !== "informative") {
    console.log(`  failed: ${id} ${displayValue ?? ""}`);
    for (const item of process.env.DETAILS ? (details?.items ?? []) : []) {
      console.log(`    ${JSON.stringify(item).slice(0, 400)}`);
    }
  }
}
await browser.close();
stream?.stop();
