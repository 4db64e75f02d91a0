// The phone's page, as a WebXR phone emulated by iwer, and with Chromium's fake camera. Pictures go to the folder
// SCREENSHOTS, if it is set.

import assert from "node:assert/strict";
import { createRequire } from "node:module";
import { after, test } from "node:test";
import { launch, PAGE_URL } from "./support.mjs";

const IWER = createRequire(import.meta.url).resolve("iwer").replace(/lib\/index\.js$/, "build/iwer.min.js");
const token = process.env.PAGE_TOKEN;
const browser = await launch("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream");
after(() => browser.close());

/** An Android phone: iwer has poses and sessions; the camera's texture and the depth are painted here. */
function emulatePhone({ camera, depth }) {
  const { IWER } = globalThis;
  const features = ["viewer", "local", "local-floor", "dom-overlay", "depth-sensing", ...(camera ? ["camera-access"] : [])];
  const device = new IWER.XRDevice(
    {
      name: "phone",
      controllerConfig: undefined,
      supportedSessionModes: ["inline", "immersive-ar"],
      supportedFeatures: features,
      supportedFrameRates: [30],
      isSystemKeyboardSupported: false,
      internalNominalFrameRate: 30,
      environmentBlendModes: { "immersive-ar": "alpha-blend" },
      interactionMode: "screen-space",
      userAgent: navigator.userAgent,
    },
    { stereoEnabled: false, fovy: 1, ipd: 0 },
  );
  device.installRuntime({ forceInstall: true });
  device.position.set(0.3, 1.4, 0.2);
  globalThis.phone = device;
  globalThis.XRWebGLBinding = class {
    constructor(_session, gl) {
      this.gl = gl;
    }
    getCameraImage({ width, height }) {
      const { gl } = this;
      const rgba = new Uint8Array(width * height * 4);
      for (let at = 0; at < width * height; at++) {
        rgba.set(at % width < width / 2 ? [240, 30, 30, 255] : [30, 240, 30, 255], 4 * at);
      }
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.bindTexture(gl.TEXTURE_2D, null);
      return texture;
    }
  };
  Object.defineProperty(IWER.XRView.prototype, "camera", { get: () => ({ width: 640, height: 480 }) });
  IWER.XRFrame.prototype.getDepthInformation = () =>
    depth
      ? {
          width: 48,
          height: 64, // of the sensor, turned by 90 degrees from the view
          data: new Uint16Array(48 * 64).fill(1500).buffer,
          rawValueToMeters: 0.001,
          normDepthBufferFromNormView: { matrix: [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1] },
        }
      : null;
}

async function open(phone) {
  const context = await browser.newContext({ viewport: { width: 390, height: 780 }, permissions: ["camera"] });
  after(() => context.close());
  const code = await link();
  const page = await context.newPage();
  const heard = [];
  page.on("pageerror", (error) => heard.push(String(error)));
  page.on("console", (message) => heard.push(message.text()));
  page.on("request", (request) => heard.push(request.url()));
  if (phone) {
    await page.addInitScript({ path: IWER });
    await page.addInitScript(emulatePhone, phone);
  }
  await page.goto(`${PAGE_URL}/phone#pair=${code}`);
  await page.getByRole("button", { name: "Start" }).waitFor();
  await page.waitForFunction(() => localStorage.getItem("roomlight-token") !== null);
  const own = await page.evaluate(() => localStorage.getItem("roomlight-token"));
  return { page, context, heard, code, own };
}

/** Call the server with the token of the operator, or of a phone. */
async function call(method, path, bearer = token, json) {
  const headers = { authorization: `Bearer ${bearer}`, ...(json && { "content-type": "application/json" }) };
  const response = await fetch(`${PAGE_URL}${path}`, { method, headers, body: JSON.stringify(json) });
  return response.status === 204 ? null : response.json();
}

/** The code of a link for one phone. */
async function link() {
  const { url } = await call("POST", "/v1/pairing");
  return url.split("#pair=")[1];
}

const figure = (page, name) => page.locator(".figures div", { hasText: name }).locator("dd").innerText();

