// A page in Chromium: its renderer shows light from the right directions, and it streams to ROOMLIGHT_SERVER.

import assert from "node:assert/strict";
import { existsSync, readFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { chromium, type Browser, type Page } from "playwright-core";
import { RoomLight, type Vector } from "roomlight";
import * as field from "../light_field.js";
import { serve } from "../server.js";
import { vectors } from "../vectors.js";
import type { Calls } from "./page.js";

const ROOT = new URL("../../../", import.meta.url);
const TYPES: Record<string, string> = { html: "text/html", js: "text/javascript" };
const EXECUTABLES = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
const ARGUMENTS = [
  ...["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run"],
  ...["--disable-background-networking", "--disable-component-update", "--disable-sync"],
];

let browser: Browser;
let page: Page;
const errors: string[] = [];
const cleanups: (() => void)[] = [];

before(async () => {
  const executablePath = process.env["CHROMIUM"] ?? EXECUTABLES.find((path) => existsSync(path));
  assert.ok(executablePath, `Chromium is needed, at one of ${EXECUTABLES.join(", ")} or at the path in CHROMIUM`);
  const server = await serve({ after: (end) => void cleanups.push(end as () => void) }, ({ path }) => {
    const file = new URL(`.${path}`, ROOT);
    return existsSync(file)
      ? { body: readFileSync(file), headers: { "content-type": TYPES[path.split(".").pop()!] ?? "text/plain" } }
      : { status: 404 };
  });
  browser = await chromium.launch({ executablePath, args: ARGUMENTS });
  page = await browser.newPage();
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("console", (message) => void (message.type() === "error" && errors.push(message.text())));
  await page.goto(`${server.url}/test/real_server/page.html`);
  await page.waitForFunction("globalThis.calls");
});

after(async () => {
  await browser?.close();
  cleanups.forEach((cleanup) => cleanup());
});

/** Call a function of page.ts in the page. */
function call<Name extends keyof Calls>(
  name: Name,
  ...parameters: Parameters<Calls[Name]>
): Promise<Awaited<ReturnType<Calls[Name]>>> {
  return page.evaluate(([name, parameters]) => (globalThis as never as { calls: any }).calls[name](...parameters), [
    name,
    parameters,
  ] as [string, any[]]);
}

function near(shown: readonly number[][], wanted: readonly (readonly number[])[], within: number) {
  assert.equal(shown.length, wanted.length);
  shown.forEach((pixel, at) =>
    pixel.forEach((value, channel) => {
      const what = `direction ${field.DIRECTIONS[at]}: ${pixel} is not ${wanted[at]}`;
      assert.ok(Math.abs(value - Math.min(wanted[at]![channel]!, 1)) <= within, what);
    }),
  );
}

const all = (of: (direction: Vector) => number[]) => field.DIRECTIONS.map(of);
const lambert = (normal: Vector) => normal.map((part) => 0.5 + (2 / 3) * 0.4 * part); // irradiance / pi

test("a mirror and a panorama show light in its direction", async () => {
  const wanted = all((direction) => [...field.radiance(direction)]);
  near(await call("mirrored"), wanted, 0.02); // after three.js's own filtering of the cube
  near(await call("panorama"), wanted, 0.02);
});

test("harmonics shade like the light, main light counted once", async () => {
  for (const basis of ["arcore", "arkit", "threejs"] as const) {
    near(await call("diffuse", [field.harmonicsForm(basis)]), all(lambert), 0.01);
  }
  const weak = { direction: field.unit([1, 2, 2]), intensity: [0.3, 0.2, 0.1] as Vector };
  const dim = await call("diffuse", [field.harmonicsForm("threejs"), { ...field.MAIN_LIGHT, values: weak }]);
  // A clamped cosine replaces the main light's share of the nine harmonics.
  const lobe = (cosine: number) => 1 / 4 + cosine / 2 + (5 / 32) * (3 * cosine * cosine - 1);
  near(
    dim,
    all((normal) => {
      const cosine = normal.reduce((sum, part, axis) => sum + part * weak.direction[axis]!, 0);
      return lambert(normal).map(
        (value, at) => value + (weak.intensity[at]! / Math.PI) * (Math.max(cosine, 0) - lobe(cosine)),
      );
    }),
    0.01,
  );
});

test("a sphere is lit as the server's composite lights it", async () => {
  const { session, view, inside, radiance } = JSON.parse(readFileSync(process.env["ROOMLIGHT_SPHERE"]!, "utf8"));
  const server = new RoomLight(process.env["ROOMLIGHT_SERVER"]!, { token: process.env["ROOMLIGHT_TOKEN"]! });
  const joined = await server.join(session);
  const wanted = radiance as number[];
  const mean = (values: number[]) => values.reduce((sum, value) => sum + value, 0) / values.length;
  const seenIn = async (...formats: ("hdr" | "main_light" | "sh")[]) => {
    const light = await joined.lightAt(view.position, formats.map((format) => ({ format })));
    const shown = await call("sphere", light, view);
    return (inside as number[]).map((at) => shown[at]!);
  };
  const seen = await seenIn("sh", "main_light");
  const apart = mean(seen.map((value, at) => Math.abs(value - wanted[at]!))) / mean(wanted);
  assert.ok(seen.length > 150 && apart < 0.05, `${apart} of the mean apart, at ${seen.length} values`);
  for (const form of ["hdr", "sh"] as const) {
    const ofChannel = (values: number[], channel: number) => mean(values.filter((_, at) => at % 3 === channel));
    const alone = await seenIn(form);
    for (const channel of [0, 1, 2]) {
      const ratio = ofChannel(alone, channel) / ofChannel(wanted, channel);
      assert.ok(Math.abs(ratio - 1) < 0.05, `with ${form} alone, channel ${channel} is ${ratio} times as bright`);
    }
  }
});

test("a shader samples each level of the specular mips", async () => {
  for (const [level, gain] of [1, 0.5, 0.25].entries()) {
    const texels = all((direction) => field.radiance(direction).map((value) => value * gain));
    near(await call("specular", level), texels, 0.03 + 0.08 * level * gain); // the smallest level is two texels wide
  }
});

test("a main light of intensity 0 still casts a shadow", async () => {
  const [under, beside] = (await call("shadows")) as [number[], number[]];
  assert.ok(under[0]! < 0.6 && beside[0]! > 0.95, `${under} under the box, ${beside} beside it`);
});

test("a camera's texture becomes an upright JPEG", async () => {
  const { size, pixels } = await call("quarters");
  assert.deepEqual(size, [320, 240]);
  const [topLeft, topRight, bottomLeft, bottomRight] = pixels as [number[], number[], number[], number[]];
  const isNear = (pixel: number[], wanted: number[]) => pixel.every((value, at) => Math.abs(value - wanted[at]!) < 16);
  assert.ok(isNear(topLeft, [60, 0, 0]) && isNear(topRight, [0, 60, 0]), `${pixels}`);
  assert.ok(isNear(bottomLeft, [240, 0, 0]) && isNear(bottomRight, [0, 240, 0]), `${pixels}`);
});

test("a camera's image is averaged when it is scaled down", async () => {
  for (const value of await call("stripes")) {
    assert.ok(Math.abs(value - 255 / 8) < 4, `${value} is not the mean of seven black columns and a white one`);
  }
});

test("the page streams frames and shows the server's light", async () => {
  const [url, token] = [process.env["ROOMLIGHT_SERVER"]!, process.env["ROOMLIGHT_TOKEN"]!];
  const plain = vectors().map(({ frame }) => frame);
  const asArrays = JSON.parse(JSON.stringify(plain, (_, value) => (value instanceof Uint8Array ? [...value] : value)));
  const { statuses, gone, ahead, coverage, unchanged } = await call("session", url, token, asArrays);
  assert.deepEqual(statuses, ["processed", "processed", "processed", "processed"]);
  assert.deepEqual([gone, unchanged], [404, true]);
  assert.ok(coverage > 0.03);
  const [left, right] = ahead as [number[], number[]];
  assert.ok(
    left[0]! > 2 * left[1]! && right[1]! > 2 * right[0]!,
    `red on the left, green on the right: ${left}, ${right}`,
  );
  assert.deepEqual(
    errors.filter((text) => !text.includes("404")),
    [],
  );
});
