// WebXR's views and depth, compared with the specification's algorithms.

import assert from "node:assert/strict";
import { test } from "node:test";
import { packFrame } from "roomlight";
import {
  depthOfView,
  frameOfView,
  intrinsicsOfView,
  type CpuDepthLike,
  type FrameLike,
  type ViewFrame,
  type ViewLike,
} from "roomlight/webxr";
import { Matrix4, PerspectiveCamera, Vector3 } from "three";

/** Compiles only if WebXR's own types satisfy the interfaces. */
export const fits = (
  view: XRView,
  depth: XRCPUDepthInformation,
  frame: XRFrame,
): [ViewLike, CpuDepthLike, FrameLike] => [view, depth, frame];

const IDENTITY = new Matrix4();
const image = { data: new Uint8Array([255, 216, 255]), width: 40, height: 30 };

/** A camera with its principal point off the centre, like a phone's. */
function camera() {
  const found = new PerspectiveCamera(50, 4 / 3, 0.1, 100);
  found.setViewOffset(400, 300, 12, -7, 400, 300);
  found.updateProjectionMatrix();
  return found;
}

test("intrinsics project like the projection matrix", () => {
  const { projectionMatrix } = camera();
  const size = { width: 640, height: 480 };
  const { fx, fy, cx, cy } = intrinsicsOfView(projectionMatrix.elements, size);
  for (const point of [new Vector3(0.3, -0.2, -2), new Vector3(-1, 0.5, -3), new Vector3(0, 0, -1)]) {
    const clip = point.clone().applyMatrix4(projectionMatrix);
    const wanted = [((clip.x + 1) / 2) * size.width, ((1 - clip.y) / 2) * size.height]; // rows go down
    const found = [cx + (fx * point.x) / -point.z, cy - (fy * point.y) / -point.z];
    found.forEach((value, at) => assert.ok(Math.abs(value - wanted[at]!) < 1e-3, `${found} is not ${wanted}`));
  }
  assert.notEqual(cx, 320);
});

test("other projections are refused", () => {
  const skewed = [...camera().projectionMatrix.elements];
  skewed[4] = 0.1;
  for (const projection of [skewed, IDENTITY.elements, [1, 2]]) {
    assert.throws(() => intrinsicsOfView(projection, image), RangeError);
  }
});

/** A depth buffer like a browser's, and the specification's way of reading it. */
function buffer(width: number, height: number, matrix: Matrix4, isFloat: boolean, rawValueToMeters: number) {
  const values = Array.from({ length: width * height }, (_, at) => 1000 + at);
  const data = (isFloat ? Float32Array.from(values) : Uint16Array.from(values)).buffer;
  const info: CpuDepthLike = {
    width,
    height,
    data,
    rawValueToMeters,
    normDepthBufferFromNormView: { matrix: matrix.elements },
  };
  const depthInMetres = (x: number, y: number) => {
    const at = new Vector3(x, y, 0).applyMatrix4(matrix);
    const column = Math.min(Math.max(Math.trunc(at.x * width), 0), width - 1);
    return values[Math.min(Math.max(Math.trunc(at.y * height), 0), height - 1) * width + column]! * rawValueToMeters;
  };
  return { info, depthInMetres };
}

test("depth is rotated upright, in millimetres or metres", () => {
  // A phone held upright: the buffer's columns are the view's rows.
  const rotated = new Matrix4().set(0, 1, 0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1);
  const [landscape, portrait] = [{ width: 400, height: 300 }, { width: 300, height: 400 }];
  const cases = [
    [IDENTITY, landscape, false, 0.001, "uint16_mm"],
    [rotated, portrait, false, 0.001, "uint16_mm"],
    [rotated, portrait, true, 0.5, "float32_m"],
    [IDENTITY, landscape, false, 0.002, "float32_m"],
  ] as const;
  for (const [matrix, view, isFloat, raw, format] of cases) {
    const { info, depthInMetres } = buffer(16, 12, matrix, isFloat, raw);
    const { width, height, data, ...rest } = depthOfView(info, view);
    assert.deepEqual(rest, { format, encoding: "raw" });
    assert.deepEqual([width, height].sort(), [12, 16]);
    assert.ok(Math.abs(width / height - view.width / view.height) < 0.01);
    const scale = format === "uint16_mm" ? 0.001 : 1;
    for (const [column, row] of [
      [0, 0],
      [width - 1, 0],
      [3, 5],
      [width - 1, height - 1],
    ] as const) {
      const found = (data as Uint16Array)[row * width + column]! * scale;
      assert.ok(Math.abs(found - depthInMetres((column + 0.5) / width, (row + 0.5) / height)) < 1e-4);
    }
  }
});

test("depth outside the sensor's view is unknown", () => {
  const narrower = new Matrix4()
    .makeTranslation(-0.5, -0.5, 0)
    .premultiply(new Matrix4().makeScale(2, 1, 1))
    .premultiply(new Matrix4().makeTranslation(0.5, 0.5, 0));
  const { info } = buffer(16, 12, narrower, false, 0.001);
  const { width, height, data } = depthOfView(info, { width: 1920, height: 1080 });
  assert.deepEqual([width, height], [16, 9]);
  const row = Array.from((data as Uint16Array).subarray(4 * width, 5 * width));
  assert.ok(row.slice(0, 4).every((value) => value === 0) && row.slice(12).every((value) => value === 0));
  assert.ok(row.slice(4, 12).every((value) => value > 0));
  assert.throws(() => depthOfView({ ...info, data: new ArrayBuffer(7) }, image), RangeError);
});

test("a frame of a view can be packed", async () => {
  const pose = new Matrix4().makeRotationY(0.3).setPosition(1, 2, 3);
  const whole: ViewFrame = {
    view: {
      projectionMatrix: camera().projectionMatrix.elements,
      transform: { matrix: Float32Array.from(pose.elements) },
    },
    depth: buffer(16, 12, IDENTITY, false, 0.001).info,
    image,
    time_ms: 2500,
    exposure: 0.25,
  };
  const frame = frameOfView(whole);
  assert.deepEqual(
    [frame.timestamp_s, frame.exposure, frame.tracking_state, frame.colour.encoding],
    [2.5, 0.25, "normal", "jpeg"],
  );
  assert.equal(frameOfView({ ...whole, emulatedPosition: true }).tracking_state, "limited");
  const { depth, ...bare } = whole;
  assert.deepEqual(frameOfView({ ...bare, xrFrame: { getDepthInformation: () => depth as CpuDepthLike } }), frame);
  const refuse = () => {
    throw new Error("NotSupportedError: no depth-sensing");
  };
  for (const xrFrame of [undefined, {}, { getDepthInformation: () => null }, { getDepthInformation: refuse }]) {
    assert.ok(!("depth" in frameOfView({ ...bare, xrFrame })));
  }
  const packed = Buffer.from(await packFrame(frame));
  const header = JSON.parse(packed.subarray(8, 8 + packed.readUInt32LE(4)).toString());
  assert.deepEqual(header.camera_to_world.slice(12), [1, 2, 3, 1]);
  assert.deepEqual([header.colour.bytes, header.depth.bytes, header.intrinsics.width], [3, 2 * 16 * 12, 40]);
});