/** Wait until at least so many frames are in the light, and its panorama is shown. */
async function lit(page, count) {
  await page.waitForFunction(
    (least) => {
      const shown = document.querySelector(".panorama");
      const values = [...document.querySelectorAll(".figures dd")].map((one) => Number.parseFloat(one.textContent));
      return values[1] >= least && shown.dataset.frame !== undefined && shown.width === 128 && !shown.hidden;
    },
    count,
    { timeout: 60_000 },
  );
}

async function sessions(bearer = token) {
  return (await call("GET", "/v1/sessions", bearer)).sessions;
}

/** The bounds of the room that a phone's session shows, in metres; asked for until there is one. */
async function roomSize(bearer) {
  for (;;) {
    const [first] = await sessions(bearer);
    const headers = { authorization: `Bearer ${bearer}` };
    const answer = first && (await fetch(`${PAGE_URL}/v1/sessions/${first.id}/mesh`, { headers }));
    if (answer?.ok) {
      const glb = Buffer.from(await answer.arrayBuffer());
      const { accessors } = JSON.parse(glb.subarray(20, 20 + glb.readUInt32LE(12)).toString());
      const [{ min, max }] = accessors; // of the positions
      return max.map((value, axis) => value - min[axis]);
    }
  }
}

/** Start, and check that what the server found is no wall at one distance from a camera that looks along -z. */
async function depthWasEstimated(page, heard, own) {
  await page.getByRole("button", { name: "Start" }).click();
  await lit(page, 1);
  const size = await roomSize(own);
  assert.ok(size[2] > 0.1, `the room is ${size} m, as far as its camera looks: its depth is one number`);
  assert.deepEqual(noErrors(heard), []);
}

/** Ask again until it holds; the test's own limit ends that. */
async function until(holds) {
  while (!(await holds())) {
    await new Promise(setImmediate);
  }
}

async function picture(page, name) {
  if (process.env.SCREENSHOTS) {
    await page.screenshot({ path: `${process.env.SCREENSHOTS}/${name}.png` });
  }
}

const noErrors = (heard) => heard.filter((line) => /error|refused|token=|pair=/i.test(line) || line.includes(token));

test("a WebXR phone sends frames with poses and depth", async () => {
  const { page, heard } = await open({ camera: true, depth: true });
  assert.equal(await page.evaluate(() => location.hash), "");
  await picture(page, "phone-start");
  await page.getByRole("button", { name: "Start" }).click();
  await lit(page, 2);
  assert.equal(await page.locator(".state").innerText(), "Connected");
  const [first] = await sessions();
  assert.equal(first.frames.refused, 0);
  const { camera_to_world: pose, intrinsics } = await call("GET", `/v1/sessions/${first.id}/camera`);
  assert.deepEqual(pose.slice(12, 15).map((value) => Math.round(value * 1000) / 1000), [0.3, 1.4, 0.2]);
  assert.ok(Math.abs(intrinsics.fy - 240 / Math.tan(0.5)) < 1, `fovy is 1 radian: ${JSON.stringify(intrinsics)}`);
  await picture(page, "phone-webxr");
  // iwer lays its canvas over the page, where a phone shows the overlay on top: the click goes to the button itself
  await page.getByRole("button", { name: "Stop" }).dispatchEvent("click");
  await page.getByRole("button", { name: "Start" }).waitFor();
  assert.equal(await page.locator(".state").innerText(), "Ended");
  await page.getByRole("button", { name: "Start" }).click();
  await lit(page, 1);
  assert.equal((await sessions()).length, 2); // of two AR sessions, whose origins differ
  await page.getByRole("button", { name: "Stop" }).dispatchEvent("click");
  await page.getByRole("button", { name: "Start" }).waitFor();
  assert.deepEqual(noErrors(heard), []);
});

test("what fails in AR is shown, and the phone can start again", async () => {
  const { page } = await open({ camera: true, depth: true });
  await page.evaluate(() => {
    globalThis.XRWebGLBinding.prototype.getCameraImage = () => {
      throw new Error("the camera has no picture");
    };
  });
  await page.getByRole("button", { name: "Start" }).click();
  await page.getByText("the camera has no picture").waitFor();
  await page.getByRole("button", { name: "Start" }).waitFor();
});

test("a phone whose AR fails at once closes its stream", async () => {
  const { page } = await open({ camera: true, depth: true });
  await page.evaluate(() => {
    globalThis.XRWebGLBinding = function () {
      throw new Error("there is no binding");
    };
  });
  const [socket] = await Promise.all([page.waitForEvent("websocket"), page.getByRole("button", { name: "Start" }).click()]);
  await (socket.isClosed() || socket.waitForEvent("close"));
  assert.equal(await page.locator(".problem").innerText(), "there is no binding");
});

test("a WebXR phone without depth says who estimates it", async () => {
  const { page, heard, own } = await open({ camera: true, depth: false });
  await depthWasEstimated(page, heard, own);
  assert.match(await page.locator(".note").innerText(), /no depth.*server estimates/);
});

for (const [name, phone] of [
  ["without WebXR", null],
  ["whose WebXR gives no camera", { camera: false, depth: true }],
]) {
  test(`a browser ${name} sends photos`, async () => {
    const { page, heard, own } = await open(phone);
    await depthWasEstimated(page, heard, own);
    const [{ id }] = await sessions(own);
    await call("DELETE", `/v1/sessions/${id}`, own); // as a server that is started again
    await lit(page, 2);
    const scene = `/v1/sessions/${id}/scene`; // each photo is another session of this name
    await until(async () => (await call("PUT", scene, own, { title: "Kitchen", objects: [] })).title === "Kitchen");
    await lit(page, 1 + Number(await figure(page, "Frames sent")));
    await until(async () => (await call("GET", scene, own)).title === "Kitchen");
    assert.match(await page.locator(".note").innerText(), /photos/);
    await picture(page, `phone-photos-${phone ? "refused" : "plain"}`);
    await page.getByRole("button", { name: "Stop" }).click();
    await page.getByRole("button", { name: "Start" }).waitFor();
    assert.ok(Number(await figure(page, "Frames sent")) >= 2);
    assert.deepEqual(noErrors(heard), []);
  });
}

test("a browser that gives noise in place of pixels sends none, and the page says what to allow", async () => {
  const { page } = await open(null);
  await page.evaluate(() => {
    OffscreenCanvasRenderingContext2D.prototype.getImageData = () => new ImageData(new Uint8ClampedArray(4).fill(77), 1, 1);
  });
  await page.getByRole("button", { name: "Start" }).click();
  await page.getByText("allow canvas data for this site").waitFor();
  assert.equal(await figure(page, "Frames sent"), "0");
});

test("a phone has a token and sessions of its own until it is removed", async () => {
  const [first, second] = [await open({ camera: true, depth: true }), await open(null)];
  assert.notEqual(first.own, second.own);
  assert.notEqual(first.own, token);
  await first.page.getByRole("button", { name: "Start" }).click();
  await lit(first.page, 1);
  const [{ id }] = await sessions(first.own);
  assert.deepEqual(await sessions(second.own), []);
  assert.equal((await call("GET", `/v1/sessions/${id}`, second.own)).type, "urn:roomlight:problem:session-not-found");
  assert.equal((await call("GET", `/v1/sessions/${id}`)).id, id);

  const again = await first.context.newPage(); // the same code in the same phone: the token is kept
  await again.goto(`${PAGE_URL}/phone#pair=${first.code}`);
  await again.getByRole("button", { name: "Start" }).click();
  await lit(again, 1);

  const { phones } = await call("GET", "/v1/phones");
  const { id: phone } = phones.find(({ sessions }) => sessions.includes(id));
  await call("DELETE", `/v1/phones/${phone}`);
  await again.reload();
  await again.getByRole("button", { name: "Start" }).click();
  await again.getByText("The server does not know this phone").waitFor();
  await again.goto(`${PAGE_URL}/phone#pair=${await link()}`); // another code in the same tab
  await again.getByText("Paired, ready").waitFor();
  assert.notEqual(await again.evaluate(() => localStorage.getItem("roomlight-token")), first.own);
  assert.equal((await call("GET", `/v1/sessions/${id}`)).id, id); // the operator still has what it saw
});

test("a wrong token is asked for", async () => {
  const { page } = await open(null);
  await page.evaluate(() => sessionStorage.setItem("roomlight-token", "wrong"));
  await page.reload();
  await page.getByRole("button", { name: "Start" }).click();
  await page.getByLabel("Token of the server").fill(token);
  await page.getByRole("button", { name: "Use" }).click();
  await page.getByRole("button", { name: "Start" }).click();
  await lit(page, 1);
});
